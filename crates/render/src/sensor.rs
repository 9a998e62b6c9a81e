//! The camera's sensor: noise, clipping, encoding and quantisation (paper §4).

use ops::colour::GAMMA;
use ops::planes::Planes;
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, LogNormal, StandardNormal};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Median of the noise's standard deviation in linear space.
pub const NOISE_MEDIAN: f32 = 0.005;
/// Standard deviation of its logarithm.
pub const NOISE_SPREAD: f32 = 0.3;

/// How one frame is read out.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sensor {
    /// Standard deviation of the Gaussian noise in linear space.
    pub sigma: f32,
    /// Seed of the frame's noise.
    pub seed: u64,
}

impl Sensor {
    /// A sensor with the paper's random noise, sigma = exp(N(ln 0.005, 0.3)), for one frame.
    pub fn draw(rng: &mut impl Rng) -> Self {
        let spread = LogNormal::new(NOISE_MEDIAN.ln(), NOISE_SPREAD).expect("the spread is finite");
        Self { sigma: spread.sample(rng), seed: rng.random() }
    }

    /// A sensor that only clips, encodes and quantises.
    pub fn noiseless() -> Self {
        Self { sigma: 0.0, seed: 0 }
    }

    /// Linear light to the frame a program reads: noise, clip to [0, 1], power 1/2.2, 8 bits.
    ///
    /// Values come back as multiples of 1/255. Every row has its own noise stream, so the result doesn't depend on the
    /// number of threads.
    pub fn expose(&self, linear: &Planes) -> Planes {
        let mut frame = Planes::new(linear.channels, linear.height, linear.width);
        let encoder = Encoder::shared();
        let rows = frame.data.par_chunks_mut(linear.width).zip(linear.data.par_chunks(linear.width));
        rows.enumerate().for_each(|(row, (out, light))| {
            if self.sigma == 0.0 {
                out.iter_mut().zip(light).for_each(|(value, &x)| *value = encoder.encode(x));
                return;
            }
            let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
            rng.set_stream(row as u64);
            for (value, &x) in out.iter_mut().zip(light) {
                let noise: f32 = rng.sample(StandardNormal);
                *value = encoder.encode(x + self.sigma * noise);
            }
        });
        frame
    }
}

/// Linear value to 8-bit code without a power or a branch per pixel: by a table over √x, in which the codes' thresholds lie
/// almost evenly, and one comparison.
struct Encoder {
    /// The code at the lower end of each bin.
    guess: Vec<u8>,
    /// The light from which on the code is at least k; code 256 is never reached.
    threshold: [f32; 257],
    /// The code as a share of 255.
    share: [f32; 256],
}

impl Encoder {
    /// Bins over √x from 0 to 1: narrower than the distance between two thresholds, so that none holds two.
    const BINS: usize = 1024;

    fn shared() -> &'static Self {
        static ENCODER: std::sync::OnceLock<Encoder> = std::sync::OnceLock::new();
        ENCODER.get_or_init(Self::new)
    }

    fn new() -> Self {
        let mut threshold = [f32::INFINITY; 257];
        for (k, t) in threshold.iter_mut().enumerate().take(256) {
            *t = if k == 0 { 0.0 } else { ((k as f32 - 0.5) / 255.0).powf(GAMMA) };
        }
        // A root that was rounded up may reach a bin's lower end from below.
        let lower = |bin: usize| ((bin as f32 - 0.01) / Self::BINS as f32).max(0.0).powi(2);
        let code = |x: f32| threshold[1..256].partition_point(|t| *t <= x) as u8;
        let guess = (0..=Self::BINS).map(|bin| code(lower(bin))).collect();
        Self { guess, threshold, share: std::array::from_fn(|k| k as f32 / 255.0) }
    }

    /// round(255·clip(x)^(1/2.2)).
    #[inline]
    fn code(&self, x: f32) -> usize {
        let x = x.clamp(0.0, 1.0);
        let guess = usize::from(self.guess[(x.sqrt() * Self::BINS as f32) as usize]);
        guess + usize::from(x >= self.threshold[guess + 1])
    }

    /// The code as a share of 255.
    #[inline]
    fn encode(&self, x: f32) -> f32 {
        self.share[self.code(x)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ops::colour::gamma_encode;

    #[test]
    fn codes_are_the_rounded_encoding() {
        let encoder = Encoder::new();
        for i in 0..=100_000 {
            let x = i as f32 / 100_000.0;
            let exact = f64::from(x).powf(1.0 / 2.2) * 255.0;
            assert!((encoder.code(x) as f64 - exact).abs() < 0.5001, "{x}");
        }
        // At every threshold and the numbers beside it, where the guess could be two codes off.
        for (k, &t) in encoder.threshold[1..256].iter().enumerate() {
            assert_eq!((encoder.code(t.next_down()), encoder.code(t)), (k, k + 1));
        }
        assert_eq!(encoder.code(-3.0), 0);
        assert_eq!(encoder.code(7.0), 255);
    }

    #[test]
    fn noise_has_its_deviation_and_repeats() {
        let grey = Planes::constant(128, 128, &[0.2; 3]);
        let sensor = Sensor { sigma: 0.01, seed: 4 };
        let frame = sensor.expose(&grey);
        assert_eq!(frame, sensor.expose(&grey));
        let light: Vec<f64> = frame.data.iter().map(|&v| f64::from(v).powf(2.2)).collect();
        let mean = light.iter().sum::<f64>() / light.len() as f64;
        let deviation = (light.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / light.len() as f64).sqrt();
        assert!((mean - 0.2).abs() < 5e-4 && (deviation - 0.01).abs() < 3e-4, "{mean} {deviation}");
        assert_ne!(frame, Sensor { seed: 5, ..sensor }.expose(&grey));
        assert_ne!(frame.plane(0)[..128], frame.plane(0)[128..256], "rows differ");
        assert_eq!(frame.data[0] * 255.0, (frame.data[0] * 255.0).round());
        assert_eq!(Sensor::noiseless().expose(&grey).data[0], (gamma_encode(0.2) * 255.0).round() / 255.0);
    }

    #[test]
    fn drawn_noise_is_log_normal() {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let logs: Vec<f32> = (0..4000).map(|_| Sensor::draw(&mut rng).sigma.ln()).collect();
        let mean = logs.iter().sum::<f32>() / logs.len() as f32;
        let spread = (logs.iter().map(|v| (v - mean).powi(2)).sum::<f32>() / logs.len() as f32).sqrt();
        assert!((mean - NOISE_MEDIAN.ln()).abs() < 0.03 && (spread - NOISE_SPREAD).abs() < 0.02);
    }
}
