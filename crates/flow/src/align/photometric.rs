//! Direct refinement of a homography between two images, on the pixels themselves.
//!
//! Gauss–Newton on the difference of contrast-normalised images, coarse to fine, from a shift over a similarity and an affine
//! map to all eight parameters. The update is composed on the target's side with the mean of both images' gradients
//! (efficient second-order minimisation, Malis 2004), which converges from further away than either gradient alone. Cauchy
//! weights keep what moves differently, such as a highlight, from pulling.

use nalgebra::{DMatrix, Matrix3, SMatrix, SVector};
use ops::homography::Homography;
use ops::planes::Planes;

use super::config::PhotometricConfig;
use super::contrast::ContrastPyramid;
use super::size::{Size, resized};

/// Fewer common pixels than this on a level end the refinement.
const FEWEST_PIXELS: usize = 200;
/// A step shorter than this, in pixels of the level, ends the level.
const STILL_PX: f64 = 0.02;
/// Gauss–Newton steps of the levels above the last, at most: they only have to come near.
const COARSE_ITERATIONS: usize = 8;
/// Every second row of a last level with more rows than this is left out.
const ALL_ROWS: usize = 200;
/// Standard deviations that a refinement is expected to change the affine and the perspective parameters by, in units of
/// half the image: keeps directions that few pixels hold from wandering. A frame's camera turns by 1° and rises by 2 % (§4).
const PRIOR_AFFINE: f64 = 0.05;
const PRIOR_PERSPECTIVE: f64 = 0.02;
/// Cauchy scale in robust standard deviations: 95 % efficiency on Gaussian noise.
pub(super) const CAUCHY: f32 = 2.385;

type Matrix8 = SMatrix<f64, 8, 8>;
type Vector8 = SVector<f64, 8>;

/// A homography refined on the pixels.
#[derive(Clone, Copy, Debug)]
pub struct Refined {
    /// Target pixel to source pixel, at the finest level's size.
    pub homography: Homography,
    /// How alike the images are under it.
    pub consistency: Consistency,
    /// Whether the last level came to rest.
    pub converged: bool,
    /// Expected error, in pixels of the finest level, root mean square over the whole target; grows where the overlap is
    /// small, the texture weak or the fit poor.
    pub expected_px: f64,
}

/// How alike two contrast-normalised images are under a homography.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Consistency {
    /// Zero-mean normalised cross-correlation over the common pixels.
    pub zncc: f64,
    /// Share of the target's pixels that have a partner.
    pub overlap: f64,
    /// Number of values compared.
    pub compared: usize,
}

impl Consistency {
    /// No common pixels.
    pub const NONE: Self = Self { zncc: 0.0, overlap: 0.0, compared: 0 };

    /// Fisher's z of the correlation, which makes correlations comparable.
    pub fn fisher_z(&self) -> f64 {
        self.zncc.clamp(-0.999, 0.999).atanh()
    }

    /// How many standard errors the correlation lies above that of unrelated images.
    pub fn significance(&self) -> f64 {
        self.fisher_z() * (self.compared as f64 / CORRELATED_PIXELS).sqrt()
    }

    /// Strength of evidence: Fisher's z times the root of the overlap, as the standard error
    /// falls with the root of the number of pixels.
    pub fn score(&self) -> f64 {
        self.fisher_z() * self.overlap.max(0.0).sqrt()
    }
}

/// Refines `initial` from pyramid level `start` (0 is the finest) down to level `end`; `None` when the images have too little
/// in common or the result leaves the plausible range. Homographies are given at the finest level's size.
pub fn refine(
    target: &ContrastPyramid,
    source: &ContrastPyramid,
    initial: &Homography,
    (start, end): (usize, usize),
    config: &PhotometricConfig,
) -> Option<Refined> {
    let deepest = target.levels.len().min(source.levels.len()) - 1;
    let (start, end) = (start.min(deepest), end.min(deepest));
    let mut homography = *initial;
    let mut converged = false;
    let mut expected_px = f64::INFINITY;
    for level in (end..=start).rev() {
        let (t, s) = (&target.levels[level], &source.levels[level]);
        let sizes = ((target.size(), Size::of(t)), (source.size(), Size::of(s)));
        let models: &[Model] = match (level == start, level == end) {
            (true, false) => &[Model::Shift, Model::Similarity],
            (true, true) if level > 1 => &[Model::Shift, Model::Similarity],
            (_, false) => &[Model::Affine],
            (_, true) if level == 1 => &[Model::Affine],
            (_, true) => &[Model::Homography],
        };
        let mut at_level = resized(&homography, sizes.0, sizes.1);
        for &model in models {
            let iterations = if level == end { config.iterations } else { config.iterations.min(COARSE_ITERATIONS) };
            let fit = descend(t, s, &at_level, model, iterations)?;
            at_level = fit.homography;
            converged = fit.converged;
            expected_px = fit.expected_px * sizes.0.0.width as f64 / sizes.0.1.width as f64;
        }
        homography = resized(&at_level, (sizes.0.1, sizes.0.0), (sizes.1.1, sizes.1.0));
    }
    let consistency = consistency(target, source, &homography, end);
    Some(Refined { homography, consistency, converged, expected_px })
}

