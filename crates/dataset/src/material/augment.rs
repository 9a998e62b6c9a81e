//! Augmentation of a material: flips, transpose, scales, the roughness floor and the Perlin specular layer (spec of §4).
//!
//! Nothing is copied: an [`AugmentedMaterial`] changes where it samples and what it makes of the sample.

#![allow(clippy::needless_range_loop, reason = "lockstep loops over a dozen arrays are plainest with one index")]

use std::sync::Arc;

use rand::{Rng, RngExt};
use render::block::{LANES, Lane, TexelBlock};
use render::texel::Texel;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::perlin::PerlinMask;
use super::stored::{GRID, Material};

/// The Perlin layer is for materials without a strong specular component: all specular values below this.
const PERLIN_MAX_SPECULAR: f32 = 0.1;
/// Roughness of the Perlin layer.
const PERLIN_ROUGHNESS: [f32; 2] = [0.1, 0.4];
/// Diffuse of the Perlin layer as a factor of its specular.
const PERLIN_DIFFUSE: [f32; 2] = [0.0, 0.1];

/// How materials are varied. The defaults are the recipe of the SVBRDF net; `perlin = 0` is that of the flow nets.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct AugmentConfig {
    /// Probability of each of: horizontal flip, vertical flip, transpose.
    #[schemars(extend("unit" = "probability"))]
    pub flip: f64,
    /// Range of the factors on diffuse, specular and roughness; the upper end is lowered where a map would exceed 1.
    pub scale: [f32; 2],
    /// f in r ← (1 − f)·r + f: the smallest roughness that frames show.
    pub roughness_floor: f32,
    /// Probability of the Perlin specular layer on a material whose specular stays below 0.1.
    #[schemars(extend("unit" = "probability"))]
    pub perlin: f64,
    /// Range of the Perlin wavelength in texels of the 4096² grid; \[16, 48\] in the paper's text, \[16, 64\] in its code.
    #[schemars(extend("unit" = "texels"))]
    pub perlin_wavelength: [f32; 2],
    /// How many different Perlin masks there are.
    pub perlin_masks: u32,
}

impl Default for AugmentConfig {
    fn default() -> Self {
        Self {
            flip: 0.5,
            scale: [0.8, 1.25],
            roughness_floor: 0.1,
            perlin: 0.5,
            perlin_wavelength: [16.0, 64.0],
            perlin_masks: 100,
        }
    }
}

/// A value of [`AugmentConfig`] out of its range.
#[derive(Debug, thiserror::Error, PartialEq)]
#[error("augmentation: {key} is {found}; expected {expected}")]
pub struct AugmentError {
    /// Name of the value.
    pub key: &'static str,
    /// What it is.
    pub found: String,
    /// What it may be.
    pub expected: &'static str,
}

impl AugmentConfig {
    /// Nothing varied, roughness kept: for measuring.
    pub fn none() -> Self {
        Self { flip: 0.0, scale: [1.0; 2], roughness_floor: 0.0, perlin: 0.0, ..Self::default() }
    }

    /// Checks every value.
    ///
    /// # Errors
    /// [`AugmentError`] for the first value out of range.
    pub fn validate(&self) -> Result<(), AugmentError> {
        let share = |v: f64| (0.0..=1.0).contains(&v);
        let rising = |v: [f32; 2], least: f32| v[0] >= least && v[0] <= v[1] && v[1].is_finite();
        let fail = |key, found: String, expected| Err(AugmentError { key, found, expected });
        if !share(self.flip) {
            return fail("flip", self.flip.to_string(), "a probability in [0, 1]");
        }
        if !share(self.perlin) {
            return fail("perlin", self.perlin.to_string(), "a probability in [0, 1]");
        }
        if !rising(self.scale, 1e-3) || self.scale[0] > 1.0 {
            return fail("scale", format!("{:?}", self.scale), "[low, high] with 0.001 ≤ low ≤ 1 and low ≤ high");
        }
        if !(0.0..=1.0).contains(&self.roughness_floor) {
            return fail("roughness_floor", self.roughness_floor.to_string(), "a roughness in [0, 1]");
        }
        if !rising(self.perlin_wavelength, 1.0) {
            return fail("perlin_wavelength", format!("{:?}", self.perlin_wavelength), "[low, high] with 1 ≤ low ≤ high");
        }
        if self.perlin_masks == 0 {
            return fail("perlin_masks", "0".into(), "at least 1; perlin = 0 switches the layer off");
        }
        Ok(())
    }
}

/// The homogeneous material that shows where a Perlin mask is 0. Normals stay those of the base.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PerlinLayer {
    /// Where the base material shows.
    pub mask: PerlinMask,
    /// Specular albedo of the layer.
    pub specular: [f32; 3],
    /// Diffuse albedo of the layer.
    pub diffuse: [f32; 3],
    /// Roughness of the layer.
    pub roughness: f32,
}

/// One draw of everything that is varied.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Augmentation {
    /// x ← −x of the source, first.
    pub flip_x: bool,
    /// y ← −y of the source, first.
    pub flip_y: bool,
    /// Rows and columns of the (flipped) texel grid exchanged, last: world (x, y) ← (−y, −x).
    pub transpose: bool,
    /// Factor on the diffuse albedo.
    pub diffuse: f32,
    /// Factor on the specular albedo.
    pub specular: f32,
    /// Factor and offset of the roughness: r ← factor·r + offset.
    pub roughness: [f32; 2],
    /// The specular layer, where there is one.
    pub perlin: Option<PerlinLayer>,
}

impl Augmentation {
    /// No change at all.
    pub const IDENTITY: Self = Self {
        flip_x: false,
        flip_y: false,
        transpose: false,
        diffuse: 1.0,
        specular: 1.0,
        roughness: [1.0, 0.0],
        perlin: None,
    };

