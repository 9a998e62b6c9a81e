//! All places that look like the frame, seen as places already found see it: a pattern that repeats has more of them than the
//! first search keeps, and its right place looks more alike only when compared more finely.

use nalgebra::{Matrix3, Vector3};
use ops::homography::Homography;
use ops::planes::Planes;

use super::super::photometric::warp;
use super::super::size::Size;
use super::bank::{Correlation, Disc, contrast};
use super::densities::Densities;
use super::search::Guess;

/// Side of the frame when it is looked for, in pixels.
const SIDE: f64 = 192.0;
/// The photo is looked through up to here, in sides of the frame from where the pose was found.
const FARTHEST: f64 = 4.0;
/// Places nearer than this share of the frame's side are one.
const SAME: f64 = 0.03;
/// Poses looked for …
const POSES: usize = 4;
/// … those that differ by more than this factor or this many degrees …
const SAME_POSE: (f64, f64) = (1.05, 3.0);
/// … and places kept of all of them.
const PLACES: usize = 96;

/// How a photo is seen: as the place that was found there, but for where it lies.
struct Pose {
    homography: Homography,
    scale: f64,
    /// Of places seen alike: a small map of the frame about its middle, row by row.
    others: Vec<[f64; 4]>,
}

/// Guesses all over the photo from the places found so far, the best first.
pub(super) fn guesses(guidance: &Densities, frame: &Densities, found: &[Guess]) -> Vec<Guess> {
    let mut poses: Vec<Pose> = Vec::new();
    for guess in found {
        let same = poses.iter_mut().find_map(|p| Some((linear(&guess.homography, &p.homography, frame.size())?, p)));
        match same {
            Some((linear, pose)) => pose.others.push(linear),
            None => poses.push(Pose { homography: guess.homography, scale: guess.scale, others: vec![[1.0, 0.0, 0.0, 1.0]] }),
        }
    }
    poses.truncate(POSES);
    let share = PLACES / poses.len().max(1);
    poses.iter().flat_map(|pose| places(guidance, frame, &pose.middle(frame.size()), share)).collect()
}

/// How differently one place is seen from another, without where: `None` if not alike.
fn linear(a: &Homography, b: &Homography, frame: Size) -> Option<[f64; 4]> {
    let (cx, cy) = middle(frame);
    let back = b.inverse()?;
    let at = |x: f64, y: f64| back.apply(x, y).and_then(|(u, v)| a.apply(u, v));
    let step = 0.25 * frame.width.min(frame.height) as f64;
    let (centre, right, below) = (at(cx, cy)?, at(cx + step, cy)?, at(cx, cy + step)?);
    let linear = [right.0 - centre.0, below.0 - centre.0, right.1 - centre.1, below.1 - centre.1].map(|v| v / step);
    let [xx, xy, yx, yy] = linear;
    let (size, turn) = ((xx * yy - xy * yx).max(1e-9).sqrt(), (yx - xy).atan2(xx + yy).to_degrees());
    (size.ln().abs() < SAME_POSE.0.ln() && turn.abs() < SAME_POSE.1).then_some(linear)
}

fn middle(frame: Size) -> (f64, f64) {
    (0.5 * (frame.width as f64 - 1.0), 0.5 * (frame.height as f64 - 1.0))
}

impl Pose {
    /// The median of the places seen alike: a wrong one is bent until it fits, each another way.
    fn middle(&self, frame: Size) -> Guess {
        let median = |k: usize| {
            let mut values: Vec<f64> = self.others.iter().map(|o| o[k]).collect();
            let middle = values.len() / 2;
            *values.select_nth_unstable_by(middle, f64::total_cmp).1
        };
        let (cx, cy) = middle(frame);
        let bend = Matrix3::new(median(0), median(1), 0.0, median(2), median(3), 0.0, 0.0, 0.0, 1.0);
        let about = Homography::translation(cx, cy).matrix * bend * Homography::translation(-cx, -cy).matrix;
        Guess { homography: Homography::new(about * self.homography.matrix), scale: self.scale }
    }
}

/// The places that look most like the frame when the photo is laid out in the axes of a frame of that pose.
fn places(guidance: &Densities, frame: &Densities, pose: &Guess, count: usize) -> Vec<Guess> {
    let (size, shown) = (frame.size(), guidance.size());
    let full = size.width.min(size.height) as f64;
    let side = SIDE.min(full / pose.scale).round().max(1.0);
    let factor = full / side;
    let template = contrast(frame, factor);
    let photo = contrast(guidance, (factor / pose.scale).max(1.0));
    let (right, bottom) = (shown.width as f64 - 1.0, shown.height as f64 - 1.0);
    let corners = [(0.0, 0.0), (right, 0.0), (right, bottom), (0.0, bottom)].map(|(x, y)| pose.homography.apply(x, y));
    let corners: Option<Vec<(f64, f64)>> = corners.into_iter().collect();
    let (Some(corners), Some(back)) = (corners, pose.homography.inverse()) else { return Vec::new() };
    let range = |of: fn(&(f64, f64)) -> f64, middle: f64| {
        let low = corners.iter().map(of).fold(f64::INFINITY, f64::min).max(middle - FARTHEST * full);
        let high = corners.iter().map(of).fold(f64::NEG_INFINITY, f64::max).min(middle + FARTHEST * full);
        (low, ((high - low) / factor).ceil().max(0.0) as usize)
    };
    let (cx, cy) = middle(size);
    let ((left, width), (top, height)) = (range(|c| c.0, cx), range(|c| c.1, cy));
    if width.min(height) < side as usize {
        return Vec::new();
    }
    // Pixels of the photo laid out to pixels of the frame.
    let to_frame =
        Matrix3::new(factor, 0.0, left + 0.5 * (factor - 1.0), 0.0, factor, top + 0.5 * (factor - 1.0), 0.0, 0.0, 1.0);
    let mut laid_out = Planes::new(1, height, width);
    let to_photo = Homography::new(shown.resize_matrix(Size::of(&photo)) * back.matrix * to_frame);
    warp(&photo, 0, &to_photo, width, &mut laid_out.data);
    let correlation = Correlation::new(&laid_out, side);
    let disc = Disc::new(&template, 0.0);
    let norm = disc.norm;
    let surface = correlation.of(&[disc]);
    let same = (SAME * side).max(2.0);
    let mut kept: Vec<[f64; 2]> = Vec::new();
    for (_, at) in correlation.peaks(same as usize, |i| surface[i].re / norm) {
        if kept.iter().all(|k| (k[0] - at[0]).abs().max((k[1] - at[1]).abs()) > same) {
            kept.push(at);
        }
        if kept.len() == count {
            break;
        }
    }
    let moved = |[x, y]: [f64; 2]| {
        let at = to_frame * Vector3::new(x, y, 1.0);
        Guess { homography: Homography::translation(cx - at.x, cy - at.y).after(&pose.homography), scale: pose.scale }
    };
    kept.into_iter().map(moved).collect()
}
