//! Levenberg–Marquardt over focal length, plane and all poses.

use nalgebra::{DMatrix, DVector, Matrix3};
use rayon::prelude::*;

use super::model::{Model, Motion, SHARED};

/// Fields of view, in degrees, from which the search starts.
const STARTS_DEG: [f64; 6] = [12.0, 20.0, 30.0, 44.0, 62.0, 84.0];
/// Slopes of the plane from which it starts again at the best field of view.
const SLOPES: [[f64; 2]; 4] = [[0.25, 0.0], [-0.25, 0.0], [0.0, 0.25], [0.0, -0.25]];
/// Steps of the starts and of the end.
const FEW: usize = 6;
const MANY: usize = 60;
/// Steps of the central differences: the unknowns are of order one.
const DIFFERENCE: f64 = 1e-6;
/// Squared residual, in squared expected errors, at which a homography counts half (Cauchy).
const HALF_WEIGHT: f64 = 9.0;
/// Independent equations in a homography.
const EQUATIONS: f64 = 8.0;

/// The camera that fits best and how well it is known.
pub(super) struct Solution {
    pub model: Model,
    /// Of the unknowns of [`Model::stepped`].
    pub covariance: DMatrix<f64>,
    /// Root mean square residual, in units.
    pub residual: f64,
}

impl Solution {
    /// Standard error of an unknown.
    pub fn deviation(&self, unknown: usize) -> f64 {
        self.covariance[(unknown, unknown)].sqrt()
    }

    /// Standard errors of functions of some of the unknowns.
    pub fn spread(&self, unknowns: &[usize], of: impl Fn(&Model) -> Vec<f64>) -> Vec<f64> {
        let gradient = |&u: &usize| {
            let (ahead, behind) = (of(&self.model.moved(u, DIFFERENCE)), of(&self.model.moved(u, -DIFFERENCE)));
            ahead.iter().zip(&behind).map(|(a, b)| (a - b) / (2.0 * DIFFERENCE)).collect::<Vec<f64>>()
        };
        let gradients: Vec<Vec<f64>> = unknowns.iter().map(gradient).collect();
        let variance = |k: usize| {
            let pairs = unknowns.iter().zip(&gradients).flat_map(|a| unknowns.iter().zip(&gradients).map(move |b| (a, b)));
            pairs.map(|((&i, a), (&j, b))| a[k] * b[k] * self.covariance[(i, j)]).sum::<f64>()
        };
        (0..gradients.first().map_or(0, Vec::len)).map(|k| variance(k).max(0.0).sqrt()).collect()
    }
}

/// The best camera for the measured homographies, from several fields of view and planes; `starts` are the homographies from
/// the reference to every node. A given focal length (in units) stays.
pub(super) fn solve(motions: &[Motion], starts: &[Matrix3<f64>], given: Option<f64>) -> Option<Solution> {
    let focals: Vec<f64> = match given {
        Some(focal) => vec![focal],
        None => STARTS_DEG.iter().map(|deg| 1.0 / (0.5 * deg.to_radians()).tan()).collect(),
    };
    let held = Problem { motions, free_focal: false };
    let problem = Problem { motions, free_focal: given.is_none() };
    // The focal length is held until plane and poses have come near: it would run away from theirs.
    let descended = |focal: f64, slopes| problem.descend(held.descend(Model::near(starts, focal, slopes)?, FEW)?.0, MANY);
    let best = |ends: Vec<(Model, f64)>| ends.into_iter().min_by(|a, b| a.1.total_cmp(&b.1));
    let straight = best(focals.par_iter().filter_map(|&f| descended(f, [0.0; 2])).collect())?;
    let tilted = SLOPES.par_iter().filter_map(|&s| descended(straight.0.focal().clamp(0.5, 20.0), s));
    let (model, _) = best(tilted.chain([straight.clone()]).collect())?;
    problem.conclude(model)
}

struct Problem<'a> {
    motions: &'a [Motion],
    free_focal: bool,
}

/// JᵀWJ and JᵀWr with the sums that tell how good the fit is.
struct Normal {
    matrix: DMatrix<f64>,
    vector: DVector<f64>,
    /// Robust cost.
    cost: f64,
    /// Weighted squares and the equations that they count for.
    squares: f64,
    equations: f64,
}

