//! Floor 0: the weightless functions the paper needs and burn lacks.
//!
//! Two kinds of data live here. *Planes* are images on the CPU (channel-major `f32`), used where a program reads, renders
//! or measures; *tensors* are burn's, used where a net learns. Everything else in the workspace builds on these.
//!
//! # Conventions (stated once; other crates link here)
//! - Tensors are `[N, C, H, W]`, `f32`.
//! - Image coordinates: x to the right, y **down**, pixel centres at **integers**; the upper-left pixel is (0, 0).
//! - Flow is `[N, 2, H, W]`, channels (x, y), in pixels, **backward**: `source position = target pixel + flow`.
//! - A [`homography::Homography`] maps target pixel to source pixel.
//! - Validity is a mask, never a huge number.
//! - Colours that travel between crates are gamma-encoded RGB in \[0, 1\] ([`colour::gamma_encode`]); albedos are linear.

pub mod activation;
pub mod colour;
pub mod compute;
pub mod conv;
pub mod cost_volume;
pub mod filters;
pub mod flow_field;
pub mod gradcheck;
pub mod homography;
pub mod kernel;
pub mod planes;
pub mod process;
pub mod resample;
mod setting;
pub mod warp;
pub mod weights;
