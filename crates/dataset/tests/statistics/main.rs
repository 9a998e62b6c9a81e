//! The laws of distribution of everything that a synthetic scan draws, against the numbers of §4 written out here.
//!
//! A range is checked by its shape (Kolmogorov–Smirnov) and by its ends, which a hundred thousand draws reach to within a
//! ten-thousandth of the range: a constant that is a little off fails.

mod augment;
mod exemplar;
#[path = "../../../../tests/statistics/laws.rs"]
mod laws;
mod light;
mod noise;
mod pair;
mod path;
mod perlin;

use std::sync::Arc;

use dataset::material::{Material, MaterialInfo, Precision};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use render::texel::Texel;

fn rng(seed: u64) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(seed)
}

/// A matte material of 64² texels whose grey diffuse albedo is a function of column and row.
fn painted(grey: impl Fn(usize, usize) -> f32 + Sync) -> Arc<Material> {
    stored(64, |x, y| Texel::matte([grey(x, y); 3]))
}

fn stored(side: usize, texel: impl Fn(usize, usize) -> Texel + Sync) -> Arc<Material> {
    let info = MaterialInfo::made_up("test");
    Arc::new(Material::build(info, side, side, Precision::Sixteen, texel).expect("the texels are finite"))
}
