//! Correlation over a bank of densities and rotations.

use nalgebra::Matrix3;
use ops::homography::Homography;
use ops::planes::Planes;
use rayon::prelude::*;
use rustfft::num_complex::Complex32;

use super::super::config::PhotometricConfig;
use super::super::contrast::ContrastPyramid;
use super::super::phase::Transform;
use super::super::size::Size;
use super::{LocaliseConfig, NotLocated};

/// Side of the frame when it is looked for, and the least that still shows a pattern, in pixels.
const SIDE: f64 = 64.0;
const LEAST_SIDE: f64 = 24.0;
/// Longest side of the photo when it is searched, in pixels.
const LONGEST: f64 = 512.0;
/// Factor between neighbouring densities and steps of the rotation in degrees: half a step moves the frame's edge by a pixel.
const SCALE_STEP: f64 = 1.06;
const ROTATION_STEP_DEG: f64 = 4.0;
/// The disc reaches to this share of the frame's side and fades from the inner one on.
const DISC: [f32; 2] = [0.4, 0.5];
/// Guesses handed on.
const GUESSES: usize = 24;
/// Peaks taken from one surface.
const PEAKS: usize = 2;
/// Guesses nearer than this (in frame sides, as a factor, in degrees) are one guess.
const SAME: (f64, f64, f64) = (0.12, 1.1, 8.0);
/// Deviation of a contrast-normalised image below which there is nothing to find.
const LEAST_TEXTURE: f64 = 0.1;

/// A place where the frame may be.
#[derive(Clone, Copy, Debug)]
pub(super) struct Guess {
    /// Photo pixel to frame pixel.
    pub homography: Homography,
    /// Frame pixels per photo pixel.
    pub scale: f64,
}

/// The strongest guesses over all densities and rotations, the strongest first.
pub(super) fn search(guidance: &Planes, frame: &Planes, config: &LocaliseConfig) -> Result<Vec<Guess>, NotLocated> {
    for (name, image) in [("the guidance photo", guidance), ("the first frame", frame)] {
        let small = shrunk(image, (Size::of(image).height.min(image.width) as f64 / 128.0).max(1.0));
        if ContrastPyramid::new(&small, &normalisation()).texture() < LEAST_TEXTURE {
            return Err(NotLocated::NoTexture { image: name });
        }
    }
    let [least, most] = config.scale;
    let count = ((most / least).ln() / SCALE_STEP.ln()).ceil() as i32;
    let scales: Vec<f64> = (0..=count).map(|i| least * SCALE_STEP.powi(i)).collect();
    let banks: Vec<Bank> = scales.iter().filter_map(|&s| Bank::plan(Size::of(guidance), Size::of(frame), s)).collect();
    if banks.is_empty() {
        return Err(NotLocated::Sizes { guidance: Size::of(guidance), frame: Size::of(frame) });
    }
    let found: Vec<Found> = banks.par_iter().flat_map_iter(|bank| bank.search(guidance, frame, config.rotation_deg)).collect();
    Ok(distinct(found).into_iter().map(|f| f.guess(Size::of(frame))).collect())
}

/// Finer than the aligner's: the images are small.
fn normalisation() -> PhotometricConfig {
    PhotometricConfig { mean_sigma_px: 3.0, contrast_sigma_px: 6.0, chroma: 0.0, ..PhotometricConfig::default() }
}

fn shrunk(image: &Planes, factor: f64) -> Planes {
    let side = |v: usize| ((v as f64 / factor).round() as usize).max(1);
    image.resize_area(side(image.height), side(image.width))
}

/// The searched sizes of one density.
struct Bank {
    scale: f64,
    /// Frame and photo are made smaller by these.
    frame_factor: f64,
    guidance_factor: f64,
}

/// A peak.
#[derive(Clone, Copy)]
struct Found {
    /// In standard deviations of the surface.
    peak: f64,
    scale: f64,
    angle: f64,
    /// Middle of the frame in photo pixels.
    centre: [f64; 2],
    /// Side of the frame in photo pixels.
    side: f64,
}

impl Bank {
    /// `None` where the photo is smaller than the frame at this density, or the frame would have too few pixels.
    fn plan(guidance: Size, frame: Size, scale: f64) -> Option<Self> {
        let (longer, shorter) = (guidance.width.max(guidance.height) as f64, guidance.width.min(guidance.height) as f64);
        let native = frame.width.min(frame.height) as f64 / scale;
        let side = SIDE.min(native).min(LONGEST * native / longer);
        let fits = native <= 1.02 * shorter && side >= LEAST_SIDE;
        fits.then_some(Self { scale, frame_factor: scale * native / side, guidance_factor: native / side })
    }

