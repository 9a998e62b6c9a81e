//! What the fuzz targets share. A target lets a reader loose on bytes that libFuzzer makes up: it may refuse them with an
//! error, but not panic, hang or take much memory, and what it accepts must hold together.

use std::path::Path;

use dataset::image_io::{ImageError, MAX_SIDE, Picture, Samples};
use dataset::material::{GRID, Material, MaterialInfo, Wrap};

/// What errors name: no file is read.
pub const NAME: &str = "fuzzed";

/// Lets a panic pass that the reader catches (the image decoders are other people's); one that leaves the reader still ends
/// the run.
pub fn allow_caught_panics() {
    std::panic::set_hook(Box::new(|panic| eprintln!("{panic}")));
}

/// Decodes an image of one format; bytes of another kind are left to that format's target.
pub fn image(start: &[u8], bytes: &[u8]) {
    if bytes.starts_with(start) {
        checked(Picture::decode(bytes, Path::new(NAME)));
    }
}

/// A picture has as many numbers as its size says, all finite; an error can be shown.
fn checked(result: Result<Picture, ImageError>) {
    match result {
        Ok(Picture { width, height, channels, samples }) => {
            let count = match &samples {
                Samples::Eight(values) => values.len(),
                Samples::Sixteen(values) => values.len(),
                Samples::Linear(values) => {
                    assert!(values.iter().all(|v| v.is_finite()));
                    values.len()
                }
            };
            assert_eq!(count, width * height * channels);
            assert!((1..=MAX_SIDE).contains(&width) && (1..=MAX_SIDE).contains(&height) && [1, 3].contains(&channels));
        }
        Err(error) => show(&error),
    }
}

/// Writes an error as a person would see it.
pub fn show(error: &impl std::fmt::Display) {
    assert!(!error.to_string().is_empty());
}

/// What is known of a material before its file is read. Measuring its texture takes longer than reading a small one, so most
/// inputs go without.
pub fn material_info(measured: bool) -> MaterialInfo {
    MaterialInfo {
        name: NAME.into(),
        identity: NAME.into(),
        source: NAME.into(),
        licence: NAME.into(),
        textured: (!measured).then_some(true),
        wrap: Wrap::Mirror,
        texels: GRID,
    }
}

/// Every texel of a material is a number within its range, wherever it is sampled.
pub fn sampled(material: &Material) {
    for place in [0.0, 0.5, 17.3, -1e6, 1e6] {
        for footprint in [0.5, 3.7, 1e4] {
            let texel = material.sample(place, -place, footprint);
            let albedos = texel.diffuse.into_iter().chain(texel.specular).chain([texel.roughness]);
            assert!(albedos.into_iter().all(|v| (-1e-3..=1.001).contains(&v)), "{texel:?}");
            assert!(texel.normal.into_iter().all(|v| v.is_finite()), "{texel:?}");
        }
    }
}

/// The bytes before and after the first zero, for targets that take a text and something else.
pub fn split_at_zero(bytes: &[u8]) -> (&[u8], &[u8]) {
    match bytes.iter().position(|b| *b == 0) {
        Some(at) => (&bytes[..at], &bytes[at + 1..]),
        None => (bytes, &[]),
    }
}
