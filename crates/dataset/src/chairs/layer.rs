//! One moving piece of a pair: an outline, the material that covers it, and its affine motion.

use std::sync::Arc;

use rand::seq::SliceRandom;
use rand::{Rng, RngExt};
use render::texel::Texel;

use super::normal;
use super::shape::Outline;
use crate::material::augment::{AugmentConfig, Augmentation, AugmentedMaterial};
use crate::material::{GRID, Material};

/// Standard deviations of a motion's rotation, logarithmic zoom and shear.
const TURN_RAD: f64 = 0.05;
const ZOOM_LOG: f64 = 0.04;
const SHEAR: f64 = 0.02;
/// How much more a shape turns, zooms and shears than the background.
const SHAPE_LIVELINESS: f64 = 2.0;
/// Range of texels per pixel; frames of a scan at 256² show 0.8 to 1.6 (§4).
const PITCH: [f64; 2] = [0.6, 2.5];
/// Range of a shape's mean radius as a share of the image's side.
const RADIUS: [f64; 2] = [0.05, 0.2];

/// x ↦ matrix·x + offset, in pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Affine {
    matrix: [[f64; 2]; 2],
    offset: [f64; 2],
}

impl Affine {
    /// A random motion about a centre: a shift of the given standard deviation, and some rotation, zoom and shear.
    pub(super) fn draw_motion(centre: [f64; 2], shift_px: f64, liveliness: f64, rng: &mut impl Rng) -> Self {
        let (sine, cosine) = (liveliness * TURN_RAD * normal(rng)).sin_cos();
        let zoom = (liveliness * ZOOM_LOG * normal(rng)).exp();
        let shear = liveliness * SHEAR * normal(rng);
        let matrix = [[zoom * cosine, zoom * (shear - sine)], [zoom * sine, zoom * cosine]];
        let shift = [shift_px * normal(rng), shift_px * normal(rng)];
        let turned: [f64; 2] = std::array::from_fn(|r| matrix[r][0] * centre[0] + matrix[r][1] * centre[1]);
        Self { matrix, offset: std::array::from_fn(|r| centre[r] + shift[r] - turned[r]) }
    }

    fn identity() -> Self {
        Self { matrix: [[1.0, 0.0], [0.0, 1.0]], offset: [0.0; 2] }
    }

    #[inline]
    fn apply(&self, x: f64, y: f64) -> [f64; 2] {
        std::array::from_fn(|r| self.matrix[r][0] * x + self.matrix[r][1] * y + self.offset[r])
    }

    /// `self` after `first`.
    fn after(&self, first: &Self) -> Self {
        let entry = |r: usize, c: usize| (0..2).map(|k| self.matrix[r][k] * first.matrix[k][c]).sum();
        let matrix = std::array::from_fn(|r| std::array::from_fn(|c| entry(r, c)));
        Self { matrix, offset: self.apply(first.offset[0], first.offset[1]) }
    }

    fn determinant(&self) -> f64 {
        self.matrix[0][0] * self.matrix[1][1] - self.matrix[0][1] * self.matrix[1][0]
    }

    /// The inverse; drawn motions keep their zoom away from 0.
    fn inverse(&self) -> Self {
        let [[a, b], [c, d]] = self.matrix;
        let det = self.determinant();
        let matrix = [[d / det, -b / det], [-c / det, a / det]];
        let [x, y] = self.offset;
        Self { matrix, offset: std::array::from_fn(|r| -(matrix[r][0] * x + matrix[r][1] * y)) }
    }

    fn in_f32(&self) -> [[f32; 3]; 2] {
        std::array::from_fn(|r| [self.matrix[r][0] as f32, self.matrix[r][1] as f32, self.offset[r] as f32])
    }
}

#[inline]
fn at(map: &[[f32; 3]; 2], x: f32, y: f32) -> [f32; 2] {
    std::array::from_fn(|r| map[r][0] * x + map[r][1] * y + map[r][2])
}

/// One of the two images' view of a layer.
#[derive(Clone, Debug)]
struct Seen {
    /// Pixel to the outline's coordinates.
    to_outline: [[f32; 3]; 2],
    /// Pixel to texel.
    to_texel: [[f32; 3]; 2],
    /// Pixels of this image per pixel of the outline.
    zoom: f32,
    /// Texels per pixel.
    footprint: f32,
    /// Cosine and sine of the angle from texture to image, y down.
    turn: [f32; 2],
}

/// A piece of a pair.
#[derive(Clone, Debug)]
pub(super) struct Layer {
    /// `None` covers everything.
    outline: Option<Outline>,
    reach: f32,
    surface: AugmentedMaterial,
    /// Source channel of each colour channel: more colours than the materials have.
    channels: [usize; 3],
    motion: Affine,
    seen: [Seen; 2],
}

impl Layer {
    /// A layer that covers the whole image.
    pub(super) fn background(material: &Arc<Material>, side: usize, motion: Affine, rng: &mut impl Rng) -> Self {
        Self::new(None, [side as f64 / 2.0; 2], material, motion, rng)
    }

    /// A shape somewhere in the image that moves with the background and on its own.
    pub(super) fn shape(material: &Arc<Material>, side: usize, background: &Affine, shift_px: f64, rng: &mut impl Rng) -> Self {
        let side = side as f64;
        let radius = side * RADIUS[0] * (RADIUS[1] / RADIUS[0]).powf(rng.random_range(0.0..=1.0));
        let outline = Outline::draw(radius as f32, rng);
        let centre: [f64; 2] = std::array::from_fn(|_| rng.random_range(-0.1..=1.1) * side);
        let own = Affine::draw_motion(centre, shift_px, SHAPE_LIVELINESS, rng);
        Self::new(Some(outline), centre, material, background.after(&own), rng)
    }

