//! Periodic gradient noise and its fractal sums, evaluated row by row.
//!
//! The `noise` crate's fields are `f64`, evaluated point by point and periodic only through 4-D tricks; these wrap at the
//! tile's edge by construction and cost a few nanoseconds per texel and octave.

use std::f32::consts::FRAC_1_SQRT_2;

use super::field::{Field, TILE};

/// A well-mixed 32-bit hash of a lattice point.
#[inline]
pub fn hash(seed: u32, x: u32, y: u32) -> u32 {
    mix(seed ^ mix(x.wrapping_add(0x9E37_79B9) ^ mix(y.wrapping_add(0x85EB_CA6B))))
}

/// The `index`-th uniform number in [0, 1) that belongs to an identity (a brick, a thread, a pebble).
#[inline]
pub fn unit(id: u32, index: u32) -> f32 {
    (hash(id, index, 0x51ED) >> 8) as f32 / (1 << 24) as f32
}

/// Finaliser by C. Wellons ("lowbias32").
#[inline]
fn mix(mut h: u32) -> u32 {
    h = (h ^ (h >> 16)).wrapping_mul(0x7FEB_352D);
    h = (h ^ (h >> 15)).wrapping_mul(0x846C_A68B);
    h ^ (h >> 16)
}

/// A fractal sum of gradient noise: octaves double in frequency and shrink by `gain`.
#[derive(Clone, Copy, Debug)]
pub struct Fbm {
    /// Size of the largest features along x and y, in reference texels.
    pub wavelength: [f32; 2],
    /// Number of octaves; those finer than two texels are left out.
    pub octaves: u32,
    /// Amplitude ratio of successive octaves.
    pub gain: f32,
}

impl Fbm {
    /// Isotropic noise with halving amplitudes.
    pub fn new(wavelength: f32, octaves: u32) -> Self {
        Self::stretched(wavelength, wavelength, octaves)
    }

    /// Noise with different feature sizes along x and y.
    pub fn stretched(x: f32, y: f32, octaves: u32) -> Self {
        Self { wavelength: [x, y], octaves, gain: 0.5 }
    }

    /// The same with another amplitude ratio.
    pub fn gain(self, gain: f32) -> Self {
        Self { gain, ..self }
    }

    /// Zero-mean noise with a standard deviation near 0.35, about within [−1, 1].
    pub fn field(self, size: usize, seed: u32) -> Field {
        self.sum(size, seed, |n| n)
    }

    /// Ridged noise: every octave is 1 − 2·|n|, so sharp crests (near +1) run between valleys.
    pub fn ridged(self, size: usize, seed: u32) -> Field {
        self.sum(size, seed, |n| 1.0 - 2.5 * n.abs())
    }

    /// Billowy noise: every octave is 2·|n| − 1/2, round lumps between sharp creases.
    pub fn billow(self, size: usize, seed: u32) -> Field {
        self.sum(size, seed, |n| 2.5 * n.abs() - 0.6)
    }

    fn sum(self, size: usize, seed: u32, shape: impl Fn(f32) -> f32 + Copy) -> Field {
        let power: f32 = (0..self.octaves).map(|k| self.gain.powi(2 * k as i32)).sum();
        let mut out = Field::constant(size, 0.0);
        let cells = self.wavelength.map(|w| (TILE / w).round().max(1.0) as usize);
        for octave in 0..self.octaves {
            let cells = cells.map(|c| c << octave);
            if cells[0].max(cells[1]) * 2 > size && octave > 0 {
                break;
            }
            let cells = cells.map(|c| c.min((size / 2).max(1)));
            let amplitude = self.gain.powi(octave as i32) / power.sqrt();
            add_gradient_noise(&mut out, cells, hash(seed, octave, 7), |n| amplitude * shape(n));
        }
        out
    }
}

/// Adds gradient noise (Perlin 2002: quintic fade; here with random values at the lattice points too) with `cells` lattice cells per tile edge.
///
/// Within a row, interpolating the two lattice rows first leaves one linear function per lattice column, so a texel costs
/// two of them and a blend.
fn add_gradient_noise(out: &mut Field, cells: [usize; 2], seed: u32, shape: impl Fn(f32) -> f32) {
    let size = out.size;
    let columns: Vec<(usize, f32, f32)> = (0..size).map(|x| lattice(x, size, cells[0])).collect();
    let (mut slope, mut offset) = (vec![0.0f32; cells[0] + 1], vec![0.0f32; cells[0] + 1]);
    for (y, row) in out.data.chunks_exact_mut(size).enumerate() {
        let (j, fy, v) = lattice(y, size, cells[1]);
        let below = (j + 1) % cells[1];
        for i in 0..cells[0] {
            let (a, b) = (knot(seed, i, j), knot(seed, i, below));
            slope[i] = a.slope[0] + v * (b.slope[0] - a.slope[0]);
            offset[i] = (1.0 - v) * (a.value + a.slope[1] * fy) + v * (b.value + b.slope[1] * (fy - 1.0));
        }
        (slope[cells[0]], offset[cells[0]]) = (slope[0], offset[0]);
        for (value, &(i, fx, u)) in row.iter_mut().zip(&columns) {
            let left = slope[i] * fx + offset[i];
            let right = slope[i + 1] * (fx - 1.0) + offset[i + 1];
            *value += shape(left + u * (right - left));
        }
    }
}

