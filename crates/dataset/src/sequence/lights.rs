//! The lights of one video (§4): a flash at the camera, and for the flow nets a second light that doesn't move.

use rand::{Rng, RngExt};
use rand_distr::{Distribution, LogNormal};
use render::camera::Camera;
use render::environment::Environment;
use render::light::Light;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::environment::EnvironmentMaps;

/// Intensity of the flash at the reference height (§4).
const INTENSITY: f64 = 0.1;
/// The height d0 at which the flash has its reference intensity.
const REFERENCE_HEIGHT: f64 = 0.28;
/// Mean and standard deviation of ln e, the exponent of the flash's cone.
const EXPONENT_LOG: (f64, f64) = (1.6, 0.35);
/// Standard deviation of the logarithm of the flash's random factor in flow sequences.
const FACTOR_LOG_SPREAD: f64 = 0.3;
/// Median and log spread of the second light's distance.
const SECOND_DISTANCE: (f64, f64) = (2.25, 0.2);
/// Median and log spread of the second light's intensity.
const SECOND_INTENSITY: (f64, f64) = (0.1, 0.2);
/// Least z of the direction to the second light: it shines from above, never grazing.
const SECOND_LEAST_Z: f64 = 0.3;
/// Directional lights that stand for an environment.
const ENVIRONMENT_LIGHTS: usize = 8;

/// How a video is lit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Lighting {
    /// The SVBRDF net's: only the flash, I = 0.1·(d0/0.28)², so that every height is exposed alike.
    #[default]
    Svbrdf,
    /// The flow nets', as the paper's code has it: I = 0.1 times a random factor, and a second, resting light.
    Flow,
    /// As `flow`, with the flash of `svbrdf` under the random factor: low cameras aren't over-exposed.
    FlowExposed,
}

/// What the lights of a video are drawn from.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct LightConfig {
    /// Flash and second light.
    pub kind: Lighting,
    /// Range of the environment's irradiance as a share of the flash's at the frame centre (Table 5: 0.01 to 0.2);
    /// \[0, 0\] is the paper's dark room.
    #[schemars(extend("unit" = "share of the flash"))]
    pub ambient: [f64; 2],
    /// Where environments come from when there is `ambient` light: a lat-long EXR or Radiance HDR file, or a folder of such
    /// (z up), each turned at random; generated skies when empty.
    pub environments: EnvironmentMaps,
}

/// The lights of one video. The flash moves with the camera, the others rest.
#[derive(Clone, Debug, PartialEq)]
pub struct VideoLights {
    /// I of the flash.
    pub intensity: f32,
    /// e, exponent of the flash's cone.
    pub exponent: f32,
    /// Second light and environment.
    pub resting: Vec<Light>,
}

impl VideoLights {
    /// Draws the lights of a video whose camera hovers at `height` (d0).
    ///
    /// # Panics
    /// If environment files can't be read: [`EnvironmentMaps::load`] says so before.
    pub fn draw(config: &LightConfig, height: f64, rng: &mut impl Rng) -> Self {
        let exponent = log_normal(EXPONENT_LOG.0.exp(), EXPONENT_LOG.1, rng);
        let factor = log_normal(1.0, FACTOR_LOG_SPREAD, rng);
        let second = second_light(rng);
        let by_height = INTENSITY * (height / REFERENCE_HEIGHT).powi(2);
        let (intensity, mut resting) = match config.kind {
            Lighting::Svbrdf => (by_height, vec![]),
            Lighting::Flow => (INTENSITY * factor, vec![second]),
            Lighting::FlowExposed => (by_height * factor, vec![second]),
        };
        let [low, high] = config.ambient;
        let ambient = low + rng.random_range(0.0..=1.0) * (high - low);
        if ambient > 0.0 {
            let irradiance = (ambient * intensity / (height * height)) as f32;
            let environment = config.environments.draw(rng).unwrap_or_else(|| Environment::sky(rng));
            resting.extend(environment.lights(ENVIRONMENT_LIGHTS, irradiance, rng));
        }
        Self { intensity: intensity as f32, exponent: exponent as f32, resting }
    }

