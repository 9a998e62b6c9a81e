//! Synthetic scanning sequences: materials, camera paths, frames with exact flow and target maps.

#![allow(clippy::needless_range_loop, reason = "numbered channels, lanes and taps read plainer by index")]

pub mod capture;
pub mod chairs;
#[cfg(test)]
mod damage;
pub mod exemplar;
pub mod image_io;
pub mod material;
pub mod mixing;
mod npy;
pub mod pair;
pub mod path;
pub mod producer;
pub mod sequence;
pub mod stream;
