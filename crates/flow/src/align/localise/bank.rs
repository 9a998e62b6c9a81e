//! The frame at one density, correlated with the photo at every place and rotation.

use ops::planes::Planes;
use rustfft::num_complex::Complex32;

use super::super::config::PhotometricConfig;
use super::super::contrast::ContrastPyramid;
use super::super::phase::Transform;
use super::super::size::Size;
use super::densities::Densities;

/// Side of the frame when it is looked for, and the least that still shows a pattern, in pixels.
const SIDE: f64 = 40.0;
const LEAST_SIDE: f64 = 20.0;
/// Longest side of the photo when it is searched, in pixels.
const LONGEST: f64 = 400.0;
/// Step of the rotation in degrees: half of it moves the frame's edge by a pixel.
const ROTATION_STEP_DEG: f64 = 6.0;
/// The disc reaches to this share of the frame's side and fades from the inner one on.
const DISC: [f32; 2] = [0.4, 0.5];
/// Peaks taken from one surface, each the highest of a square of the photo; the square's side as a share of the frame's.
const PEAKS: usize = 6;
const SQUARE: f64 = 0.2;
/// Deviation of the normalised photo below which a place counts as even.
const EVEN: f32 = 0.2;

/// The searched sizes of one density.
pub(super) struct Bank {
    /// Frame pixels per photo pixel.
    pub scale: f64,
    /// Frame and photo are made smaller by these.
    frame_factor: f64,
    guidance_factor: f64,
}

/// A peak.
#[derive(Clone, Copy, Debug)]
pub(super) struct Peak {
    /// Correlation under the disc, in root mean squares of the highest correlations of all squares and rotations of this density.
    pub height: f64,
    /// Frame pixels per photo pixel.
    pub scale: f64,
    /// Rotation from photo to frame in radians.
    pub angle: f64,
    /// Middle of the frame in photo pixels.
    pub centre: [f64; 2],
    /// Side of the frame in photo pixels.
    pub side: f64,
}

impl Bank {
    /// `None` where the photo is smaller than the frame at this density, or the frame would have too few pixels.
    pub fn plan(guidance: Size, frame: Size, scale: f64) -> Option<Self> {
        let (longer, shorter) = (guidance.width.max(guidance.height) as f64, guidance.width.min(guidance.height) as f64);
        let native = frame.width.min(frame.height) as f64 / scale;
        let side = SIDE.min(native).min(LONGEST * native / longer);
        let fits = native <= 1.02 * shorter && side >= LEAST_SIDE;
        fits.then_some(Self { scale, frame_factor: scale * native / side, guidance_factor: native / side })
    }

    /// The highest peaks of every rotation.
    pub fn search(&self, guidance: &Densities, frame: &Densities, rotation_deg: f64) -> Vec<Peak> {
        let (photo, template) = (contrast(guidance, self.guidance_factor), contrast(frame, self.frame_factor));
        let side = template.height.min(template.width) as f64;
        let correlation = Correlation::new(&photo, side);
        let steps = (rotation_deg / ROTATION_STEP_DEG).floor() as i32;
        let last = if rotation_deg >= 180.0 { steps - 1 } else { steps };
        let angles: Vec<f64> = (-steps..=last).map(|i| (f64::from(i) * ROTATION_STEP_DEG).to_radians()).collect();
        let back = Size::of(&photo).resize_matrix(guidance.size());
        let mut found = Vec::new();
        let (mut squares, mut count) = (0.0, 0.0);
        // Two real templates in one complex transform: their correlations come back as real and imaginary part.
        for pair in angles.chunks(2) {
            let discs: Vec<Disc> = pair.iter().map(|&angle| Disc::new(&template, angle)).collect();
            let surfaces = correlation.of(&discs);
            for (part, (disc, &angle)) in discs.iter().zip(pair).enumerate() {
                let surface = |i: usize| if part == 0 { surfaces[i].re } else { -surfaces[i].im } / disc.norm;
                let peaks = correlation.peaks(((SQUARE * side) as usize).max(1), surface);
                squares += peaks.iter().map(|(ncc, _)| ncc * ncc).sum::<f64>();
                count += peaks.len() as f64;
                for &(height, [x, y]) in peaks.iter().take(PEAKS) {
                    let centre = [back[(0, 0)] * x + back[(0, 2)], back[(1, 1)] * y + back[(1, 2)]];
                    found.push(Peak { height, scale: self.scale, angle, centre, side: side * self.guidance_factor });
                }
            }
        }
        let usual = f64::sqrt(squares / f64::max(count, 1.0)).max(1e-6);
        found.iter_mut().for_each(|p| p.height /= usual);
        found
    }
}