    fn search(&self, guidance: &Planes, frame: &Planes, rotation_deg: f64) -> Vec<Found> {
        let contrast =
            |image: &Planes, factor| ContrastPyramid::new(&shrunk(image, factor), &normalisation()).levels.swap_remove(0);
        let (photo, template) = (contrast(guidance, self.guidance_factor), contrast(frame, self.frame_factor));
        let size = Size { height: smooth(photo.height), width: smooth(photo.width) };
        let transform = Transform::new(size);
        let mut spectrum = vec![Complex32::default(); size.height * size.width];
        for y in 0..photo.height {
            for x in 0..photo.width {
                spectrum[y * size.width + x].re = known(photo.at(0, y, x));
            }
        }
        transform.forward(&mut spectrum);
        let steps = (rotation_deg / ROTATION_STEP_DEG).floor() as i32;
        let last = if rotation_deg >= 180.0 { steps - 1 } else { steps };
        let angles: Vec<f64> = (-steps..=last).map(|i| (f64::from(i) * ROTATION_STEP_DEG).to_radians()).collect();
        let side = template.height.min(template.width) as f64;
        let mut found = Vec::new();
        for pair in angles.chunks(2) {
            // Two real templates in one complex transform: their correlations come back as real and imaginary part.
            let mut values = vec![Complex32::default(); spectrum.len()];
            for (part, &angle) in pair.iter().enumerate() {
                lay(&template, angle, part, &mut values, size);
            }
            transform.forward(&mut values);
            values.iter_mut().zip(&spectrum).for_each(|(t, g)| *t = g * t.conj());
            transform.inverse(&mut values);
            for (part, &angle) in pair.iter().enumerate() {
                let surface = |i: usize| if part == 0 { values[i].re } else { -values[i].im };
                for (peak, [x, y]) in peaks(surface, size, Size::of(&photo), side) {
                    let back = Size::of(&photo).resize_matrix(Size::of(guidance));
                    let centre = [back[(0, 0)] * x + back[(0, 2)], back[(1, 1)] * y + back[(1, 2)]];
                    found.push(Found { peak, scale: self.scale, angle, centre, side: side * self.guidance_factor });
                }
            }
        }
        found
    }
}

impl Found {
    fn guess(&self, frame: Size) -> Guess {
        let (sin, cos) = self.angle.sin_cos();
        let (cx, cy) = (0.5 * (frame.width as f64 - 1.0), 0.5 * (frame.height as f64 - 1.0));
        let s = self.scale;
        let turned = Matrix3::new(s * cos, -s * sin, cx, s * sin, s * cos, cy, 0.0, 0.0, 1.0);
        let homography = Homography::new(turned * Homography::translation(-self.centre[0], -self.centre[1]).matrix);
        Guess { homography, scale: s }
    }
}

fn known(v: f32) -> f32 {
    if v.is_nan() { 0.0 } else { v }
}

/// The least number from `n` on without prime factors above 5.
fn smooth(n: usize) -> usize {
    (n..)
        .find(|&m| {
            [2, 3, 5]
                .iter()
                .fold(m, |m, &p| std::iter::successors(Some(m), |&m| m.is_multiple_of(p).then(|| m / p)).last().unwrap_or(m))
                == 1
        })
        .unwrap_or(n)
}

/// Adds the turned, faded disc of the template around the origin (which wraps) to the real or imaginary part.
fn lay(template: &Planes, angle: f64, part: usize, values: &mut [Complex32], size: Size) {
    let (sin, cos) = (angle.sin() as f32, angle.cos() as f32);
    let (cx, cy) = (0.5 * (template.width as f32 - 1.0), 0.5 * (template.height as f32 - 1.0));
    let side = template.width.min(template.height) as f32;
    let [inner, outer] = DISC.map(|share| share * side);
    let reach = outer.ceil() as i32;
    for v in -reach..=reach {
        for u in -reach..=reach {
            let (x, y) = (u as f32, v as f32);
            let weight = ((outer - x.hypot(y)) / (outer - inner)).clamp(0.0, 1.0);
            let Some(value) = template.sample_bilinear(0, cx + cos * x - sin * y, cy + sin * x + cos * y) else { continue };
            let index = v.rem_euclid(size.height as i32) as usize * size.width + u.rem_euclid(size.width as i32) as usize;
            let value = weight * known(value);
            if part == 0 { values[index].re += value } else { values[index].im += value }
        }
    }
}

/// The highest local maxima of a surface where the disc lies within the photo, in standard deviations of the surface there.
fn peaks(surface: impl Fn(usize) -> f32, size: Size, photo: Size, side: f64) -> Vec<(f64, [f64; 2])> {
    let margin = (f64::from(DISC[0]) * side) as usize;
    if photo.height <= 2 * margin || photo.width <= 2 * margin {
        return Vec::new();
    }
    let inside = || (margin..photo.height - margin).flat_map(|y| (margin..photo.width - margin).map(move |x| (x, y)));
    let at = |(x, y): (usize, usize)| f64::from(surface(y * size.width + x));
    let (mut sum, mut squares, mut count) = (0.0, 0.0, 0.0);
    for p in inside() {
        let v = at(p);
        (sum, squares, count) = (sum + v, squares + v * v, count + 1.0);
    }
    let mean = sum / count;
    let deviation = (squares / count - mean * mean).max(0.0).sqrt();
    if deviation < 1e-9 {
        return Vec::new();
    }
    let mut kept: Vec<(f64, [f64; 2])> = Vec::new();
    for _ in 0..PEAKS {
        let apart =
            |&(x, y): &(usize, usize)| kept.iter().all(|(_, k)| (k[0] - x as f64).hypot(k[1] - y as f64) > SAME.0 * side);
        let Some(best) = inside().filter(apart).max_by(|&a, &b| at(a).total_cmp(&at(b))) else { break };
        kept.push(((at(best) - mean) / deviation, [best.0 as f64, best.1 as f64]));
    }
    kept
}

/// The strongest guesses that differ.
fn distinct(mut found: Vec<Found>) -> Vec<Found> {
    found.sort_by(|a, b| b.peak.total_cmp(&a.peak));
    let mut kept: Vec<Found> = Vec::new();
    for f in found {
        let same = |k: &Found| {
            let apart = (k.centre[0] - f.centre[0]).hypot(k.centre[1] - f.centre[1]) / k.side.min(f.side);
            let turned = (k.angle - f.angle).to_degrees().rem_euclid(360.0);
            apart < SAME.0 && (k.scale / f.scale).ln().abs() < SAME.1.ln() && turned.min(360.0 - turned) < SAME.2
        };
        if !kept.iter().any(same) {
            kept.push(f);
        }
        if kept.len() == GUESSES {
            break;
        }
    }
    kept
}
