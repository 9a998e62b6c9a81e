//! What a point shows as a function of the slopes u of the light's direction.
//!
//! With light and camera at one place what a flat point shows depends on |u| alone: a term in |u|² takes the part of highlight
//! and falloff. The brightness of a slope is linear in u besides; its colour isn't.

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
/// The same for |u|²: gloss is taken from lights at many slopes, and from few hardly told apart from relief.
const GLOSS_RIDGE: f32 = 0.02;
/// Residuals of every so many pixels tell the deviation.
const DEVIATION_STRIDE: usize = 3;

/// What a pixel's terms are multiplied with; NaN where that can't be told.
pub(super) type Shading<const N: usize> = SVector<f32, N>;

/// Terms of the brightness A + B·u + C|u|².
pub(super) fn brightness(u: f32, v: f32) -> Shading<4> {
    Shading::from([1.0, u, v, u * u + v * v])
}

/// Terms of the colour A + C|u|².
pub(super) fn colour(u: f32, v: f32) -> Shading<2> {
    Shading::from([1.0, u * u + v * v])
}

/// The images at their places on one level.
pub(super) struct Samples {
    pub size: Size,
    /// Pixel of the level to position on the surface.
    pub to_surface: Matrix3<f32>,
    /// Position of the light and the image, NaN where unknown, of every node that takes part.
    pub nodes: Vec<([f32; 3], Vec<f32>)>,
}

/// The shading of every pixel, and how well it fits.
pub(super) struct Fit<const N: usize> {
    pub shading: Vec<Shading<N>>,
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
    pub fn fit<const N: usize>(&self, terms: fn(f32, f32) -> Shading<N>, deviation: f32) -> Fit<N> {
        let width = self.size.width;
        let rows: Vec<(Vec<Shading<N>>, f64, usize, Vec<f32>)> = (0..self.size.height)
            .into_par_iter()
            .map(|row| {
                let (mut loss, mut count, mut residuals) = (0.0, 0, Vec::new());
                let mut seen: Vec<(Shading<N>, f32)> = Vec::with_capacity(self.nodes.len());
                let fits = (row * width..(row + 1) * width).map(|pixel| {
                    let position = self.position(pixel);
                    seen.clear();
                    seen.extend(self.nodes.iter().filter_map(|(light, image)| {
                        let [u, v] = Self::slope(position, *light);
                        (!image[pixel].is_nan() && u.hypot(v) > HIGHLIGHT).then(|| (terms(u, v), image[pixel]))
                    }));
                    let Some(shading) = solve(&seen, deviation) else { return Shading::from([f32::NAN; N]) };
                    for (terms, value) in &seen {
                        let residual = value - shading.dot(terms);
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
    pub fn predicted(&self, shading: &[Shading<4>], light: [f64; 3]) -> Planes {
        let light = light.map(|v| v as f32);
        let value = |(pixel, shading): (usize, &Shading<4>)| {
            let [u, v] = Self::slope(self.position(pixel), light);
            shading.dot(&brightness(u, v))
        };
        let data = shading.iter().enumerate().map(value).collect();
        Planes::from_vec(1, self.size.height, self.size.width, data)
    }
}

/// The shading through samples (terms, value) by iterated least squares with Cauchy weights; `None` for too few of them.
pub(super) fn solve<const N: usize>(samples: &[(Shading<N>, f32)], deviation: f32) -> Option<Shading<N>> {
    if samples.len() < FEWEST_LIGHTS {
        return None;
    }
    let inverse = 1.0 / (CAUCHY * deviation);
    let mut found: Option<Shading<N>> = None;
    for _ in 0..if deviation.is_finite() { 3 } else { 1 } {
        let mut matrix = SMatrix::<f32, N, N>::from_diagonal_element(RIDGE);
        matrix[(0, 0)] = 0.0;
        matrix[(N - 1, N - 1)] = GLOSS_RIDGE;
        let mut vector = Shading::<N>::zeros();
        for (terms, value) in samples {
            let residual = found.map_or(0.0, |f| value - f.dot(terms));
            let weight = 1.0 / (1.0 + (residual * inverse).powi(2));
            matrix += terms * terms.transpose() * weight;
            vector += terms * (weight * value);
        }
        found = Some(matrix.cholesky()?.solve(&vector));
    }
    found
}
