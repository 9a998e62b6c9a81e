//! What a real lens does beside the pinhole: it bends straight lines and darkens the corners.

use serde::{Deserialize, Serialize};

use crate::block::LANES;
use crate::camera::Camera;

/// Largest absolute k1 and k2 for which [`RadialDistortion`] folds no part of an image over another.
pub const DISTORTION_LIMIT: f64 = 0.5;
/// r² from which on the distortion's factor stays as it is. With both coefficients at −[`DISTORTION_LIMIT`] the shown
/// distance stops growing here; images with fields of view up to 35°, the widest of §4, lie inside even then.
const FACTOR_R2: f64 = 0.4;
/// Newton steps that always suffice: three do for a phone's lens, seven at the limits.
const NEWTON_STEPS: usize = 16;

/// Radial distortion of a lens.
///
/// What a pinhole camera shows at distance r from the image centre, in focal lengths, this lens shows at
/// r·(1 + k1·r² + k2·r⁴). Negative coefficients give a barrel, positive ones a pincushion.
///
/// # Source
/// D. C. Brown, "Decentering distortion of lenses", 1966, the radial terms; k1 and k2 are those of OpenCV. Departs: from
/// r² = 0.4 on the factor stays constant, so that the map has an inverse everywhere.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RadialDistortion {
    /// Coefficient of r².
    pub k1: f64,
    /// Coefficient of r⁴.
    pub k2: f64,
}

impl RadialDistortion {
    /// Whether straight lines stay straight.
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }

    /// The pixel at which the lens shows what a pinhole camera shows at pixel (x, y).
    pub fn distort(&self, camera: &Camera, (x, y): (f64, f64), res: usize) -> (f64, f64) {
        ImageLens::new(*self, camera, res).distort((x, y))
    }

    /// The pixel at which a pinhole camera shows what the lens shows at pixel (x, y).
    pub fn undistort(&self, camera: &Camera, (x, y): (f64, f64), res: usize) -> (f64, f64) {
        ImageLens::new(*self, camera, res).undistort((x, y))
    }

    #[inline(always)]
    fn factor(&self, r2: f64) -> f64 {
        let r2 = r2.min(FACTOR_R2);
        1.0 + r2 * (self.k1 + r2 * self.k2)
    }

    /// The r with r·factor(r²) = `shown`.
    fn undistorted_radius(&self, shown: f64) -> f64 {
        let end = FACTOR_R2.sqrt();
        if shown >= end * self.factor(FACTOR_R2) {
            return shown / self.factor(FACTOR_R2);
        }
        let mut r = shown.min(end);
        for _ in 0..NEWTON_STEPS {
            let next = self.newton(r, shown);
            let step = next - r;
            r = next;
            if step.abs() < 1e-13 {
                break;
            }
        }
        r
    }

    /// A step of Newton's method towards the r with r·factor(r²) = `shown`.
    #[inline(always)]
    fn newton(&self, r: f64, shown: f64) -> f64 {
        let r2 = r * r;
        let slope = 1.0 + r2 * (3.0 * self.k1 + 5.0 * r2 * self.k2);
        let step = (r * self.factor(r2) - shown) / slope.max(1e-3);
        (r - step).clamp(0.0, FACTOR_R2.sqrt())
    }

    /// Newton steps after which every radius up to `shown` is within 1e-9 focal lengths.
    fn newton_steps(&self, shown: f64) -> usize {
        let needed = |shown: f64| {
            let exact = self.undistorted_radius(shown).min(FACTOR_R2.sqrt());
            let mut r = shown.min(FACTOR_R2.sqrt());
            for step in 0..NEWTON_STEPS {
                if (r - exact).abs() < 1e-9 {
                    return step;
                }
                r = self.newton(r, shown);
            }
            NEWTON_STEPS
        };
        // Slowest where the shown distance hardly grows any more: before the end, or never.
        let slowest = (FACTOR_R2.sqrt() * self.factor(FACTOR_R2)).min(shown);
        let radii = (1..=32).map(|k| shown * f64::from(k) / 32.0).chain((1..=8).map(|k| slowest * (1.0 - 0.1_f64.powi(k))));
        radii.map(needed).max().unwrap_or(NEWTON_STEPS).max(1)
    }
}

/// [`RadialDistortion`] in the pixels of one image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImageLens {
    lens: RadialDistortion,
    focal: f64,
    centre: f64,
    /// Newton steps that all its pixels together need; 0 where straight lines stay straight.
    steps: usize,
}

