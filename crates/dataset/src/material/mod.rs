//! Materials: normal, diffuse, roughness and specular maps, and where they come from.

pub mod maps;
pub mod procedural;
