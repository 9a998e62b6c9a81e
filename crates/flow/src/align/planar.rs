//! The robust homography of a flow field (spec: `regularise = "homography"`, in place of the paper's §5 pose estimation).
//!
//! A flat sample moves by a homography whatever the camera's field of view. It is found by RANSAC with the MSAC score on
//! normalised direct linear transforms of four points, then refined on all points by Levenberg–Marquardt with Geman–McClure weights.

use nalgebra::{Matrix3, SMatrix, SVector, SymmetricEigen};
use ops::homography::Homography;
use ops::planes::{Mask, Planes};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::size::Size;

/// Fewer valid points than this don't make a fit (spec 3.2, step 3).
pub const FEWEST_POINTS: usize = 10;
/// RANSAC ends when a better sample would be found with less than this probability.
const MISS_PROBABILITY: f64 = 1e-4;
/// Levenberg–Marquardt steps, at most.
const REFINEMENTS: usize = 15;

/// A target position and the source position that shows the same surface point, in pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PointPair {
    /// Target x, y.
    pub target: [f64; 2],
    /// Source x, y.
    pub source: [f64; 2],
}

/// How a robust fit searches.
#[derive(Clone, Copy, Debug)]
pub struct RobustFit {
    /// A pair further off than this, in pixels, is an outlier.
    pub threshold_px: f64,
    /// Samples, at most.
    pub samples: usize,
    /// Seed of the samples.
    pub seed: u64,
}

impl Default for RobustFit {
    fn default() -> Self {
        Self { threshold_px: 1.5, samples: 1000, seed: 0 }
    }
}

/// A homography with the figures that tell how well it fits.
#[derive(Clone, Copy, Debug)]
pub struct PlanarFit {
    /// Target pixel to source pixel.
    pub homography: Homography,
    /// Root mean square transfer error of the inliers, in pixels.
    pub residual_px: f64,
    /// Share of the pairs that are inliers.
    pub inliers: f64,
}

/// Every `step`-th valid pixel of a flow field as a pair of points.
pub fn pairs_of_flow(flow: &Planes, valid: &Mask, step: usize) -> Vec<PointPair> {
    let (first, step) = (step / 2, step.max(1));
    let rows = (first..flow.height).step_by(step);
    rows.flat_map(|y| (first..flow.width).step_by(step).map(move |x| (x, y)))
        .filter(|&(x, y)| valid.at(y, x) && flow.at(0, y, x).is_finite() && flow.at(1, y, x).is_finite())
        .map(|(x, y)| {
            let target = [x as f64, y as f64];
            let source = [target[0] + f64::from(flow.at(0, y, x)), target[1] + f64::from(flow.at(1, y, x))];
            PointPair { target, source }
        })
        .collect()
}

/// Every eighth pixel tells [`planar_flow`] the homography of a field.
const FIELD_STEP: usize = 8;

/// The flow of the homography that most of a flow field agrees on, looking at its valid pixels. No motion where there is
/// none, or where its horizon crosses the frame.
pub fn planar_flow(flow: &Planes, valid: &Mask) -> Planes {
    fit(&pairs_of_flow(flow, valid, FIELD_STEP), &RobustFit::default())
        .map(|found| found.homography.flow(flow.height, flow.width))
        .filter(|planar| planar.data.iter().all(|value| value.is_finite()))
        .unwrap_or_else(|| Planes::new(2, flow.height, flow.width))
}

/// The homography that most pairs agree on; `None` for fewer than [`FEWEST_POINTS`] pairs or when no sample yields a
/// homography that fits as many.
pub fn fit(pairs: &[PointPair], search: &RobustFit) -> Option<PlanarFit> {
    if pairs.len() < FEWEST_POINTS {
        return None;
    }
    let sampled = ransac(pairs, search)?;
    let homography = refine(pairs, sampled, search.threshold_px);
    let limit = search.threshold_px * search.threshold_px;
    let inlying: Vec<f64> = pairs.iter().map(|p| squared_error(&homography, p)).filter(|&e| e <= limit).collect();
    if inlying.len() < FEWEST_POINTS {
        return None;
    }
    let residual_px = (inlying.iter().sum::<f64>() / inlying.len() as f64).sqrt();
    Some(PlanarFit { homography, residual_px, inliers: inlying.len() as f64 / pairs.len() as f64 })
}

/// Squared distance between where a homography sends the target point and the source point.
fn squared_error(homography: &Homography, pair: &PointPair) -> f64 {
    match homography.apply(pair.target[0], pair.target[1]) {
        Some((x, y)) => (x - pair.source[0]).powi(2) + (y - pair.source[1]).powi(2),
        None => f64::INFINITY,
    }
}

