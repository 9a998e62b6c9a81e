//! Rendered scans on disk: what a phone would bring, with the motion known.

use std::path::Path;
use std::sync::Arc;

use dataset::image_io::{ImageError, Overwrite, write_png8};
use dataset::material::augment::AugmentConfig;
use dataset::material::procedural::{Family, generate};
use dataset::material::{Material, MaterialError, MaterialInfo, Wrap};
use dataset::sequence::{Sequence, SequenceConfig};
use dataset::stream::Stream;

/// Seed of everything a rendered clip is drawn from.
const SEED: u64 = 20;
/// Texels per side of the material's tile, and how many tiles lie beside each other on the material.
const TILE: usize = 512;
const TILES: usize = 4;

/// A spiral scan of a generated material, with the sensor's noise.
///
/// # Errors
/// If the family's maps make no material.
pub fn spiral(family: Family) -> Result<Sequence, MaterialError> {
    let info = MaterialInfo {
        name: family.name().into(),
        identity: format!("acceptance/{}", family.name()),
        source: format!("procedural {}", family.name()),
        licence: "CC0-1.0".into(),
        textured: Some(family.textured()),
        wrap: Wrap::Repeat,
        texels: TILES * TILE,
    };
    let material = Material::from_maps(info, &generate(family, SEED, TILE))?;
    let mut config = SequenceConfig { augment: AugmentConfig::none(), ..SequenceConfig::svbrdf() };
    config.path.line_share = 0.0;
    Ok(Sequence::new(Arc::new(material), &config, &Stream::new(SEED), 0))
}

/// Writes the first `count` frames of a scan as `frame-0000.png` and so on into an existing folder.
///
/// # Errors
/// If a file can't be written or is there already.
///
/// # Panics
/// If the scan has fewer frames.
pub fn write(scan: &Sequence, count: usize, resolution: usize, folder: &Path) -> Result<(), ImageError> {
    (0..count)
        .try_for_each(|i| write_png8(&folder.join(format!("frame-{i:04}.png")), &scan.frame(i, resolution), Overwrite::Refuse))
}
