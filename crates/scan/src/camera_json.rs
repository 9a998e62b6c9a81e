//! The camera in `alignment.json`.

use flow::align::camera::{CameraUnknown, FocalSource, ScanCamera};
use serde::Serialize;

/// What lengths and axes mean.
const CONVENTIONS: &str = "lengths in widths of the reference frame on the material (times width_mm: millimetres); axes of the material: x along \
     the reference frame's rows, y up, z to the camera, z = 0 the surface, origin at what the middle of that frame shows; right, \
     down and forward are the camera's axes; uncertainties are standard errors and hold for a flat surface, an undistorted lens and \
     a global shutter";

/// The camera, or why it isn't known.
#[derive(Serialize)]
pub(crate) struct CameraJson {
    #[serde(skip_serializing_if = "Option::is_none")]
    unknown: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none", flatten)]
    known: Option<Known>,
}

#[derive(Serialize)]
struct Known {
    conventions: &'static str,
    /// Where the focal length comes from.
    source: FocalSource,
    focal_px: f64,
    fov_deg: f64,
    focal_relative_uncertainty: f64,
    height: f64,
    height_relative_uncertainty: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    height_mm: Option<f64>,
    tilt_deg: f64,
    tilt_uncertainty_deg: f64,
    residual_px: f64,
    /// The first one is the reference.
    poses: Vec<PoseJson>,
}

#[derive(Serialize)]
struct PoseJson {
    index: usize,
    position: [f64; 3],
    right: [f64; 3],
    down: [f64; 3],
    forward: [f64; 3],
    position_uncertainty: f64,
    direction_uncertainty_deg: f64,
}

impl CameraJson {
    /// `indices` are the frames' numbers in the clip; `width_mm` is 0 where unknown.
    pub fn new(camera: &Result<ScanCamera, CameraUnknown>, indices: &[usize], width_mm: f64) -> Self {
        match camera {
            Err(why) => Self { unknown: Some(why.to_string()), known: None },
            Ok(camera) => Self { unknown: None, known: Some(Known::new(camera, indices, width_mm)) },
        }
    }
}

impl Known {
    fn new(camera: &ScanCamera, indices: &[usize], width_mm: f64) -> Self {
        let poses = camera.poses.iter().map(|p| PoseJson {
            index: indices[p.frame],
            position: p.position,
            right: p.right,
            down: p.down,
            forward: p.forward,
            position_uncertainty: p.position_uncertainty,
            direction_uncertainty_deg: p.direction_uncertainty_deg,
        });
        Self {
            conventions: CONVENTIONS,
            source: camera.source,
            focal_px: camera.focal_px,
            fov_deg: camera.fov_deg,
            focal_relative_uncertainty: camera.focal_uncertainty,
            height: camera.height,
            height_relative_uncertainty: camera.height_uncertainty,
            height_mm: (width_mm > 0.0).then_some(camera.height * width_mm),
            tilt_deg: camera.tilt_deg,
            tilt_uncertainty_deg: camera.tilt_uncertainty_deg,
            residual_px: camera.residual_px,
            poses: poses.collect(),
        }
    }
}