    fn new(outline: Option<Outline>, centre: [f64; 2], material: &Arc<Material>, motion: Affine, rng: &mut impl Rng) -> Self {
        let augmentation = Augmentation::draw(material, rng, &AugmentConfig { perlin: 0.0, ..AugmentConfig::default() });
        let mut channels = [0, 1, 2];
        channels.shuffle(rng);
        let pitch = PITCH[0] * (PITCH[1] / PITCH[0]).powf(rng.random_range(0.0..=1.0));
        let angle: f64 = rng.random_range(0.0..std::f64::consts::TAU);
        let (sine, cosine) = angle.sin_cos();
        let place: [f64; 2] = std::array::from_fn(|_| rng.random_range(0.0..GRID as f64));
        let to_texel = Affine { matrix: [[pitch * cosine, -pitch * sine], [pitch * sine, pitch * cosine]], offset: place };
        let to_outline = Affine { offset: [-centre[0], -centre[1]], ..Affine::identity() };
        let seen = [Affine::identity(), motion].map(|motion| {
            let back = to_outline.after(&motion.inverse());
            let zoom = motion.determinant().sqrt();
            let turn = motion.matrix[1][0].atan2(motion.matrix[0][0]) - angle;
            Seen {
                to_outline: back.in_f32(),
                to_texel: to_texel.after(&back).in_f32(),
                zoom: zoom as f32,
                footprint: (pitch / zoom) as f32,
                turn: [turn.cos() as f32, turn.sin() as f32],
            }
        });
        let reach = outline.as_ref().map_or(f32::INFINITY, Outline::reach);
        let surface = AugmentedMaterial { material: Arc::clone(material), augmentation };
        Self { outline, reach, surface, channels, motion, seen }
    }

    /// Where a point of the first image is in the second.
    pub(super) fn moved(&self, x: f64, y: f64) -> [f64; 2] {
        self.motion.apply(x, y)
    }

    /// Share of a pixel that the layer covers.
    #[inline]
    pub(super) fn coverage(&self, time: usize, x: f32, y: f32) -> f32 {
        let Some(outline) = &self.outline else { return 1.0 };
        let seen = &self.seen[time];
        let [u, v] = at(&seen.to_outline, x, y);
        let limit = self.reach + 2.0;
        if u * u + v * v > limit * limit {
            return 0.0;
        }
        (0.5 - outline.distance(u, v) * seen.zoom).clamp(0.0, 1.0)
    }

    /// The reflectance that shows at a pixel, its normal in the image's axes.
    #[inline]
    pub(super) fn texel(&self, time: usize, x: f32, y: f32) -> Texel {
        let seen = &self.seen[time];
        let [tx, ty] = at(&seen.to_texel, x, y);
        let texel = self.surface.sample(tx, ty, seen.footprint);
        let [cosine, sine] = seen.turn;
        let [nx, ny, nz] = texel.normal;
        // Normals have y up, the rotation is written for y down.
        let normal = [cosine * nx + sine * ny, cosine * ny - sine * nx, nz];
        let permuted = |v: [f32; 3]| self.channels.map(|c| v[c]);
        Texel { normal, diffuse: permuted(texel.diffuse), specular: permuted(texel.specular), ..texel }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sequence::tests::material;
    use crate::stream::Stream;

    #[test]
    fn motions_compose_and_invert() {
        let rng = &mut Stream::new(1).rng("motion", 0);
        let (a, b) = (Affine::draw_motion([40.0, 20.0], 5.0, 1.0, rng), Affine::draw_motion([10.0, 0.0], 5.0, 2.0, rng));
        let [x, y] = b.apply(7.0, -3.0);
        let (expected, found) = (a.apply(x, y), a.after(&b).apply(7.0, -3.0));
        assert!((expected[0] - found[0]).abs() < 1e-9 && (expected[1] - found[1]).abs() < 1e-9);
        let [x, y] = a.inverse().apply(a.apply(7.0, -3.0)[0], a.apply(7.0, -3.0)[1]);
        assert!((x - 7.0).abs() < 1e-9 && (y + 3.0).abs() < 1e-9);
    }

    #[test]
    fn a_point_carries_its_texel_and_coverage_along_and_turns_its_normal() {
        let rng = &mut Stream::new(1).rng("layer", 3);
        let layer = Layer::shape(&material(), 128, &Affine::identity(), 6.0, rng);
        let mut compared = 0;
        for (x, y) in (0..4096).map(|i| ((i % 64) as f32 * 2.0, (i / 64) as f32 * 2.0)) {
            let [px, py] = layer.moved(f64::from(x), f64::from(y)).map(|v| v as f32);
            if layer.coverage(0, x, y) < 1.0 {
                continue;
            }
            compared += 1;
            assert!(layer.coverage(1, px, py) > 0.9);
            let (before, after) = (layer.texel(0, x, y), layer.texel(1, px, py));
            assert!((before.diffuse[0] - after.diffuse[0]).abs() < 0.02);
            let turned = layer.motion.matrix;
            let expected = turned[0][0] as f32 * before.normal[0] - turned[0][1] as f32 * before.normal[1];
            assert!((after.normal[0] - expected).abs() < 0.06, "{} beside {expected}", after.normal[0]);
        }
        assert!(compared > 20, "the shape covers {compared} of the compared pixels");
    }
}
