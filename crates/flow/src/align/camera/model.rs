//! The unknowns and the homographies that they predict.
//!
//! Image positions are in *units*: the principal point at 0, half the frame's width 1. A focal length of φ units is one of
//! φ·width/2 pixels, and K = diag(φ, φ, 1).

use nalgebra::{Matrix3, Rotation3, Vector3};
use ops::homography::Homography;

use super::super::graph::Link;
use super::super::pose::Pose;
use super::super::size::Size;

/// Positions per side at which a homography is compared.
const SIDE: usize = 5;
/// A homography that is known at fewer of them is left out: this many don't lie in one row.
const FEWEST_PAIRS: usize = 8;
/// No homography is believed to be better than this share of the frame's width.
const SHARPEST: f64 = 1e-6;
/// Unknowns before those of the poses: log φ and the plane's two slopes.
pub(super) const SHARED: usize = 3;

/// A homography between pixels of two frames of one size, in units.
pub(super) fn in_units(homography: &Homography, size: Size) -> Matrix3<f64> {
    let (to, from) = unit_frame(size);
    to * homography.matrix * from
}

fn unit_frame(size: Size) -> (Matrix3<f64>, Matrix3<f64>) {
    let (half, cx, cy) = (0.5 * size.width as f64, 0.5 * (size.width as f64 - 1.0), 0.5 * (size.height as f64 - 1.0));
    let to = Matrix3::new(1.0 / half, 0.0, -cx / half, 0.0, 1.0 / half, -cy / half, 0.0, 0.0, 1.0);
    (to, Matrix3::new(half, 0.0, cx, 0.0, half, cy, 0.0, 0.0, 1.0))
}

/// A measured homography as pairs of positions, in units.
pub(super) struct Motion {
    pub target: usize,
    pub source: usize,
    /// Target position and where the measurement puts it in the source.
    pub pairs: Vec<[[f64; 2]; 2]>,
    /// Its expected error.
    pub error: f64,
}

impl Motion {
    /// The link at those positions of its target that it maps into its source, where it was measured; `None` for too
    /// few of them.
    pub fn of(link: &Link, size: Size) -> Option<Self> {
        let (to, half) = (unit_frame(size).0, 0.5 * size.width as f64);
        let unit = |(x, y): (f64, f64)| {
            let p = to * Vector3::new(x, y, 1.0);
            [p.x, p.y]
        };
        let pair = |p: (f64, f64)| {
            let q = link.homography.apply(p.0, p.1).filter(|&q| size.contains(q))?;
            Some([unit(p), unit(q)])
        };
        let pairs: Vec<_> = size.grid(SIDE).filter_map(pair).collect();
        let error = link.error_px.max(SHARPEST * size.width as f64) / half;
        (pairs.len() >= FEWEST_PAIRS).then_some(Self { target: link.target, source: link.source, pairs, error })
    }
}

/// A camera over a plane and its poses; the first pose is the reference and stays at rest.
#[derive(Clone)]
pub(super) struct Model {
    pub log_focal: f64,
    /// The plane is slope₀·X + slope₁·Y + Z = 1 in the reference camera's axes.
    pub slopes: [f64; 2],
    /// Reference camera to camera; lengths in depths of the plane along the reference's axis.
    pub poses: Vec<Pose>,
}

impl Model {
    /// The poses that come nearest to the given homographies (in units) for a focal length and a plane.
    pub fn near(starts: &[Matrix3<f64>], focal: f64, slopes: [f64; 2]) -> Option<Self> {
        let (k, back) = (diagonal(focal), diagonal(1.0 / focal));
        let plane = Vector3::new(slopes[0], slopes[1], 1.0);
        let turn = Rotation3::rotation_between(&Vector3::z(), &plane)?;
        let pose = |h: &Matrix3<f64>| {
            // νᵀ·turn = |ν|·e₃ᵀ: seen from a camera turned so, the plane lies straight ahead.
            let seen = Pose::nearest(&(back * h * k * turn.matrix()))?;
            Some(Pose { rotation: seen.rotation * turn.inverse(), shift: seen.shift / plane.norm() })
        };
        let mut poses = starts.iter().map(pose).collect::<Option<Vec<Pose>>>()?;
        poses[0] = Pose::at_rest();
        Some(Self { log_focal: focal.ln(), slopes, poses })
    }

    /// φ.
    pub fn focal(&self) -> f64 {
        self.log_focal.exp()
    }

    /// ν.
    pub fn plane(&self) -> Vector3<f64> {
        Vector3::new(self.slopes[0], self.slopes[1], 1.0)
    }

    /// Number of unknowns.
    pub fn unknowns(&self) -> usize {
        SHARED + 6 * (self.poses.len() - 1)
    }

    /// The unknowns on which the homography of a node depends.
    pub fn columns(node: usize) -> std::ops::Range<usize> {
        if node == 0 { 0..0 } else { SHARED + 6 * (node - 1)..SHARED + 6 * node }
    }

    /// The model with one unknown changed.
    pub fn moved(&self, unknown: usize, by: f64) -> Self {
        let mut step = vec![0.0; self.unknowns()];
        step[unknown] = by;
        self.stepped(&step)
    }

    /// The model after a step of all unknowns.
    pub fn stepped(&self, step: &[f64]) -> Self {
        let pose = |(node, pose): (usize, &Pose)| match Self::columns(node) {
            own if own.is_empty() => *pose,
            own => pose.moved(&nalgebra::SVector::from_column_slice(&step[own])),
        };
        Self {
            log_focal: self.log_focal + step[0],
            slopes: [self.slopes[0] + step[1], self.slopes[1] + step[2]],
            poses: self.poses.iter().enumerate().map(pose).collect(),
        }
    }

    /// Reference to node, in units.
    pub fn homography(&self, node: usize) -> Matrix3<f64> {
        diagonal(self.focal()) * self.poses[node].matrix(&self.plane()) * diagonal(1.0 / self.focal())
    }

    /// Predicted minus measured positions, divided by the expected error; `None` where the prediction leaves the view.
    pub fn residuals(&self, motion: &Motion, out: &mut Vec<f64>) -> Option<()> {
        let relative = self.homography(motion.source) * self.homography(motion.target).try_inverse()?;
        out.clear();
        for [p, q] in &motion.pairs {
            let seen = relative * Vector3::new(p[0], p[1], 1.0);
            if seen.z.abs() < 1e-9 {
                return None;
            }
            out.extend([(seen.x / seen.z - q[0]) / motion.error, (seen.y / seen.z - q[1]) / motion.error]);
        }
        out.iter().all(|r| r.is_finite()).then_some(())
    }
}

fn diagonal(focal: f64) -> Matrix3<f64> {
    Matrix3::from_diagonal(&Vector3::new(focal, focal, 1.0))
}
