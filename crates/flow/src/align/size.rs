//! Homographies between images that were resized, with one factor per axis (odd sizes don't halve evenly).

use nalgebra::Matrix3;
use ops::homography::Homography;
use ops::planes::Planes;

/// Height and width of an image in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Size {
    /// Rows.
    pub height: usize,
    /// Columns.
    pub width: usize,
}

impl Size {
    /// The size of an image.
    pub fn of(image: &Planes) -> Self {
        Self { height: image.height, width: image.width }
    }

    /// The size with the same proportions whose shorter side is `shorter`; never larger than `self`.
    pub fn limited(self, shorter: usize) -> Self {
        let side = self.height.min(self.width);
        if side <= shorter {
            return self;
        }
        let scale = |v: usize| ((v * shorter) as f64 / side as f64).round().max(1.0) as usize;
        Self { height: scale(self.height), width: scale(self.width) }
    }

    /// Maps pixel positions of an image of this size to those of the image resized to `to` (edges stay in place).
    pub fn resize_matrix(self, to: Self) -> Matrix3<f64> {
        let (sx, sy) = (to.width as f64 / self.width as f64, to.height as f64 / self.height as f64);
        Matrix3::new(sx, 0.0, 0.5 * sx - 0.5, 0.0, sy, 0.5 * sy - 0.5, 0.0, 0.0, 1.0)
    }

    /// Whether a position lies between the outermost pixel centres.
    pub fn contains(self, (x, y): (f64, f64)) -> bool {
        x >= 0.0 && y >= 0.0 && x <= self.width as f64 - 1.0 && y <= self.height as f64 - 1.0
    }

    /// A regular grid of about `side × side` positions, half a cell away from the border.
    pub fn grid(self, side: usize) -> impl Iterator<Item = (f64, f64)> {
        let step = move |n: usize, i: usize| (i as f64 + 0.5) * n as f64 / side as f64 - 0.5;
        (0..side * side).map(move |i| (step(self.width, i % side), step(self.height, i / side)))
    }
}

/// `homography` between a target resized from `target.0` to `target.1` and a source resized from `source.0` to `source.1`.
pub fn resized(homography: &Homography, target: (Size, Size), source: (Size, Size)) -> Homography {
    let back = target.1.resize_matrix(target.0);
    Homography::new(source.0.resize_matrix(source.1) * homography.matrix * back)
}

/// The share of a target's positions that `homography` maps into a source.
pub fn overlap(homography: &Homography, target: Size, source: Size) -> f64 {
    const SIDE: usize = 24;
    let inside = target.grid(SIDE).filter(|&(x, y)| homography.apply(x, y).is_some_and(|p| source.contains(p))).count();
    inside as f64 / (SIDE * SIDE) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn resizing_agrees_with_the_uniform_scale_and_undoes_itself() {
        let h = Homography::new(Matrix3::new(1.1, 0.02, -7.0, -0.03, 0.95, 4.0, 1e-4, -2e-4, 1.0));
        let (full, half) = (Size { height: 64, width: 48 }, Size { height: 32, width: 24 });
        let small = resized(&h, (full, half), (full, half));
        assert!((small.matrix - h.scaled(0.5, 0.5).matrix).norm() < 1e-12);
        let odd = Size { height: 21, width: 31 };
        let back = resized(&resized(&h, (full, odd), (full, half)), (odd, full), (half, full));
        assert!((back.matrix - h.matrix).norm() < 1e-9);
    }

    #[test]
    fn overlap_of_a_shift_is_the_remaining_share() {
        let size = Size { height: 48, width: 48 };
        assert_eq!(overlap(&Homography::identity(), size, size), 1.0);
        assert!((overlap(&Homography::translation(12.0, 0.0), size, size) - 0.75).abs() < 0.05);
        assert_eq!(overlap(&Homography::translation(100.0, 0.0), size, size), 0.0);
        assert_eq!(Size { height: 1080, width: 1920 }.limited(256), Size { height: 256, width: 455 });
        assert_eq!(size.limited(256), size);
    }
}
