//! One synthetic scanning video (paper §4): frames, exact flow between any two of them, and the maps each frame sees.
//!
//! Everything comes from the same cameras, so frames, flow, warps and target maps agree. A frame is a pure function of
//! (seed, video, frame index, resolution): the order of requests and the number of threads change nothing, and a crop of
//! a frame is rendered alone yet equals the same rectangle of the whole frame.

pub mod environment;
pub mod lights;
mod noise;
pub mod sensor;
mod target;
mod warp;

use std::borrow::Cow;
use std::sync::Arc;

use ops::homography::Homography;
use ops::kernel::vectorise::vectorised;
use ops::planes::{Mask, Planes};
use rayon::prelude::*;
use render::block::{LANES, Lane};
use render::brdf::BrdfModel;
use render::camera::Camera;
use render::light::Light;
use render::sensor::expose_row;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::material::augment::{AugmentConfig, AugmentError, Augmentation, AugmentedMaterial};
use crate::material::texture::Texture;
use crate::material::{GRID, Material};
use crate::path::line::LineOrder;
use crate::path::{CameraPath, PathConfig, PathError};
use crate::stream::Stream;

use environment::EnvironmentMapsError;
use lights::{LightConfig, Lighting, VideoLights};
pub(crate) use noise::PixelNoise;
use sensor::{BLOCK, REACH, SensorConfig, SensorError, VideoSensor, compressed};
use warp::FrameGeometry;
pub use warp::{BentWarp, FrameWarp};

/// What videos to make.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SequenceConfig {
    /// The camera's way.
    pub path: PathConfig,
    /// How the material is varied.
    pub augment: AugmentConfig,
    /// How the video is lit.
    pub light: LightConfig,
    /// Multiplies the sensor noise of §4; 0 switches it off.
    pub noise_scale: f32,
    /// What the paper's sensor doesn't do: lens, shutter, automatic controls, compression. All off by default.
    pub sensor: SensorConfig,
}

impl Default for SequenceConfig {
    fn default() -> Self {
        Self::svbrdf()
    }
}