/// Samples of four pairs, scored by the truncated squared error (MSAC, Torr and Zisserman 2000).
fn ransac(pairs: &[PointPair], search: &RobustFit) -> Option<Homography> {
    let mut rng = ChaCha8Rng::seed_from_u64(search.seed);
    let limit = search.threshold_px * search.threshold_px;
    let mut best: Option<(f64, Homography)> = None;
    let mut needed = search.samples;
    let mut drawn = 0;
    while drawn < needed.min(search.samples) {
        drawn += 1;
        let mut sample = [pairs[0]; 4];
        sample.iter_mut().for_each(|p| *p = pairs[rng.random_range(0..pairs.len())]);
        let Some(homography) = direct_linear(&sample) else { continue };
        let worst = best.map_or(f64::INFINITY, |(score, _)| score);
        let Some(score) = msac_score(&homography, pairs, limit, worst) else { continue };
        best = Some((score, homography));
        let inliers = pairs.iter().filter(|p| squared_error(&homography, p) <= limit).count() as f64 / pairs.len() as f64;
        let all_good = inliers.powi(4).clamp(1e-9, 1.0 - 1e-9);
        needed = (MISS_PROBABILITY.ln() / (1.0 - all_good).ln()).ceil() as usize;
    }
    best.map(|(_, homography)| homography)
}

/// The sum of truncated squared errors, or `None` as soon as it reaches `worst`.
fn msac_score(homography: &Homography, pairs: &[PointPair], limit: f64, worst: f64) -> Option<f64> {
    let mut score = 0.0;
    for pair in pairs {
        score += squared_error(homography, pair).min(limit);
        if score >= worst {
            return None;
        }
    }
    Some(score)
}

/// Direct linear transform of four or more pairs, with both point sets moved to the origin and scaled to √2 (Hartley 1997).
pub fn direct_linear(pairs: &[PointPair]) -> Option<Homography> {
    if pairs.len() < 4 {
        return None;
    }
    let from = normalisation(pairs.iter().map(|p| p.target))?;
    let to = normalisation(pairs.iter().map(|p| p.source))?;
    let mut normal = SMatrix::<f64, 9, 9>::zeros();
    for pair in pairs {
        let (x, y) = transformed(&from, pair.target);
        let (u, v) = transformed(&to, pair.source);
        let rows = [[x, y, 1.0, 0.0, 0.0, 0.0, -u * x, -u * y, -u], [0.0, 0.0, 0.0, x, y, 1.0, -v * x, -v * y, -v]];
        for row in rows {
            let row = SVector::<f64, 9>::from(row);
            normal += row * row.transpose();
        }
    }
    let eigen = SymmetricEigen::new(normal);
    let mut order: Vec<usize> = (0..9).collect();
    order.sort_by(|&a, &b| eigen.eigenvalues[a].total_cmp(&eigen.eigenvalues[b]));
    // A second vanishing eigenvalue: the points don't determine a homography (three on a line, or repeated).
    if eigen.eigenvalues[order[1]] < 1e-9 * eigen.eigenvalues[order[8]] {
        return None;
    }
    let h = eigen.eigenvectors.column(order[0]);
    let matrix = to.try_inverse()? * Matrix3::from_row_slice(h.as_slice()) * from;
    let homography = Homography::new(matrix);
    let usable = matrix.iter().all(|v| v.is_finite()) && homography.matrix.determinant().abs() > 1e-12;
    usable.then_some(homography)
}

fn normalisation(points: impl Iterator<Item = [f64; 2]> + Clone) -> Option<Matrix3<f64>> {
    let n = points.clone().count() as f64;
    let (cx, cy) = points.clone().fold((0.0, 0.0), |(x, y), p| (x + p[0] / n, y + p[1] / n));
    let spread = points.map(|p| (p[0] - cx).hypot(p[1] - cy)).sum::<f64>() / n;
    let s = std::f64::consts::SQRT_2 / spread;
    (spread > 1e-9 && s.is_finite()).then(|| Matrix3::new(s, 0.0, -s * cx, 0.0, s, -s * cy, 0.0, 0.0, 1.0))
}

fn transformed(matrix: &Matrix3<f64>, p: [f64; 2]) -> (f64, f64) {
    (matrix[(0, 0)] * p[0] + matrix[(0, 2)], matrix[(1, 1)] * p[1] + matrix[(1, 2)])
}

