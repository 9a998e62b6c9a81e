//! Sensor noise (§4) as a function of the pixel, so that a crop of a frame holds the same noise as the whole frame.

use std::sync::OnceLock;

use rand::{Rng, RngExt};
use rand_distr::{Distribution, LogNormal};

/// Median of the noise's standard deviation in linear light.
const MEDIAN: f32 = 0.005;
/// Standard deviation of its logarithm.
const LOG_SPREAD: f32 = 0.3;
/// Entries of the table of normal quantiles.
const QUANTILES: usize = 1 << 12;

/// Gaussian noise of one frame; every pixel and channel has its own value, whichever pixels are asked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PixelNoise {
    sigma: f32,
    key: u64,
}

impl PixelNoise {
    /// The noise of one frame, sigma = `scale`·exp(N(ln 0.005, 0.3)).
    pub fn draw(scale: f32, rng: &mut impl Rng) -> Self {
        let sigma = LogNormal::new(MEDIAN.ln(), LOG_SPREAD).expect("the spread is a finite constant").sample(rng);
        // The first number is passed over, as ever: a change would change every video of a seed.
        let [_, key] = rng.random();
        Self::new(scale * sigma, key)
    }

    /// The noise of a frame with the given standard deviation; frames with different keys share nothing.
    pub fn new(sigma: f32, key: u64) -> Self {
        Self { sigma, key }
    }

    /// The noise of the three channels at a pixel.
    #[inline(always)]
    pub fn at(&self, y: usize, x: usize) -> [f32; 3] {
        let bits = mixed(self.key.wrapping_add(((y as u64) << 32 | x as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15)));
        let table = quantiles();
        [bits >> 52, bits >> 40, bits >> 28].map(|b| self.sigma * table[b as usize & (QUANTILES - 1)])
    }
}

/// The finaliser of SplitMix64 (Steele, Lea and Flood 2014): every input bit reaches every output bit.
#[inline(always)]
fn mixed(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// The normal distribution's quantiles at (k + ½)/4096, scaled to variance 1.
///
/// One lookup per value instead of a logarithm and a square root; the steps of the table are far below one 8-bit code.
#[inline(always)]
fn quantiles() -> &'static [f32; QUANTILES] {
    static TABLE: OnceLock<Box<[f32; QUANTILES]>> = OnceLock::new();
    TABLE.get_or_init(|| {
        let steps = 400_000;
        let width = 12.0 / steps as f64;
        let density = |z: f64| (-0.5 * z * z).exp() / std::f64::consts::TAU.sqrt();
        let mut table = Box::new([0.0f32; QUANTILES]);
        let (mut filled, mut below) = (0, 0.0);
        for step in 0..steps {
            let z = -6.0 + (step as f64 + 0.5) * width;
            below += density(z) * width;
            while filled < QUANTILES && below >= (filled as f64 + 0.5) / QUANTILES as f64 {
                table[filled] = z as f32;
                filled += 1;
            }
        }
        let square: f32 = table.iter().map(|v| v * v).sum::<f32>() / QUANTILES as f32;
        table.iter_mut().for_each(|v| *v /= square.sqrt());
        table
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moments_are_those_of_the_normal_distribution() {
        let noise = PixelNoise::new(2.0, 99);
        let values: Vec<f64> = (0..200_000).flat_map(|i| noise.at(i / 512, i % 512)).map(f64::from).collect();
        let moment = |p: i32| values.iter().map(|v| (v / 2.0).powi(p)).sum::<f64>() / values.len() as f64;
        assert!(moment(1).abs() < 0.005 && (moment(2) - 1.0).abs() < 0.01);
        assert!(moment(3).abs() < 0.02 && (moment(4) - 3.0).abs() < 0.06, "{} {}", moment(3), moment(4));
    }

    #[test]
    fn channels_neighbours_and_frames_are_independent() {
        let (a, b) = (PixelNoise::new(1.0, 1), PixelNoise::new(1.0, 2));
        let pixels: Vec<(usize, usize)> = (0..40_000).map(|i| (i / 200, i % 200)).collect();
        let correlation = |f: &dyn Fn(usize, usize) -> f32| {
            pixels.iter().map(|&(y, x)| f64::from(f(y, x))).sum::<f64>() / pixels.len() as f64
        };
        assert!(correlation(&|y, x| a.at(y, x)[0] * a.at(y, x)[1]).abs() < 0.02);
        assert!(correlation(&|y, x| a.at(y, x)[0] * a.at(y, x + 1)[0]).abs() < 0.02);
        assert!(correlation(&|y, x| a.at(y, x)[2] * a.at(y + 1, x)[2]).abs() < 0.02);
        assert!(correlation(&|y, x| a.at(y, x)[0] * b.at(y, x)[0]).abs() < 0.02);
    }
}