/// Gauss–Newton steps of a registration that starts near the end.
const NEAR_ITERATIONS: usize = 3;

/// Registers a source plane to a target plane that it nearly fits already; NaN is unknown in both. `None` as in [`refine`].
pub(super) fn register(target: &Planes, source: &Planes, initial: &Homography) -> Option<Homography> {
    descend(target, source, initial, Model::Homography, NEAR_ITERATIONS).map(|d| d.homography)
}

/// Compares two images under a homography (given at the finest level's size) on pyramid level `level`.
pub fn consistency(target: &ContrastPyramid, source: &ContrastPyramid, homography: &Homography, level: usize) -> Consistency {
    let level = level.min(target.levels.len() - 1).min(source.levels.len() - 1);
    let (t, s) = (&target.levels[level], &source.levels[level]);
    let at_level = resized(homography, (target.size(), Size::of(t)), (source.size(), Size::of(s)));
    let mut sums = [0.0f64; 5];
    let mut count = 0usize;
    let mut warped = vec![0.0f32; t.area()];
    for c in 0..t.channels {
        warp(s, c, &at_level, t.width, &mut warped);
        for (&a, &b) in t.plane(c).iter().zip(&warped).filter(|(a, b)| !(*a + *b).is_nan()) {
            let (a, b) = (f64::from(a), f64::from(b));
            [a, b, a * a, b * b, a * b].iter().zip(&mut sums).for_each(|(v, s)| *s += v);
            count += 1;
        }
    }
    if count < FEWEST_PIXELS {
        return Consistency::NONE;
    }
    let n = count as f64;
    let [a, b, aa, bb, ab] = sums.map(|s| s / n);
    let spread = ((aa - a * a) * (bb - b * b)).max(0.0).sqrt();
    let zncc = if spread > 1e-9 { (ab - a * b) / spread } else { 0.0 };
    Consistency { zncc, overlap: n / t.data.len() as f64, compared: count }
}

/// Which of the eight parameters may move.
#[derive(Clone, Copy, Debug)]
enum Model {
    Shift,
    Similarity,
    Affine,
    Homography,
}

impl Model {
    /// Directions in the parameters of [`update`] that this model may take, one column each.
    fn directions(self) -> DMatrix<f64> {
        let unit = |entries: &[(usize, f64)]| {
            let mut column = [0.0; 8];
            entries.iter().for_each(|&(i, v)| column[i] = v);
            column
        };
        let columns: Vec<[f64; 8]> = match self {
            Self::Shift => vec![unit(&[(2, 1.0)]), unit(&[(5, 1.0)])],
            Self::Similarity => {
                vec![unit(&[(2, 1.0)]), unit(&[(5, 1.0)]), unit(&[(0, 1.0), (4, 1.0)]), unit(&[(1, -1.0), (3, 1.0)])]
            }
            Self::Affine => (0..6).map(|i| unit(&[(i, 1.0)])).collect(),
            Self::Homography => (0..8).map(|i| unit(&[(i, 1.0)])).collect(),
        };
        DMatrix::from_fn(8, columns.len(), |r, c| columns[c][r])
    }
}

/// What a level's descent ends with.
struct Descent {
    homography: Homography,
    converged: bool,
    expected_px: f64,
}

/// Coordinates of the target in which all parameters have about the same effect: centre at 0, half the longer side 1.
struct Frame {
    to_unit: Matrix3<f64>,
    from_unit: Matrix3<f64>,
    half: f64,
}

impl Frame {
    fn of(image: &Planes) -> Self {
        let half = 0.5 * image.height.max(image.width) as f64;
        let (cx, cy) = (0.5 * (image.width as f64 - 1.0), 0.5 * (image.height as f64 - 1.0));
        let from_unit = Matrix3::new(half, 0.0, cx, 0.0, half, cy, 0.0, 0.0, 1.0);
        let to_unit = Matrix3::new(1.0 / half, 0.0, -cx / half, 0.0, 1.0 / half, -cy / half, 0.0, 0.0, 1.0);
        Self { to_unit, from_unit, half }
    }
}

