//! The maps as 16-bit PNG and EXR, and `material.json` with every convention.

use std::path::{Path, PathBuf};

use dataset::image_io::{ImageError, Overwrite, Picture, write_bytes, write_exr, write_png16};
use ops::colour::linear_to_srgb;
use ops::planes::Planes;
use render::brdf::BrdfModel;
use render::svbrdf::SvbrdfImage;
use render::views::EvaluationViews;
use serde::Serialize;
use svbrdf::metrics::RenderErrors;

use super::metalness::{base_colour_and_metalness, diffuse_and_specular};
use crate::reconstruct::Reconstruction;

/// What a map's PNG holds.
#[derive(Clone, Copy)]
enum Stored {
    /// sRGB-encoded colour.
    Colour,
    /// The value itself.
    Value,
    /// `0.5·n + 0.5`.
    Normal,
}

#[derive(Serialize)]
struct MapEntry {
    name: &'static str,
    png: String,
    exr: String,
    png_encoding: &'static str,
    exr_encoding: &'static str,
}

#[derive(Serialize)]
struct MaterialJson<'a> {
    format: u32,
    generator: &'static str,
    source: &'a str,
    width: usize,
    height: usize,
    brdf: &'static str,
    roughness: &'static str,
    normal: &'static str,
    axes: &'static str,
    maps: Vec<MapEntry>,
    /// Mean absolute difference of the standard renderings after the conversion to base colour and metalness.
    metalness_conversion_render_l1: f64,
    key_frames: usize,
    key_frames_aligned: usize,
    mean_coverage: f64,
}

