//! Guesses from correlations over a bank of densities and rotations.

use nalgebra::Matrix3;
use ops::homography::Homography;
use rayon::prelude::*;

use super::super::contrast::ContrastPyramid;
use super::super::size::Size;
use super::bank::{Bank, Peak, normalisation};
use super::densities::Densities;
use super::{LocaliseConfig, NotLocated};

/// Factor between neighbouring densities: half a step moves the frame's edge by a pixel.
const SCALE_STEP: f64 = 1.1;
/// Guesses handed on.
const GUESSES: usize = 64;
/// Peaks nearer than this (in frame sides, as a factor, in degrees) are one guess.
const SAME: (f64, f64, f64) = (0.12, 1.15, 9.0);
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
pub(super) fn search(guidance: &Densities, frame: &Densities, config: &LocaliseConfig) -> Result<Vec<Guess>, NotLocated> {
    for (name, image) in [("the guidance photo", guidance), ("the first frame", frame)] {
        let Size { height, width } = image.size();
        let small = image.shrunk((height.min(width) as f64 / 128.0).max(1.0));
        if ContrastPyramid::new(&small, &normalisation()).texture() < LEAST_TEXTURE {
            return Err(NotLocated::NoTexture { image: name });
        }
    }
    let [least, most] = config.scale;
    let count = ((most / least).ln() / SCALE_STEP.ln()).ceil() as i32;
    let scales = (0..=count).map(|i| least * SCALE_STEP.powi(i));
    let banks: Vec<Bank> = scales.filter_map(|s| Bank::plan(guidance.size(), frame.size(), s)).collect();
    if banks.is_empty() {
        return Err(NotLocated::Sizes { guidance: guidance.size(), frame: frame.size() });
    }
    // The densities with the largest photos come last: shared out one by one, the cores end together.
    let of_bank = |bank: &Bank| distinct(bank.search(guidance, frame, config.rotation_deg));
    let found: Vec<Vec<Peak>> = banks.par_iter().with_max_len(1).map(of_bank).collect();
    Ok(distinct(found.into_iter().flatten().collect()).into_iter().map(|p| p.guess(frame.size())).collect())
}

impl Peak {
    fn guess(&self, frame: Size) -> Guess {
        let (sin, cos) = self.angle.sin_cos();
        let (cx, cy) = (0.5 * (frame.width as f64 - 1.0), 0.5 * (frame.height as f64 - 1.0));
        let s = self.scale;
        let turned = Matrix3::new(s * cos, -s * sin, cx, s * sin, s * cos, cy, 0.0, 0.0, 1.0);
        let homography = Homography::new(turned * Homography::translation(-self.centre[0], -self.centre[1]).matrix);
        Guess { homography, scale: s }
    }
}

/// The highest peaks that differ.
fn distinct(mut found: Vec<Peak>) -> Vec<Peak> {
    found.sort_by(|a, b| b.height.total_cmp(&a.height));
    let mut kept: Vec<Peak> = Vec::new();
    for f in found {
        let same = |k: &Peak| {
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
