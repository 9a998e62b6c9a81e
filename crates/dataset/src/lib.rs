//! Synthetic scanning sequences: materials, camera paths, frames with exact flow and target maps.

pub mod capture;
pub mod chairs;
pub mod exemplar;
pub mod image_io;
pub mod material;
pub mod mixing;
pub mod pair;
pub mod path;
pub mod producer;
pub mod sequence;
pub mod stream;
