//! How the contrast of a picture is spread over scales.

use rustfft::FftPlanner;
use rustfft::num_complex::Complex32;

/// Rings that the spectrum is averaged over, each half an octave wide.
pub const RINGS: usize = 12;
/// Lowest frequency of the first ring; below, a tile says little.
///
/// # Units
/// Cycles per window.
pub const LOWEST: f32 = 4.0;
/// Variance of the rounding to 8 bit: the floor that keeps an even material's spectrum finite.
const ROUNDING: f64 = 1.0 / 12.0 / (255.0 * 255.0);

/// The radially averaged power spectrum.
pub struct Spectrum {
    /// Mean power of each ring, as log10.
    pub rings: [f32; RINGS],
    /// Slope of log power over log frequency; natural pictures are near −2.
    pub slope: f32,
}

impl Spectrum {
    /// Of a square picture, under a Hann window (a crop of a larger map isn't periodic).
    pub fn of(picture: &[f32], side: usize) -> Self {
        let mean = picture.iter().map(|v| f64::from(*v)).sum::<f64>() / picture.len() as f64;
        let hann: Vec<f32> =
            (0..side).map(|i| 0.5 - 0.5 * ((i as f32 + 0.5) / side as f32 * std::f32::consts::TAU).cos()).collect();
        let windowed = picture.iter().enumerate();
        let mut values: Vec<Complex32> =
            windowed.map(|(i, v)| Complex32::new((v - mean as f32) * hann[i / side] * hann[i % side], 0.0)).collect();
        let fft = FftPlanner::new().plan_fft_forward(side);
        for _ in 0..2 {
            fft.process(&mut values);
            values = (0..values.len()).map(|i| values[i % side * side + i / side]).collect();
        }
        // Mean of the window's square: with it, white noise of variance v has power v everywhere.
        let gain = picture.len() as f64 * (3.0f64 / 8.0).powi(2);
        let (mut power, mut count) = ([0.0f64; RINGS], [0.0f64; RINGS]);
        let signed = |i: usize| if i < side / 2 { i as f32 } else { i as f32 - side as f32 };
        for (i, value) in values.iter().enumerate() {
            let ring = 2.0 * (signed(i / side).hypot(signed(i % side)) / LOWEST).log2();
            if (0.0..RINGS as f32).contains(&ring) {
                power[ring as usize] += f64::from(value.norm_sqr()) / gain;
                count[ring as usize] += 1.0;
            }
        }
        let rings = std::array::from_fn(|r| (power[r] / count[r] + ROUNDING).log10() as f32);
        Self { rings, slope: slope(&rings) }
    }
}

/// Least-squares line through the rings.
fn slope(rings: &[f32; RINGS]) -> f32 {
    let step = std::f32::consts::LOG10_2 / 2.0;
    let centre = (RINGS - 1) as f32 / 2.0;
    let mean = rings.iter().sum::<f32>() / RINGS as f32;
    let at = |r: usize| (r as f32 - centre) * step;
    let (mut with, mut alone) = (0.0, 0.0);
    for (r, power) in rings.iter().enumerate() {
        with += at(r) * (power - mean);
        alone += at(r) * at(r);
    }
    with / alone
}
