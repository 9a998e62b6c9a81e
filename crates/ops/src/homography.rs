//! Plane-to-plane maps between images of a flat material (exact for a planar sample, paper §5).

use nalgebra::Matrix3;
use rayon::prelude::*;

use crate::planes::{Mask, Planes};

/// Maps a **target** pixel to the **source** pixel that shows the same surface point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Homography {
    /// The 3×3 matrix on homogeneous (x, y, 1), pixel centres at integers.
    pub matrix: Matrix3<f64>,
}

impl Homography {
    /// Every pixel maps to itself.
    pub fn identity() -> Self {
        Self { matrix: Matrix3::identity() }
    }

    /// Wraps a matrix, scaled so that its last entry is 1 where that is possible.
    pub fn new(matrix: Matrix3<f64>) -> Self {
        let last = matrix[(2, 2)];
        Self { matrix: if last.abs() > 1e-12 { matrix / last } else { matrix } }
    }

    /// A shift by (x, y) pixels.
    pub fn translation(x: f64, y: f64) -> Self {
        Self { matrix: Matrix3::new(1.0, 0.0, x, 0.0, 1.0, y, 0.0, 0.0, 1.0) }
    }

    /// The source position of target position (x, y); `None` at or behind the horizon.
    #[inline]
    pub fn apply(&self, x: f64, y: f64) -> Option<(f64, f64)> {
        let m = &self.matrix;
        let w = m[(2, 0)] * x + m[(2, 1)] * y + m[(2, 2)];
        let mapped = ((m[(0, 0)] * x + m[(0, 1)] * y + m[(0, 2)]) / w, (m[(1, 0)] * x + m[(1, 1)] * y + m[(1, 2)]) / w);
        (w > 1e-9).then_some(mapped)
    }

    /// Source pixel to target pixel; `None` for a singular matrix.
    pub fn inverse(&self) -> Option<Self> {
        self.matrix.try_inverse().map(Self::new)
    }

    /// `self ∘ first`: maps by `first`, then by `self`.
    pub fn after(&self, first: &Self) -> Self {
        Self::new(self.matrix * first.matrix)
    }

    /// The same map between resized images: the target is `target_factor` times as large, the source `source_factor` times.
    pub fn scaled(&self, target_factor: f64, source_factor: f64) -> Self {
        // Pixel centres at integers: x' = s·(x + ½) − ½ keeps the images' edges in place.
        let resize = |s: f64| Matrix3::new(s, 0.0, 0.5 * s - 0.5, 0.0, s, 0.5 * s - 0.5, 0.0, 0.0, 1.0);
        let to_original = resize(1.0 / target_factor);
        Self::new(resize(source_factor) * self.matrix * to_original)
    }

    /// The dense backward flow of a `height × width` target: 2 planes (x, y) in pixels. Positions behind the horizon get NaN,
    /// which every consumer treats as invalid.
    pub fn flow(&self, height: usize, width: usize) -> Planes {
        let mut flow = Planes::new(2, height, width);
        let (xs, ys) = flow.data.split_at_mut(height * width);
        xs.par_chunks_mut(width).zip(ys.par_chunks_mut(width)).enumerate().for_each(|(y, (row_x, row_y))| {
            for x in 0..width {
                let (sx, sy) = self.apply(x as f64, y as f64).unwrap_or((f64::NAN, f64::NAN));
                row_x[x] = (sx - x as f64) as f32;
                row_y[x] = (sy - y as f64) as f32;
            }
        });
        flow
    }

    /// The target pixels whose source position lies inside a `source_height × source_width` image (all bilinear taps inside).
    pub fn valid(&self, height: usize, width: usize, source_height: usize, source_width: usize) -> Mask {
        Mask::from_fn(height, width, |y, x| {
            self.apply(x as f64, y as f64).is_some_and(|(sx, sy)| {
                sx >= 0.0 && sy >= 0.0 && sx <= (source_width - 1) as f64 && sy <= (source_height - 1) as f64
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tilted() -> Homography {
        Homography::new(Matrix3::new(1.1, 0.02, -7.0, -0.03, 0.95, 4.0, 1e-4, -2e-4, 1.0))
    }

    #[test]
    fn inverse_and_composition_are_consistent() {
        let h = tilted();
        let back = h.inverse().unwrap().after(&h);
        let (x, y) = back.apply(123.0, 45.0).unwrap();
        assert!((x - 123.0).abs() < 1e-9 && (y - 45.0).abs() < 1e-9);
        assert!(Homography::new(Matrix3::zeros()).inverse().is_none());
    }

    #[test]
    fn flow_and_validity_follow_the_map() {
        let h = tilted();
        let flow = h.flow(20, 30);
        let (sx, sy) = h.apply(17.0, 11.0).unwrap();
        assert!((f64::from(flow.at(0, 11, 17)) - (sx - 17.0)).abs() < 1e-5);
        assert!((f64::from(flow.at(1, 11, 17)) - (sy - 11.0)).abs() < 1e-5);
        let valid = Homography::translation(2.0, 0.0).valid(4, 10, 4, 10);
        assert!(valid.at(0, 7) && !valid.at(0, 8));
        assert_eq!(valid.count(), 4 * 8);
    }

    #[test]
    fn scaling_keeps_surface_points_together() {
        // The centre of a 2× larger image's upper-left block of 2×2 pixels is the old pixel centre.
        let (x, y) = Homography::identity().scaled(2.0, 1.0).apply(0.5, 0.5).unwrap();
        assert!(x.abs() < 1e-12 && y.abs() < 1e-12);
        let h = tilted();
        let (x, y) = h.scaled(4.0, 4.0).apply(4.0 * 10.0 + 1.5, 4.0 * 20.0 + 1.5).unwrap();
        let (sx, sy) = h.apply(10.0, 20.0).unwrap();
        assert!((x - (4.0 * sx + 1.5)).abs() < 1e-9 && (y - (4.0 * sy + 1.5)).abs() < 1e-9);
    }
}
