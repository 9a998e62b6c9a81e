//! Pairs of the FlyingChairs kind, on which the flow nets are pre-trained (§5; Dosovitskiy et al. 2015).
//!
//! [`Chairs`] makes its own: a background and 5 to 20 foreground shapes, each a material with its own affine motion, seen
//! under a flash whose highlight stays with the camera while the textures move. A net that follows highlights is wrong
//! here, as it would be on real scans. [`published`] reads the published format.

pub mod flo;
mod layer;
pub mod ppm;
pub mod published;
pub mod shape;

use std::sync::Arc;

use ops::planes::{Mask, Planes};
use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use render::brdf::BrdfModel;
use render::light::{Light, radiance};
use render::sensor::expose;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::material::Material;
use crate::pair::FlowPair;
use crate::sequence::lights::{LightConfig, Lighting, VideoLights};
use crate::sequence::{PixelNoise, rendered};
use crate::stream::Stream;

use layer::{Affine, Layer};

/// What pairs to make.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ChairsConfig {
    /// Side of the images.
    #[schemars(extend("unit" = "pixels"))]
    pub resolution: usize,
    /// Range of the number of foreground shapes.
    pub shapes: [usize; 2],
    /// Standard deviation of the background's translation, per axis, in pixels; 11 gives a mean displacement of about
    /// 15 px, as between neighbouring frames of a scan (§4).
    #[schemars(extend("unit" = "pixels"))]
    pub background_px: f64,
    /// Standard deviation of a shape's translation relative to the background, per axis, in pixels.
    #[schemars(extend("unit" = "pixels"))]
    pub shape_px: f64,
    /// Multiplies the sensor noise of §4; 0 switches it off.
    pub noise_scale: f32,
    /// How many materials are in use at a time: what a cache of materials has to hold.
    pub pool_materials: u64,
    /// After how many pairs the materials in use change.
    pub pool_pairs: u64,
}

impl Default for ChairsConfig {
    fn default() -> Self {
        Self {
            resolution: 256,
            shapes: [5, 20],
            background_px: 11.0,
            shape_px: 8.0,
            noise_scale: 1.0,
            pool_materials: 24,
            pool_pairs: 400,
        }
    }
}

/// A value of [`ChairsConfig`] out of its range.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("chairs.{key} is {found}; expected {expected}")]
pub struct ChairsError {
    /// Name of the value.
    pub key: &'static str,
    /// What it is.
    pub found: String,
    /// What it may be.
    pub expected: &'static str,
}

impl ChairsConfig {
    /// Checks every value.
    ///
    /// # Errors
    /// [`ChairsError`] for the first value out of range.
    pub fn validate(&self) -> Result<(), ChairsError> {
        let fail = |key, found: String, expected| Err(ChairsError { key, found, expected });
        if !(32..=4096).contains(&self.resolution) {
            return fail("resolution", self.resolution.to_string(), "32 to 4096 pixels");
        }
        if self.shapes[0] > self.shapes[1] || self.shapes[1] > 200 {
            return fail("shapes", format!("{:?}", self.shapes), "[low, high] with low ≤ high ≤ 200");
        }
        for (key, value) in [("background_px", self.background_px), ("shape_px", self.shape_px)] {
            if !(0.0..=1000.0).contains(&value) {
                return fail(key, value.to_string(), "0 to 1000 pixels");
            }
        }
        if !(0.0..=100.0).contains(&self.noise_scale) {
            return fail("noise_scale", self.noise_scale.to_string(), "a factor, 0 to 100");
        }
        for (key, value) in [("pool_materials", self.pool_materials), ("pool_pairs", self.pool_pairs)] {
            if value == 0 {
                return fail(key, "0".into(), "at least 1");
            }
        }
        Ok(())
    }
}

/// The generator of pairs.
#[derive(Clone, Debug)]
pub struct Chairs {
    config: ChairsConfig,
    streams: Stream,
}