/// Finer than the aligner's: the images are small.
pub(super) fn normalisation() -> PhotometricConfig {
    PhotometricConfig { mean_sigma_px: 3.0, contrast_sigma_px: 6.0, chroma: 0.0, ..PhotometricConfig::default() }
}

/// An image with `factor` of its pixels per pixel along a side, contrast-normalised.
pub(super) fn contrast(image: &Densities, factor: f64) -> Planes {
    ContrastPyramid::new(&image.shrunk(factor), &normalisation()).levels.swap_remove(0)
}

/// The turned template under the disc's weights, around its middle, without its mean.
pub(super) struct Disc {
    /// Offsets from the middle and values.
    values: Vec<([i32; 2], f32)>,
    /// Root of the weighted sum of squares.
    pub norm: f32,
}

impl Disc {
    pub fn new(template: &Planes, angle: f64) -> Self {
        let (sin, cos) = (angle.sin() as f32, angle.cos() as f32);
        let (cx, cy) = (0.5 * (template.width as f32 - 1.0), 0.5 * (template.height as f32 - 1.0));
        let value = |[u, v]: [i32; 2]| {
            let (x, y) = (u as f32, v as f32);
            template.sample_bilinear(0, cx + cos * x - sin * y, cy + sin * x + cos * y).filter(|v| !v.is_nan())
        };
        let side = template.height.min(template.width) as f64;
        let weighted: Vec<([i32; 2], f32, f32)> =
            weights(side).into_iter().filter_map(|(at, weight)| Some((at, weight, value(at)?))).collect();
        let total: f32 = weighted.iter().map(|(_, w, _)| w).sum();
        let mean = weighted.iter().map(|(_, w, v)| w * v).sum::<f32>() / total.max(f32::MIN_POSITIVE);
        let squares: f32 = weighted.iter().map(|(_, w, v)| w * (v - mean).powi(2)).sum();
        let values = weighted.iter().map(|&(at, w, v)| (at, w * (v - mean))).collect();
        Self { values, norm: squares.sqrt().max(1e-6) }
    }
}

/// Offsets within the disc of a frame of `side` pixels, and their weights.
fn weights(side: f64) -> Vec<([i32; 2], f32)> {
    let [inner, outer] = DISC.map(|share| share * side as f32);
    let reach = outer.ceil() as i32;
    let offsets = (-reach..=reach).flat_map(|v| (-reach..=reach).map(move |u| [u, v]));
    let weight = |[u, v]: [i32; 2]| ((outer - (u as f32).hypot(v as f32)) / (outer - inner)).clamp(0.0, 1.0);
    offsets.map(|at| (at, weight(at))).filter(|(_, w)| *w > 0.0).collect()
}

/// A photo prepared for correlations with discs of one size.
pub(super) struct Correlation {
    transform: Transform,
    /// Of the photo, padded.
    spectrum: Vec<Complex32>,
    /// What a correlation is divided by, beside the disc's norm, so that it lies in −1 … 1.
    deviation: Vec<f32>,
    /// Rows and columns where a disc's middle may lie: that much of the disc is on the photo.
    rows: std::ops::Range<usize>,
    columns: std::ops::Range<usize>,
}

impl Correlation {
    pub fn new(photo: &Planes, side: f64) -> Self {
        let margin = (f64::from(DISC[0]) * side) as usize;
        let disc = weights(side);
        let reach = disc.iter().map(|([u, _], _)| u.unsigned_abs() as usize).max().unwrap_or(0);
        // Indices wrap: the rim of a disc that reaches over one edge must not lie on the photo's other side.
        let rim = reach.saturating_sub(margin);
        let size = Size { height: smooth(photo.height + rim), width: smooth(photo.width + rim) };
        let transform = Transform::new(size);
        let mut values = vec![Complex32::default(); size.height * size.width];
        for y in 0..photo.height {
            for x in 0..photo.width {
                let value = photo.at(0, y, x);
                values[y * size.width + x].re = if value.is_nan() { 0.0 } else { value };
            }
        }
        // Weighted sums of squares and of values under the disc, as real and imaginary part.
        let total: f32 = disc.iter().map(|(_, w)| w).sum();
        let mut sums: Vec<Complex32> = values.iter().map(|v| Complex32::new(v.re * v.re, v.re)).collect();
        let mut window = vec![Complex32::default(); values.len()];
        disc.iter().for_each(|&(at, w)| window[wrapped(at, size)].re += w);
        [&mut sums, &mut window].into_iter().for_each(|v| transform.forward(v));
        sums.iter_mut().zip(&window).for_each(|(s, w)| *s *= w.conj());
        transform.inverse(&mut sums);
        let count = sums.len() as f32;
        let deviation = |s: &Complex32| {
            let (squares, sum) = (s.re / count, s.im / count);
            // The inverse transform of the correlation isn't divided by the number of values either.
            (squares - sum * sum / total).max(EVEN * EVEN * total).sqrt() * count
        };
        let deviation = sums.iter().map(deviation).collect();
        transform.forward(&mut values);
        let inside = |length: usize| margin..length.saturating_sub(margin).max(margin);
        Self { transform, spectrum: values, deviation, rows: inside(photo.height), columns: inside(photo.width) }
    }

