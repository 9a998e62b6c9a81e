//! One photo and what became of it.

use std::time::Instant;

use dataset::material::texture::Texture;
use dataset::path::CameraPath;
use dataset::sequence::Sequence;
use dataset::sequence::lights::{LightConfig, VideoLights};
use flow::align::PhotometricConfig;
use flow::align::localise::{NotLocated, localise};
use flow::align::metrics::REFERENCE_WIDTH;
use flow::align::size::Size;
use ops::homography::Homography;
use ops::planes::Planes;
use rand::{Rng, RngExt};
use render::camera::Camera;
use serde::{Deserialize, Serialize};

use super::LocalisationConfig;

/// A place further off than this, in pixels at a width of 1024, is wrong (the goal for localisation).
const GOAL_PX: f64 = 16.0;

/// How a photo is lit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Light {
    /// By its own flash, from its own distance.
    Flash,
    /// By the flash and half as much light from all around.
    Mixed,
    /// From all around only.
    Environment,
}

impl Light {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Flash, Self::Mixed, Self::Environment];

    fn draw(self, height: f64, rng: &mut impl Rng) -> VideoLights {
        let ambient = match self {
            Self::Flash => 0.0,
            Self::Mixed => 0.5,
            Self::Environment => 1.0,
        };
        let config = LightConfig { ambient: [ambient; 2], ..LightConfig::default() };
        let lights = VideoLights::draw(&config, height, rng);
        if self == Self::Environment { VideoLights { intensity: 0.0, ..lights } } else { lights }
    }
}

/// What became of a photo.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Outcome {
    /// Within 16 pixels of the truth, at a frame width of 1024.
    Found,
    /// No place was given: none was found.
    Refused,
    /// No place was given: several fit.
    Repeats,
    /// A place was given that isn't the frame's.
    Wrong,
}

/// One photo.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Case {
    /// Number of the scan.
    pub scan: usize,
    /// Name of the frame's material.
    pub material: String,
    /// What it shows to align by.
    pub texture: Texture,
    /// Whether the photo shows another material.
    pub foreign: bool,
    /// Video pixels per photo pixel.
    pub scale: f64,
    /// How the photo is lit.
    pub light: Light,
    /// What became of it.
    pub outcome: Outcome,
    /// Mean error over the frame in pixels at a width of 1024, of an accepted place.
    pub error_px: Option<f64>,
    /// What the localiser says, or why it refused.
    pub answer: String,
    /// Time taken.
    pub seconds: f64,
}

impl Case {
    /// Takes the photo of `shown` around the place of `own`'s frame 0 and looks for the frame in it.
    pub(super) fn measure(
        (own, shown): (&Sequence, &Sequence),
        frame: &Planes,
        (scan, scale, light): (usize, f64, Light),
        config: &LocalisationConfig,
        rng: &mut impl Rng,
    ) -> Self {
        let foreign = !std::ptr::eq(own, shown);
        let first = own.camera(0);
        let camera = photo_camera(first, config, rng);
        let side = (config.cover * config.resolution as f64 / scale).round() as usize;
        let photo = photo(shown, camera, light.draw(camera.position[2], rng), side);
        let start = Instant::now();
        let found = localise(&photo, frame, &config.localise, &PhotometricConfig::default());
        let seconds = start.elapsed().as_secs_f64();
        let truth = Homography::new(first.world_to_pixel(config.resolution).matrix * camera.pixel_to_world(side).matrix);
        let size = Size::of(frame);
        let error_px = found.as_ref().ok().map(|f| distance(&f.homography, &truth, size) * REFERENCE_WIDTH / size.width as f64);
        let outcome = match error_px {
            None if matches!(found, Err(NotLocated::Ambiguous { .. })) => Outcome::Repeats,
            None => Outcome::Refused,
            Some(error) if error <= GOAL_PX && !foreign => Outcome::Found,
            Some(_) => Outcome::Wrong,
        };
        let answer = match &found {
            Ok(f) => format!("zncc {:.2}, {:.0} standard errors, runner-up {:.2}", f.zncc, f.significance, f.runner_up),
            Err(why) => why.to_string(),
        };
        let (material, texture) = (own.material().into(), own.texture());
        Self { scan, material, texture, foreign, scale, light, outcome, error_px, answer, seconds }
    }
}

/// A camera higher up that shows all of the frame somewhere.
fn photo_camera(first: &Camera, config: &LocalisationConfig, rng: &mut impl Rng) -> Camera {
    let half_view = first.position[2] * (0.5 * first.fov_rad).tan();
    let height = config.cover * first.position[2];
    // The frame's corners stay in the picture however it is turned.
    let free = (half_view * (config.cover - 1.5)).max(0.0);
    let mut within = |reach: f64| reach * rng.random_range(-1.0..=1.0);
    let centre: [f64; 2] = std::array::from_fn(|k| first.position[k] + within(0.7 * free));
    let lean = config.tilt_deg.to_radians().tan() * height / std::f64::consts::SQRT_2;
    let position = [centre[0] + within(lean), centre[1] + within(lean), height];
    let turn = within(config.rotation_deg).to_radians();
    Camera::look_at(position, [centre[0], centre[1], 0.0], [0.0, 1.0, 0.0], first.fov_rad).rolled(turn)
}

fn photo(shown: &Sequence, camera: Camera, lights: VideoLights, side: usize) -> Planes {
    let path = CameraPath { cameras: vec![camera], ..shown.path().clone() };
    Sequence::from_parts(shown.surface().clone(), path, lights).frame(0, side)
}

/// Mean distance, over the frame, between where two photo-to-frame maps put what the frame shows.
fn distance(found: &Homography, truth: &Homography, frame: Size) -> f64 {
    const SIDE: usize = 5;
    let at = |(x, y): (f64, f64)| {
        let (u, v) = truth.inverse()?.apply(x, y)?;
        let (p, q) = found.apply(u, v)?;
        Some((p - x).hypot(q - y))
    };
    let sum: Option<f64> = frame.grid(SIDE).map(at).sum();
    sum.map_or(f64::INFINITY, |s| s / (SIDE * SIDE) as f64)
}
