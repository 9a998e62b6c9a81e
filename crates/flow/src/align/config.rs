//! Switches and limits of the alignment.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What the alignment does; every part of it can be switched off for an ablation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct AlignConfig {
    /// Every how many frames a key frame is taken (paper §5: 5).
    pub key_frame_step: usize,
    /// Shorter side, in pixels, of the area-downsampled frames on which neighbouring frames are aligned (paper §5: 256).
    pub size: usize,
    /// Shorter side, in pixels, of the frames on which a key frame is refined against the guidance image; frames that are
    /// smaller keep their own size.
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
            seed: 0,
        }
    }
}

/// How a chained warp is made regular (paper §5, "pose estimation").
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Regularise {
    /// A robust homography: exact for a planar sample, needs no field of view.
    Homography,
    /// Nothing: flows are composed as they are (the paper's ablation). Needs an `adjacent` net.
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
    pub mean_sigma_px: f32,
    /// Standard deviation, in pixels, of the Gaussian over which the local contrast is measured.
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