    /// Draws an augmentation for a material. The number of draws doesn't depend on the material, so neighbouring draws
    /// of the same stream stay what they are when a material is exchanged.
    pub fn draw(material: &Material, rng: &mut impl Rng, config: &AugmentConfig) -> Self {
        let [flip_x, flip_y, transpose] = std::array::from_fn(|_| rng.random_bool(config.flip));
        let maxima = material.maxima();
        let mut factor = |v_max: f32| {
            let high = config.scale[1].min(1.0 / (v_max + 1e-4)).max(config.scale[0]);
            config.scale[0] + rng.random_range(0.0..=1.0) * (high - config.scale[0])
        };
        let [diffuse, specular, roughness] = [maxima.diffuse, maxima.specular, maxima.roughness].map(&mut factor);
        let floor = config.roughness_floor;
        let wanted = rng.random_bool(config.perlin);
        let layer = PerlinLayer::draw(rng, config);
        Self {
            flip_x,
            flip_y,
            transpose,
            diffuse,
            specular,
            roughness: [roughness * (1.0 - floor), floor],
            perlin: (wanted && maxima.specular * specular < PERLIN_MAX_SPECULAR).then_some(layer),
        }
    }

    /// Where a place of the augmented grid lies in the source's grid.
    #[inline(always)]
    pub fn to_source(&self, tx: f32, ty: f32) -> (f32, f32) {
        let last = (GRID - 1) as f32;
        let (x, y) = if self.transpose { (ty, tx) } else { (tx, ty) };
        (if self.flip_x { last - x } else { x }, if self.flip_y { last - y } else { y })
    }

    /// A direction of the source's tangent frame, seen in the augmented material.
    #[inline(always)]
    pub fn direction_from_source(&self, [x, y, z]: [f32; 3]) -> [f32; 3] {
        let x = if self.flip_x { -x } else { x };
        let y = if self.flip_y { -y } else { y };
        // y points up while rows count down, so exchanging rows and columns exchanges x and −y.
        if self.transpose { [-y, -x, z] } else { [x, y, z] }
    }
}

impl PerlinLayer {
    fn draw(rng: &mut impl Rng, config: &AugmentConfig) -> Self {
        let mask = PerlinMask::from_pool(rng.random_range(0..config.perlin_masks), config.perlin_wavelength);
        let specular: [f32; 3] = std::array::from_fn(|_| rng.random_range(0.0..=1.0));
        let roughness = rng.random_range(PERLIN_ROUGHNESS[0]..=PERLIN_ROUGHNESS[1]);
        let factor = rng.random_range(PERLIN_DIFFUSE[0]..=PERLIN_DIFFUSE[1]);
        Self { mask, specular, diffuse: specular.map(|s| s * factor), roughness }
    }

    /// Replaces texels by the layer where the mask is 0.
    #[inline(always)]
    fn blend(&self, texels: &mut TexelBlock, [tx, ty]: [&Lane; 2], footprint: &Lane) {
        let base = self.mask.value_block([tx, ty], footprint);
        let mix = |lane: &mut Lane, layer: f32| {
            for k in 0..LANES {
                lane[k] = layer + base[k] * (lane[k] - layer);
            }
        };
        for c in 0..3 {
            mix(&mut texels.diffuse[c], self.diffuse[c]);
            mix(&mut texels.specular[c], self.specular[c]);
        }
        mix(&mut texels.roughness, self.roughness);
    }
}

/// A material as one video shows it.
#[derive(Clone, Debug)]
pub struct AugmentedMaterial {
    /// The maps.
    pub material: Arc<Material>,
    /// What is made of them.
    pub augmentation: Augmentation,
}

impl AugmentedMaterial {
    /// The material as it is stored.
    pub fn plain(material: Arc<Material>) -> Self {
        Self { material, augmentation: Augmentation::IDENTITY }
    }

    /// The augmented reflectance at a place of the grid; see [`Material::sample`] for units.
    pub fn sample(&self, tx: f32, ty: f32, footprint: f32) -> Texel {
        self.sample_block(&[tx; LANES], &[ty; LANES], &[footprint; LANES]).at(0)
    }

    /// The augmented reflectance at the places of a block.
    #[inline(always)]
    pub fn sample_block(&self, tx: &Lane, ty: &Lane, footprint: &Lane) -> TexelBlock {
        let augmentation = &self.augmentation;
        let (mut x, mut y) = (*tx, *ty);
        for k in 0..LANES {
            (x[k], y[k]) = augmentation.to_source(tx[k], ty[k]);
        }
        let TexelBlock { mut normal, mut diffuse, mut roughness, mut specular } = self.material.sample_block(&x, &y, footprint);
        for k in 0..LANES {
            let turned = augmentation.direction_from_source([normal[0][k], normal[1][k], normal[2][k]]);
            (normal[0][k], normal[1][k]) = (turned[0], turned[1]);
        }
        let [factor, offset] = augmentation.roughness;
        roughness = roughness.map(|r| (r * factor + offset).min(1.0));
        diffuse = diffuse.map(|lane| lane.map(|v| (v * augmentation.diffuse).min(1.0)));
        specular = specular.map(|lane| lane.map(|v| (v * augmentation.specular).min(1.0)));
        let mut texels = TexelBlock { normal, diffuse, roughness, specular };
        if let Some(layer) = &augmentation.perlin {
            // In the source's grid, so that a flipped material is flipped as a whole.
            layer.blend(&mut texels, [&x, &y], footprint);
        }
        texels
    }

    /// Name shown to people.
    pub fn name(&self) -> &str {
        self.material.name()
    }
}

#[cfg(test)]
mod tests;
