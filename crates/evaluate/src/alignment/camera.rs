//! The camera that the homographies tell, against the one that filmed (`flow::align::camera`).
//!
//! `focal_unknown` is 1 for a scan of which the aligner says that its focal length isn't observable; then the other figures are
//! absent. `focal_error` is relative, `height_error` the mean over reference and key frames of the heights' relative error, in
//! widths of the first frame on the material; `focal_uncertainty` is the stated standard error, `focal_within` 1 for an
//! error of at most 2 %, `tilt_error_deg` the error of the first camera's tilt.

use dataset::sequence::Sequence;
use flow::align::Alignment;
use flow::align::camera::ScanCamera;

/// The goal for focal length and height.
const GOAL: f64 = 0.02;

/// The figures of a scan whose guidance image is frame 0.
pub fn figures(alignment: &Alignment, sequence: &Sequence) -> Vec<(String, f64)> {
    let figures = match alignment.camera(None) {
        Err(_) => vec![("focal_unknown", 1.0)],
        Ok(camera) => known(&camera, sequence),
    };
    figures.into_iter().map(|(name, value)| (name.to_string(), value)).collect()
}

fn known(camera: &ScanCamera, sequence: &Sequence) -> Vec<(&'static str, f64)> {
    let first = sequence.camera(0);
    let half_view = (0.5 * first.fov_rad).tan();
    let focal_error = (half_view / (0.5 * camera.fov_deg.to_radians()).tan() - 1.0).abs();
    // Of the first frame on the material, along the row through its middle.
    let width = 2.0 * half_view * first.position[2] / -first.forward[2];
    let height_errors = camera.poses.iter().map(|p| (p.position[2] * width / sequence.camera(p.frame).position[2] - 1.0).abs());
    let tilt = (-first.forward[2]).clamp(-1.0, 1.0).acos().to_degrees();
    vec![
        ("focal_unknown", 0.0),
        ("focal_error", focal_error),
        ("focal_uncertainty", camera.focal_uncertainty),
        ("focal_within", f64::from(focal_error <= GOAL)),
        ("height_error", height_errors.sum::<f64>() / camera.poses.len() as f64),
        ("tilt_error_deg", (camera.tilt_deg - tilt).abs()),
    ]
}