    /// Only a flash that exposes every height alike, with the median cone: for measuring.
    pub fn flash(height: f64) -> Self {
        let intensity = INTENSITY * (height / REFERENCE_HEIGHT).powi(2);
        Self { intensity: intensity as f32, exponent: EXPONENT_LOG.0.exp() as f32, resting: vec![] }
    }

    /// All lights while the camera takes a frame.
    pub fn at(&self, camera: &Camera) -> Vec<Light> {
        let axis = camera.forward.map(|v| v as f32);
        let flash = Light::Flash { position: camera.eye(), axis, intensity: self.intensity, exponent: self.exponent };
        std::iter::once(flash).chain(self.resting.iter().copied()).collect()
    }
}

fn log_normal(median: f64, spread: f64, rng: &mut impl Rng) -> f64 {
    LogNormal::new(median.ln(), spread).expect("the spread is a finite constant").sample(rng)
}

/// A light without fall-off whose diffuse reflection on white is its intensity.
fn second_light(rng: &mut impl Rng) -> Light {
    let azimuth = rng.random_range(0.0..std::f64::consts::TAU);
    let z: f64 = rng.random_range(SECOND_LEAST_Z..=1.0);
    let distance = log_normal(SECOND_DISTANCE.0, SECOND_DISTANCE.1, rng);
    let intensity = log_normal(SECOND_INTENSITY.0, SECOND_INTENSITY.1, rng);
    let across = (1.0 - z * z).sqrt();
    let direction = [across * azimuth.cos(), across * azimuth.sin(), z];
    let irradiance = (intensity * std::f64::consts::PI) as f32;
    Light::Point { position: direction.map(|d| (distance * d) as f32), irradiance: [irradiance; 3] }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    fn drawn(kind: Lighting, height: f64) -> Vec<VideoLights> {
        let config = LightConfig { kind, ..LightConfig::default() };
        (0..400).map(|s| VideoLights::draw(&config, height, &mut ChaCha8Rng::seed_from_u64(s))).collect()
    }

    #[test]
    fn the_svbrdf_flash_exposes_every_height_alike() {
        for height in [0.15, 0.28, 0.45] {
            for lights in drawn(Lighting::Svbrdf, height) {
                assert!((f64::from(lights.intensity) / height.powi(2) - 0.1 / 0.28f64.powi(2)).abs() < 1e-5);
                assert!(lights.resting.is_empty());
            }
        }
    }

    #[test]
    fn draws_have_the_medians_of_the_paper() {
        let median = |mut v: Vec<f32>| {
            v.sort_by(f32::total_cmp);
            v[v.len() / 2]
        };
        let lights = drawn(Lighting::Flow, 0.2);
        assert!((median(lights.iter().map(|l| l.exponent.ln()).collect()) - 1.6).abs() < 0.08);
        assert!((median(lights.iter().map(|l| l.intensity).collect()) / 0.1 - 1.0).abs() < 0.08);
        let (mut distance, mut intensity) = (vec![], vec![]);
        for light in &lights {
            let [Light::Point { position, irradiance }] = light.resting[..] else { panic!("one resting point light") };
            assert!(position[2] > 0.2);
            distance.push(position.iter().map(|v| v * v).sum::<f32>().sqrt());
            intensity.push(irradiance[0] / std::f32::consts::PI);
        }
        assert!((median(distance) / 2.25 - 1.0).abs() < 0.05 && (median(intensity) / 0.1 - 1.0).abs() < 0.05);
    }

    #[test]
    fn the_environment_adds_its_share_of_the_flash_at_the_frame_centre() {
        let config = LightConfig { ambient: [0.2, 0.2], ..LightConfig::default() };
        let lights = VideoLights::draw(&config, 0.3, &mut ChaCha8Rng::seed_from_u64(4));
        let on_plane = |light: &Light| {
            let incident = light.incident([0.0; 3]);
            incident.wi[2] * incident.irradiance.iter().sum::<f32>() / 3.0
        };
        let environment: f32 = lights.resting.iter().map(on_plane).sum();
        let flash = lights.intensity / 0.09;
        assert!((environment / flash - 0.2).abs() < 0.01, "{environment} beside {flash}");
    }
}