impl Chairs {
    /// A generator.
    ///
    /// # Errors
    /// [`ChairsError`] for a value out of range.
    pub fn new(config: ChairsConfig, streams: Stream) -> Result<Self, ChairsError> {
        config.validate()?;
        Ok(Self { config, streams })
    }

    /// Pair `index`, covered with materials that `material` gives by number (`|n| library.material(Split::Train, n)`): a
    /// function of the seed and the index alone, if `material` is one of its number.
    ///
    /// # Errors
    /// Those of `material`.
    pub fn pair<E>(&self, index: u64, material: impl FnMut(u64) -> Result<Arc<Material>, E>) -> Result<FlowPair, E> {
        let scene = self.scene(index, material)?;
        let (flow, valid) = scene.flow();
        let noise = self.streams.child("chairs noise", index);
        let image =
            |time: usize| scene.image(time, &PixelNoise::draw(self.config.noise_scale, &mut noise.rng("image", time as u64)));
        Ok(FlowPair { first: image(0), second: image(1), flow, valid })
    }

    fn scene<E>(&self, index: u64, mut material: impl FnMut(u64) -> Result<Arc<Material>, E>) -> Result<Scene, E> {
        let mut rng = self.streams.rng("chairs", index);
        let first = index / self.config.pool_pairs * self.config.pool_materials;
        let count = rng.random_range(self.config.shapes[0]..=self.config.shapes[1]);
        let mut draw = |_| material(first + rng.random_range(0..self.config.pool_materials));
        let materials = (0..=count).map(&mut draw).collect::<Result<Vec<_>, E>>()?;
        Ok(Scene::draw(&materials, &self.config, &mut rng))
    }
}

/// All layers of a pair (the background first) and how the two images are lit.
struct Scene {
    side: usize,
    layers: Vec<Layer>,
    /// Half the width of the view, world units: what turns pixels into the world in which lights are drawn.
    half_view: f64,
    /// Position of camera and flash in either image, world units.
    eyes: [[f32; 3]; 2],
    lights: [Vec<Light>; 2],
    gains: [f32; 2],
}

impl Scene {
    /// One layer per material, the first as the background.
    fn draw(materials: &[Arc<Material>], config: &ChairsConfig, rng: &mut impl Rng) -> Self {
        let side = config.resolution;
        let scene_motion = Affine::draw_motion([(side - 1) as f64 / 2.0; 2], config.background_px, 1.0, rng);
        let layers = materials.iter().enumerate().map(|(k, material)| {
            if k == 0 {
                Layer::background(material, side, scene_motion, rng)
            } else {
                Layer::shape(material, side, &scene_motion, config.shape_px, rng)
            }
        });
        let layers = layers.collect();
        let half_view = rng.random_range(0.05..=0.1);
        let height = half_view / rng.random_range(12.5f64..=17.5).to_radians().tan();
        let lighting = LightConfig { kind: Lighting::FlowExposed, ..LightConfig::default() };
        let drawn = VideoLights::draw(&lighting, height, rng);
        let eyes = std::array::from_fn(|_| {
            // The hand moves and tilts: highlights and fall-off shift from image to image, independent of any texture.
            let mut across = || (0.25 * half_view * normal(rng)) as f32;
            [across(), across(), height as f32]
        });
        let lights = eyes.map(|position| {
            let flash = Light::Flash { position, axis: [0.0, 0.0, -1.0], intensity: drawn.intensity, exponent: drawn.exponent };
            std::iter::once(flash).chain(drawn.resting.iter().copied()).collect()
        });
        let gains = std::array::from_fn(|_| (0.08 * normal(rng)).exp() as f32);
        Self { side, layers, half_view, eyes, lights, gains }
    }