/// A value of [`SequenceConfig`] out of its range.
#[derive(Debug, thiserror::Error)]
pub enum SequenceConfigError {
    /// In the path.
    #[error(transparent)]
    Path(#[from] PathError),
    /// In the augmentation.
    #[error(transparent)]
    Augment(#[from] AugmentError),
    /// In the light.
    #[error("light.ambient is {0:?}; expected [low, high] with 0 ≤ low ≤ high ≤ 10, a share of the flash")]
    Ambient([f64; 2]),
    /// In the files of the light.
    #[error(transparent)]
    Environment(#[from] EnvironmentMapsError),
    /// In the noise.
    #[error("noise_scale is {0}; expected a factor, 0 to 100")]
    Noise(f32),
    /// In the sensor's options.
    #[error(transparent)]
    Sensor(#[from] SensorError),
    /// A path without a motion between frames.
    #[error(
        "path.line_order is interleaved, which jumps from frame to frame; sensor.motion_blur and sensor.rolling_shutter expect line_order = \"scan\""
    )]
    Jumps,
}

impl SequenceConfig {
    /// Videos for the SVBRDF net: spiral or (1/3) line, flash only, Perlin specular layer.
    pub fn svbrdf() -> Self {
        Self {
            path: PathConfig { line_share: 1.0 / 3.0, ..PathConfig::default() },
            augment: AugmentConfig::default(),
            light: LightConfig::default(),
            noise_scale: 1.0,
            sensor: SensorConfig::default(),
        }
    }

    /// Videos for the flow nets: spiral, flash of random strength and a second light, no Perlin layer.
    pub fn flow() -> Self {
        Self {
            path: PathConfig::default(),
            augment: AugmentConfig { perlin: 0.0, ..AugmentConfig::default() },
            light: LightConfig { kind: Lighting::Flow, ..LightConfig::default() },
            noise_scale: 1.0,
            sensor: SensorConfig::default(),
        }
    }

    /// Checks every value.
    ///
    /// # Errors
    /// Names the key, its value and the allowed range.
    pub fn validate(&self) -> Result<(), SequenceConfigError> {
        self.path.validate()?;
        self.augment.validate()?;
        let [low, high] = self.light.ambient;
        if !(0.0 <= low && low <= high && high <= 10.0) {
            return Err(SequenceConfigError::Ambient(self.light.ambient));
        }
        self.light.environments.load()?;
        if !(0.0..=100.0).contains(&self.noise_scale) {
            return Err(SequenceConfigError::Noise(self.noise_scale));
        }
        self.sensor.validate()?;
        if self.sensor.moves() && self.path.line_order == LineOrder::Interleaved {
            return Err(SequenceConfigError::Jumps);
        }
        Ok(())
    }
}

/// A scanning video of one material.
#[derive(Clone, Debug)]
pub struct Sequence {
    surface: AugmentedMaterial,
    path: CameraPath,
    lights: VideoLights,
    sensor: VideoSensor,
    noise: Option<Stream>,
    noise_scale: f32,
}

impl Sequence {
    /// Draws the video with the given index: augmentation, path, lights and noise come from streams named by it.
    pub fn new(material: Arc<Material>, config: &SequenceConfig, streams: &Stream, video: u64) -> Self {
        let augmentation = Augmentation::draw(&material, &mut streams.rng("augmentation", video), &config.augment);
        let path = config.path.draw(&mut streams.rng("camera path", video));
        let lights = VideoLights::draw(&config.light, path.height, &mut streams.rng("light", video));
        let noise = streams.child("sensor", video);
        Self {
            surface: AugmentedMaterial { material, augmentation },
            path,
            lights,
            sensor: VideoSensor::draw(&config.sensor, &noise),
            noise: Some(noise),
            noise_scale: config.noise_scale,
        }
    }

    /// A video of given parts with a noiseless sensor without options: for measuring.
    pub fn from_parts(surface: AugmentedMaterial, path: CameraPath, lights: VideoLights) -> Self {
        Self { surface, path, lights, sensor: VideoSensor::default(), noise: None, noise_scale: 0.0 }
    }

    /// Number of frames.
    pub fn len(&self) -> usize {
        self.path.cameras.len()
    }

    /// Whether there is no frame.
    pub fn is_empty(&self) -> bool {
        self.path.cameras.is_empty()
    }

    /// Name of the material.
    pub fn material(&self) -> &str {
        self.surface.name()
    }

    /// What the material shows to align by.
    pub fn texture(&self) -> Texture {
        Texture::of(&self.surface.material)
    }

    /// The material as this video shows it.
    pub fn surface(&self) -> &AugmentedMaterial {
        &self.surface
    }

    /// The camera's way and the figures it was drawn from.
    pub fn path(&self) -> &CameraPath {
        &self.path
    }

    /// The lights.
    pub fn lights(&self) -> &VideoLights {
        &self.lights
    }

    /// The camera of a frame.
    ///
    /// # Panics
    /// Like every method that takes a frame index, if there is no such frame.
    pub fn camera(&self, frame: usize) -> &Camera {
        &self.path.cameras[frame]
    }

    /// A frame as the program reads it: noisy, clipped, gamma-encoded, 8 bit, with the options of [`SensorConfig`].
    ///
    /// # Shapes
    /// 3 planes of `res × res`, multiples of 1/255.
    pub fn frame(&self, frame: usize, res: usize) -> Planes {
        self.frame_crop(frame, res, 0, 0, res, res)
    }

    /// The rectangle of [`Sequence::frame`] with the upper-left corner (row `y0`, column `x0`); nothing else is rendered
    /// (under compression: nothing but the blocks that it touches).
    pub fn frame_crop(&self, frame: usize, res: usize, y0: usize, x0: usize, height: usize, width: usize) -> Planes {
        let Some(quality) = self.sensor.quality else {
            return self.exposed(frame, res, [y0, x0], [height, width]);
        };
        let start = |v: usize| v.saturating_sub(REACH) / BLOCK * BLOCK;
        let end = |v: usize| (v + REACH).next_multiple_of(BLOCK).min(res);
        let (top, left) = (start(y0), start(x0));
        let blocks = self.exposed(frame, res, [top, left], [end(y0 + height) - top, end(x0 + width) - left]);
        compressed(&blocks, quality).crop(y0 - top, x0 - left, height, width)
    }

    /// The linear light on the sensor, not clipped: no noise, no white balance.
    pub fn radiance(&self, frame: usize, res: usize) -> Planes {
        self.radiance_crop(frame, res, [0, 0], [res, res], |_, _| {})
    }

    /// A rectangle of a frame before compression.
    fn exposed(&self, frame: usize, res: usize, corner: [usize; 2], size: [usize; 2]) -> Planes {
        let (noise, balance) = (self.noise(frame), self.sensor.white_balance_gains(self.share(frame)));
        self.radiance_crop(
            frame,
            res,
            corner,
            size,
            #[inline(always)]
            |y, [red, green, blue]| {
                for (k, ((red, green), blue)) in red.iter_mut().zip(&mut *green).zip(&mut *blue).enumerate() {
                    let noise = noise.at(y, corner[1] + k);
                    *red = balance[0] * (*red + noise[0]);
                    *green = balance[1] * (*green + noise[1]);
                    *blue = balance[2] * (*blue + noise[2]);
                }
                [red, green, blue].into_iter().for_each(expose_row);
            },
        )
    }

    fn noise(&self, frame: usize) -> PixelNoise {
        let drawn = |streams: Stream| PixelNoise::draw(self.noise_scale, &mut streams.rng("frame", frame as u64));
        self.noise.map_or(PixelNoise::new(0.0, 0), drawn)
    }

    /// How much of the video has passed at a frame, 0 to 1.
    fn share(&self, frame: usize) -> f64 {
        frame as f64 / (self.len() - 1).max(1) as f64
    }

    fn geometry(&self, frame: usize, res: usize) -> FrameGeometry {
        FrameGeometry::new(&self.path, frame, &self.sensor, res)
    }

    /// The light of a rectangle; `read` is given each row of the frame and its three channels while they are at hand.
    fn radiance_crop(
        &self,
        frame: usize,
        res: usize,
        [y0, x0]: [usize; 2],
        [height, width]: [usize; 2],
        read: impl Fn(usize, [&mut [f32]; 3]) + Sync,
    ) -> Planes {
        let geometry = self.geometry(frame, res);
        let delays = geometry.exposure_delays(self.sensor.shutter, self.sensor.sub_frames);
        let instants = ByRow::new(&geometry, |delay| {
            delays.iter().map(|d| Instant::new(&geometry.camera(delay + d), res, &self.lights)).collect::<Vec<_>>()
        });
        let exposure = self.sensor.exposure_gain(self.share(frame)) / delays.len() as f32;
        by_rows(
            [height, width],
            #[inline(always)]
            |y, [red, green, blue]| {
                let instants = instants.at(y + y0);
                for first in (0..width).step_by(LANES) {
                    // Past the row's end the last pixel is repeated.
                    let column = |k: usize| x0 + (first + k).min(width - 1);
                    let pixels =
                        geometry.lens.undistort_block([&std::array::from_fn(|k| column(k) as f64), &[(y + y0) as f64; LANES]]);
                    let mut sum = [[0.0; LANES]; 3];
                    for Instant { view, lights, eye } in instants.iter() {
                        let seen = view.block(&pixels);
                        let texels = self.surface.sample_block(&seen.tx, &seen.ty, &seen.footprint);
                        texels.add_radiance([&seen.x, &seen.y], *eye, lights, BrdfModel::default(), &mut sum);
                    }
                    for k in 0..LANES.min(width - first) {
                        let gain = exposure * self.sensor.vignetting.gain(column(k), y + y0, res);
                        (red[first + k], green[first + k], blue[first + k]) =
                            (gain * sum[0][k], gain * sum[1][k], gain * sum[2][k]);
                    }
                }
                read(y + y0, [red, green, blue]);
            },
        )
    }

    /// The map from pixels of frame `target` to those of frame `source` that show the same point, as pinhole cameras at the
    /// middle of both frames see it. It is exact unless the lens bends lines or the shutter rolls ([`Sequence::warp`] always is).
    pub fn homography(&self, target: usize, source: usize, res: usize) -> Homography {
        Camera::between(self.camera(target), self.camera(source), res)
    }

    /// The exact map from pixels of frame `target` to those of frame `source` that show the same point.
    pub fn warp(&self, target: usize, source: usize, res: usize) -> FrameWarp {
        let (target_geometry, source_geometry) = (self.geometry(target, res), self.geometry(source, res));
        if target_geometry.is_pinhole() {
            FrameWarp::Plane(self.homography(target, source, res))
        } else {
            FrameWarp::bent(target_geometry, source_geometry)
        }
    }

    /// The exact backward flow from frame `target` to frame `source`, and the pixels whose point is inside `source`.
    pub fn flow(&self, target: usize, source: usize, res: usize) -> (Planes, Mask) {
        self.warp(target, source, res).flow([res; 2], [res; 2])
    }
}

/// What depends on the time at which a row is read.
struct ByRow<'a, T, F> {
    geometry: &'a FrameGeometry,
    at: F,
    /// The value for all rows, under a global shutter.
    all: Option<T>,
}

impl<'a, T: Clone, F: Fn(f64) -> T> ByRow<'a, T, F> {
    /// From a function of [`FrameGeometry::delay`].
    fn new(geometry: &'a FrameGeometry, at: F) -> Self {
        let all = geometry.global_shutter().then(|| at(0.0));
        Self { geometry, at, all }
    }