impl ImageLens {
    /// Of the images of a camera.
    pub fn new(lens: RadialDistortion, camera: &Camera, res: usize) -> Self {
        let (focal, centre) = (camera.focal_px(res), centre(res));
        let steps = if lens.is_none() { 0 } else { lens.newton_steps(centre * std::f64::consts::SQRT_2 / focal) };
        Self { lens, focal, centre, steps }
    }

    /// Whether straight lines stay straight.
    pub fn is_none(&self) -> bool {
        self.steps == 0
    }

    /// [`RadialDistortion::distort`].
    #[inline]
    pub fn distort(&self, (x, y): (f64, f64)) -> (f64, f64) {
        let (a, b) = ((x - self.centre) / self.focal, (y - self.centre) / self.focal);
        let factor = self.lens.factor(a * a + b * b);
        (self.centre + factor * (x - self.centre), self.centre + factor * (y - self.centre))
    }

    /// [`RadialDistortion::undistort`].
    #[inline]
    pub fn undistort(&self, (x, y): (f64, f64)) -> (f64, f64) {
        if self.steps == 0 {
            return (x, y);
        }
        let (a, b) = (x - self.centre, y - self.centre);
        let r = self.lens.undistorted_radius((a * a + b * b).sqrt() / self.focal);
        let factor = self.lens.factor(r * r);
        (self.centre + a / factor, self.centre + b / factor)
    }

    /// [`ImageLens::undistort`] for the pixels of a block, within 1e-6 pixels.
    #[inline(always)]
    pub fn undistort_block(&self, [x, y]: [&[f64; LANES]; 2]) -> [[f64; LANES]; 2] {
        if self.steps == 0 {
            return [*x, *y];
        }
        let end = FACTOR_R2.sqrt();
        let (mut shown, mut r) = ([0.0; LANES], [0.0; LANES]);
        for k in 0..LANES {
            let (a, b) = (x[k] - self.centre, y[k] - self.centre);
            shown[k] = (a * a + b * b).sqrt() / self.focal;
            r[k] = shown[k].min(end);
        }
        for _ in 0..self.steps {
            for k in 0..LANES {
                r[k] = self.lens.newton(r[k], shown[k]);
            }
        }
        let mut ideal = [[0.0; LANES]; 2];
        for k in 0..LANES {
            // Beyond the end, where the factor is constant, Newton's steps stop at the end too.
            let scale = 1.0 / self.lens.factor(r[k] * r[k]);
            ideal[0][k] = self.centre + (x[k] - self.centre) * scale;
            ideal[1][k] = self.centre + (y[k] - self.centre) * scale;
        }
        ideal
    }
}

/// Fall-off of light from the image centre to its corners.
///
/// # Source
/// The cos⁴ law of image irradiance, cos⁴θ = 1/(1 + tan²θ)², tan²θ growing with the squared distance from the centre; the
/// angle is free, so that stops and cover glasses that cut off more light than the law are covered too.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Vignetting {
    /// tan² of the angle that the image's corner stands for.
    corner: f32,
}

impl Vignetting {
    /// A lens that loses the given share of the light in the image's corners; 0 loses none.
    pub fn new(corner_loss: f32) -> Self {
        Self { corner: (1.0 - corner_loss).powf(-0.5) - 1.0 }
    }

    /// The share of light that reaches pixel (x, y) of an image of `res × res` pixels.
    #[inline]
    pub fn gain(&self, x: usize, y: usize, res: usize) -> f32 {
        let from_centre = |v: usize| v as f32 - 0.5 * (res as f32 - 1.0);
        let (x, y) = (from_centre(x), from_centre(y));
        // The outer corners of the corner pixels lie at distance res/√2.
        let r2 = (x * x + y * y) / (0.5 * (res * res) as f32);
        let cosine2 = 1.0 / (1.0 + self.corner * r2);
        cosine2 * cosine2
    }
}

