//! Where the material is seen and lit from: the random renderings of the losses (paper §6) and the fixed ones of the
//! evaluation (paper §8).
//!
//! A view looks at the maps themselves, not through a camera: the maps fill the plane z = 0 over [−1, 1]², pixel (row i,
//! column j) of h × w maps lies at x = (2j + 1)/w − 1, y = 1 − (2i + 1)/h.

use std::f32::consts::{PI, TAU};

use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};

use crate::direction::{dot, minus, scaled, unit};

/// Intensity of the loss renderings' light.
pub const LOSS_INTENSITY: f32 = 1.5 * PI;
/// Smallest wi.z by which the loss renderings are divided.
pub const LOSS_COSINE_MIN: f32 = 1e-3;
/// Distance of the evaluation's cameras: [−1, 1] fills a field of view of 30°, 1/tan 15°.
pub const EVALUATION_DISTANCE: f32 = 3.732_051;
/// Intensity of the evaluation's flash.
pub const EVALUATION_INTENSITY: f32 = 17.8;
/// Cone exponent of the evaluation's flash, e^1.6.
pub const EVALUATION_EXPONENT: f32 = 4.953_032_4;
/// Seed of the evaluation's nine random pairs.
pub const EVALUATION_SEED: u64 = 0x5eed_0018;

/// Where a camera or a light is.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Origin {
    /// At infinity: a unit direction, constant over the plane.
    Direction([f32; 3]),
    /// At a world position.
    Point([f32; 3]),
}

impl Origin {
    /// Unit direction from a point of the plane to the origin.
    #[inline(always)]
    pub fn from(&self, x: f32, y: f32) -> [f32; 3] {
        let (position, near) = self.position();
        unit([position[0] - near * x, position[1] - near * y, position[2]])
    }

    /// The position and 1, or the direction and 0: direction = unit(position − near · point).
    #[inline(always)]
    pub fn position(&self) -> ([f32; 3], f32) {
        match *self {
            Self::Direction(d) => (d, 0.0),
            Self::Point(p) => (p, 1.0),
        }
    }
}

/// How much light arrives.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Emission {
    /// The loss renderings: the given intensity without fall-off or cone, divided by max(wi.z, 1e-3) so that a flat matte
    /// surface has the same brightness from everywhere.
    Even {
        /// Irradiance perpendicular to wi, before the division.
        intensity: f32,
    },
    /// A flash aimed at the plane's centre: I·max(0, w·axis)^exponent / d². A light at infinity has d = 1 and no cone.
    Flash {
        /// I.
        intensity: f32,
        /// Exponent of the cone.
        exponent: f32,
    },
}

/// One rendering of the maps.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct View {
    /// Where it is seen from.
    pub camera: Origin,
    /// Where it is lit from.
    pub light: Origin,
    /// How much light arrives.
    pub emission: Emission,
}

impl View {
    /// A loss rendering.
    pub fn even(camera: Origin, light: Origin) -> Self {
        Self { camera, light, emission: Emission::Even { intensity: LOSS_INTENSITY } }
    }

    /// What BRDF · cosine is multiplied by at a point of the plane, given its direction to the light.
    #[inline(always)]
    pub fn irradiance(&self, wi: [f32; 3], x: f32, y: f32) -> f32 {
        match (self.emission, self.light) {
            (Emission::Even { intensity }, _) => intensity / wi[2].max(LOSS_COSINE_MIN),
            (Emission::Flash { intensity, .. }, Origin::Direction(_)) => intensity,
            (Emission::Flash { intensity, exponent }, Origin::Point(position)) => {
                flash_irradiance(intensity, exponent, position, wi, [x, y])
            }
        }
    }
}

/// A flash at `position` aimed at the plane's centre: I·max(0, w·axis)^exponent / d² at a point of the plane, given its
/// direction to the light.
#[inline(always)]
pub fn flash_irradiance(intensity: f32, exponent: f32, position: [f32; 3], wi: [f32; 3], point: [f32; 2]) -> f32 {
    let to_light = minus(position, [point[0], point[1], 0.0]);
    let cosine = dot(wi, unit(position)).max(0.0);
    intensity * crate::approximation::power(cosine, exponent) / dot(to_light, to_light).max(1e-12)
}

/// World (x, y) of a pixel of `height × width` maps.
#[inline(always)]
pub fn plane_point(row: usize, column: usize, height: usize, width: usize) -> (f32, f32) {
    (plane_x(column, width), plane_y(row, height))
}

/// World x of a column.
#[inline(always)]
pub fn plane_x(column: usize, width: usize) -> f32 {
    (2 * column + 1) as f32 / width as f32 - 1.0
}

/// World y of a row.
#[inline(always)]
pub fn plane_y(row: usize, height: usize) -> f32 {
    1.0 - (2 * row + 1) as f32 / height as f32
}

/// The fifteen random renderings of one training step (paper §6).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LossViews {
    /// Three diffuse ones, constant directions, and six around the mirror direction: the terms of L_r.
    pub rendering: Vec<View>,
    /// Six from above with the light at the camera: the terms of L_t.
    pub top: Vec<View>,
}

impl LossViews {
    /// Number of diffuse renderings.
    pub const DIFFUSE: usize = 3;
    /// Number of specular renderings.
    pub const SPECULAR: usize = 6;
    /// Number of top renderings.
    pub const TOP: usize = 6;

