//! The tables that switch the sensor's options on.

use render::lens::DISTORTION_LIMIT;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What a phone's camera does to the frames beyond the paper's recipe (noise, clipping, encoding).
///
/// Every option is a table of its own: a table that isn't there is off, an empty one takes its defaults, which are those of a
/// phone. Each draws from a random stream of its own, so that switching one on changes no other draw. At strength 0 frames
/// and labels are, bit for bit, those without the table.
///
/// # Labels
/// Flow, validity and target maps are exact for the frames as they are: they follow the lens's distortion and, row by row,
/// the rolling shutter, because a net can only learn to match what its images show, and maps must lie under the guidance
/// frame pixel by pixel. The camera moves while the shutter is open; labels are those of the middle of that time. The
/// *homography* between two frames stays that of pinhole cameras at the middle of their frames: it is what an alignment by
/// homographies can at best find.
///
/// ```
/// let config: dataset::sequence::sensor::SensorConfig = toml::from_str(
///     "vignetting = { corner_loss = [0.1, 0.4] }
///      motion_blur = {}",
/// ).unwrap();
/// assert!(config.compression.is_none());
/// config.validate().unwrap();
/// ```
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SensorConfig {
    /// The lens darkens the corners.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub vignetting: Option<VignettingConfig>,
    /// The automatic exposure wanders.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub exposure: Option<ExposureConfig>,
    /// The automatic white balance wanders.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub white_balance: Option<WhiteBalanceConfig>,
    /// The camera moves while the shutter is open.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub motion_blur: Option<MotionBlurConfig>,
    /// The lens bends straight lines.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub distortion: Option<DistortionConfig>,
    /// Rows are read one after the other.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rolling_shutter: Option<RollingShutterConfig>,
    /// The video is compressed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub compression: Option<CompressionConfig>,
}

/// `vignetting`
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct VignettingConfig {
    /// Range of the share of light that is lost in the image's corners, one draw per video.
    #[schemars(extend("unit" = "share of light"))]
    pub corner_loss: [f64; 2],
}

impl Default for VignettingConfig {
    fn default() -> Self {
        Self { corner_loss: [0.0, 0.4] }
    }
}

/// `exposure`
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ExposureConfig {
    /// Standard deviation of the last frame's exposure against the first one's, in stops (factors of two). The exposure
    /// wanders smoothly and acts before noise and clipping.
    #[schemars(extend("unit" = "stops"))]
    pub stops: f64,
}

impl Default for ExposureConfig {
    fn default() -> Self {
        Self { stops: 0.25 }
    }
}

/// `white_balance`
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct WhiteBalanceConfig {
    /// Standard deviation, in stops, of red and of blue against green in the last frame, 0 in the first. The luminance of grey
    /// (Rec. 709) stays.
    #[schemars(extend("unit" = "stops"))]
    pub stops: f64,
}

impl Default for WhiteBalanceConfig {
    fn default() -> Self {
        Self { stops: 0.08 }
    }
}

/// `motion_blur`
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct MotionBlurConfig {
    /// Range of the share of the time between two frames for which the shutter is open, one draw per video.
    #[schemars(extend("unit" = "share of a frame's time"))]
    pub shutter: [f64; 2],
    /// Most renderings that a frame is averaged over; it takes one per pixel of motion, and as many times as long to make.
    #[schemars(extend("unit" = "renderings"))]
    pub sub_frames: usize,
}

impl Default for MotionBlurConfig {
    fn default() -> Self {
        Self { shutter: [0.1, 0.5], sub_frames: 16 }
    }
}

/// `distortion`
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct DistortionConfig {
    /// Range of k1 of [`render::lens::RadialDistortion`], one draw per video.
    pub k1: [f64; 2],
    /// Range of k2.
    pub k2: [f64; 2],
}

