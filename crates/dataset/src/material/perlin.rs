//! Perlin masks: where an augmented material shows its second, homogeneous specular layer (paper §4).
//!
//! A mask is a function of the texel's position and is evaluated where it is sampled, at any footprint.

#![allow(clippy::needless_range_loop, reason = "lockstep loops over several arrays are plainest with one index")]

use rand::{Rng, RngExt};
use render::block::{LANES, Lane};

use super::levels::whole_and_fraction;
use crate::stream::Stream;

/// Seed of the pool of masks: a constant, so that every run draws from the same pool.
const POOL_SEED: u64 = 0x5045_524c_494e;
/// Amplitude of each octave relative to the one before.
const PERSISTENCE: f32 = 0.5;
/// Frequency of each octave relative to the one before.
const LACUNARITY: f32 = 2.0;
/// Typical slope of the noise per unit of its own coordinate: turns a distance in noise value into one in texels.
const TYPICAL_SLOPE: f32 = 1.0;

/// Gradients of classic Perlin noise, seen in the plane z = 0: the twelve edge midpoints of a cube and four of them again.
const GRADIENTS: [[i32; 2]; 16] = [
    [1, 1],
    [-1, 1],
    [1, -1],
    [-1, -1],
    [1, 0],
    [-1, 0],
    [1, 0],
    [-1, 0],
    [0, 1],
    [0, -1],
    [0, 1],
    [0, -1],
    [1, 0],
    [-1, 0],
    [0, -1],
    [0, 1],
];

/// Thresholded Perlin noise over the texel grid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PerlinMask {
    /// Octaves of the noise.
    pub octaves: u32,
    /// Wavelength of the coarsest octave, in texels of the 4096² grid.
    pub wavelength: f32,
    /// What is added to coordinates, in wavelengths of an octave.
    pub offset: [f32; 2],
    /// The noise above which the base material shows.
    pub threshold: f32,
}

impl PerlinMask {
    /// A random mask: octaves from {1, 2, 3}, offset U\[0, 1024\]², threshold U\[−0.3, 0.3\].
    ///
    /// # Units
    /// `wavelength`: range of the coarsest octave's wavelength, in texels of the 4096² grid.
    pub fn draw(rng: &mut impl Rng, wavelength: [f32; 2]) -> Self {
        Self {
            octaves: rng.random_range(1..=3),
            wavelength: rng.random_range(wavelength[0]..=wavelength[1]),
            offset: [rng.random_range(0.0..1024.0), rng.random_range(0.0..1024.0)],
            threshold: rng.random_range(-0.3..=0.3),
        }
    }

    /// Mask `index` of the pool that videos draw from (100 masks in the paper's setting); the same in every run.
    pub fn from_pool(index: u32, wavelength: [f32; 2]) -> Self {
        Self::draw(&mut Stream::new(POOL_SEED).rng("perlin mask", u64::from(index)), wavelength)
    }

    /// The noise under the threshold: octaves added and divided by the sum of their amplitudes, so within \[−1, 1\].
    pub fn noise(&self, tx: f32, ty: f32) -> f32 {
        self.noise_block([&[tx; LANES], &[ty; LANES]])[0]
    }

    #[inline(always)]
    fn noise_block(&self, [tx, ty]: [&Lane; 2]) -> Lane {
        let mut frequency = 1.0 / self.wavelength;
        let (mut amplitude, mut sum, mut total) = (1.0, [0.0; LANES], 0.0);
        for octave in 0..self.octaves {
            for k in 0..LANES {
                let (x, y) = (tx[k] * frequency + self.offset[0], ty[k] * frequency + self.offset[1]);
                sum[k] += amplitude * perlin(x, y, octave);
            }
            total += amplitude;
            amplitude *= PERSISTENCE;
            frequency *= LACUNARITY;
        }
        sum.map(|sum| sum / total)
    }

    /// The mask's value: 1 where the noise is above the threshold, 0 below, and an edge as wide as the footprint between.
    ///
    /// # Units
    /// Texels of the 4096² grid.
    pub fn value(&self, tx: f32, ty: f32, footprint: f32) -> f32 {
        self.value_block([&[tx; LANES], &[ty; LANES]], &[footprint; LANES])[0]
    }

    /// [`PerlinMask::value`] at the places of a block.
    #[inline(always)]
    pub fn value_block(&self, places: [&Lane; 2], footprint: &Lane) -> Lane {
        let mut value = self.noise_block(places);
        for k in 0..LANES {
            let texels = (value[k] - self.threshold) * self.wavelength / TYPICAL_SLOPE;
            value[k] = (texels / footprint[k].max(1.0) + 0.5).clamp(0.0, 1.0);
        }
        value
    }
}

