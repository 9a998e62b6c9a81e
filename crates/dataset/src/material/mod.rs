//! Materials: normal, diffuse, roughness and specular maps, and where they come from.
//!
//! A [`Material`] keeps its texels in stored precision and is sampled by addressing: repetition, mirroring, enlargement and
//! augmentation never build a copy.

pub mod augment;
mod block;
mod decoding;
mod encoding;
mod error;
pub mod files;
mod four_maps;
pub mod inria;
mod levels;
pub mod library;
pub mod manifest;
pub mod maps;
pub mod npy;
pub mod pbr;
pub mod perlin;
pub mod procedural;
pub mod split;
pub mod stored;
pub mod texture;

pub use augment::{AugmentConfig, Augmentation, AugmentedMaterial};
pub use error::MaterialError;
pub use four_maps::AlbedoEncoding;
pub use library::{LibraryError, MaterialLibrary, SourceConfig};
pub use maps::MaterialMaps;
pub use split::Split;
pub use stored::{GRID, Material, MaterialInfo, Maxima, Precision, Wrap};
