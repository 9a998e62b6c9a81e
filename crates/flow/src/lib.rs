//! Optical flow: PWC-Net, its losses and metrics, its weights, and the alignment of a sequence to its guidance image.
//!
//! The conventions of flow and image coordinates are those of [`ops`].

pub mod align;
mod estimator;
pub mod loss;
pub mod metrics;
pub mod pwc;
pub mod target;
pub mod visual;
pub mod weights;