/// The small map of the target with parameters p, in unit coordinates: [1+p0, p1, p2; p3, 1+p4, p5; p6, p7, 1].
fn update(p: &Vector8) -> Matrix3<f64> {
    Matrix3::new(1.0 + p[0], p[1], p[2], p[3], 1.0 + p[4], p[5], p[6], p[7], 1.0)
}

fn descend(target: &Planes, source: &Planes, initial: &Homography, model: Model, iterations: usize) -> Option<Descent> {
    let frame = Frame::of(target);
    let directions = model.directions();
    let mut homography = *initial;
    let mut converged = false;
    let mut normal = Normal::default();
    let mut total = Vector8::zeros();
    let row_step = if target.height > ALL_ROWS { 2 } else { 1 };
    let mut warped = vec![0.0f32; target.area()];
    for _ in 0..iterations {
        normal = Normal::default();
        for c in 0..target.channels {
            warp(source, c, &homography, target.width, &mut warped);
            normal.add(target.plane(c), &warped, Size::of(target), row_step, &frame);
        }
        if normal.pixels * row_step < FEWEST_PIXELS * target.channels {
            return None;
        }
        normal.add_prior(&total);
        let step = normal.solve(&directions)?;
        total += step;
        homography = Homography::new(homography.matrix * (frame.from_unit * update(&step) * frame.to_unit));
        if !plausible(&homography, Size::of(target)) {
            return None;
        }
        if step.norm() * frame.half < STILL_PX {
            converged = true;
            break;
        }
    }
    Some(Descent { homography, converged, expected_px: normal.expected_px(&directions, &frame, target) })
}

/// The weighted normal equations of one Gauss–Newton step, with the sums that tell how good the fit is.
#[derive(Default)]
struct Normal {
    matrix: Matrix8,
    vector: Vector8,
    weight: f64,
    squares: f64,
    pixels: usize,
}

impl Normal {
    /// Adds one plane: residual, robust weight and gradient of every pixel whose neighbours have partners too.
    fn add(&mut self, target: &[f32], warped: &[f32], Size { height, width }: Size, row_step: usize, frame: &Frame) {
        let scale = residual_scale(target, warped);
        let inverse_scale = 1.0 / (CAUCHY * scale);
        let unit = |i: usize, n: usize| ((i as f64 - 0.5 * (n as f64 - 1.0)) / frame.half) as f32;
        let columns: Vec<f32> = (0..width).map(|x| unit(x, width)).collect();
        // A quarter: half of the two images' mean, half of a central difference. Gradients are per pixel, parameters per half side.
        let per_unit = 0.25 * frame.half as f32;
        for y in (1..height.saturating_sub(1)).step_by(row_step) {
            let v = unit(y, height);
            // Rows are summed in f32 and added up in f64.
            let (mut matrix, mut vector) = ([[0.0f32; 8]; 8], [0.0f32; 8]);
            let (mut weights, mut squares) = (0.0f32, 0.0f32);
            for x in 1..width - 1 {
                let i = y * width + x;
                let gx = per_unit * (warped[i + 1] - warped[i - 1] + target[i + 1] - target[i - 1]);
                let gy = per_unit * (warped[i + width] - warped[i - width] + target[i + width] - target[i - width]);
                let residual = warped[i] - target[i];
                if (gx + gy + residual).is_nan() {
                    continue;
                }
                let weight = 1.0 / (1.0 + (residual * inverse_scale).powi(2));
                let u = columns[x];
                let radial = -(gx * u + gy * v);
                let j = [gx * u, gx * v, gx, gy * u, gy * v, gy, radial * u, radial * v];
                for r in 0..8 {
                    let wj = weight * j[r];
                    vector[r] += wj * residual;
                    for c in 0..8 {
                        matrix[r][c] += wj * j[c];
                    }
                }
                weights += weight;
                squares += weight * residual * residual;
                self.pixels += 1;
            }
            for r in 0..8 {
                self.vector[r] += f64::from(vector[r]);
                (0..8).for_each(|c| self.matrix[(r, c)] += f64::from(matrix[r][c]));
            }
            self.weight += f64::from(weights);
            self.squares += f64::from(squares);
        }
    }

