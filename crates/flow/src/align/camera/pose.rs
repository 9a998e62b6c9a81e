//! Poses in the axes of the material.

use nalgebra::{Matrix3, Vector3};

use super::model::Model;
use super::solve::Solution;

/// Where a frame's camera is and how it looks, in the material's axes: the surface is z = 0, the origin is what the middle of
/// the reference frame shows, x points along that frame's rows, y up, z to the camera. The unit is the width of the reference
/// frame on the material. Scaled to the world's unit, this is a camera of the renderer.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraPose {
    /// Index of the frame.
    pub frame: usize,
    /// Centre of projection; its third coordinate is the height.
    pub position: [f64; 3],
    /// Unit vector along the image's x axis.
    pub right: [f64; 3],
    /// Unit vector along the image's y axis, which points down.
    pub down: [f64; 3],
    /// Unit vector along the optical axis.
    pub forward: [f64; 3],
    /// Standard error of the position, root of the sum over the coordinates.
    pub position_uncertainty: f64,
    /// Standard error of the direction, in degrees.
    pub direction_uncertainty_deg: f64,
}

impl CameraPose {
    pub(super) fn new(found: &Solution, node: usize, frame: usize) -> Self {
        let unknowns: Vec<usize> = (0..3).chain(Model::columns(node)).collect();
        let norm = |v: &[f64]| v.iter().map(|v| v * v).sum::<f64>().sqrt();
        let all = |m: &Model| {
            let [position, right, down, forward] = placed(m, node);
            [position, right, down, forward].iter().flatten().copied().collect()
        };
        let spread = found.spread(&unknowns, all);
        let [position, right, down, forward] = placed(&found.model, node);
        Self {
            frame,
            position,
            right,
            down,
            forward,
            position_uncertainty: norm(&spread[..3]),
            direction_uncertainty_deg: norm(&spread[9..]).to_degrees(),
        }
    }
}

/// A node's height over the surface.
pub(super) fn height(model: &Model, node: usize) -> f64 {
    placed(model, node)[0][2]
}

/// Position, right, down and forward in the material's axes.
fn placed(model: &Model, node: usize) -> [[f64; 3]; 4] {
    let axes = material_axes(&model.plane());
    let pose = &model.poses[node];
    let back = pose.rotation.inverse();
    let centre = back * -pose.shift;
    // At depth 1 the frame is 2/φ wide.
    let position = axes.transpose() * (centre - Vector3::z()) * (0.5 * model.focal());
    let axis = |v: Vector3<f64>| axes.transpose() * (back * v);
    [position, axis(Vector3::x()), axis(Vector3::y()), axis(Vector3::z())].map(Into::into)
}

/// The material's axes as columns, in the reference camera's.
fn material_axes(plane: &Vector3<f64>) -> Matrix3<f64> {
    let z = -plane.normalize();
    let x = (Vector3::x() - z * z.x).normalize();
    Matrix3::from_columns(&[x, z.cross(&x), z])
}