/// Lattice cell, position within it and the fade weight of a texel centre.
fn lattice(texel: usize, size: usize, cells: usize) -> (usize, f32, f32) {
    let position = (texel as f32 + 0.5) * cells as f32 / size as f32;
    let cell = (position as usize).min(cells - 1);
    let t = position - cell as f32;
    (cell, t, t * t * t * (t * (t * 6.0 - 15.0) + 10.0))
}

/// What the noise does at a lattice point: its value and its gradient.
struct Knot {
    value: f32,
    slope: [f32; 2],
}

/// Perlin's noise is zero at every lattice point, which shows as a grid when cells are a few texels wide; a random value
/// there hides it. The factors keep the standard deviation near 0.35.
#[inline]
fn knot(seed: u32, x: usize, y: usize) -> Knot {
    const VALUE: f32 = 0.75;
    const SLOPE: f32 = 1.0;
    const COS: [f32; 16] = [
        1.0,
        0.923_88,
        FRAC_1_SQRT_2,
        0.382_683,
        0.0,
        -0.382_683,
        -FRAC_1_SQRT_2,
        -0.923_88,
        -1.0,
        -0.923_88,
        -FRAC_1_SQRT_2,
        -0.382_683,
        0.0,
        0.382_683,
        FRAC_1_SQRT_2,
        0.923_88,
    ];
    let bits = hash(seed, x as u32, y as u32);
    let turn = (bits >> 28) as usize;
    let value = (bits & 0xFFFF) as f32 / 32768.0 - 1.0;
    Knot { value: VALUE * value, slope: [SLOPE * COS[turn], SLOPE * COS[(turn + 12) & 15]] }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn moments(field: &Field) -> (f32, f32) {
        let n = field.data.len() as f32;
        let mean = field.data.iter().sum::<f32>() / n;
        (mean, (field.data.iter().map(|v| (v - mean).powi(2)).sum::<f32>() / n).sqrt())
    }

    #[test]
    fn noise_has_the_promised_spread_at_every_octave_count() {
        for octaves in 1..=5 {
            let (mean, deviation) = moments(&Fbm::new(24.0, octaves).field(512, 11));
            assert!(mean.abs() < 0.05, "{octaves}: mean {mean}");
            assert!((0.28..0.42).contains(&deviation), "{octaves}: standard deviation {deviation}");
        }
    }

    #[test]
    fn noise_continues_over_the_edge() {
        let field = Fbm::stretched(300.0, 200.0, 2).field(256, 3);
        let largest = |pairs: &mut dyn Iterator<Item = (usize, usize)>| {
            pairs.map(|(a, b)| (field.data[a] - field.data[b]).abs()).fold(0.0f32, f32::max)
        };
        let inside = largest(&mut (0..256).flat_map(|y| (1..256).map(move |x| (y * 256 + x, y * 256 + x - 1))));
        let over_x = largest(&mut (0..256).map(|y| (y * 256, y * 256 + 255)));
        let over_y = largest(&mut (0..256).map(|x| (x, 255 * 256 + x)));
        assert!(over_x <= 1.1 * inside && over_y <= 1.1 * inside, "{over_x} {over_y} against {inside}");
    }

    #[test]
    fn a_noise_is_the_same_function_at_two_resolutions() {
        let (coarse, fine) = (Fbm::new(128.0, 2).field(128, 5), Fbm::new(128.0, 2).field(384, 5));
        // Three fine texels lie in a coarse one; the middle one has its centre.
        for y in 0..128 {
            for x in 0..128 {
                let (a, b) = (coarse.data[y * 128 + x], fine.data[(3 * y + 1) * 384 + 3 * x + 1]);
                assert!((a - b).abs() < 1e-4, "{x} {y}: {a} {b}");
            }
        }
    }

    #[test]
    fn identities_are_uniform_and_independent() {
        let values: Vec<[f32; 2]> = (0..4096).map(|k| [unit(hash(1, k, 2), 0), unit(hash(1, k, 2), 1)]).collect();
        for axis in 0..2 {
            let mean = values.iter().map(|v| v[axis]).sum::<f32>() / 4096.0;
            assert!((mean - 0.5).abs() < 0.02, "{mean}");
        }
        let product = values.iter().map(|v| (v[0] - 0.5) * (v[1] - 0.5)).sum::<f32>() / 4096.0;
        assert!(product.abs() < 0.006, "{product}");
    }
}