    /// Adds the expectation that a refinement, `total` so far, stays small.
    fn add_prior(&mut self, total: &Vector8) {
        let variance = self.variance();
        for (i, deviation) in [
            (0, PRIOR_AFFINE),
            (1, PRIOR_AFFINE),
            (3, PRIOR_AFFINE),
            (4, PRIOR_AFFINE),
            (6, PRIOR_PERSPECTIVE),
            (7, PRIOR_PERSPECTIVE),
        ] {
            let precision = variance / (deviation * deviation);
            self.matrix[(i, i)] += precision;
            self.vector[i] += precision * total[i];
        }
    }

    /// Variance that a residual would have if all pixels were independent.
    fn variance(&self) -> f64 {
        self.squares / self.weight.max(1.0) * CORRELATED_PIXELS
    }

    /// The step within the model's directions, slightly damped; `None` where the texture doesn't determine it.
    fn solve(&self, directions: &DMatrix<f64>) -> Option<Vector8> {
        let mut matrix = directions.transpose() * self.matrix * directions;
        let damping = 1e-3 * matrix.trace() / matrix.nrows() as f64 + 1e-9;
        (0..matrix.nrows()).for_each(|i| matrix[(i, i)] += damping);
        let step = matrix.cholesky()?.solve(&(directions.transpose() * -self.vector));
        let full = directions * step;
        let full = Vector8::from_fn(|r, _| full[r]);
        full.iter().all(|v| v.is_finite()).then_some(full)
    }

    /// Root mean square, over the target, of the error that the residuals let expect.
    fn expected_px(&self, directions: &DMatrix<f64>, frame: &Frame, target: &Planes) -> f64 {
        let matrix = directions.transpose() * self.matrix * directions;
        let Some(inverse) = matrix.cholesky().map(|c| c.inverse()) else { return f64::INFINITY };
        let covariance = directions * inverse * directions.transpose() * self.variance();
        let size = Size::of(target);
        let mut sum = 0.0;
        const SIDE: usize = 5;
        for (x, y) in size.grid(SIDE) {
            let unit = frame.to_unit * nalgebra::Vector3::new(x, y, 1.0);
            let (u, v) = (unit.x, unit.y);
            let jx = SVector::<f64, 8>::from([u, v, 1.0, 0.0, 0.0, 0.0, -u * u, -u * v]);
            let jy = SVector::<f64, 8>::from([0.0, 0.0, 0.0, u, v, 1.0, -u * v, -v * v]);
            sum += (jx.transpose() * &covariance * jx)[0] + (jy.transpose() * &covariance * jy)[0];
        }
        (sum / (SIDE * SIDE) as f64).max(0.0).sqrt() * frame.half
    }
}

/// Neighbouring residuals are alike: this many pixels carry the information of one independent one (the normalisation's own
/// correlation length squared, roughly).
const CORRELATED_PIXELS: f64 = 16.0;

/// Robust standard deviation of the residuals, on every seventh pixel.
fn residual_scale(target: &[f32], warped: &[f32]) -> f32 {
    let mut sizes: Vec<f32> =
        target.iter().zip(warped).step_by(7).map(|(t, w)| (w - t).abs()).filter(|r| !r.is_nan()).collect();
    residual_deviation(&mut sizes)
}

/// Robust standard deviation of residuals of the given sizes (1.4826 · median), at least a twentieth of the contrast; 1
/// without any.
pub(super) fn residual_deviation(sizes: &mut [f32]) -> f32 {
    if sizes.is_empty() {
        return 1.0;
    }
    let middle = sizes.len() / 2;
    let (_, &mut median, _) = sizes.select_nth_unstable_by(middle, f32::total_cmp);
    (1.4826 * median).max(0.05)
}

/// Samples one plane of `source` at `homography(target pixel)`; NaN outside and where the source is unknown.
pub(super) fn warp(source: &Planes, channel: usize, homography: &Homography, width: usize, out: &mut [f32]) {
    let plane = source.plane(channel);
    let m = homography.matrix.map(|v| v as f32);
    let (right, bottom) = ((source.width - 1) as f32, (source.height - 1) as f32);
    for (y, row) in out.chunks_mut(width).enumerate() {
        let y = y as f32;
        let (bx, by, bw) = (m[(0, 1)] * y + m[(0, 2)], m[(1, 1)] * y + m[(1, 2)], m[(2, 1)] * y + m[(2, 2)]);
        for (x, value) in row.iter_mut().enumerate() {
            let x = x as f32;
            let w = m[(2, 0)] * x + bw;
            let inverse = if w > 1e-6 { 1.0 / w } else { f32::NAN };
            let (sx, sy) = ((m[(0, 0)] * x + bx) * inverse, (m[(1, 0)] * x + by) * inverse);
            *value = if sx >= 0.0 && sy >= 0.0 && sx < right && sy < bottom {
                let (x0, y0) = (sx as usize, sy as usize);
                let (fx, fy) = (sx - x0 as f32, sy - y0 as f32);
                let i = y0 * source.width + x0;
                let top = plane[i] + fx * (plane[i + 1] - plane[i]);
                let low = plane[i + source.width] + fx * (plane[i + source.width + 1] - plane[i + source.width]);
                top + fy * (low - top)
            } else {
                f32::NAN
            };
        }
    }
}

