//! The paper's regularisation (§5, "pose estimation"; spec: `regularise = "pnp"`): the pose of a camera with an assumed field of
//! view that sees the guidance image as a plane right in front of it.
//!
//! With the plane at depth 1, the guidance pixel (x, y) is the point X = K⁻¹·(x, y, 1) and a source shows it at K·(R·X + t), so
//! the warp is the homography K·(R + t·e₃ᵀ)·K⁻¹: six parameters instead of eight, exact only if the field of view is right and
//! the guidance camera looks straight down.

use nalgebra::{Matrix3, Rotation3, SMatrix, SVector, Vector3};
use ops::homography::Homography;

use super::planar::{FEWEST_POINTS, PointPair, direct_linear};
use super::size::Size;

/// The field of view that the paper assumes.
const FOV_DEG: f64 = 30.0;
/// Levenberg–Marquardt steps, at most.
const STEPS: usize = 20;
/// Step of the central differences, in radians and plane depths.
const DIFFERENCE: f64 = 1e-6;

type Vector6 = SVector<f64, 6>;

/// The warp of the pose that fits the pairs best in the least-squares sense, as OpenCV's iterative `solvePnP` finds it: from
/// the homography of all pairs, by Levenberg–Marquardt on the re-projection error. `None` for fewer than [`FEWEST_POINTS`]
/// pairs, or when they determine no pose.
pub fn fit_pose(pairs: &[PointPair], target: Size, source: Size) -> Option<Homography> {
    if pairs.len() < FEWEST_POINTS {
        return None;
    }
    let (from_plane, to_plane) = (intrinsics(source), intrinsics(target).try_inverse()?);
    let warp = |pose: &Pose| Homography { matrix: from_plane * pose.matrix(&Vector3::z()) * to_plane };
    let start = direct_linear(pairs)?;
    let mut pose = Pose::nearest(&(from_plane.try_inverse()? * start.matrix * to_plane.try_inverse()?))?;
    let mut cost = squared_error(&warp(&pose), pairs)?;
    let mut damping = 1e-3;
    for _ in 0..STEPS {
        let (matrix, vector) = normal_equations(pairs, &pose, warp)?;
        let mut damped = matrix;
        (0..6).for_each(|i| damped[(i, i)] *= 1.0 + damping);
        let Some(step) = damped.cholesky().map(|c| c.solve(&-vector)) else { break };
        let tried = pose.moved(&step);
        match squared_error(&warp(&tried), pairs).filter(|&c| c < cost) {
            Some(better) => {
                let gain = cost - better;
                (pose, cost, damping) = (tried, better, damping * 0.1);
                if gain < 1e-12 * cost {
                    break;
                }
            }
            None => damping *= 10.0,
        }
    }
    Some(Homography::new(warp(&pose).matrix))
}

/// K of a camera with the assumed field of view across its width, square pixels and the principal point in the middle.
fn intrinsics(size: Size) -> Matrix3<f64> {
    let focal = 0.5 * size.width as f64 / (0.5 * FOV_DEG.to_radians()).tan();
    let (cx, cy) = (0.5 * (size.width as f64 - 1.0), 0.5 * (size.height as f64 - 1.0));
    Matrix3::new(focal, 0.0, cx, 0.0, focal, cy, 0.0, 0.0, 1.0)
}

/// A rigid motion from the guidance camera to a source camera; lengths in depths of the plane.
#[derive(Clone, Copy)]
pub(super) struct Pose {
    pub rotation: Rotation3<f64>,
    pub shift: Vector3<f64>,
}

impl Pose {
    /// R + t·νᵀ for the plane νᵀX = 1.
    pub fn matrix(&self, plane: &Vector3<f64>) -> Matrix3<f64> {
        self.rotation.matrix() + self.shift * plane.transpose()
    }

    /// No motion.
    pub fn at_rest() -> Self {
        Self { rotation: Rotation3::identity(), shift: Vector3::zeros() }
    }

    /// The pose whose matrix, with the plane Z = 1, is nearest to a multiple of `matrix`: its first two columns are those of a rotation.
    pub fn nearest(matrix: &Matrix3<f64>) -> Option<Self> {
        let scale = 0.5 * (matrix.column(0).norm() + matrix.column(1).norm());
        let scale = if matrix[(2, 2)] < 0.0 { -scale } else { scale };
        if scale.abs() < 1e-9 {
            return None;
        }
        let m = matrix / scale;
        let (a, b) = (m.column(0).into_owned(), m.column(1).into_owned());
        let svd = Matrix3::from_columns(&[a, b, a.cross(&b)]).svd(true, true);
        let rotation = Rotation3::from_matrix_unchecked(svd.u? * svd.v_t?);
        let shift = m.column(2) - rotation.matrix().column(2);
        shift.iter().all(|v| v.is_finite()).then_some(Self { rotation, shift })
    }

    pub fn moved(&self, step: &Vector6) -> Self {
        let turn = Rotation3::from_scaled_axis(step.fixed_rows::<3>(0).into_owned());
        Self { rotation: turn * self.rotation, shift: self.shift + step.fixed_rows::<3>(3) }
    }
}