    /// One of the two images, as a camera reads it.
    fn image(&self, time: usize, noise: &PixelNoise) -> Planes {
        let centre = (self.side - 1) as f64 / 2.0;
        let world = |v: f64| ((v - centre) / (0.5 * self.side as f64) * self.half_view) as f32;
        let light = rendered(self.side, self.side, |y, x| {
            let point = [world(x as f64), -world(y as f64), 0.0];
            let mut colour = noise.at(y, x);
            let mut uncovered = self.gains[time];
            for layer in self.layers.iter().rev() {
                let coverage = layer.coverage(time, x as f32, y as f32) * uncovered;
                if coverage > 0.0 {
                    let texel = layer.texel(time, x as f32, y as f32);
                    let seen = radiance(&texel, point, self.eyes[time], &self.lights[time], BrdfModel::default());
                    (0..3).for_each(|c| colour[c] += coverage * seen[c]);
                    uncovered -= coverage;
                }
                if uncovered < 1e-3 {
                    break;
                }
            }
            colour
        });
        expose(&light)
    }

    /// The layer that shows at a position: the topmost that covers it by half.
    fn owner(&self, time: usize, x: f32, y: f32) -> usize {
        let covers = |k: &usize| self.layers[*k].coverage(time, x, y) >= 0.5;
        (1..self.layers.len()).rev().find(covers).unwrap_or(0)
    }

    /// Exact flow from the first to the second image, and the pixels of the first whose point shows in the second.
    fn flow(&self) -> (Planes, Mask) {
        let side = self.side;
        let last = (side - 1) as f64;
        let pixels: Vec<([f32; 2], bool)> = (0..side * side)
            .into_par_iter()
            .with_min_len(side)
            .map(|i| {
                let (x, y) = (i % side, i / side);
                let owner = self.owner(0, x as f32, y as f32);
                let [px, py] = self.layers[owner].moved(x as f64, y as f64);
                let inside = (0.0..=last).contains(&px) && (0.0..=last).contains(&py);
                let shows = inside && self.owner(1, px as f32, py as f32) == owner;
                ([(px - x as f64) as f32, (py - y as f64) as f32], shows)
            })
            .collect();
        let data = (0..2).flat_map(|c| pixels.iter().map(move |p| p.0[c])).collect();
        let valid = Mask { height: side, width: side, data: pixels.iter().map(|p| p.1).collect() };
        (Planes::from_vec(2, side, side, data), valid)
    }
}