fn centre(res: usize) -> f64 {
    (res as f64 - 1.0) / 2.0
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A camera whose focal length is 100 px at 100 px: tan(fov/2) = ½.
    fn camera() -> Camera {
        Camera::look_at([0.0, 0.0, 1.0], [0.0; 3], [0.0, 1.0, 0.0], 2.0 * 0.5_f64.atan())
    }

    #[test]
    fn a_known_pixel_is_moved_as_the_polynomial_says() {
        // Pixel (79.5, 49.5) lies 30 px = 0.3 focal lengths right of the centre: 30·(1 + 0.2·0.09 − 0.4·0.0081) = 30.4428.
        let lens = RadialDistortion { k1: 0.2, k2: -0.4 };
        let (x, y) = lens.distort(&camera(), (79.5, 49.5), 100);
        assert!((x - 79.9428).abs() < 1e-9 && (y - 49.5).abs() < 1e-9, "{x} {y}");
        // 3-4-5: the same distance along a diagonal.
        let (x, y) = lens.distort(&camera(), (49.5 - 24.0, 49.5 + 18.0), 100);
        assert!((x - (49.5 - 24.0 * 1.01476)).abs() < 1e-9 && (y - (49.5 + 18.0 * 1.01476)).abs() < 1e-9);
    }

    #[test]
    fn undistorting_is_the_inverse_up_to_the_limits_and_beyond_the_image() {
        for (k1, k2) in [(0.1, 0.05), (-0.1, -0.02), (-0.5, -0.5), (0.5, 0.5), (-0.5, 0.5), (0.5, -0.5)] {
            let lens = RadialDistortion { k1, k2 };
            for p in [(0.0, 0.0), (99.0, 0.0), (49.5, 49.5), (12.25, 71.5), (-20.0, 130.0)] {
                let (x, y) = lens.undistort(&camera(), p, 100);
                let back = lens.distort(&camera(), (x, y), 100);
                assert!((back.0 - p.0).abs() < 1e-6 && (back.1 - p.1).abs() < 1e-6, "{k1} {k2}: {p:?} {back:?}");
            }
        }
    }

    #[test]
    fn a_block_is_undistorted_like_its_pixels() {
        for (k1, k2) in [(0.0, 0.0), (0.08, -0.04), (-0.08, 0.04), (-0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)] {
            let lens = RadialDistortion { k1, k2 };
            let block = ImageLens::new(lens, &camera(), 100);
            for y in [0.0, 3.0, 49.0, 99.0] {
                for first in [0.0, 16.0, 84.0] {
                    let x = std::array::from_fn(|k| first + k as f64);
                    let [u, v] = block.undistort_block([&x, &[y; LANES]]);
                    for k in 0..LANES {
                        let (a, b) = lens.undistort(&camera(), (x[k], y), 100);
                        assert!((u[k] - a).abs() < 1e-6 && (v[k] - b).abs() < 1e-6, "{k1} {k2}: {} {y}", x[k]);
                    }
                }
            }
        }
    }

    #[test]
    fn no_point_far_outside_is_folded_into_the_image() {
        let lens = RadialDistortion { k1: -DISTORTION_LIMIT, k2: -DISTORTION_LIMIT };
        let mut last = 0.0;
        for step in 1..400 {
            let (x, _) = lens.distort(&camera(), (49.5 + f64::from(step), 49.5), 100);
            assert!(x >= last, "step {step}");
            last = x;
        }
    }

    #[test]
    fn without_coefficients_pixels_stay_bit_for_bit() {
        let lens = RadialDistortion::default();
        assert!(lens.is_none());
        assert_eq!(lens.undistort(&camera(), (13.1, 77.7), 100), (13.1, 77.7));
        assert_eq!(lens.distort(&camera(), (13.0, 77.0), 100), (13.0, 77.0));
        assert_eq!(RadialDistortion { k1: 0.3, k2: 0.1 }.undistort(&camera(), (0.0, 0.0), 1), (0.0, 0.0));
    }

    #[test]
    fn light_falls_from_the_centre_to_the_stated_loss_in_the_corner() {
        let lens = Vignetting::new(0.36);
        // The centre of a large image, and the corner to within its half pixel.
        assert!((lens.gain(500, 500, 1001) - 1.0).abs() < 1e-6);
        assert!((lens.gain(0, 0, 1001) - 0.64).abs() < 2e-3);
        // (1 − 0.36)^(−½) = 1.25: at the middle of an edge r² = ½, so 1/(1 + 0.125)².
        assert!((lens.gain(0, 500, 1001) - 0.790_12).abs() < 2e-3);
        let along: Vec<f32> = (500..1001).map(|x| lens.gain(x, 500, 1001)).collect();
        assert!(along.windows(2).all(|w| w[0] >= w[1]));
        assert_eq!(lens.gain(3, 10, 64), lens.gain(60, 53, 64));
    }

    #[test]
    fn a_lens_without_loss_and_an_image_of_one_pixel_keep_their_light() {
        for (x, y) in [(0, 0), (17, 3), (63, 63)] {
            assert_eq!(Vignetting::new(0.0).gain(x, y, 64), 1.0);
        }
        assert_eq!(Vignetting::new(0.9).gain(0, 0, 1), 1.0);
    }
}