/// Levenberg–Marquardt on the transfer error of all pairs, in coordinates of the target's extent, with Geman–McClure weights:
/// a coherent group of outliers must not pull.
fn refine(pairs: &[PointPair], start: Homography, threshold_px: f64) -> Homography {
    let Some(unit) = normalisation(pairs.iter().map(|p| p.target)) else { return start };
    let Some(back) = unit.try_inverse() else { return start };
    let robust = |e: f64| e / (e + threshold_px * threshold_px);
    let cost = |h: &Homography| pairs.iter().map(|p| robust(squared_error(h, p).min(1e12))).sum::<f64>();
    let mut best = start;
    let mut best_cost = cost(&best);
    let mut damping = 1e-4;
    for _ in 0..REFINEMENTS {
        let in_unit = Homography::new(best.matrix * back);
        let (matrix, vector) = normal_equations(pairs, &in_unit, &unit, threshold_px);
        let mut damped = matrix;
        (0..8).for_each(|i| damped[(i, i)] += damping * (matrix[(i, i)] + 1e-9));
        let Some(step) = damped.cholesky().map(|c| c.solve(&-vector)) else { break };
        let m = in_unit.matrix;
        let moved = Matrix3::from_fn(|r, c| m[(r, c)] + if (r, c) == (2, 2) { 0.0 } else { step[3 * r + c] });
        let tried = Homography::new(moved * unit);
        let tried_cost = cost(&tried);
        if tried_cost < best_cost {
            let gain = best_cost - tried_cost;
            (best, best_cost, damping) = (tried, tried_cost, damping * 0.2);
            if gain < 1e-9 * (1.0 + best_cost) {
                break;
            }
        } else {
            damping *= 10.0;
        }
    }
    best
}

/// Weighted JᵀJ and Jᵀr of the transfer error by the first eight entries of the matrix.
fn normal_equations(
    pairs: &[PointPair],
    homography: &Homography,
    unit: &Matrix3<f64>,
    threshold_px: f64,
) -> (SMatrix<f64, 8, 8>, SVector<f64, 8>) {
    let mut matrix = SMatrix::<f64, 8, 8>::zeros();
    let mut vector = SVector::<f64, 8>::zeros();
    let m = &homography.matrix;
    for pair in pairs {
        let (x, y) = transformed(unit, pair.target);
        let w = m[(2, 0)] * x + m[(2, 1)] * y + m[(2, 2)];
        let Some((u, v)) = homography.apply(x, y) else { continue };
        let (ru, rv) = (u - pair.source[0], v - pair.source[1]);
        let weight = (1.0 + (ru * ru + rv * rv) / (threshold_px * threshold_px)).powi(-2);
        let ju = SVector::<f64, 8>::from([x, y, 1.0, 0.0, 0.0, 0.0, -u * x, -u * y]) / w;
        let jv = SVector::<f64, 8>::from([0.0, 0.0, 0.0, x, y, 1.0, -v * x, -v * y]) / w;
        matrix += weight * (ju * ju.transpose() + jv * jv.transpose());
        vector += weight * (ju * ru + jv * rv);
    }
    (matrix, vector)
}

/// Whether a homography is one that two frames of a scan can have: finite, in front of the camera, not mirrored, the frame's
/// area changed by less than `factor`, and no corner moved by more than two frame sizes.
pub fn sane(homography: &Homography, size: Size, factor: f64) -> bool {
    let (w, h) = (size.width as f64 - 1.0, size.height as f64 - 1.0);
    let corners = [(0.0, 0.0), (w, 0.0), (w, h), (0.0, h)];
    let Some(mapped) = corners.iter().map(|&(x, y)| homography.apply(x, y)).collect::<Option<Vec<_>>>() else {
        return false;
    };
    // Twice the signed area of each corner's triangle: all positive for a convex image of the same orientation.
    let turn = |i: usize| {
        let ((ax, ay), (bx, by), (cx, cy)) = (mapped[i], mapped[(i + 1) % 4], mapped[(i + 2) % 4]);
        (bx - ax) * (cy - by) - (by - ay) * (cx - bx)
    };
    let turns: Vec<f64> = (0..4).map(turn).collect();
    let area = 0.25 * turns.iter().sum::<f64>();
    let reach = 2.0 * w.max(h).max(1.0);
    let near = mapped.iter().zip(&corners).all(|(m, c)| (m.0 - c.0).hypot(m.1 - c.1) < reach * std::f64::consts::SQRT_2);
    let shares = turns.iter().all(|t| *t > w * h / (3.0 * factor) && t.is_finite());
    near && shares && area > w * h / factor && area < w * h * factor
}

#[cfg(test)]
mod tests {
    use super::*;

    fn truth() -> Homography {
        Homography::new(Matrix3::new(1.05, 0.03, -12.0, -0.02, 0.97, 8.0, 2e-4, -1e-4, 1.0))
    }

    fn grid(homography: &Homography, side: usize) -> Vec<PointPair> {
        let pair = |(x, y): (f64, f64)| {
            let (u, v) = homography.apply(x, y).unwrap();
            PointPair { target: [x, y], source: [u, v] }
        };
        Size { height: 256, width: 256 }.grid(side).map(pair).collect()
    }