fn normal(rng: &mut impl Rng) -> f64 {
    StandardNormal.sample(rng)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sequence::tests::material;
    use ops::flow_field::warp_planes;
    use std::convert::Infallible;

    fn chairs(config: ChairsConfig) -> Chairs {
        Chairs::new(config, Stream::new(8)).unwrap()
    }

    fn scene(chairs: &Chairs, index: u64) -> Scene {
        let material = material();
        chairs.scene::<Infallible>(index, |_| Ok(Arc::clone(&material))).unwrap()
    }

    fn pair(chairs: &Chairs, index: u64) -> FlowPair {
        chairs.pair::<Infallible>(index, |_| Ok(material())).unwrap()
    }

    fn small() -> ChairsConfig {
        ChairsConfig { resolution: 96, ..ChairsConfig::default() }
    }

    /// Under one light that rests, images differ by the motion alone.
    fn evenly_lit(chairs: &Chairs, index: u64) -> Scene {
        let mut scene = scene(chairs, index);
        let overhead = Light::Directional { wi: [0.0, 0.0, 1.0], irradiance: [1.5; 3] };
        scene.lights = [vec![overhead], vec![overhead]];
        scene.eyes[1] = scene.eyes[0];
        scene.gains = [1.0; 2];
        scene
    }

    #[test]
    fn warping_the_second_image_by_the_flow_gives_the_first_where_it_is_valid() {
        let chairs = chairs(ChairsConfig { background_px: 5.0, shape_px: 4.0, ..small() });
        let (mut warped_error, mut still_error, mut hidden_error) = (0.0, 0.0, 0.0);
        for index in 0..6 {
            let scene = evenly_lit(&chairs, index);
            let quiet = PixelNoise::new(0.0, 0);
            let (first, second, (flow, valid)) = (scene.image(0, &quiet), scene.image(1, &quiet), scene.flow());
            let (warped, inside) = warp_planes(&second, &flow);
            let mean = |image: &Planes, keep: &dyn Fn(usize) -> bool| {
                let pixels: Vec<usize> = (0..96 * 96).filter(|&i| keep(i)).collect();
                pixels.iter().map(|&i| (image.data[i] - first.data[i]).abs()).sum::<f32>() / pixels.len().max(1) as f32
            };
            warped_error += mean(&warped, &|i| valid.data[i]);
            still_error += mean(&second, &|i| valid.data[i]);
            hidden_error += mean(&warped, &|i| !valid.data[i] && inside.data[i]);
        }
        assert!(warped_error < 0.35 * still_error, "{warped_error} warped, {still_error} as it is");
        assert!(warped_error < 0.35 * hidden_error, "{warped_error} where valid, {hidden_error} where hidden");
    }

    #[test]
    fn displacements_are_those_of_neighbouring_frames() {
        let chairs = chairs(ChairsConfig { resolution: 256, ..ChairsConfig::default() });
        let mut lengths = vec![];
        for index in 0..60 {
            let scene = scene(&chairs, index);
            for i in 0..64 {
                let (x, y) = ((i % 8) as f64 * 32.0 + 16.0, (i / 8) as f64 * 32.0 + 16.0);
                let [px, py] = scene.layers[scene.owner(0, x as f32, y as f32)].moved(x, y);
                lengths.push((px - x).hypot(py - y));
            }
        }
        lengths.sort_by(f64::total_cmp);
        let mean = lengths.iter().sum::<f64>() / lengths.len() as f64;
        assert!((12.0..20.0).contains(&mean), "mean {mean} px");
        assert!(lengths[lengths.len() * 95 / 100] > 28.0, "p95 {}", lengths[lengths.len() * 95 / 100]);
    }

    #[test]
    fn a_pair_is_a_function_of_seed_and_index_and_most_of_it_is_valid() {
        let drawn = pair(&chairs(small()), 3);
        assert_eq!(drawn, pair(&chairs(small()), 3));
        assert!(drawn != pair(&chairs(small()), 4));
        assert!(drawn.valid.share() > 0.3 && drawn.valid.share() < 1.0);
        assert!(drawn.first.data.iter().all(|v| (0.0..=1.0).contains(v)));
    }

    #[test]
    fn a_pool_of_materials_serves_a_row_of_pairs_and_its_errors_surface() {
        let chairs = chairs(ChairsConfig { pool_materials: 3, pool_pairs: 10, resolution: 32, ..small() });
        let asked = |index| {
            let mut numbers = std::collections::BTreeSet::new();
            for index in index..index + 4 {
                let scene = chairs.scene::<Infallible>(index, |n| {
                    numbers.insert(n);
                    Ok(material())
                });
                assert!((6..=21).contains(&scene.unwrap().layers.len()));
            }
            numbers.into_iter().collect::<Vec<_>>()
        };
        assert_eq!((asked(0), asked(20)), (vec![0, 1, 2], vec![6, 7, 8]));
        assert_eq!(chairs.pair(0, |_| Err("no such material")), Err("no such material"));
    }

    #[test]
    fn bad_values_are_named() {
        let refused = |config| Chairs::new(config, Stream::new(0)).unwrap_err().to_string();
        assert!(refused(ChairsConfig { resolution: 8, ..small() }).contains("chairs.resolution is 8"));
        assert!(refused(ChairsConfig { shapes: [9, 3], ..small() }).contains("[9, 3]"));
        assert!(refused(ChairsConfig { shape_px: f64::NAN, ..small() }).contains("shape_px"));
        assert!(refused(ChairsConfig { pool_pairs: 0, ..small() }).contains("pool_pairs is 0"));
    }
}