/// Classic gradient noise with the quintic fade. Zero at every lattice point.
#[inline(always)]
fn perlin(x: f32, y: f32, octave: u32) -> f32 {
    let ((ix, fx), (iy, fy)) = (whole_and_fraction(x), whole_and_fraction(y));
    let corner = |dx: i32, dy: i32| {
        let hash = lattice_hash((ix + dx) as u32, (iy + dy) as u32, octave);
        gradient(GRADIENTS_X, hash) * (fx - dx as f32) + gradient(GRADIENTS_Y, hash) * (fy - dy as f32)
    };
    let fade = |t: f32| t * t * t * (t * (t * 6.0 - 15.0) + 10.0);
    let (u, v) = (fade(fx), fade(fy));
    let top = corner(0, 0) + u * (corner(1, 0) - corner(0, 0));
    let bottom = corner(0, 1) + u * (corner(1, 1) - corner(0, 1));
    top + v * (bottom - top)
}

/// A coordinate of the gradient that the lowest four bits of a hash choose, by a shift rather than a look into the table: that
/// vectorises.
#[inline(always)]
fn gradient(packed: u32, hash: u32) -> f32 {
    ((packed >> (2 * (hash & 15))) & 3) as i32 as f32 - 1.0
}

/// A coordinate of all [`GRADIENTS`], each plus one in two bits.
const fn packed(axis: usize) -> u32 {
    let (mut bits, mut k) = (0, 0);
    while k < GRADIENTS.len() {
        bits |= ((GRADIENTS[k][axis] + 1) as u32) << (2 * k);
        k += 1;
    }
    bits
}

const GRADIENTS_X: u32 = packed(0);
const GRADIENTS_Y: u32 = packed(1);

/// A well-mixed number per lattice point: what the permutation table is to the original, without its period of 256.
#[inline(always)]
fn lattice_hash(x: u32, y: u32, octave: u32) -> u32 {
    let mut h = x.wrapping_mul(0x9e37_79b1) ^ y.wrapping_mul(0x85eb_ca77).rotate_left(16) ^ octave.wrapping_mul(0xc2b2_ae3d);
    h = (h ^ (h >> 15)).wrapping_mul(0x2c1b_3c6d);
    h = (h ^ (h >> 12)).wrapping_mul(0x297a_2d39);
    h ^ (h >> 15)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mask(octaves: u32) -> PerlinMask {
        PerlinMask { octaves, wavelength: 16.0, offset: [3.0, 7.0], threshold: 0.0 }
    }

    #[test]
    fn noise_is_zero_on_the_lattice_continuous_and_in_range() {
        let one = mask(1);
        assert_eq!(one.noise(32.0, 48.0), 0.0);
        let (mut low, mut high, mut square) = (0.0f32, 0.0f32, 0.0f64);
        for i in 0..40_000 {
            let (x, y) = ((i % 200) as f32 * 1.7, (i / 200) as f32 * 1.3);
            for octaves in 1..=3 {
                let here = mask(octaves).noise(x, y);
                assert!((here - mask(octaves).noise(x + 0.01, y)).abs() < 0.01, "a jump at {x}, {y}");
                (low, high) = (low.min(here), high.max(here));
            }
            square += f64::from(one.noise(x, y)).powi(2);
        }
        assert!((-1.0..-0.5).contains(&low) && (0.5..=1.0).contains(&high), "{low}..{high}");
        // Classic 2-D Perlin noise has a standard deviation near 0.27.
        assert!((0.2..0.35).contains(&(square / 40_000.0).sqrt()));
    }

    #[test]
    fn the_mask_averages_where_a_pixel_covers_much() {
        let share = |footprint: f32| {
            (0..10_000).filter(|i| (0.01..0.99).contains(&mask(2).value((i % 100) as f32, (i / 100) as f32, footprint))).count()
        };
        assert!(share(1.0) < 1_500 && share(16.0) > 5_000, "{} {}", share(1.0), share(16.0));
    }

    #[test]
    fn the_pool_is_fixed_and_varied() {
        let pool: Vec<_> = (0..100).map(|i| PerlinMask::from_pool(i, [16.0, 64.0])).collect();
        assert_eq!(pool[7], PerlinMask::from_pool(7, [16.0, 64.0]));
        for octaves in 1..=3 {
            assert!(pool.iter().filter(|m| m.octaves == octaves).count() > 15);
        }
        assert!(pool.iter().all(|m| (16.0..=64.0).contains(&m.wavelength) && m.threshold.abs() <= 0.3));
    }
}
