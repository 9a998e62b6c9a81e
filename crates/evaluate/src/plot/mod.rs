//! Plots as SVG: [`Axis`] from values to places, [`curve`] over training steps.

mod axis;
mod curve;

pub use axis::{Axis, Scale};
pub use curve::{Point, curve, short};

/// Text that is not data.
pub(crate) const SOFT: &str = "#6b6b6b";
/// Lines behind data.
pub(crate) const GRID: &str = "#e4e4e4";
/// The main line of a plot; dark enough on white for everyone.
pub(crate) const MAIN: &str = "#20639b";
