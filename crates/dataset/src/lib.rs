//! Synthetic scanning sequences: materials, camera paths, frames with exact flow and target maps.

pub mod material;
pub mod stream;