    /// Of one or two discs, not yet divided by their norms: the first is the real part, the second the imaginary part negated.
    pub fn of(&self, discs: &[Disc]) -> Vec<Complex32> {
        let mut values = vec![Complex32::default(); self.spectrum.len()];
        for (part, disc) in discs.iter().enumerate() {
            for &(at, value) in &disc.values {
                let here = &mut values[wrapped(at, self.transform.size)];
                if part == 0 { here.re += value } else { here.im += value }
            }
        }
        self.transform.forward(&mut values);
        values.iter_mut().zip(&self.spectrum).for_each(|(t, g)| *t = g * t.conj());
        self.transform.inverse(&mut values);
        values.iter_mut().zip(&self.deviation).for_each(|(v, d)| *v /= *d);
        values
    }

    /// The highest value of each square of a surface, the highest first; `square` is a side in pixels.
    pub fn peaks(&self, square: usize, surface: impl Fn(usize) -> f32) -> Vec<(f64, [f64; 2])> {
        let width = self.transform.size.width;
        let mut highest = Vec::new();
        for top in self.rows.clone().step_by(square) {
            for left in self.columns.clone().step_by(square) {
                let rows = top..(top + square).min(self.rows.end);
                let columns = left..(left + square).min(self.columns.end);
                let mut best = (f32::NEG_INFINITY, [0.0; 2]);
                for y in rows {
                    for x in columns.clone() {
                        let value = surface(y * width + x);
                        if value > best.0 {
                            best = (value, [x as f64, y as f64]);
                        }
                    }
                }
                highest.push((f64::from(best.0), best.1));
            }
        }
        highest.sort_unstable_by(|a, b| b.0.total_cmp(&a.0));
        highest
    }
}

/// Index of an offset from the origin, which wraps.
fn wrapped([u, v]: [i32; 2], size: Size) -> usize {
    v.rem_euclid(size.height as i32) as usize * size.width + u.rem_euclid(size.width as i32) as usize
}

/// The least number from `n` on without prime factors above 5.
fn smooth(n: usize) -> usize {
    let rest = |m: usize, p: usize| std::iter::successors(Some(m), |&m| m.is_multiple_of(p).then(|| m / p)).last().unwrap_or(m);
    (n..).find(|&m| [2, 3, 5].iter().fold(m, |m, &p| rest(m, p)) == 1).unwrap_or(n)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_disc_over_one_edge_sees_nothing_of_the_other() {
        const SIDE: usize = 40;
        let wave = |x: usize, y: usize| ((x * 7 + y * 3) as f32 * 0.3).sin();
        let template = Planes::from_vec(1, SIDE, SIDE, (0..SIDE * SIDE).map(|i| wave(i % SIDE, i / SIDE)).collect());
        // 80 needs no padding to be transformed fast.
        let at_left = |right: f32| {
            let value = |i: usize| if i % 80 < 76 { wave(i % 80, i / 80) } else { right };
            let photo = Planes::from_vec(1, 80, 80, (0..6400).map(value).collect());
            let correlation = Correlation::new(&photo, SIDE as f64);
            let disc = Disc::new(&template, 0.0);
            let middle = correlation.rows.start + correlation.rows.len() / 2;
            correlation.of(&[disc])[middle * correlation.transform.size.width + correlation.columns.start].re
        };
        let (plain, bright) = (at_left(0.0), at_left(5.0));
        assert!(plain.abs() > 0.1 && (plain - bright).abs() < 1e-3, "{plain}, {bright}");
    }
}
