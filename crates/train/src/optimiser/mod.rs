//! How weights move: parameters by name, gradients, Adam, the learning rate's course, the moving average.

mod adam;
mod average;
mod loss_scale;
mod parameters;
mod schedule;

pub use adam::AdamOptimiser;
pub use average::Average;
pub use loss_scale::LossScale;
pub use parameters::{Gradients, NamedTensors, ParameterError, assign, first_non_finite, gradients, values};
pub(crate) use parameters::{from_vec, to_vec};
pub use schedule::rate;