/// Whether a homography is one that two frames of a scan can have: finite, not mirrored, area within a factor of 3, and not
/// bent so far that the frame's corners go near the horizon.
pub fn plausible(homography: &Homography, size: Size) -> bool {
    super::planar::sane(homography, size, 3.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::candidates::largest_shift;
    use crate::align::scene::{Scene, between, view};

    const SIZE: Size = Size { height: 128, width: 128 };

    fn pyramid(image: &Planes) -> ContrastPyramid {
        ContrastPyramid::new(image, &PhotometricConfig::default())
    }

    fn lit_scene() -> Scene {
        Scene { highlight: 0.35, noise: 0.02, ..Scene::new(11) }
    }

    #[test]
    fn converges_from_six_pixels_and_two_degrees_under_a_travelling_light() {
        let scene = lit_scene();
        let (a, b) = (view(SIZE, 40.0, 60.0, 0.02, 1.0, 0.0), view(SIZE, 49.0, 66.0, -0.03, 1.04, 0.03));
        let (target, source) = (pyramid(&scene.frame(&a, SIZE)), pyramid(&scene.frame(&b, SIZE)));
        let truth = between(&a, &b);
        for (dx, dy, roll) in [(6.0, 0.0, 0.0), (-6.0, 4.0, 0.035), (0.0, -6.0, -0.035), (4.0, 4.0, 0.0)] {
            let off = between(&view(SIZE, dx, dy, roll, 1.0, 0.0), &view(SIZE, 0.0, 0.0, 0.0, 1.0, 0.0));
            let refined = refine(&target, &source, &truth.after(&off), (2, 0), &PhotometricConfig::default()).unwrap();
            let error = largest_shift(&refined.homography, &truth, SIZE);
            assert!(error < 0.35, "from {dx}, {dy}, {roll}: {error} px, expected {}", refined.expected_px);
            assert!(refined.consistency.zncc > 0.75 && refined.expected_px < 0.5);
        }
    }

    #[test]
    fn a_perfect_start_stays_and_is_fully_consistent() {
        let scene = Scene::new(2);
        let image = pyramid(&scene.frame(&Homography::identity(), SIZE));
        let refined = refine(&image, &image, &Homography::identity(), (2, 0), &PhotometricConfig::default()).unwrap();
        assert!(refined.converged && largest_shift(&refined.homography, &Homography::identity(), SIZE) < 1e-3);
        assert!((refined.consistency.zncc - 1.0).abs() < 1e-4 && refined.consistency.overlap > 0.97);
    }

    #[test]
    fn odd_and_different_sizes_work() {
        let scene = Scene::new(4);
        let (small, large) = (Size { height: 96, width: 117 }, Size { height: 131, width: 140 });
        let a = view(small, 10.0, 10.0, 0.0, 1.0, 0.0);
        let b = view(large, 12.0, 9.0, 0.02, 1.0, 0.0);
        let (target, source) = (pyramid(&scene.frame(&a, small)), pyramid(&scene.frame(&b, large)));
        let truth = between(&a, &b);
        let start = Homography::translation(2.0, -2.0).after(&truth);
        let refined = refine(&target, &source, &start, (1, 0), &PhotometricConfig::default()).unwrap();
        assert!(largest_shift(&refined.homography, &truth, small) < 0.2);
    }

    #[test]
    fn nothing_in_common_or_nothing_to_see_gives_no_result() {
        let scene = Scene::new(7);
        let config = PhotometricConfig::default();
        let image = pyramid(&scene.frame(&Homography::identity(), SIZE));
        assert!(refine(&image, &image, &Homography::translation(300.0, 0.0), (2, 0), &config).is_none());
        assert_eq!(consistency(&image, &image, &Homography::translation(300.0, 0.0), 0), Consistency::NONE);
        let black = pyramid(&Planes::new(3, 128, 128));
        assert_eq!(consistency(&black, &image, &Homography::identity(), 0).zncc, 0.0);
        if let Some(refined) = refine(&black, &black, &Homography::identity(), (2, 0), &config) {
            assert_eq!(refined.consistency.zncc, 0.0);
        }
    }
}
