//! PNG strips: normal | diffuse | roughness | specular side by side, each H×H, as Deschaintre et al. published their set
//! (*Single-Image SVBRDF Capture with a Rendering-Aware Deep Network*, 2018).

use std::path::Path;

use super::error::MaterialError;
use super::four_maps::{AlbedoEncoding, FourMaps, Strides};
use super::stored::{Material, MaterialInfo};
use crate::image_io::{Picture, Samples};

/// Extension of the strips.
pub const EXTENSION: &str = "png";
/// Maps in a strip.
const MAPS: usize = 4;
const CHANNELS: usize = 3;

/// Reads a strip of 8 or 16 bit.
///
/// # Errors
/// [`MaterialError::Image`] for an unreadable file, [`MaterialError::Strip`] for a picture of another kind.
pub fn load(path: &Path, albedo: AlbedoEncoding, info: MaterialInfo) -> Result<Material, MaterialError> {
    convert(Picture::read(path)?, path, albedo, info)
}

/// As [`load`] for a file's bytes; errors name `path`.
///
/// # Errors
/// As [`load`].
pub fn decode(bytes: &[u8], path: &Path, albedo: AlbedoEncoding, info: MaterialInfo) -> Result<Material, MaterialError> {
    convert(Picture::decode(bytes, path)?, path, albedo, info)
}

fn convert(picture: Picture, path: &Path, albedo: AlbedoEncoding, info: MaterialInfo) -> Result<Material, MaterialError> {
    let Picture { width, height, channels, samples } = picture;
    let fail = |found: String| Err(MaterialError::Strip { path: path.into(), found });
    if width == (MAPS + 1) * height {
        return fail(format!("{width}×{height} pixels, five squares; if the first is a photo or rendering, cut it off"));
    }
    if width != MAPS * height {
        return fail(format!("{width}×{height} pixels"));
    }
    if channels != CHANNELS {
        return fail("a grey picture".into());
    }
    if let Samples::Linear(_) = samples {
        return fail("floats of an EXR".into());
    }
    let strides = Strides { column: CHANNELS, row: width * CHANNELS, map: height * CHANNELS };
    FourMaps { samples, width: height, height, strides, albedo, roughness_squared: false }.build(info)
}
