//! Outlines of the foreground shapes: ellipses, polygons and blobs, as signed distances for antialiased edges.

use rand::{Rng, RngExt};

/// A closed outline around (0, 0), in pixels of the first image.
#[derive(Clone, Debug, PartialEq)]
pub enum Outline {
    /// Half axes.
    Ellipse([f32; 2]),
    /// Corners in order; star-shaped around the origin.
    Polygon(Vec<[f32; 2]>),
    /// A circle whose radius swings: mean radius, then (relative amplitude, phase) of the harmonics 2, 3, 4 …
    Blob(f32, Vec<[f32; 2]>),
}

impl Outline {
    /// Draws one of the three kinds with the given mean radius.
    pub fn draw(radius: f32, rng: &mut impl Rng) -> Self {
        match rng.random_range(0..3) {
            0 => {
                let stretch: f32 = rng.random_range(0.6..1.6);
                Self::Ellipse([radius * stretch.sqrt(), radius / stretch.sqrt()])
            }
            1 => {
                let corners = rng.random_range(3..=9);
                let turn = std::f32::consts::TAU / corners as f32;
                let corner = |k: usize, rng: &mut dyn FnMut() -> [f32; 2]| {
                    let [angle, length] = rng();
                    let angle = turn * (k as f32 + angle);
                    [radius * length * angle.cos(), radius * length * angle.sin()]
                };
                let mut draw = || [rng.random_range(-0.3..0.3), rng.random_range(0.55..1.45)];
                Self::Polygon((0..corners).map(|k| corner(k, &mut draw)).collect())
            }
            _ => {
                let harmonics = rng.random_range(2..=6);
                let wave = |k: usize, rng: &mut dyn FnMut(f32) -> f32| [rng(0.35 / k as f32), rng(std::f32::consts::PI)];
                let mut draw = |limit: f32| rng.random_range(-limit..limit);
                Self::Blob(radius, (1..=harmonics).map(|k| wave(k, &mut draw)).collect())
            }
        }
    }

    /// Distance to the outline, negative inside. Exact for polygons, first order near the outline for the others, which is
    /// where it decides an edge pixel's coverage.
    pub fn distance(&self, x: f32, y: f32) -> f32 {
        match self {
            Self::Ellipse([a, b]) => {
                let (u, v) = (x / a, y / b);
                let length = (u * u + v * v).sqrt();
                let gradient = ((u / a).powi(2) + (v / b).powi(2)).sqrt();
                if gradient > 0.0 { (length - 1.0) * length / gradient } else { -a.min(*b) }
            }
            Self::Polygon(corners) => polygon_distance(corners, x, y),
            Self::Blob(radius, waves) => {
                let angle = y.atan2(x);
                let (mut factor, mut slope) = (1.0f32, 0.0f32);
                for (k, [amplitude, phase]) in waves.iter().enumerate() {
                    let order = (k + 2) as f32;
                    factor += amplitude * (order * angle + phase).cos();
                    slope -= amplitude * order * (order * angle + phase).sin();
                }
                let factor = factor.max(0.2);
                ((x * x + y * y).sqrt() - radius * factor) / (1.0 + (slope / factor).powi(2)).sqrt()
            }
        }
    }

    /// A radius that holds the whole outline.
    pub fn reach(&self) -> f32 {
        match self {
            Self::Ellipse([a, b]) => a.max(*b),
            Self::Polygon(corners) => corners.iter().map(|[x, y]| x.hypot(*y)).fold(0.0, f32::max),
            Self::Blob(radius, waves) => radius * (1.0 + waves.iter().map(|w| w[0].abs()).sum::<f32>()),
        }
    }
}

fn polygon_distance(corners: &[[f32; 2]], x: f32, y: f32) -> f32 {
    let mut nearest = f32::INFINITY;
    let mut inside = false;
    for (k, &[ax, ay]) in corners.iter().enumerate() {
        let [bx, by] = corners[(k + 1) % corners.len()];
        let (ex, ey, px, py) = (bx - ax, by - ay, x - ax, y - ay);
        let along = ((px * ex + py * ey) / (ex * ex + ey * ey).max(1e-12)).clamp(0.0, 1.0);
        nearest = nearest.min((px - along * ex).hypot(py - along * ey));
        // Even-odd rule: does a ray to the right cross this edge?
        if (ay > y) != (by > y) && x < ax + (y - ay) / (by - ay) * ex {
            inside = !inside;
        }
    }
    if inside { -nearest } else { nearest }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn distances_are_right_where_they_are_known() {
        let circle = Outline::Ellipse([5.0, 5.0]);
        assert!((circle.distance(8.0, 0.0) - 3.0).abs() < 1e-4 && circle.distance(0.0, 0.0) < -4.9);
        let square = Outline::Polygon(vec![[-2.0, -2.0], [2.0, -2.0], [2.0, 2.0], [-2.0, 2.0]]);
        assert_eq!((square.distance(0.0, 0.5), square.distance(5.0, 6.0)), (-1.5, 5.0));
        let blob = Outline::Blob(4.0, vec![]);
        assert!((blob.distance(0.0, 7.0) - 3.0).abs() < 1e-5);
    }

    #[test]
    fn every_outline_changes_sign_once_and_stays_within_its_reach() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        for _ in 0..60 {
            let outline = Outline::draw(20.0, &mut rng);
            let reach = outline.reach();
            assert!((10.0..60.0).contains(&reach), "{outline:?}");
            for step in 0..24 {
                let angle = step as f32 / 24.0 * std::f32::consts::TAU;
                let at = |r: f32| outline.distance(r * angle.cos(), r * angle.sin());
                assert!(at(0.5) < 0.0 && at(reach + 0.5) > 0.0, "{outline:?}");
            }
        }
    }
}
