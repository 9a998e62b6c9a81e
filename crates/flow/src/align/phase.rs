//! Phase correlation: shifts between two images, found in the frequency domain.

use std::sync::Arc;

use ops::planes::Planes;
use rustfft::num_complex::Complex32;
use rustfft::{Fft, FftPlanner};

use super::size::Size;

/// Peaks closer than this, in pixels, are one peak.
const PEAK_RADIUS: i64 = 3;
/// Whitening divides by the magnitude plus this share of the mean magnitude: where neither image has energy, noise must not
/// speak as loud as texture.
const SOFTENING: f32 = 0.1;

/// The Fourier transforms of one image size, shared between threads.
#[derive(Clone)]
pub(super) struct Transform {
    pub size: Size,
    /// Rows, columns; forward, then inverse.
    plans: [[Arc<dyn Fft<f32>>; 2]; 2],
}

impl Transform {
    pub fn new(size: Size) -> Self {
        let mut planner = FftPlanner::new();
        let forward = [planner.plan_fft_forward(size.width), planner.plan_fft_forward(size.height)];
        let inverse = [planner.plan_fft_inverse(size.width), planner.plan_fft_inverse(size.height)];
        Self { size, plans: [forward, inverse] }
    }

    pub fn forward(&self, values: &mut Vec<Complex32>) {
        self.apply(values, 0);
    }

    /// Not divided by the number of values.
    pub fn inverse(&self, values: &mut Vec<Complex32>) {
        self.apply(values, 1);
    }

    /// In place: rows, transpose, rows, transpose.
    fn apply(&self, values: &mut Vec<Complex32>, direction: usize) {
        let [rows, columns] = &self.plans[direction];
        rows.process(values);
        let mut turned = transpose(values, self.size.height, self.size.width);
        columns.process(&mut turned);
        *values = transpose(&turned, self.size.width, self.size.height);
    }
}

/// Finds shifts between images of up to one size; shared between threads.
#[derive(Clone)]
pub struct Correlator {
    size: Size,
    transform: Transform,
}

/// The windowed spectrum of an image.
#[derive(Clone, Debug)]
pub struct Spectrum {
    values: Vec<Complex32>,
}

impl Correlator {
    /// Prepares transforms of a size that holds every image to be compared.
    pub fn new(size: Size) -> Self {
        Self { size, transform: Transform::new(size) }
    }

    /// The spectrum of an image's first plane under a Hann window, padded with zeros.
    pub fn spectrum(&self, image: &Planes) -> Spectrum {
        let hann = |n: usize| -> Vec<f32> {
            (0..n).map(|i| 0.5 - 0.5 * (std::f32::consts::TAU * (i as f32 + 0.5) / n as f32).cos()).collect()
        };
        let (rows, columns) = (hann(image.height), hann(image.width));
        let known = |v: f32| if v.is_nan() { 0.0 } else { v };
        let mut values = vec![Complex32::default(); self.size.height * self.size.width];
        for y in 0..image.height.min(self.size.height) {
            for x in 0..image.width.min(self.size.width) {
                values[y * self.size.width + x] = Complex32::new(known(image.at(0, y, x)) * rows[y] * columns[x], 0.0);
            }
        }
        self.transform.forward(&mut values);
        Spectrum { values }
    }

    /// The strongest shifts (x, y) such that `source(p + shift)` looks like `target(p)`, strongest first.
    pub fn shifts(&self, target: &Spectrum, source: &Spectrum, count: usize) -> Vec<(f64, f64)> {
        let mut cross: Vec<Complex32> = target.values.iter().zip(&source.values).map(|(a, b)| b * a.conj()).collect();
        let mean = cross.iter().map(|c| c.norm()).sum::<f32>() / cross.len() as f32;
        if !(mean > 0.0 && mean.is_finite()) {
            return Vec::new();
        }
        cross.iter_mut().for_each(|c| *c /= c.norm() + SOFTENING * mean);
        self.transform.inverse(&mut cross);
        let surface: Vec<f32> = cross.iter().map(|c| c.re).collect();
        peaks(&surface, self.size, count)
    }
}

fn transpose(values: &[Complex32], height: usize, width: usize) -> Vec<Complex32> {
    const TILE: usize = 16;
    let mut out = vec![Complex32::default(); values.len()];
    for y0 in (0..height).step_by(TILE) {
        for x0 in (0..width).step_by(TILE) {
            for y in y0..(y0 + TILE).min(height) {
                for x in x0..(x0 + TILE).min(width) {
                    out[x * height + y] = values[y * width + x];
                }
            }
        }
    }
    out
}

/// Local maxima of a periodic surface, as signed shifts with a parabolic sub-pixel part.
fn peaks(surface: &[f32], size: Size, count: usize) -> Vec<(f64, f64)> {
    let (h, w) = (size.height as i64, size.width as i64);
    let at = |x: i64, y: i64| surface[(y.rem_euclid(h) * w + x.rem_euclid(w)) as usize];
    let is_peak = |i: usize| {
        let (x, y, v) = (i as i64 % w, i as i64 / w, surface[i]);
        v > 0.0 && (-1..=1).all(|dy| (-1..=1).all(|dx| (dx, dy) == (0, 0) || at(x + dx, y + dy) <= v))
    };
    let mut maxima: Vec<usize> = (0..surface.len()).filter(|&i| is_peak(i)).collect();
    maxima.sort_by(|&a, &b| surface[b].total_cmp(&surface[a]).then(a.cmp(&b)));
    let mut kept: Vec<(i64, i64)> = Vec::new();
    let signed = |v: i64, n: i64| if v > n / 2 { v - n } else { v };
    for i in maxima {
        let (x, y) = (signed(i as i64 % w, w), signed(i as i64 / w, h));
        if kept.iter().all(|&(kx, ky)| (kx - x).abs() > PEAK_RADIUS || (ky - y).abs() > PEAK_RADIUS) {
            kept.push((x, y));
        }
        if kept.len() == count {
            break;
        }
    }
    let vertex = |before: f32, here: f32, after: f32| {
        let bend = 2.0 * here - before - after;
        if bend > 1e-12 { f64::from((0.5 * (after - before) / bend).clamp(-0.5, 0.5)) } else { 0.0 }
    };
    let refine = |&(x, y): &(i64, i64)| {
        let here = at(x, y);
        let dx = vertex(at(x - 1, y), here, at(x + 1, y));
        let dy = vertex(at(x, y - 1), here, at(x, y + 1));
        (x as f64 + dx, y as f64 + dy)
    };
    kept.iter().map(refine).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::scene::Scene;
    use ops::homography::Homography;

    #[test]
    fn finds_a_known_shift_first_and_nothing_in_a_black_image() {
        let size = Size { height: 60, width: 72 };
        let scene = Scene::new(3);
        let target = scene.frame(&Homography::identity(), size);
        let source = scene.frame(&Homography::translation(-11.0, 6.5), size);
        let correlator = Correlator::new(size);
        let spectrum = |image: &Planes| correlator.spectrum(&image.clone().map(|v| v - 0.5));
        let shifts = correlator.shifts(&spectrum(&target), &spectrum(&source), 3);
        let (x, y) = shifts[0];
        assert!((x - 11.0).abs() < 0.5 && (y + 6.5).abs() < 0.6, "{shifts:?}");
        let black = correlator.spectrum(&Planes::new(1, 60, 72));
        assert!(correlator.shifts(&black, &black, 3).is_empty());
    }
}
