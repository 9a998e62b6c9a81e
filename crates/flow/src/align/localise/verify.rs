//! Guesses refined on the pixels, and whether the best of them is believed.

use ops::homography::Homography;
use ops::planes::Planes;
use rayon::prelude::*;

use super::super::candidates::{Candidate, Origin, Step, choose};
use super::super::config::PhotometricConfig;
use super::super::contrast::ContrastPyramid;
use super::super::size::Size;
use super::search::Guess;
use super::{Located, NotLocated};

/// Sides of the frame, in pixels, between which guesses are compared at the photo's density.
const COMPARED: [f64; 2] = [96.0, 256.0];
/// Largest side on which the best guess is refined.
const REFINED: f64 = 512.0;
/// The photo is cut out with this border, as a share of the frame's side.
const BORDER: f64 = 0.15;
/// The correlation of a place that is believed …
const LEAST_ZNCC: f64 = 0.15;
/// … its standard errors above chance: the best of some million places is five above it by luck …
const LEAST_SIGNIFICANCE: f64 = 8.0;
/// … by how much it exceeds the same place displaced …
const LEAST_MARGIN: f64 = 0.08;
/// … and the share of its evidence that another place may have.
const LARGEST_RUNNER_UP: f64 = 0.8;
/// Share of the frame that the photo must show.
const LEAST_OVERLAP: f64 = 0.5;
/// Places further apart than this share of the frame's side are different places.
const APART: f64 = 0.1;

/// A guess refined: photo pixel to frame pixel at full size.
struct Tried {
    homography: Homography,
    guess: Guess,
    step: Step,
}

impl Tried {
    fn evidence(&self) -> f64 {
        self.step.consistency.score()
    }
}

/// The guess that the images support best, refined.
pub(super) fn best(
    guidance: &Planes,
    frame: &Planes,
    guesses: &[Guess],
    photometric: &PhotometricConfig,
) -> Result<Located, NotLocated> {
    let tried = guesses.par_iter().filter_map(|g| try_out(guidance, frame, g, COMPARED, photometric));
    let mut tried: Vec<Tried> = tried.filter(|t| t.step.consistency.overlap >= LEAST_OVERLAP).collect();
    tried.sort_by(|a, b| b.evidence().total_cmp(&a.evidence()));
    let Some(best) = tried.first() else { return Err(NotLocated::NotFound { zncc: 0.0, significance: 0.0 }) };
    let Step { consistency, margin, .. } = best.step;
    let significance = consistency.significance();
    if consistency.zncc < LEAST_ZNCC || significance < LEAST_SIGNIFICANCE || margin < LEAST_MARGIN {
        return Err(NotLocated::NotFound { zncc: consistency.zncc, significance });
    }
    let other = tried.iter().skip(1).find(|t| apart(t, best, Size::of(frame)));
    let runner_up = other.map_or(0.0, |t| t.evidence().max(0.0) / best.evidence());
    if runner_up > LARGEST_RUNNER_UP {
        return Err(NotLocated::Ambiguous { runner_up });
    }
    let start = Guess { homography: best.homography, ..best.guess };
    let finer = try_out(guidance, frame, &start, [COMPARED[0], REFINED], photometric);
    let finer = finer.filter(|t| !apart(t, best, Size::of(frame)) && t.step.consistency.significance() >= LEAST_SIGNIFICANCE);
    let end = finer.as_ref().unwrap_or(best);
    let larger = frame.width as f64
        / compared_side(frame, end.guess.scale, if finer.is_some() { [COMPARED[0], REFINED] } else { COMPARED });
    Ok(Located {
        homography: end.homography,
        scale: scale(&end.homography, Size::of(frame)).unwrap_or(end.guess.scale),
        zncc: end.step.consistency.zncc,
        significance,
        runner_up,
        expected_px: end.step.expected_px * larger,
    })
}