fn squared_error(warp: &Homography, pairs: &[PointPair]) -> Option<f64> {
    let mut sum = 0.0;
    for pair in pairs {
        let (x, y) = warp.apply(pair.target[0], pair.target[1])?;
        sum += (x - pair.source[0]).powi(2) + (y - pair.source[1]).powi(2);
    }
    Some(sum)
}

/// JᵀJ and Jᵀr of the re-projection error by the six parameters of [`Pose::moved`]; `None` when a point leaves the view.
fn normal_equations(
    pairs: &[PointPair],
    pose: &Pose,
    warp: impl Fn(&Pose) -> Homography,
) -> Option<(SMatrix<f64, 6, 6>, Vector6)> {
    let here = warp(pose);
    let beside = |k: usize, by: f64| warp(&pose.moved(&Vector6::from_fn(|r, _| if r == k { by } else { 0.0 })));
    let around: [[Homography; 2]; 6] = std::array::from_fn(|k| [beside(k, DIFFERENCE), beside(k, -DIFFERENCE)]);
    let (mut matrix, mut vector) = (SMatrix::<f64, 6, 6>::zeros(), Vector6::zeros());
    for pair in pairs {
        let at = |h: &Homography| h.apply(pair.target[0], pair.target[1]);
        let (x, y) = at(&here)?;
        let (mut across, mut down) = (Vector6::zeros(), Vector6::zeros());
        for (k, [ahead, behind]) in around.iter().enumerate() {
            let (ahead, behind) = (at(ahead)?, at(behind)?);
            across[k] = (ahead.0 - behind.0) / (2.0 * DIFFERENCE);
            down[k] = (ahead.1 - behind.1) / (2.0 * DIFFERENCE);
        }
        matrix += across * across.transpose() + down * down.transpose();
        vector += across * (x - pair.source[0]) + down * (y - pair.source[1]);
    }
    Some((matrix, vector))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::candidates::largest_shift;

    const SIZE: Size = Size { height: 96, width: 128 };

    fn pairs(warp: &Homography, noise: f64) -> Vec<PointPair> {
        let pair = |(i, (x, y)): (usize, (f64, f64))| {
            let (u, v) = warp.apply(x, y).unwrap();
            let off = |k: f64| noise * (12.9898 * (i as f64 + k)).sin();
            PointPair { target: [x, y], source: [u + off(0.0), v + off(0.5)] }
        };
        SIZE.grid(12).enumerate().map(pair).collect()
    }

    /// A camera of the given field of view that moved and turned.
    fn moved_camera(fov_deg: f64) -> Homography {
        let pose = Pose { rotation: Rotation3::from_euler_angles(0.05, -0.08, 0.6), shift: Vector3::new(0.1, -0.05, 0.07) };
        let focal = 0.5 * SIZE.width as f64 / (0.5 * fov_deg.to_radians()).tan();
        let mut k = intrinsics(SIZE);
        (k[(0, 0)], k[(1, 1)]) = (focal, focal);
        Homography::new(k * pose.matrix(&Vector3::z()) * k.try_inverse().unwrap())
    }

    #[test]
    fn the_pose_of_a_camera_with_the_assumed_field_of_view_is_exact() {
        let truth = moved_camera(FOV_DEG);
        let found = fit_pose(&pairs(&truth, 0.0), SIZE, SIZE).unwrap();
        assert!(largest_shift(&found, &truth, SIZE) < 1e-5);
        let noisy = fit_pose(&pairs(&truth, 0.5), SIZE, SIZE).unwrap();
        assert!(largest_shift(&noisy, &truth, SIZE) < 0.4, "{}", largest_shift(&noisy, &truth, SIZE));
    }

    #[test]
    fn another_field_of_view_leaves_an_error_that_the_homography_would_not() {
        let truth = moved_camera(40.0);
        let found = fit_pose(&pairs(&truth, 0.0), SIZE, SIZE).unwrap();
        let error = largest_shift(&found, &truth, SIZE);
        assert!((0.05..6.0).contains(&error), "{error}");
        let best = squared_error(&found, &pairs(&truth, 0.0)).unwrap();
        let beside = |axis: usize, by: f64| {
            let k = intrinsics(SIZE);
            let back = k.try_inverse().unwrap();
            let pose = Pose::nearest(&(back * found.matrix * k)).unwrap();
            let step = Vector6::from_fn(|r, _| if r == axis { by } else { 0.0 });
            squared_error(&Homography { matrix: k * pose.moved(&step).matrix(&Vector3::z()) * back }, &pairs(&truth, 0.0))
                .unwrap()
        };
        assert!((0..6).all(|k| beside(k, 1e-3) > best && beside(k, -1e-3) > best), "a least-squares minimum");
    }

    #[test]
    fn too_few_or_collinear_points_give_no_pose() {
        let truth = moved_camera(FOV_DEG);
        assert!(fit_pose(&pairs(&truth, 0.0)[..9], SIZE, SIZE).is_none());
        assert!(fit_pose(&pairs(&truth, 0.0)[..12], SIZE, SIZE).is_none(), "one row of the grid");
    }
}