impl Problem<'_> {
    /// The robust cost alone.
    fn cost(&self, model: &Model) -> Option<f64> {
        let (mut cost, mut residuals) = (0.0, Vec::new());
        for motion in self.motions {
            model.residuals(motion, &mut residuals)?;
            cost += robust(&residuals).0;
        }
        Some(cost)
    }

    fn descend(&self, mut model: Model, steps: usize) -> Option<(Model, f64)> {
        let mut damping = 1e-3;
        let mut normal = self.linearise(&model)?;
        for _ in 0..steps {
            let mut damped = normal.matrix.clone();
            (0..damped.nrows()).for_each(|i| damped[(i, i)] *= 1.0 + damping);
            let Some(step) = damped.cholesky().map(|c| c.solve(&-&normal.vector)) else { break };
            // A focal length that runs away is stopped: it isn't observable, and the covariance says so.
            let longest = step[0].abs().max(1e-12);
            let tried = model.stepped((step * (0.5 / longest).min(1.0)).as_slice());
            match self.cost(&tried).filter(|&c| c < normal.cost && (-4.0..7.0).contains(&tried.log_focal)) {
                Some(cost) => {
                    let gain = normal.cost - cost;
                    let enough = gain < 1e-10 * (cost + 1e-16);
                    (model, damping) = (tried, damping * 0.1);
                    normal = self.linearise(&model)?;
                    if enough {
                        break;
                    }
                }
                None if damping > 1e8 => break,
                None => damping *= 10.0,
            }
        }
        Some((model, normal.cost))
    }

    fn linearise(&self, model: &Model) -> Option<Normal> {
        let n = model.unknowns();
        let mut normal =
            Normal { matrix: DMatrix::zeros(n, n), vector: DVector::zeros(n), cost: 0.0, squares: 0.0, equations: 0.0 };
        let around: Vec<[Model; 2]> = (0..n).map(|u| [model.moved(u, DIFFERENCE), model.moved(u, -DIFFERENCE)]).collect();
        let (mut now, mut ahead, mut behind) = (Vec::new(), Vec::new(), Vec::new());
        for motion in self.motions {
            model.residuals(motion, &mut now)?;
            let (cost, weight) = robust(&now);
            // The positions of one homography share its eight equations.
            let each = weight * EQUATIONS / now.len() as f64;
            let unknowns = (0..SHARED).chain(Model::columns(motion.target)).chain(Model::columns(motion.source));
            let mut columns: Vec<(usize, Vec<f64>)> = Vec::new();
            for u in unknowns.filter(|&u| u > 0 || self.free_focal) {
                around[u][0].residuals(motion, &mut ahead)?;
                around[u][1].residuals(motion, &mut behind)?;
                columns.push((u, ahead.iter().zip(&behind).map(|(a, b)| (a - b) / (2.0 * DIFFERENCE)).collect()));
            }
            for (i, a) in &columns {
                normal.vector[*i] += each * a.iter().zip(&now).map(|(a, r)| a * r).sum::<f64>();
                for (j, b) in &columns {
                    normal.matrix[(*i, *j)] += each * a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
                }
            }
            normal.cost += cost;
            normal.squares += each * now.iter().map(|r| r * r).sum::<f64>();
            normal.equations += weight * EQUATIONS;
        }
        if !self.free_focal {
            normal.matrix[(0, 0)] = 1.0;
        }
        Some(normal)
    }

    fn conclude(&self, model: Model) -> Option<Solution> {
        let normal = self.linearise(&model)?;
        let n = model.unknowns();
        let determined = normal.equations - (n - usize::from(!self.free_focal)) as f64;
        let spread = if determined > 0.5 { normal.squares / determined } else { 1.0 };
        // Homographies that share a frame share its errors (shading, rolling shutter): each frame is believed once.
        let shared = self.motions.len() as f64 / (model.poses.len() - 1).max(1) as f64;
        let spread = spread * shared.max(1.0);
        let mut covariance = match normal.matrix.cholesky() {
            Some(c) => c.inverse() * spread,
            None => DMatrix::from_element(n, n, f64::INFINITY),
        };
        if !self.free_focal {
            covariance.row_mut(0).fill(0.0);
            covariance.column_mut(0).fill(0.0);
        }
        let (mut squares, mut count, mut residuals) = (0.0, 0usize, Vec::new());
        for motion in self.motions {
            model.residuals(motion, &mut residuals)?;
            squares += residuals.iter().map(|r| (r * motion.error).powi(2)).sum::<f64>();
            count += motion.pairs.len();
        }
        Some(Solution { model, covariance, residual: (squares / count.max(1) as f64).sqrt() })
    }
}

/// Cauchy's cost of a homography, by its mean squared residual, and its weight.
fn robust(residuals: &[f64]) -> (f64, f64) {
    let mean = residuals.iter().map(|r| r * r).sum::<f64>() / residuals.len().max(1) as f64;
    (EQUATIONS * HALF_WEIGHT * (mean / HALF_WEIGHT).ln_1p(), 1.0 / (1.0 + mean / HALF_WEIGHT))
}
