//! Switches and limits of the alignment.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::result::AlignError;

/// Frames below this side can't be aligned.
pub(super) const SMALLEST_SIDE: usize = 32;
/// Frames above this side don't fit into memory as a scan.
const LARGEST_SIDE: usize = 8192;

/// What the alignment does; every part of it can be switched off for an ablation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct AlignConfig {
    /// Every how many frames a key frame is taken (paper §5: 5).
    #[schemars(extend("unit" = "frames"))]
    pub key_frame_step: usize,
    /// Shorter side, in pixels, of the area-downsampled frames on which neighbouring frames are aligned (paper §5: 256).
    #[schemars(extend("unit" = "pixels"))]
    pub size: usize,
    /// Shorter side, in pixels, of the frames on which a key frame is refined against the guidance image; frames that are
    /// smaller keep their own size.
    #[schemars(extend("unit" = "pixels"))]
    pub refine_size: usize,
    /// How a chained warp is made regular before the next step builds on it.
    pub regularise: Regularise,
    /// Which guesses of a step between two frames compete.
    pub candidates: CandidateSwitches,
    /// The direct photometric refinement.
    pub photometric: PhotometricConfig,
    /// Whether what stands still in the image during the whole scan, such as the flash's highlight, is taken out first.
    pub steady: bool,
    /// Whether the `distant` net, where there is one, estimates the flow that remains against the guidance image.
    pub distant: bool,
    /// Whether key frames are also tied to earlier key frames that show the same place.
    pub loops: bool,
    /// Whether all key frames are adjusted together after the last one has been found.
    pub adjust: bool,
    /// Whether the change of shading that relief shows under the travelling light is told from motion. Needs ten key frames
    /// and a guidance image that is frame 0.
    pub relief: bool,
    /// Seed of the robust fits.
    pub seed: u64,
}

impl Default for AlignConfig {
    fn default() -> Self {
        Self {
            key_frame_step: 5,
            size: 256,
            refine_size: 512,
            regularise: Regularise::Homography,
            candidates: CandidateSwitches::default(),
            photometric: PhotometricConfig::default(),
            steady: true,
            distant: true,
            loops: true,
            adjust: true,
            relief: true,
            seed: 0,
        }
    }
}

impl AlignConfig {
    /// Checks every value by itself; whether a net is there is for the aligner to see.
    ///
    /// # Errors
    /// [`AlignError::Config`] for the first value that can't work.
    pub fn validate(&self) -> Result<(), AlignError> {
        let require = |holds: bool, name, found: &dyn std::fmt::Display, expected| {
            if holds { Ok(()) } else { Err(AlignError::Config { name, found: found.to_string(), expected }) }
        };
        let step = self.key_frame_step;
        require((1..=10_000).contains(&step), "key_frame_step", &step, "every 1st to 10 000th frame (paper: 5)")?;
        let sides = SMALLEST_SIDE..=LARGEST_SIDE;
        require(sides.contains(&self.size), "size", &self.size, "32 to 8192 pixels (paper: 256)")?;
        let fits = sides.contains(&self.refine_size) && self.refine_size >= self.size;
        require(fits, "refine_size", &self.refine_size, "32 to 8192 pixels, and not below `size`")?;
        let PhotometricConfig { iterations, mean_sigma_px, contrast_sigma_px, contrast_floor, chroma, .. } = self.photometric;
        require(iterations <= 1000, "photometric.iterations", &iterations, "0 to 1000 steps")?;
        for (name, sigma) in
            [("photometric.mean_sigma_px", mean_sigma_px), ("photometric.contrast_sigma_px", contrast_sigma_px)]
        {
            require((0.1..=100.0).contains(&sigma), name, &sigma, "0.1 to 100 pixels")?;
        }
        let floor = contrast_floor > 0.0 && contrast_floor <= 1.0;
        require(floor, "photometric.contrast_floor", &contrast_floor, "a contrast above 0 and up to 1")?;
        require((0.0..=100.0).contains(&chroma), "photometric.chroma", &chroma, "a weight from 0 to 100")
    }
}

/// How a chained warp is made regular (paper §5, "pose estimation").
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Regularise {
    /// A robust homography: exact for a planar sample, needs no field of view.
    Homography,
    /// The paper's own chain: the pose of a camera with a field of view of 30°, key frame by key frame, without any of the
    /// other switches. Needs an `adjacent` net.
    Pnp,
    /// The same without any regularisation (the paper's ablation). Needs an `adjacent` net.
    None,
}

/// The guesses of a step between two frames.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct CandidateSwitches {
    /// The homography that fits the `adjacent` net's flow.
    pub net: bool,
    /// Peaks of the phase correlation.
    pub phase_correlation: bool,
    /// The motion of the neighbouring steps, where the step's own guesses fail.
    pub velocity: bool,
    /// No motion.
    pub identity: bool,
}

impl Default for CandidateSwitches {
    fn default() -> Self {
        Self { net: true, phase_correlation: true, velocity: true, identity: true }
    }
}

/// The direct photometric refinement ([`super::photometric`]).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct PhotometricConfig {
    /// Whether homographies are refined on the pixels at all.
    pub enabled: bool,
    /// Gauss–Newton steps per pyramid level, at most.
    pub iterations: usize,
    /// Standard deviation, in pixels, of the Gaussian whose mean is subtracted.
    #[schemars(extend("unit" = "pixels"))]
    pub mean_sigma_px: f32,
    /// Standard deviation, in pixels, of the Gaussian over which the local contrast is measured.
    #[schemars(extend("unit" = "pixels"))]
    pub contrast_sigma_px: f32,
    /// Contrast (of gamma-encoded values) that counts as noise: local contrast is divided by `deviation + floor`.
    pub contrast_floor: f32,
    /// Weight of the two chroma planes beside luminance; 0 leaves them out.
    pub chroma: f32,
}

impl Default for PhotometricConfig {
    fn default() -> Self {
        Self { enabled: true, iterations: 12, mean_sigma_px: 4.0, contrast_sigma_px: 8.0, contrast_floor: 0.01, chroma: 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn impossible_values_are_named() {
        AlignConfig::default().validate().unwrap();
        let photometric = |change: fn(&mut PhotometricConfig)| {
            let mut config = AlignConfig::default();
            change(&mut config.photometric);
            config
        };
        for (config, expected) in [
            (AlignConfig { key_frame_step: 0, ..AlignConfig::default() }, "align.key_frame_step = 0: "),
            (AlignConfig { size: 8, ..AlignConfig::default() }, "align.size = 8: 32 to 8192"),
            (AlignConfig { refine_size: 64, ..AlignConfig::default() }, "align.refine_size = 64: "),
            (photometric(|p| p.iterations = 1 << 40), "photometric.iterations"),
            (photometric(|p| p.contrast_sigma_px = f32::NAN), "photometric.contrast_sigma_px = NaN: 0.1 to 100"),
            (photometric(|p| p.contrast_floor = 0.0), "photometric.contrast_floor = 0"),
            (photometric(|p| p.chroma = -1.0), "photometric.chroma = -1"),
        ] {
            let error = config.validate().unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }
}