    /// Draws the views of one step.
    ///
    /// # Source
    /// Paper §6; Deschaintre et al. 2018, §4.3.
    pub fn draw(rng: &mut impl Rng) -> Self {
        let mut rendering: Vec<View> = (0..Self::DIFFUSE)
            .map(|_| View::even(Origin::Direction(oblique_direction(rng)), Origin::Direction(oblique_direction(rng))))
            .collect();
        rendering.extend((0..Self::SPECULAR).map(|_| Self::specular(rng)));
        Self { rendering, top: (0..Self::TOP).map(|_| Self::top(rng)).collect() }
    }

    /// The light stands in the mirror direction of the view, each at its own distance, both moved by one shift.
    fn specular(rng: &mut impl Rng) -> View {
        let view = oblique_direction(rng);
        let light = [-view[0], -view[1], view[2]];
        let shift: [f32; 2] = std::array::from_fn(|_| rng.random_range(-1.0..1.0));
        let mut place = |direction: [f32; 3]| {
            let normal: f32 = StandardNormal.sample(rng);
            let p = scaled(direction, (0.5 + 0.75 * normal).exp());
            Origin::Point([p[0] + shift[0], p[1] + shift[1], p[2]])
        };
        let camera = place(view);
        View::even(camera, place(light))
    }

    fn top(rng: &mut impl Rng) -> View {
        let fov = rng.random_range(25f32..35.0).to_radians();
        let xy: [f32; 2] = std::array::from_fn(|_| rng.random_range(-1.0..1.0));
        let origin = Origin::Point([xy[0], xy[1], 1.0 / (0.5 * fov).tan()]);
        View::even(origin, origin)
    }

    /// All fifteen views, those of L_r first.
    pub fn all(&self) -> impl Iterator<Item = &View> {
        self.rendering.iter().chain(&self.top)
    }
}

/// A direction with z = √(1 − r1), r1 ~ U[0.001, 0.9]: cosine-weighted, up to 71.6° from the normal.
fn oblique_direction(rng: &mut impl Rng) -> [f32; 3] {
    let r1: f32 = rng.random_range(0.001..0.9);
    let azimuth = rng.random_range(0.0..TAU);
    let sine = r1.sqrt();
    [sine * azimuth.cos(), sine * azimuth.sin(), (1.0 - r1).sqrt()]
}

/// The eighteen fixed renderings of the evaluation: one from the top, four sides at 22.5° and 45°, nine random pairs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EvaluationViews {
    /// In the order top, sides, random pairs.
    pub views: Vec<View>,
}

impl Default for EvaluationViews {
    fn default() -> Self {
        Self::standard()
    }
}

impl EvaluationViews {
    /// The set that every published figure of this project uses.
    pub fn standard() -> Self {
        let flash = Emission::Flash { intensity: EVALUATION_INTENSITY, exponent: EVALUATION_EXPONENT };
        let at = |d: [f32; 3]| Origin::Point(scaled(d, EVALUATION_DISTANCE));
        let lit_from_camera = |d| View { camera: at(d), light: at(d), emission: flash };
        let mut views = vec![lit_from_camera([0.0, 0.0, 1.0])];
        for tilt_deg in [22.5f32, 45.0] {
            let (sine, cosine) = tilt_deg.to_radians().sin_cos();
            for (x, y) in [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)] {
                views.push(lit_from_camera([sine * x, sine * y, cosine]));
            }
        }
        let mut rng = ChaCha8Rng::seed_from_u64(EVALUATION_SEED);
        views.extend((0..9).map(|_| {
            let camera = at(oblique_direction(&mut rng));
            View { camera, light: at(oblique_direction(&mut rng)), emission: flash }
        }));
        Self { views }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn loss_light_makes_a_flat_matte_surface_even() {
        let view = View::even(Origin::Direction([0.0, 0.0, 1.0]), Origin::Point([0.4, 0.1, 0.3]));
        for (x, y) in [(0.0, 0.0), (-0.9, 0.8)] {
            let wi = view.light.from(x, y);
            assert!((view.irradiance(wi, x, y) * wi[2] - 1.5 * PI).abs() < 1e-4);
        }
        // Grazing light is divided by no less than 0.001.
        assert!((view.irradiance([1.0, 0.0, 1e-5], 0.0, 0.0) / (1500.0 * PI) - 1.0).abs() < 1e-6);
    }

    #[test]
    fn evaluation_is_eighteen_views_with_a_falling_flash() {
        let views = EvaluationViews::standard().views;
        assert_eq!(views.len(), 18);
        let top = views[0].irradiance([0.0, 0.0, 1.0], 0.0, 0.0);
        assert!((top - 17.8 / 3.732f32.powi(2)).abs() < 1e-3);
        let wi = views[0].light.from(1.0, 0.0);
        let cosine = wi[2];
        let expected = 17.8 * cosine.powf(EVALUATION_EXPONENT) / (3.732f32.powi(2) + 1.0);
        assert!((views[0].irradiance(wi, 1.0, 0.0) - expected).abs() < 1e-3);
        assert!(views.iter().all(|v| matches!(v.camera, Origin::Point(p) if p[2] > 1.0)));
    }

    #[test]
    fn pixels_cover_the_plane_edge_to_edge() {
        assert_eq!(plane_point(0, 0, 2, 4), (-0.75, 0.5));
        assert_eq!(plane_point(1, 3, 2, 4), (0.75, -0.5));
    }
}
