//! The sensor's options: what a phone's lens, shutter, controls and encoder do to a video.

mod compression;
mod config;
mod drift;

pub use config::{
    CompressionConfig, DistortionConfig, ExposureConfig, MotionBlurConfig, RollingShutterConfig, SensorConfig, SensorError,
    VignettingConfig, WhiteBalanceConfig,
};

pub(super) use compression::{BLOCK, REACH, compressed};

use rand::{Rng, RngExt};
use render::lens::{RadialDistortion, Vignetting};

use crate::stream::Stream;
use drift::Drift;

/// Shares of red, green and blue in luminance (Rec. 709).
const LUMINANCE: [f64; 3] = [0.2126, 0.7152, 0.0722];

/// The options of one video, drawn. The default is an ideal sensor.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct VideoSensor {
    /// Fall-off towards the corners.
    pub vignetting: Vignetting,
    /// Exposure in stops.
    pub exposure: Drift,
    /// Red and blue against green, in stops.
    pub white_balance: [Drift; 2],
    /// Share of the time between two frames for which the shutter is open.
    pub shutter: f64,
    /// Most renderings that a frame is averaged over; 0 means one.
    pub sub_frames: usize,
    /// The lens.
    pub distortion: RadialDistortion,
    /// Share of the time between two frames that passes between the first and the last row.
    pub readout: f64,
    /// JPEG quality.
    pub quality: Option<u8>,
}

impl VideoSensor {
    /// Draws every option that is on from a stream of its own.
    pub fn draw(config: &SensorConfig, streams: &Stream) -> Self {
        let rng = |option: &str| streams.rng(option, 0);
        let mut sensor = Self::default();
        if let Some(VignettingConfig { corner_loss }) = config.vignetting {
            sensor.vignetting = Vignetting::new(uniform(corner_loss, &mut rng("vignetting")) as f32);
        }
        if let Some(ExposureConfig { stops }) = config.exposure {
            sensor.exposure = Drift::draw(stops, &mut rng("exposure"));
        }
        if let Some(WhiteBalanceConfig { stops }) = config.white_balance {
            let mut rng = rng("white balance");
            sensor.white_balance = std::array::from_fn(|_| Drift::draw(stops, &mut rng));
        }
        if let Some(MotionBlurConfig { shutter, sub_frames }) = config.motion_blur {
            sensor.shutter = uniform(shutter, &mut rng("motion blur"));
            sensor.sub_frames = sub_frames;
        }
        if let Some(DistortionConfig { k1, k2 }) = config.distortion {
            let mut rng = rng("distortion");
            sensor.distortion = RadialDistortion { k1: uniform(k1, &mut rng), k2: uniform(k2, &mut rng) };
        }
        if let Some(RollingShutterConfig { readout }) = config.rolling_shutter {
            sensor.readout = uniform(readout, &mut rng("rolling shutter"));
        }
        if let Some(CompressionConfig { quality: [low, high] }) = config.compression {
            sensor.quality = Some(rng("compression").random_range(low..=high));
        }
        sensor
    }

    /// Factor on the light of the frame at a share of the video.
    pub fn exposure_gain(&self, share: f64) -> f32 {
        self.exposure.at(share).exp2() as f32
    }

    /// Factors on red, green and blue of the frame at a share of the video; grey keeps its luminance.
    pub fn white_balance_gains(&self, share: f64) -> [f32; 3] {
        let [red, blue] = self.white_balance.map(|drift| drift.at(share).exp2());
        let gains = [red, 1.0, blue];
        // As a difference from 1, so that gains of 1 have a luminance of 1 to the last bit.
        let luminance = 1.0 + (0..3).map(|c| LUMINANCE[c] * (gains[c] - 1.0)).sum::<f64>();
        gains.map(|gain| (gain / luminance) as f32)
    }
}

fn uniform([low, high]: [f64; 2], rng: &mut impl Rng) -> f64 {
    low + rng.random_range(0.0..=1.0) * (high - low)
}

#[cfg(test)]
mod tests;
