//! An image at smaller densities, each made from the next finer halving instead of from all pixels.

use ops::planes::Planes;

use super::super::size::Size;

/// Halvings end before a side becomes shorter than this, in pixels.
const SMALLEST_SIDE: usize = 16;

/// An image and its halvings.
pub(super) struct Densities<'a> {
    image: &'a Planes,
    /// The finest first.
    halvings: Vec<Planes>,
}

impl<'a> Densities<'a> {
    pub fn new(image: &'a Planes) -> Self {
        let mut halvings: Vec<Planes> = Vec::new();
        loop {
            let last = halvings.last().unwrap_or(image);
            if last.height.min(last.width) / 2 < SMALLEST_SIDE {
                return Self { image, halvings };
            }
            halvings.push(last.resize_area(last.height / 2, last.width / 2));
        }
    }

    /// Of the image itself.
    pub fn size(&self) -> Size {
        Size::of(self.image)
    }

    /// The whole image, with that many of its pixels per pixel along a side.
    pub fn shrunk(&self, factor: f64) -> Planes {
        let side = |v: usize| ((v as f64 / factor).round() as usize).max(1);
        let Size { height, width } = self.size();
        self.resized([0.0, height as f64, 0.0, width as f64], Size { height: side(height), width: side(width) }).0
    }

    /// The part between rows and columns `[y0, y1, x0, x1]` (edges, in pixels of the image, inside it) at about the size `to`,
    /// and the edges of the part that was taken, which are whole pixels of a halving.
    pub fn resized(&self, [y0, y1, x0, x1]: [f64; 4], to: Size) -> (Planes, [f64; 4]) {
        let factor = ((y1 - y0) / to.height as f64).min((x1 - x0) / to.width as f64).max(1.0);
        let level = (factor.log2().floor() as usize).min(self.halvings.len());
        let (image, full) = (level.checked_sub(1).map_or(self.image, |l| &self.halvings[l]), self.size());
        let (fy, fx) = (full.height as f64 / image.height as f64, full.width as f64 / image.width as f64);
        let cut = |low: f64, high: f64, step: f64, length: usize| {
            let first = ((low / step).floor().max(0.0) as usize).min(length - 1);
            (first, ((high / step).ceil() as usize).clamp(first + 1, length))
        };
        let ((top, bottom), (left, right)) = (cut(y0, y1, fy, image.height), cut(x0, x1, fx, image.width));
        let part = image.crop(top, left, bottom - top, right - left);
        let smaller = to.height <= part.height && to.width <= part.width;
        let part = if smaller { part.resize_area(to.height, to.width) } else { part.resize_bilinear(to.height, to.width) };
        (part, [top as f64 * fy, bottom as f64 * fy, left as f64 * fx, right as f64 * fx])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_lie_where_they_say() {
        // Brightness is the position: x/100 + y/1000, at pixel centres.
        let data = (0..60).flat_map(|y| (0..100).map(move |x| x as f32 / 100.0 + y as f32 / 1000.0));
        let plane: Vec<f32> = data.collect();
        let image = Planes::from_vec(1, 60, 100, plane);
        let densities = Densities::new(&image);
        for (edges, to) in
            [([0.0, 60.0, 0.0, 100.0], (30, 50)), ([11.0, 41.0, 20.0, 70.0], (10, 15)), ([5.0, 15.0, 7.0, 17.0], (40, 40))]
        {
            let (part, [y0, y1, x0, x1]) = densities.resized(edges, Size { height: to.0, width: to.1 });
            assert_eq!((part.height, part.width), to);
            assert!(
                y0 <= edges[0] && y1 >= edges[1] && x0 <= edges[2] && x1 >= edges[3] && y1 - y0 < edges[1] - edges[0] + 8.0
            );
            let (y, x) = (to.0 / 2, to.1 / 2);
            let at = |low: f64, high: f64, i: usize, n: usize| low + (i as f64 + 0.5) * (high - low) / n as f64 - 0.5;
            let expected = at(x0, x1, x, to.1) / 100.0 + at(y0, y1, y, to.0) / 1000.0;
            assert!((f64::from(part.at(0, y, x)) - expected).abs() < 2e-3, "{edges:?}: {} {expected}", part.at(0, y, x));
        }
        let half = densities.shrunk(2.0);
        assert_eq!((half.height, half.width), (30, 50));
    }
}
