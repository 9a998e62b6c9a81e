//! Brightness that is linear in the slopes of the light's direction.

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};
use ops::planes::Planes;
use rayon::prelude::*;

use crate::align::photometric::{CAUCHY, residual_deviation};
use crate::align::size::Size;

/// A pixel takes part when it is seen under at least this many lights.
const FEWEST_LIGHTS: usize = 8;
/// A light nearer to the point's normal than this (as a slope) shines back as a highlight, which is anything but linear.
const HIGHLIGHT: f32 = 0.12;
/// Keeps the fit of a pixel that all lights reach from one side solvable, in units of one frame's weight.
const RIDGE: f32 = 1e-3;
/// Residuals of every so many pixels tell the deviation.
const DEVIATION_STRIDE: usize = 3;

/// What a pixel shows under slope u of the light: `[A, B_x, B_y]`; NaN where it can't be told.
pub(super) type Shading = [f32; 3];

/// The images at their places on one level.
pub(super) struct Samples {
    pub size: Size,
    /// Pixel of the level to position on the surface.
    pub to_surface: Matrix3<f32>,
    /// Position of the light and the image, NaN where unknown, of every node that takes part.
    pub nodes: Vec<([f32; 3], Vec<f32>)>,
}

/// The linear shading of every pixel, and how well it fits.
pub(super) struct Fit {
    pub shading: Vec<Shading>,
    /// Mean Cauchy loss of the residuals.
    pub loss: f64,
    /// Robust standard deviation of the residuals.
    pub deviation: f32,
}

impl Samples {
    /// Position of a pixel on the surface.
    fn position(&self, pixel: usize) -> [f32; 2] {
        let p = self.to_surface * Vector3::new((pixel % self.size.width) as f32, (pixel / self.size.width) as f32, 1.0);
        [p.x / p.z, p.y / p.z]
    }

    /// Slope of a light as seen from a position.
    fn slope([x, y]: [f32; 2], light: [f32; 3]) -> [f32; 2] {
        [(light[0] - x) / light[2], (light[1] - y) / light[2]]
    }

    /// The shading of every pixel, with Cauchy weights for residuals of the given deviation.
    pub fn fit(&self, deviation: f32) -> Fit {
        let width = self.size.width;
        let rows: Vec<(Vec<Shading>, f64, usize, Vec<f32>)> = (0..self.size.height)
            .into_par_iter()
            .map(|row| {
                let (mut loss, mut count, mut residuals) = (0.0, 0, Vec::new());
                let mut seen: Vec<[f32; 3]> = Vec::with_capacity(self.nodes.len());
                let fits = (row * width..(row + 1) * width).map(|pixel| {
                    let position = self.position(pixel);
                    seen.clear();
                    seen.extend(self.nodes.iter().filter_map(|(light, image)| {
                        let [u, v] = Self::slope(position, *light);
                        (!image[pixel].is_nan() && u.hypot(v) > HIGHLIGHT).then_some([u, v, image[pixel]])
                    }));
                    let Some(shading) = line(&seen, deviation) else { return [f32::NAN; 3] };
                    for [u, v, value] in &seen {
                        let residual = value - (shading[0] + shading[1] * u + shading[2] * v);
                        loss += f64::from((residual / (CAUCHY * deviation)).powi(2).ln_1p());
                        count += 1;
                        if pixel.is_multiple_of(DEVIATION_STRIDE) {
                            residuals.push(residual.abs());
                        }
                    }
                    shading
                });
                (fits.collect(), loss, count, residuals)
            })
            .collect();
        let count: usize = rows.iter().map(|r| r.2).sum();
        let loss = rows.iter().map(|r| r.1).sum::<f64>() / count.max(1) as f64;
        let mut residuals: Vec<f32> = rows.iter().flat_map(|r| r.3.iter().copied()).collect();
        Fit { shading: rows.into_iter().flat_map(|r| r.0).collect(), loss, deviation: residual_deviation(&mut residuals) }
    }

    /// What the guidance image would look like under a light.
    pub fn predicted(&self, shading: &[Shading], light: [f64; 3]) -> Planes {
        let light = light.map(|v| v as f32);
        let value = |(pixel, [a, bx, by]): (usize, &Shading)| {
            let [u, v] = Self::slope(self.position(pixel), light);
            a + bx * u + by * v
        };
        let data = shading.iter().enumerate().map(value).collect();
        Planes::from_vec(1, self.size.height, self.size.width, data)
    }
}

/// The line through samples (u, v, value) by iterated least squares with Cauchy weights; `None` for too few of them.
pub(super) fn line(samples: &[[f32; 3]], deviation: f32) -> Option<Shading> {
    if samples.len() < FEWEST_LIGHTS {
        return None;
    }
    let inverse = 1.0 / (CAUCHY * deviation);
    let mut found: Option<SVector<f32, 3>> = None;
    for _ in 0..if deviation.is_finite() { 3 } else { 1 } {
        let mut matrix = SMatrix::<f32, 3, 3>::from_diagonal(&SVector::from([0.0, RIDGE, RIDGE]));
        let mut vector = SVector::<f32, 3>::zeros();
        for &[u, v, value] in samples {
            let row = SVector::from([1.0, u, v]);
            let residual = found.map_or(0.0, |f| value - f.dot(&row));
            let weight = 1.0 / (1.0 + (residual * inverse).powi(2));
            matrix += row * row.transpose() * weight;
            vector += row * (weight * value);
        }
        found = Some(matrix.cholesky()?.solve(&vector));
    }
    found.map(Into::into)
}
