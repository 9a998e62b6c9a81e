//! The maps as 16-bit PNG and EXR, and `material.json` with every convention.

use std::path::Path;

use dataset::image_io::{ImageError, Overwrite, write_bytes, write_exr, write_png16};
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
        axes: "those of the guidance frame (frame 0); row 0 is its top",
        maps: entries,
        metalness_conversion_render_l1: conversion_error(maps, &converted),
        key_frames: keys.len(),
        key_frames_aligned: keys.iter().filter(|k| k.aligned()).count(),
        mean_coverage: f64::from(result.coverage.data.iter().sum::<f32>()) / result.coverage.area() as f64,
    };
    let text = serde_json::to_string_pretty(&json).expect("plain numbers and text");
    write_bytes(&folder.join("material.json"), text.as_bytes(), Overwrite::Refuse)
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
