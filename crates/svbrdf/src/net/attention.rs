//! How much each frame counts in the mean over frames.

use burn::module::{Module, Param};
use burn::tensor::{Device, Tensor};

use super::SvbrdfNetConfig;
use super::convolution::filled;
use super::pooling::{Both, Observed};

/// A frame's score in a pixel: w · features + b · confidence. No constant: the softmax over the frames doesn't see it.
#[derive(Module, Debug)]
pub struct Score {
    /// w, `[C]`
    weight: Param<Tensor<1>>,
    /// b, `[1]`
    confidence: Param<Tensor<1>>,
}

impl Score {
    /// Zeros: all frames count alike at first, so attention starts as the mean.
    fn init(channels: usize, device: &Device) -> Self {
        Self { weight: filled([channels], 0.0, device), confidence: filled([1], 0.0, device) }
    }

    /// # Shapes
    /// `[K, 1, H, W]`
    fn forward(&self, frames: &Observed) -> Tensor<4> {
        let [_, c, _, _] = frames.values.dims();
        let weight = self.weight.val().reshape([1, c, 1, 1]);
        let factor = self.confidence.val().reshape([1, 1, 1, 1]);
        (frames.values.clone() * weight).sum_dim(1) + frames.confidence.clone() * factor
    }
}

/// Attention by alignment confidence: frames are weighted by the softmax of their scores over all frames that take part, the
/// guidance frame included, in every pixel for the maps and once for the global vector.
///
/// The guidance frame's confidence is 1. A key frame's is that of its mask, and for the global vector the mean over the pixels.
#[derive(Module, Debug)]
pub struct Attention {
    maps: Score,
    global: Score,
}

impl Attention {
    pub(super) fn init(config: &SvbrdfNetConfig, device: &Device) -> Self {
        let score = |channels: usize| Score::init(channels, device);
        Self { maps: score(config.feature_channels()), global: score(config.global_width()) }
    }

    pub(super) fn scores(&self, frames: &Both<Observed>) -> Both<Tensor<4>> {
        Both { maps: self.maps.forward(&frames.maps), global: self.global.forward(&frames.global) }
    }
}