    fn largest_error(a: &Homography, b: &Homography) -> f64 {
        let distance = |(x, y)| {
            let (p, q) = (a.apply(x, y).unwrap(), b.apply(x, y).unwrap());
            (p.0 - q.0).hypot(p.1 - q.1)
        };
        Size { height: 256, width: 256 }.grid(6).map(distance).fold(0.0, f64::max)
    }

    #[test]
    fn direct_linear_transform_is_exact_on_exact_points() {
        let h = direct_linear(&grid(&truth(), 2)).unwrap();
        assert!(largest_error(&h, &truth()) < 1e-6);
        let h = direct_linear(&grid(&truth(), 7)).unwrap();
        assert!(largest_error(&h, &truth()) < 1e-6);
    }

    #[test]
    fn collinear_and_repeated_points_give_no_homography() {
        let line = |i: f64| PointPair { target: [i, 2.0 * i], source: [i + 1.0, 2.0 * i] };
        assert!(direct_linear(&[line(0.0), line(1.0), line(2.0), line(5.0)]).is_none());
        assert!(direct_linear(&[line(3.0); 4]).is_none());
        assert!(fit(&(0..40).map(|i| line(f64::from(i))).collect::<Vec<_>>(), &RobustFit::default()).is_none());
        assert!(fit(&grid(&truth(), 3), &RobustFit::default()).is_none(), "nine points are too few");
    }

    #[test]
    fn robust_fit_survives_half_outliers_and_noise() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let mut pairs = grid(&truth(), 20);
        for (i, pair) in pairs.iter_mut().enumerate() {
            let reach = if i % 2 == 0 { 0.3 } else { 60.0 };
            pair.source.iter_mut().for_each(|v| *v += rng.random_range(-reach..reach));
        }
        let fitted = fit(&pairs, &RobustFit::default()).unwrap();
        assert!(largest_error(&fitted.homography, &truth()) < 0.25, "{}", largest_error(&fitted.homography, &truth()));
        assert!((fitted.inliers - 0.5).abs() < 0.05 && fitted.residual_px < 0.5);
        let again = fit(&pairs, &RobustFit::default()).unwrap();
        assert_eq!(again.homography, fitted.homography);
    }

    #[test]
    fn coherent_outliers_lose_against_the_majority() {
        // A highlight that stands still: 40 % of the pairs claim no motion.
        let mut pairs = grid(&truth(), 20);
        pairs.iter_mut().take(160).for_each(|p| p.source = p.target);
        let fitted = fit(&pairs, &RobustFit::default()).unwrap();
        assert!(largest_error(&fitted.homography, &truth()) < 0.3);
    }

    #[test]
    fn flow_points_skip_invalid_pixels() {
        let flow = Homography::translation(1.5, -2.0).flow(8, 8);
        let valid = Mask::from_fn(8, 8, |y, _| y >= 4);
        let pairs = pairs_of_flow(&flow, &valid, 2);
        assert_eq!(pairs.len(), 2 * 4);
        assert!(pairs.iter().all(|p| p.source[0] == p.target[0] + 1.5 && p.source[1] == p.target[1] - 2.0));
    }

    #[test]
    fn a_planar_flow_is_a_number_at_every_pixel() {
        let everywhere = Mask::new(64, 64, true);
        let exact = truth().flow(64, 64);
        let close = |a: &Planes, b: &Planes| a.data.iter().zip(&b.data).all(|(a, b)| (a - b).abs() < 1e-2);
        assert!(close(&planar_flow(&exact, &everywhere), &exact));
        // What a hardly trained net may say: a plane seen edge-on, whose horizon lies in the frame.
        let edge_on = Homography::new(Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, -0.02, 0.0, 1.0)).flow(64, 64);
        assert!(edge_on.data.iter().any(|v| v.is_nan()));
        let near = Mask::from_fn(64, 64, |_, x| x < 44);
        assert!(planar_flow(&edge_on, &near).data.iter().all(|&v| v == 0.0));
        assert!(planar_flow(&exact, &Mask::new(64, 64, false)).data.iter().all(|&v| v == 0.0));
    }

    #[test]
    fn sanity_refuses_mirrors_folds_and_wild_scales() {
        let size = Size { height: 100, width: 120 };
        let of = |m: [f64; 9]| Homography::new(Matrix3::from_row_slice(&m));
        assert!(sane(&truth(), size, 3.0) && sane(&Homography::translation(150.0, 0.0), size, 3.0));
        assert!(!sane(&of([-1.0, 0.0, 119.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]), size, 3.0), "mirrored");
        assert!(!sane(&of([2.0, 0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 1.0]), size, 3.0), "four times the area");
        assert!(!sane(&of([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, -0.01, 0.0, 1.0]), size, 3.0), "past the horizon");
        assert!(!sane(&Homography::new(Matrix3::from_element(f64::NAN)), size, 3.0));
        assert!(!sane(&Homography::translation(500.0, 0.0), size, 3.0), "no overlap possible");
    }
}