impl Default for DistortionConfig {
    fn default() -> Self {
        // At the widest field of view k1 = 0.08 moves the corners by 1.6 %: what is left of a phone's correction.
        Self { k1: [-0.08, 0.08], k2: [-0.04, 0.04] }
    }
}

/// `rolling_shutter`
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct RollingShutterConfig {
    /// Range of the share of the time between two frames that passes between the first and the last row, one draw per video.
    #[schemars(extend("unit" = "share of a frame's time"))]
    pub readout: [f64; 2],
}

impl Default for RollingShutterConfig {
    fn default() -> Self {
        // 10 to 30 ms of the 33 ms of a frame.
        Self { readout: [0.3, 0.9] }
    }
}

/// `compression`
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct CompressionConfig {
    /// Range of the JPEG quality, 1 to 100, one draw per video. Each frame is compressed by itself, colour at half
    /// resolution (4:2:0): that stands for a phone's video encoder.
    #[schemars(extend("unit" = "JPEG quality"))]
    pub quality: [u8; 2],
}

impl Default for CompressionConfig {
    fn default() -> Self {
        Self { quality: [40, 95] }
    }
}

/// A value of [`SensorConfig`] out of its range.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("sensor.{key} is {found}; expected {expected}")]
pub struct SensorError {
    /// Name of the value.
    pub key: &'static str,
    /// What it is.
    pub found: String,
    /// What it may be.
    pub expected: &'static str,
}

impl SensorConfig {
    /// Every option at its defaults: a phone's camera.
    pub fn phone() -> Self {
        Self {
            vignetting: Some(VignettingConfig::default()),
            exposure: Some(ExposureConfig::default()),
            white_balance: Some(WhiteBalanceConfig::default()),
            motion_blur: Some(MotionBlurConfig::default()),
            distortion: Some(DistortionConfig::default()),
            rolling_shutter: Some(RollingShutterConfig::default()),
            compression: Some(CompressionConfig::default()),
        }
    }

    /// Checks every value.
    ///
    /// # Errors
    /// [`SensorError`] for the first value out of range.
    pub fn validate(&self) -> Result<(), SensorError> {
        if let Some(VignettingConfig { corner_loss }) = self.vignetting {
            range(
                "vignetting.corner_loss",
                corner_loss,
                [0.0, 0.9],
                "[low, high] with 0 ≤ low ≤ high ≤ 0.9, a share of light",
            )?;
        }
        if let Some(ExposureConfig { stops }) = self.exposure {
            let expected = "0 to 4, a standard deviation in stops";
            require((0.0..=4.0).contains(&stops), "exposure.stops", stops.to_string(), expected)?;
        }
        if let Some(WhiteBalanceConfig { stops }) = self.white_balance {
            let expected = "0 to 2, a standard deviation in stops";
            require((0.0..=2.0).contains(&stops), "white_balance.stops", stops.to_string(), expected)?;
        }
        if let Some(MotionBlurConfig { shutter, sub_frames }) = self.motion_blur {
            range(
                "motion_blur.shutter",
                shutter,
                [0.0, 1.0],
                "[low, high] with 0 ≤ low ≤ high ≤ 1, a share of a frame's time",
            )?;
            let expected = "1 to 256 renderings";
            require((1..=256).contains(&sub_frames), "motion_blur.sub_frames", sub_frames.to_string(), expected)?;
        }
        if let Some(DistortionConfig { k1, k2 }) = self.distortion {
            let limits = [-DISTORTION_LIMIT, DISTORTION_LIMIT];
            range("distortion.k1", k1, limits, "[low, high] with −0.5 ≤ low ≤ high ≤ 0.5")?;
            range("distortion.k2", k2, limits, "[low, high] with −0.5 ≤ low ≤ high ≤ 0.5")?;
        }
        if let Some(RollingShutterConfig { readout }) = self.rolling_shutter {
            let expected = "[low, high] with 0 ≤ low ≤ high ≤ 1, a share of a frame's time";
            range("rolling_shutter.readout", readout, [0.0, 1.0], expected)?;
        }
        if let Some(CompressionConfig { quality }) = self.compression {
            let [low, high] = quality;
            let expected = "[low, high] with 1 ≤ low ≤ high ≤ 100";
            require(1 <= low && low <= high && high <= 100, "compression.quality", format!("{quality:?}"), expected)?;
        }
        Ok(())
    }