    fn at(&self, y: usize) -> Cow<'_, T> {
        self.all.as_ref().map_or_else(|| Cow::Owned((self.at)(self.geometry.delay(y as f64))), Cow::Borrowed)
    }
}

/// Fills 3 planes from a function of (row, column), rows in parallel.
pub(crate) fn rendered(height: usize, width: usize, pixel: impl Fn(usize, usize) -> [f32; 3] + Sync) -> Planes {
    by_rows([height, width], |y, [red, green, blue]| {
        for (x, ((red, green), blue)) in red.iter_mut().zip(green).zip(blue).enumerate() {
            [*red, *green, *blue] = pixel(y, x);
        }
    })
}

/// Fills 3 planes from a function that fills a row of each, rows in parallel, with the vectors that the processor has.
fn by_rows([height, width]: [usize; 2], fill: impl Fn(usize, [&mut [f32]; 3]) + Sync) -> Planes {
    let mut image = Planes::new(3, height, width);
    let (red, rest) = image.data.split_at_mut(height * width);
    let (green, blue) = rest.split_at_mut(height * width);
    let rows = red.par_chunks_mut(width).zip(green.par_chunks_mut(width)).zip(blue.par_chunks_mut(width));
    rows.enumerate().for_each(|(y, ((red, green), blue))| {
        vectorised(
            #[inline(always)]
            || fill(y, [red, green, blue]),
        );
    });
    image
}

