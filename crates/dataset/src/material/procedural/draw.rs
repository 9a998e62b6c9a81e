//! The random choices of one material, and noise fields of its size.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::colour::{Rgb, hsv};
use super::field::Field;
use super::noise::Fbm;
use super::worley::Worley;

/// A seeded stream of choices for a tile of a given size. The choices don't depend on the size.
pub struct Draw {
    /// Texels per edge of the tile.
    pub size: usize,
    rng: ChaCha8Rng,
}

impl Draw {
    /// The stream `stream` of `seed`.
    pub fn new(seed: u64, stream: u64, size: usize) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(stream);
        Self { size, rng }
    }

    /// Uniform in [low, high).
    pub fn between(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * self.rng.random::<f32>()
    }

    /// Log-uniform in [low, high): as many values between 1 and 2 as between 2 and 4.
    pub fn scale_between(&mut self, low: f32, high: f32) -> f32 {
        self.between(low.ln(), high.ln()).exp()
    }

    /// A whole number in low..=high.
    pub fn whole(&mut self, low: usize, high: usize) -> usize {
        self.rng.random_range(low as u64..=high as u64) as usize
    }

    /// True with probability `p`.
    pub fn chance(&mut self, p: f32) -> bool {
        self.rng.random::<f32>() < p
    }

    /// One of the options.
    pub fn pick<T: Copy>(&mut self, options: &[T]) -> T {
        options[self.whole(0, options.len() - 1)]
    }

    /// A seed for a noise field or a set of identities.
    pub fn seed(&mut self) -> u32 {
        self.rng.random()
    }

    /// A linear colour with hue (turns), saturation and value drawn from the ranges.
    pub fn hsv(&mut self, hue: [f32; 2], saturation: [f32; 2], value: [f32; 2]) -> Rgb {
        let mut from = |range: [f32; 2]| self.between(range[0], range[1]);
        hsv(from(hue), from(saturation), from(value))
    }

    /// A grey without any colour, its gamma-encoded value drawn from the range.
    pub fn grey(&mut self, value: [f32; 2]) -> Rgb {
        self.hsv([0.0; 2], [0.0; 2], value)
    }

    /// The colour with its brightness changed by up to ±`amount` and each channel by a sixth of that.
    pub fn near(&mut self, colour: Rgb, amount: f32) -> Rgb {
        let gain = 1.0 + self.between(-amount, amount);
        colour.map(|v| (v * gain * (1.0 + self.between(-amount, amount) / 6.0)).clamp(0.0, 1.0))
    }

    /// Isotropic fractal noise.
    pub fn noise(&mut self, wavelength: f32, octaves: u32) -> Field {
        self.fbm(Fbm::new(wavelength, octaves))
    }

    /// Fractal noise of another description.
    pub fn fbm(&mut self, fbm: Fbm) -> Field {
        fbm.field(self.size, self.seed())
    }

    /// Billowy fractal noise.
    pub fn billow(&mut self, fbm: Fbm) -> Field {
        fbm.billow(self.size, self.seed())
    }

    /// Ridged fractal noise.
    pub fn ridged(&mut self, fbm: Fbm) -> Field {
        fbm.ridged(self.size, self.seed())
    }

    /// Cells with feature points jittered by 0.85 of a cell.
    pub fn worley(&mut self, cell: f32) -> Worley {
        Worley::new(cell, [1.0; 2], 0.85, self.seed())
    }
}