/// Writes every map and, last, `material.json` into an existing folder.
///
/// # Errors
/// If a file can't be written.
pub fn write(folder: &Path, source: &str, result: &Reconstruction) -> Result<(), ImageError> {
    let maps = &result.maps;
    let (base, metalness) = base_colour_and_metalness(maps);
    let converted = diffuse_and_specular(&base, &metalness, maps);
    let most = result.coverage.data.iter().fold(1.0f32, |m, &v| m.max(v));
    let coverage = result.coverage.clone().map(|v| v / most);
    let normal_dx = flipped(&maps.normal);
    let list: [(&'static str, &Planes, Stored); 8] = [
        ("Diffuse", &maps.diffuse, Stored::Colour),
        ("Specular", &maps.specular, Stored::Colour),
        ("Roughness", &maps.roughness, Stored::Value),
        ("NormalGL", &maps.normal, Stored::Normal),
        ("NormalDX", &normal_dx, Stored::Normal),
        ("BaseColor", &base, Stored::Colour),
        ("Metalness", &metalness, Stored::Value),
        ("Coverage", &coverage, Stored::Value),
    ];
    let mut entries = Vec::new();
    for (name, planes, stored) in list {
        entries.push(write_map(folder, name, planes, stored)?);
    }
    let keys = &result.alignment.key_frames;
    let json = MaterialJson {
        format: 1,
        generator: concat!("scan ", env!("CARGO_PKG_VERSION")),
        source,
        width: maps.width(),
        height: maps.height(),
        brdf: "GGX (Walter et al. 2007), Schlick Fresnel, plus Lambertian diffuse",
        roughness: "perceptual; GGX alpha = roughness squared",
        normal: "tangent space; GL: +Y up, DX: +Y down; +X right, +Z out of the surface",
        axes: match result.view {
            Some(_) => "those of the guidance photo; row 0 is the top",
            None => "those of the guidance frame (frame 0); row 0 is its top",
        },
        maps: entries,
        metalness_conversion_render_l1: conversion_error(maps, &converted),
        key_frames: keys.len(),
        key_frames_aligned: keys.iter().filter(|k| k.aligned()).count(),
        mean_coverage: f64::from(result.coverage.data.iter().sum::<f32>()) / result.coverage.area() as f64,
    };
    let text = serde_json::to_string_pretty(&json).expect("plain numbers and text");
    write_bytes(&folder.join("material.json"), text.as_bytes(), Overwrite::Refuse)
}

/// Files that hold what the BRDF is computed from, in the order of [`SvbrdfImage::maps`].
const BRDF_MAPS: [(&str, usize); 4] = [("NormalGL.exr", 3), ("Diffuse.exr", 3), ("Roughness.exr", 1), ("Specular.exr", 3)];

/// Maps that can't be read back.
#[derive(Debug, thiserror::Error)]
pub enum ReadMapsError {
    /// A file that is missing or broken.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// A file of the wrong size.
    #[error("{} is {found} (channels × rows × columns), but {expected} is expected as in {}", path.display(), BRDF_MAPS[0].0)]
    Size {
        /// The file.
        path: PathBuf,
        /// Its size.
        found: String,
        /// The other maps' size.
        expected: String,
    },
}

/// Writes only the four maps that the BRDF is computed from, as EXR: a truth for [`read_exr`].
///
/// # Errors
/// If a file can't be written or is there already.
pub fn write_truth(folder: &Path, maps: &SvbrdfImage) -> Result<(), ImageError> {
    BRDF_MAPS.iter().zip(maps.maps()).try_for_each(|((name, _), map)| write_exr(&folder.join(name), map, Overwrite::Refuse))
}

/// Reads normal, diffuse, roughness and specular maps as [`write()`] and [`write_truth`] leave them.
///
/// # Errors
/// A missing, broken or differently sized file.
pub fn read_exr(folder: &Path) -> Result<SvbrdfImage, ReadMapsError> {
    let mut size = None;
    let mut read = |(name, channels): (&str, usize)| {
        let path = folder.join(name);
        let map = Picture::read(&path)?.to_planes();
        let &mut (height, width) = size.get_or_insert((map.height, map.width));
        if (map.channels, map.height, map.width) == (channels, height, width) {
            return Ok(map);
        }
        let found = format!("{}×{}×{}", map.channels, map.height, map.width);
        Err(ReadMapsError::Size { path, found, expected: format!("{channels}×{height}×{width}") })
    };
    let [normal, diffuse, roughness, specular] = BRDF_MAPS;
    Ok(SvbrdfImage { normal: read(normal)?, diffuse: read(diffuse)?, roughness: read(roughness)?, specular: read(specular)? })
}

fn write_map(folder: &Path, name: &'static str, planes: &Planes, stored: Stored) -> Result<MapEntry, ImageError> {
    let (encoded, png_encoding, exr_encoding) = match stored {
        Stored::Colour => (planes.clone().map(linear_to_srgb), "sRGB", "linear"),
        Stored::Value => (planes.clone(), "linear", "linear"),
        Stored::Normal => (planes.clone().map(|v| 0.5 * v + 0.5), "0.5·n + 0.5", "vector in [-1, 1]"),
    };
    let (png, exr) = (format!("{name}.png"), format!("{name}.exr"));
    write_png16(&folder.join(&png), &encoded, Overwrite::Refuse)?;
    write_exr(&folder.join(&exr), planes, Overwrite::Refuse)?;
    Ok(MapEntry { name, png, exr, png_encoding, exr_encoding })
}

fn flipped(normal: &Planes) -> Planes {
    let mut flipped = normal.clone();
    flipped.plane_mut(1).iter_mut().for_each(|y| *y = -*y);
    flipped
}

fn conversion_error(maps: &SvbrdfImage, converted: &SvbrdfImage) -> f64 {
    RenderErrors::between(converted, maps, &EvaluationViews::standard(), BrdfModel::default()).map_or(0.0, |e| e.l1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use render::texel::Texel;

    fn maps() -> SvbrdfImage {
        let texel = Texel { normal: [0.0, 0.0, 1.0], diffuse: [0.1, 0.2, 0.3], roughness: 0.4, specular: [0.05, 0.06, 0.07] };
        SvbrdfImage::constant(4, 6, &texel)
    }

    #[test]
    fn maps_come_back_as_they_were_written() {
        let folder = tempfile::tempdir().unwrap();
        write_truth(folder.path(), &maps()).unwrap();
        let read = read_exr(folder.path()).unwrap();
        assert!(read.maps().iter().zip(maps().maps()).all(|(a, b)| *a == b));
    }

    #[test]
    fn a_missing_or_differently_sized_map_is_named() {
        let folder = tempfile::tempdir().unwrap();
        assert!(read_exr(folder.path()).unwrap_err().to_string().contains("NormalGL.exr"));
        write_truth(folder.path(), &maps()).unwrap();
        std::fs::remove_file(folder.path().join("Roughness.exr")).unwrap();
        write_exr(&folder.path().join("Roughness.exr"), &Planes::new(1, 3, 6), Overwrite::Refuse).unwrap();
        let error = read_exr(folder.path()).unwrap_err().to_string();
        assert!(error.contains("Roughness.exr is 1×3×6") && error.contains("1×4×6"), "{error}");
    }
}
