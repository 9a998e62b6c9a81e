//! The camera behind the homographies: focal length, height over the material and the pose of every key frame (spec 3.2).
//!
//! All frames of a clip come from one camera with square pixels and its principal point in the middle, over one plane, so that
//! every homography is H ~ K·(R + t·νᵀ)·K⁻¹ with one K and one plane νᵀX = 1 (in the reference camera's axes). Eight equations
//! each against six unknowns leave two to find the focal length and the plane's two slopes from.
//!
//! # What is observable
//! A focal length f and a tilt θ between two frames show as a perspective θ/f, and θ again as a foreshortening θ²/2. A phone that
//! stays parallel to the surface gives the second nothing to say: then every focal length explains the clip, and the answer is
//! [`CameraUnknown`], not a number. The absolute size of the scene never shows. Lengths are therefore in **widths of the
//! reference frame on the material**, in which the height over a surface straight below is f/width: its relative error is that of
//! the focal length. Who knows the frame's width in millimetres multiplies.

mod model;
mod pose;
mod solve;

pub use pose::CameraPose;

use std::collections::BTreeSet;

use nalgebra::{Matrix3, Vector3};
use ops::homography::Homography;
use serde::Serialize;

use super::result::Alignment;
use super::size::Size;
use model::{Model, Motion};
use solve::Solution;

/// A focal length with a larger relative standard error isn't one.
pub const LARGEST_UNCERTAINTY: f64 = 0.1;
/// Homographies from fewer frames determine no camera.
const FEWEST_FRAMES: usize = 3;

/// Where a focal length comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum FocalSource {
    /// The person gave a field of view.
    Config,
    /// The pictures' metadata.
    Exif,
    /// The homographies.
    Homographies,
}

/// A focal length known beforehand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KnownFocal {
    /// Field of view across the frame's width, edge to edge, in degrees.
    pub fov_deg: f64,
    /// Who says so.
    pub source: FocalSource,
}

/// Why there is no camera.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum CameraUnknown {
    /// Too few frames were placed.
    #[error("{frames} aligned frames are too few to find the camera from; {FEWEST_FRAMES} or more are needed")]
    TooFewFrames {
        /// The frames, the reference among them.
        frames: usize,
    },
    /// The motion fits any focal length.
    #[error(
        "the focal length is not observable: the phone stayed too nearly parallel to the surface (±{percent:.0} % at best); give \
         the field of view, or tilt the phone by some 10° during the scan"
    )]
    NotObservable {
        /// Its standard error in percent.
        percent: f64,
    },
    /// No camera explains the homographies.
    #[error("no camera explains the homographies: the surface isn't flat, or the clip was stabilised or zoomed while filming")]
    NoFit,
}

/// The camera of a scan. Lengths are in widths of the reference frame on the material.
#[derive(Clone, Debug)]
pub struct ScanCamera {
    /// Where the focal length comes from.
    pub source: FocalSource,
    /// Focal length in pixels of the full frames.
    pub focal_px: f64,
    /// Field of view across the frame's width, edge to edge, in degrees.
    pub fov_deg: f64,
    /// Relative standard error of the focal length; 0 for a given one.
    pub focal_uncertainty: f64,
    /// Angle between the reference camera's axis and the surface's normal, in degrees.
    pub tilt_deg: f64,
    /// Standard error of the tilt, in degrees.
    pub tilt_uncertainty_deg: f64,
    /// Height of the reference camera over the surface.
    pub height: f64,
    /// Relative standard error of the height.
    pub height_uncertainty: f64,
    /// Root mean square distance between the measured homographies and those of the poses, in pixels of the full frames.
    pub residual_px: f64,
    /// The reference frame and the aligned key frames.
    pub poses: Vec<CameraPose>,
}