    /// Whether an option follows the camera's motion between frames.
    pub fn moves(&self) -> bool {
        self.motion_blur.is_some() || self.rolling_shutter.is_some()
    }
}

fn range(key: &'static str, [low, high]: [f64; 2], [least, most]: [f64; 2], expected: &'static str) -> Result<(), SensorError> {
    require(least <= low && low <= high && high <= most, key, format!("[{low}, {high}]"), expected)
}

fn require(holds: bool, key: &'static str, found: String, expected: &'static str) -> Result<(), SensorError> {
    if holds { Ok(()) } else { Err(SensorError { key, found, expected }) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parsed(text: &str) -> SensorConfig {
        toml::from_str(text).unwrap()
    }

    #[test]
    fn nothing_is_on_unless_it_is_written_and_an_empty_table_takes_its_defaults() {
        assert_eq!(parsed(""), SensorConfig::default());
        assert_eq!(toml::to_string(&SensorConfig::default()).unwrap(), "");
        let one = parsed("rolling_shutter = {}");
        assert_eq!(one, SensorConfig { rolling_shutter: Some(RollingShutterConfig::default()), ..SensorConfig::default() });
        assert_eq!(parsed("motion_blur = { sub_frames = 4 }").motion_blur.unwrap().shutter, [0.1, 0.5]);
        let all = parsed(
            "vignetting = {}\nexposure = {}\nwhite_balance = {}\nmotion_blur = {}\ndistortion = {}\nrolling_shutter = {}\ncompression = {}",
        );
        all.validate().unwrap();
        assert_eq!(all, SensorConfig::phone());
        assert_eq!(parsed(&toml::to_string(&all).unwrap()), all);
    }

    #[test]
    fn unknown_keys_are_refused() {
        for text in ["vigneting = {}", "vignetting = { loss = [0.0, 0.1] }", "compression = { quality = [50, 300] }"] {
            assert!(toml::from_str::<SensorConfig>(text).is_err(), "{text}");
        }
    }

    #[test]
    fn bad_values_are_named() {
        for (text, expected) in [
            ("vignetting = { corner_loss = [0.4, 0.1] }", "sensor.vignetting.corner_loss is [0.4, 0.1]; expected [low, high]"),
            ("vignetting = { corner_loss = [0.0, 1.0] }", "vignetting.corner_loss"),
            ("exposure = { stops = -1.0 }", "sensor.exposure.stops is -1; expected 0 to 4"),
            ("exposure = { stops = nan }", "sensor.exposure.stops is NaN"),
            ("white_balance = { stops = 3.0 }", "sensor.white_balance.stops is 3"),
            ("motion_blur = { shutter = [0.0, 1.5] }", "sensor.motion_blur.shutter is [0, 1.5]"),
            ("motion_blur = { sub_frames = 0 }", "sensor.motion_blur.sub_frames is 0"),
            ("distortion = { k1 = [-0.6, 0.0] }", "sensor.distortion.k1 is [-0.6, 0]"),
            ("distortion = { k2 = [0.0, inf] }", "sensor.distortion.k2 is [0, inf]"),
            ("rolling_shutter = { readout = [-0.1, 0.5] }", "sensor.rolling_shutter.readout is [-0.1, 0.5]"),
            ("compression = { quality = [0, 90] }", "sensor.compression.quality is [0, 90]"),
            ("compression = { quality = [90, 40] }", "1 ≤ low ≤ high ≤ 100"),
        ] {
            let error = parsed(text).validate().unwrap_err().to_string();
            assert!(error.contains(expected), "{text}: {error}");
        }
    }
}
