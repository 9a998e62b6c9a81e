//! Materials: normal, diffuse, roughness and specular maps, and where they come from.
//!
//! A [`Material`] keeps its texels in stored precision and is sampled by addressing: repetition, mirroring, enlargement and
//! augmentation never build a copy.

pub mod augment;
mod encoding;
mod error;
mod levels;
pub mod library;
pub mod maps;
pub mod pbr;
pub mod perlin;
pub mod procedural;
pub mod split;
pub mod stored;
pub mod texture;

pub use augment::{AugmentConfig, Augmentation, AugmentedMaterial};
pub use error::MaterialError;
pub use library::{LibraryError, MaterialLibrary, SourceConfig};
pub use maps::MaterialMaps;
pub use split::Split;
pub use stored::{GRID, Material, MaterialInfo, Maxima, Precision, Wrap};