impl Alignment {
    /// The camera that explains the links between the aligned key frames, with the given focal length or a found one. Where
    /// the guidance image is a picture of its own, the reference is the first aligned key frame.
    ///
    /// # Errors
    /// See [`CameraUnknown`].
    pub fn camera(&self, known: Option<KnownFocal>) -> Result<ScanCamera, CameraUnknown> {
        let Scene { nodes, starts, motions, size } = Scene::of(self);
        if nodes.len() < if known.is_some() { 2 } else { FEWEST_FRAMES } {
            return Err(CameraUnknown::TooFewFrames { frames: nodes.len() });
        }
        let half = 0.5 * size.width as f64;
        let given = known.map(|k| 1.0 / (0.5 * k.fov_deg.to_radians()).tan());
        let found = solve::solve(&motions, &starts, given).ok_or(CameraUnknown::NoFit)?;
        let focal_uncertainty = if known.is_some() { 0.0 } else { found.deviation(0) };
        if focal_uncertainty.is_nan() || focal_uncertainty > LARGEST_UNCERTAINTY {
            return Err(CameraUnknown::NotObservable { percent: (100.0 * focal_uncertainty).min(999.0) });
        }
        Ok(described(&found, &nodes, known, (half, focal_uncertainty)))
    }
}

fn described(
    found: &Solution,
    nodes: &[usize],
    known: Option<KnownFocal>,
    (half, focal_uncertainty): (f64, f64),
) -> ScanCamera {
    let model = &found.model;
    let focal_px = model.focal() * half;
    let tilt = |m: &Model| vec![Vector3::z().angle(&m.plane()).to_degrees()];
    // The tilt is a length: at 0 its derivative vanishes, so the slopes' own errors are taken.
    let slopes = (found.deviation(1).powi(2) + found.deviation(2).powi(2)).sqrt();
    let height = |m: &Model| vec![pose::height(m, 0).ln()];
    ScanCamera {
        source: known.map_or(FocalSource::Homographies, |k| k.source),
        focal_px,
        fov_deg: 2.0 * (half / focal_px).atan().to_degrees(),
        focal_uncertainty,
        tilt_deg: tilt(model)[0],
        tilt_uncertainty_deg: slopes.atan().to_degrees(),
        height: height(model)[0].exp(),
        height_uncertainty: found.spread(&[0, 1, 2], height)[0],
        residual_px: found.residual * half,
        poses: nodes.iter().enumerate().map(|(node, &frame)| CameraPose::new(found, node, frame)).collect(),
    }
}

/// The nodes of a scan that one camera filmed and that were placed.
struct Scene {
    /// Frame index of every node, the reference first.
    nodes: Vec<usize>,
    /// Reference pixel to pixel of every node, in units (see [`model`]).
    starts: Vec<Matrix3<f64>>,
    /// The homographies measured between these nodes.
    motions: Vec<Motion>,
    size: Size,
}

impl Scene {
    fn of(alignment: &Alignment) -> Self {
        let guidance = alignment.guidance_filmed.then_some((0, 0, Homography::identity()));
        let keys = alignment.key_frames.iter().enumerate().filter(|(_, k)| k.aligned());
        let mut placed: Vec<(usize, usize, Homography)> =
            guidance.into_iter().chain(keys.map(|(i, k)| (i + 1, k.index, k.homography))).collect();
        let size = alignment.key_frames.first().map_or(Size { height: 1, width: 1 }, |k| k.frame_size);
        let is_placed = |node: usize| placed.iter().any(|p| p.0 == node);
        let links = alignment.links.iter().filter(|l| is_placed(l.target) && is_placed(l.source));
        let mut motions: Vec<Motion> = links.filter_map(|l| Motion::of(l, size)).collect();
        let reached = reached(placed.first().map(|p| p.0), &motions);
        placed.retain(|p| reached.contains(&p.0));
        motions.retain(|m| reached.contains(&m.target));
        let number = |node: usize| placed.iter().position(|p| p.0 == node).unwrap_or(0);
        motions.iter_mut().for_each(|m| (m.target, m.source) = (number(m.target), number(m.source)));
        let to_reference = placed.first().and_then(|p| p.2.inverse()).unwrap_or(Homography::identity());
        let starts = placed.iter().map(|p| model::in_units(&p.2.after(&to_reference), size)).collect();
        Self { nodes: placed.iter().map(|p| p.1).collect(), starts, motions, size }
    }
}

/// The nodes that homographies tie to the first one.
fn reached(first: Option<usize>, motions: &[Motion]) -> BTreeSet<usize> {
    let mut reached: BTreeSet<usize> = first.into_iter().collect();
    let mut before = 0;
    while reached.len() > before {
        before = reached.len();
        for ends in motions.iter().map(|m| [m.target, m.source]) {
            if ends.iter().any(|e| reached.contains(e)) {
                reached.extend(ends);
            }
        }
    }
    reached
}

#[cfg(test)]
mod tests;
