//! The laws of distribution of everything that a synthetic scan draws, against the numbers of §4 written out here.
//!
//! A range is checked by its shape (Kolmogorov–Smirnov) and by its ends, which a hundred thousand draws reach to within a
//! ten-thousandth of the range: a constant that is a little off fails.

mod augment;
mod laws;
mod path;
mod perlin;

use std::sync::Arc;

use dataset::material::{GRID, Material, MaterialInfo, Precision, Wrap};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use render::texel::Texel;

fn rng(seed: u64) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(seed)
}

/// A material of `side`² texels.
fn stored(side: usize, texel: impl Fn(usize, usize) -> Texel + Sync) -> Arc<Material> {
    let info = MaterialInfo {
        name: "test".into(),
        identity: "test".into(),
        source: "test".into(),
        licence: "CC0".into(),
        textured: Some(true),
        wrap: Wrap::Repeat,
        texels: GRID,
    };
    Arc::new(Material::build(info, side, side, Precision::Sixteen, texel).expect("the texels are finite"))
}
