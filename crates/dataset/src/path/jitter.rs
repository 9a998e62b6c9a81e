//! The hand's deviations from a template: a damped, sprung random walk that is pushed in its acceleration (Eqs. 1–4).

use rand::Rng;
use rand_distr::{Distribution, StandardNormal};

/// Strengths of one component's perturbation (a column of Table 1).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Strengths {
    /// λ: standard deviation of the push on the acceleration.
    pub push: f64,
    /// λᵛ: how much of the last frame's velocity is taken away (damping).
    pub velocity: f64,
    /// λᵖ: how strongly the last frame's deviation pulls back (spring).
    pub position: f64,
}

/// Table 1, columns c_x and c_y; over the 141 frames of a video the standard deviation is 0.0050.
pub const POSITION_XY: Strengths = Strengths { push: 0.001, velocity: 0.1, position: 0.2 };

/// Table 1, columns c_z, l_x, l_y and t; over the 141 frames of a video the standard deviation is 0.0155
/// (hardly damped, it would go on growing to 0.0226 in videos without end).
pub const HEIGHT_AND_VIEW: Strengths = Strengths { push: 0.001, velocity: 0.01, position: 0.1 };

/// The perturbation of one component over the frames of a video; it starts at rest on the template.
#[derive(Clone, Copy, Debug)]
pub struct Jitter {
    strengths: Strengths,
    velocity: f64,
    deviation: f64,
}

impl Jitter {
    /// A component at rest.
    pub fn new(strengths: Strengths) -> Self {
        Self { strengths, velocity: 0.0, deviation: 0.0 }
    }

    /// The deviation of the present frame.
    pub fn deviation(&self) -> f64 {
        self.deviation
    }

    /// Goes on to the next frame and returns its deviation; `scale` multiplies λ (Table 5, "deviations").
    pub fn step(&mut self, scale: f64, rng: &mut impl Rng) -> f64 {
        let Strengths { push, velocity, position } = self.strengths;
        let normal: f64 = StandardNormal.sample(rng);
        let acceleration = scale * push * normal - velocity * self.velocity - position * self.deviation; // Eq. 1
        self.velocity += acceleration; // Eq. 2
        self.deviation += self.velocity; // Eq. 3; Eq. 4 adds it to the component
        self.deviation
    }
}

/// The deviations of all six components of a camera, in the order of Table 1.
#[derive(Clone, Copy, Debug)]
pub struct CameraJitter {
    components: [Jitter; 6],
}

/// What [`CameraJitter`] adds to a frame's camera.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Deviation {
    /// Camera position (c_x, c_y, c_z), world units.
    pub position: [f64; 3],
    /// Look-at point (l_x, l_y) relative to the point under the camera, world units.
    pub look_at: [f64; 2],
    /// t: the up direction is (t, 1, 0).
    pub tilt: f64,
}

impl CameraJitter {
    /// A camera at rest on the template.
    pub fn at_rest() -> Self {
        let strengths = [POSITION_XY, POSITION_XY, HEIGHT_AND_VIEW, HEIGHT_AND_VIEW, HEIGHT_AND_VIEW, HEIGHT_AND_VIEW];
        Self { components: strengths.map(Jitter::new) }
    }

    /// Goes on to the next frame.
    pub fn step(&mut self, scale: f64, rng: &mut impl Rng) -> Deviation {
        let mut d = [0.0; 6];
        for (deviation, component) in d.iter_mut().zip(&mut self.components) {
            *deviation = component.step(scale, rng);
        }
        Deviation { position: [d[0], d[1], d[2]], look_at: [d[3], d[4]], tilt: d[5] }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    /// Standard deviation over all frames of many 141-frame videos that start at rest on the template.
    fn video_deviation(strengths: Strengths, scale: f64) -> f64 {
        let mut rng = ChaCha8Rng::seed_from_u64(11);
        let (videos, frames) = (6000, 141);
        let mut squares = 0.0;
        for _ in 0..videos {
            let mut jitter = Jitter::new(strengths);
            squares += (1..frames).map(|_| jitter.step(scale, &mut rng).powi(2)).sum::<f64>();
        }
        (squares / f64::from(videos * frames)).sqrt()
    }

    #[test]
    fn deviations_of_a_video_are_those_of_table_1() {
        for (strengths, expected) in [(POSITION_XY, 0.0050), (HEIGHT_AND_VIEW, 0.0155)] {
            let found = video_deviation(strengths, 1.0);
            assert!((found / expected - 1.0).abs() < 0.03, "{strengths:?}: {found} instead of {expected}");
        }
    }

    /// An autoregression of second order has the variance (1 − φ₂)/((1 + φ₂)((1 − φ₂)² − φ₁²)).
    #[test]
    fn without_end_the_deviation_settles_at_its_analytic_value() {
        for strengths in [POSITION_XY, HEIGHT_AND_VIEW] {
            let (phi1, phi2) = (2.0 - strengths.velocity - strengths.position, strengths.velocity - 1.0);
            let expected = 0.001 * ((1.0 - phi2) / ((1.0 + phi2) * ((1.0 - phi2).powi(2) - phi1 * phi1))).sqrt();
            let mut rng = ChaCha8Rng::seed_from_u64(12);
            let mut jitter = Jitter::new(strengths);
            let squares: f64 = (0..1_000_000).map(|_| jitter.step(1.0, &mut rng).powi(2)).sum();
            let found = (squares / 1e6).sqrt();
            assert!((found / expected - 1.0).abs() < 0.03, "{strengths:?}: {found} instead of {expected}");
        }
    }

    #[test]
    fn the_scale_multiplies_the_deviation_and_zero_leaves_the_template() {
        let (once, twice) = (video_deviation(POSITION_XY, 1.0), video_deviation(POSITION_XY, 2.0));
        assert!((twice / once - 2.0).abs() < 1e-9);
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        assert_eq!(CameraJitter::at_rest().step(0.0, &mut rng), Deviation::default());
    }

    /// Eqs. 1–3 by hand: with a push of n₁ and n₂ the second deviation is λ(n₂ + (2 − λv − λp)·n₁).
    #[test]
    fn the_first_two_steps_follow_the_equations() {
        let (mut rng, mut twin) = (ChaCha8Rng::seed_from_u64(5), ChaCha8Rng::seed_from_u64(5));
        let normals: [f64; 2] = std::array::from_fn(|_| StandardNormal.sample(&mut twin));
        let mut jitter = Jitter::new(POSITION_XY);
        assert!((jitter.step(1.0, &mut rng) - 0.001 * normals[0]).abs() < 1e-15);
        let second = 0.001 * (normals[1] + (2.0 - 0.1 - 0.2) * normals[0]);
        assert!((jitter.step(1.0, &mut rng) - second).abs() < 1e-15);
    }
}
