//! Test scene: a smooth random texture seen under known homographies, lit by a highlight that travels with the camera, with
//! relief that a flash at the camera shades.

use ops::homography::Homography;
use ops::planes::Planes;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::size::Size;

/// A texture that can be sampled anywhere and doesn't repeat.
#[derive(Clone, Copy)]
pub(crate) struct Scene {
    /// Seed of the texture.
    pub seed: u64,
    /// Contrast of the texture.
    pub contrast: f32,
    /// Share of the contrast that every colour has of its own.
    pub colour: f32,
    /// Strength of the camera-fixed highlight.
    pub highlight: f32,
    /// Amplitude of the noise.
    pub noise: f32,
    /// Height of bright over dark places, in pixels of the texture per unit of it: hollows are dark.
    pub relief: f32,
}

/// A weave of one period over a texture of its own contrast, which doesn't repeat.
pub(crate) fn weave(view: &Homography, size: Size, period: f64, own: f32) -> Planes {
    let mut frame = Scene { contrast: own, noise: 0.01, ..Scene::new(3) }.frame(view, size);
    for (y, x) in (0..size.height).flat_map(|y| (0..size.width).map(move |x| (y, x))) {
        let (u, v) = view.apply(x as f64, y as f64).unwrap_or_default();
        let wave = |t: f64| (std::f64::consts::TAU * t / period).sin();
        let threads = 0.2 * (wave(u) * wave(v)) as f32;
        (0..3).for_each(|c| frame.set(c, y, x, frame.at(c, y, x) + threads));
    }
    frame
}

/// Height of the camera and its flash over the texture, in widths of the frame: a field of view of some 30°.
const FLASH_HEIGHT: f64 = 1.9;

impl Scene {
    pub fn new(seed: u64) -> Self {
        Self { seed, contrast: 0.25, colour: 0.3, highlight: 0.0, noise: 0.0, relief: 0.0 }
    }

    /// The frame of a camera whose pixels lie at `view(pixel)` on the texture.
    pub fn frame(&self, view: &Homography, size: Size) -> Planes {
        let mut frame = Planes::new(3, size.height, size.width);
        let seed = view.matrix.iter().fold(self.seed, |s, v| s.rotate_left(7) ^ v.to_bits());
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let (over_u, over_v) =
            view.apply(0.5 * (size.width as f64 - 1.0), 0.5 * (size.height as f64 - 1.0)).unwrap_or_default();
        let flash_height = FLASH_HEIGHT * size.width as f64;
        for y in 0..size.height {
            for x in 0..size.width {
                let (u, v) = view.apply(x as f64, y as f64).unwrap_or_default();
                let offset = |i: usize, n: usize| (i as f32 - 0.45 * n as f32) / (0.25 * n as f32);
                let away = offset(x, size.width).powi(2) + offset(y, size.height).powi(2);
                let glare = self.highlight * (-0.5 * away).exp();
                let shared = self.texture(u as f32, v as f32, 0);
                let towards = ((over_u - u) / flash_height, (over_v - v) / flash_height);
                let shading = 1.0 + self.shading(u as f32, v as f32, [towards.0 as f32, towards.1 as f32]);
                for c in 0..3 {
                    let noise = self.noise * rng.random_range(-1.0..1.0f32);
                    let texture = (1.0 - self.colour) * shared + self.colour * self.texture(u as f32, v as f32, c as u64 + 1);
                    frame.set(c, y, x, ((0.4 + self.contrast * texture) * shading + glare + noise).clamp(0.0, 1.0));
                }
            }
        }
        frame
    }

    /// How much brighter a place is that faces the light: minus the gradient of the height, times the slopes of the light.
    fn shading(&self, u: f32, v: f32, towards: [f32; 2]) -> f32 {
        if self.relief == 0.0 {
            return 0.0;
        }
        let across = 0.5 * (self.texture(u + 1.0, v, 0) - self.texture(u - 1.0, v, 0));
        let down = 0.5 * (self.texture(u, v + 1.0, 0) - self.texture(u, v - 1.0, 0));
        -self.relief * (across * towards[0] + down * towards[1])
    }

    /// Three octaves of value noise in about −1 … 1.
    fn texture(&self, u: f32, v: f32, layer: u64) -> f32 {
        let octaves = [(5.0, 0.5), (11.0, 0.7), (24.0, 0.8)];
        octaves
            .iter()
            .enumerate()
            .map(|(i, (cell, weight))| weight * self.noise_at(u / cell, v / cell, layer * 8 + i as u64))
            .sum()
    }

    fn noise_at(&self, u: f32, v: f32, layer: u64) -> f32 {
        let (x, y) = (u.floor(), v.floor());
        let smooth = |t: f32| t * t * t * (t * (6.0 * t - 15.0) + 10.0);
        let (fx, fy) = (smooth(u - x), smooth(v - y));
        let corner = |dx: i64, dy: i64| {
            let mut h =
                (x as i64 + dx) as u64 ^ ((y as i64 + dy) as u64).rotate_left(24) ^ layer.rotate_left(48) ^ (self.seed << 56);
            // The finaliser of splitmix64.
            h = (h ^ (h >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            h = (h ^ (h >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            (h ^ (h >> 31)) as f32 / u64::MAX as f32 * 2.0 - 1.0
        };
        let top = corner(0, 0) + fx * (corner(1, 0) - corner(0, 0));
        let low = corner(0, 1) + fx * (corner(1, 1) - corner(0, 1));
        top + fy * (low - top)
    }
}

/// A view: frame centre at (x, y) of the texture, rolled by `roll_rad`, magnified by `zoom`, with a slight tilt.
pub(crate) fn view(size: Size, x: f64, y: f64, roll_rad: f64, zoom: f64, tilt: f64) -> Homography {
    let (cx, cy) = (0.5 * (size.width as f64 - 1.0), 0.5 * (size.height as f64 - 1.0));
    let (sin, cos) = roll_rad.sin_cos();
    let centred =
        nalgebra::Matrix3::new(zoom * cos, -zoom * sin, x, zoom * sin, zoom * cos, y, tilt / cx, -0.6 * tilt / cx, 1.0);
    Homography::new(centred * Homography::translation(-cx, -cy).matrix)
}

/// target px → source px of two views.
pub(crate) fn between(target: &Homography, source: &Homography) -> Homography {
    source.inverse().expect("views are invertible").after(target)
}