/// A camera in its place, with its flash.
#[derive(Clone)]
struct Instant {
    view: View,
    lights: Vec<Light>,
    eye: [f32; 3],
}

impl Instant {
    fn new(camera: &Camera, res: usize, lights: &VideoLights) -> Self {
        Self { view: View::new(camera, res), lights: lights.at(camera), eye: camera.eye() }
    }
}

/// Where a camera's pixels lie on the material.
#[derive(Clone)]
struct View {
    matrix: [[f64; 3]; 3],
    determinant: f64,
}

/// What the pixels of a block show.
struct Seen {
    /// World x, y.
    x: Lane,
    y: Lane,
    /// The same places on the texel grid.
    tx: Lane,
    ty: Lane,
    /// Widths of the pixels in texels of the grid.
    footprint: Lane,
}

impl View {
    fn new(camera: &Camera, res: usize) -> Self {
        let m = camera.pixel_to_world(res).matrix;
        let matrix = std::array::from_fn(|r| std::array::from_fn(|c| m[(r, c)]));
        Self { matrix, determinant: m.determinant().abs() }
    }

    #[inline(always)]
    fn block(&self, [u, v]: &[[f64; LANES]; 2]) -> Seen {
        const HALF: f64 = GRID as f64 / 2.0;
        let zero = [0.0; LANES];
        let mut seen = Seen { x: zero, y: zero, tx: zero, ty: zero, footprint: zero };
        for k in 0..LANES {
            let row = |r: usize| self.matrix[r][0] * u[k] + self.matrix[r][1] * v[k] + self.matrix[r][2];
            // A pixel at or above the horizon shows a point very far away, in the mean colour of the coarsest level.
            let scale = 1.0 / row(2).max(1e-6);
            let (x, y) = (row(0) * scale, row(1) * scale);
            // The map's Jacobian determinant is det(M)/w³: the area of the pixel on the material.
            let area = (self.determinant * scale * scale * scale) as f32;
            seen.x[k] = x as f32;
            seen.y[k] = y as f32;
            seen.tx[k] = ((x + 1.0) * HALF - 0.5) as f32;
            seen.ty[k] = ((1.0 - y) * HALF - 0.5) as f32;
            seen.footprint[k] = area.sqrt() * HALF as f32;
        }
        seen
    }
}

#[cfg(test)]
pub(crate) mod tests;