/// Frame pixels per photo pixel at the frame's middle.
fn scale(homography: &Homography, frame: Size) -> Option<f64> {
    let back = homography.inverse()?;
    let (cx, cy) = (0.5 * frame.width as f64, 0.5 * frame.height as f64);
    let step = 0.1 * cx;
    let (a, b, c) = (back.apply(cx, cy)?, back.apply(cx + step, cy)?, back.apply(cx, cy + step)?);
    let area = ((b.0 - a.0) * (c.1 - a.1) - (b.1 - a.1) * (c.0 - a.0)).abs();
    Some(step / area.sqrt())
}

/// Whether the frame's middle lies elsewhere, or the frame is turned or scaled otherwise.
fn apart(a: &Tried, b: &Tried, frame: Size) -> bool {
    let relative = |x: f64, y: f64| {
        let back = b.homography.inverse()?;
        let (u, v) = back.apply(x, y)?;
        let (p, q) = a.homography.apply(u, v)?;
        Some((p - x).hypot(q - y))
    };
    let (w, h) = (frame.width as f64, frame.height as f64);
    let corners = [(0.5 * w, 0.5 * h), (0.25 * w, 0.25 * h), (0.75 * w, 0.25 * h), (0.25 * w, 0.75 * h), (0.75 * w, 0.75 * h)];
    corners.iter().any(|&(x, y)| relative(x, y).is_none_or(|d| d > APART * w.min(h)))
}

/// Side of the frame when it is compared at the photo's density.
fn compared_side(frame: &Planes, scale: f64, [least, most]: [f64; 2]) -> f64 {
    let side = frame.width.min(frame.height) as f64;
    (side / scale).clamp(least.min(side), most.min(side))
}

fn try_out(
    guidance: &Planes,
    frame: &Planes,
    guess: &Guess,
    sides: [f64; 2],
    photometric: &PhotometricConfig,
) -> Option<Tried> {
    let side = compared_side(frame, guess.scale, sides);
    let small = Size::of(frame).limited(side.round() as usize);
    // The part of the photo that the frame shows, with a border, at the frame's density.
    let back = guess.homography.inverse()?;
    let (w, h) = (frame.width as f64, frame.height as f64);
    let corners =
        [(0.0, 0.0), (w, 0.0), (w, h), (0.0, h)].iter().map(|&(x, y)| back.apply(x, y)).collect::<Option<Vec<_>>>()?;
    let border = BORDER * w.min(h) / guess.scale;
    let range = |of: fn(&(f64, f64)) -> f64, length: usize| {
        let low = corners.iter().map(of).fold(f64::INFINITY, f64::min) - border;
        let high = corners.iter().map(of).fold(f64::NEG_INFINITY, f64::max) + border;
        let (low, high) = (low.floor().clamp(0.0, length as f64), high.ceil().clamp(0.0, length as f64));
        (low as usize, high as usize - low as usize)
    };
    let ((x0, width), (y0, height)) = (range(|c| c.0, guidance.width), range(|c| c.1, guidance.height));
    if width < 16 || height < 16 {
        return None;
    }
    let cut = guidance.crop(y0, x0, height, width);
    let factor = guess.scale * side / w.min(h);
    let scaled = |v: usize| ((v as f64 * factor).round() as usize).max(16);
    let patch = Size { height: scaled(height), width: scaled(width) };
    let source =
        if factor < 1.0 { cut.resize_area(patch.height, patch.width) } else { cut.resize_bilinear(patch.height, patch.width) };
    let target = frame.resize_area(small.height, small.width);
    // Small frame → patch.
    let to_patch = Size { height, width }.resize_matrix(patch) * Homography::translation(-(x0 as f64), -(y0 as f64)).matrix;
    let from_small = small.resize_matrix(Size::of(frame));
    let initial = Homography::new(to_patch * back.matrix * from_small);
    let pyramid = |image: &Planes| ContrastPyramid::new(image, photometric);
    let candidates = [Candidate { origin: Origin::PhaseCorrelation, homography: initial }];
    let step = choose(&pyramid(&target), &pyramid(&source), &candidates, photometric)?;
    let found = Homography::new(to_patch.try_inverse()? * step.homography.matrix * from_small.try_inverse()?);
    Some(Tried { homography: found.inverse()?, guess: *guess, step })
}
