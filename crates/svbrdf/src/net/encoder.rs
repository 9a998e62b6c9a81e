//! The contracting half of the per-frame U-Net.

use burn::module::Module;
use burn::tensor::{Device, Tensor};
use ops::activation::bias_leaky_relu;
use ops::conv::{Conv3x3, Padding};
use rand_chacha::ChaCha8Rng;

use super::convolution::Convolution;
use super::global_track::GlobalTrack;
use super::{LEAK, SvbrdfNetConfig};

#[derive(Module, Debug)]
struct EncoderLevel {
    convolution: Convolution,
    global: GlobalTrack,
}

/// Stride-2 convolutions, each with its global track.
#[derive(Module, Debug)]
pub struct Encoder {
    levels: Vec<EncoderLevel>,
}

/// What the encoder hands to the decoder.
pub struct Encoded {
    /// Activated maps of every level, finest first. The leaky ReLU that follows a level in the encoder is the same that the
    /// decoder would apply to its copy, so it is applied once, here.
    pub levels: Vec<Tensor<4>>,
    /// `[N, global]`
    pub global: Tensor<2>,
}

impl Encoder {
    /// Draws an encoder of `inputs` channels.
    pub(super) fn init(config: &SvbrdfNetConfig, inputs: usize, device: &Device, rng: &mut ChaCha8Rng) -> Self {
        let (widths, global) = (config.encoder_widths(), config.global_width());
        let levels = (0..widths.len())
            .map(|i| {
                let from = if i == 0 { inputs } else { widths[i - 1] };
                EncoderLevel {
                    convolution: Convolution::init(from, widths[i], config, device, rng),
                    global: GlobalTrack::init(widths[i], (i > 0).then_some(global), global, device, rng),
                }
            })
            .collect();
        Self { levels }
    }

    /// Encodes frames independently of each other.
    ///
    /// # Shapes
    /// `[N, inputs, H, W]`; level `i` is `[N, C_i, ceil(H / 2^(i+1)), ceil(W / 2^(i+1))]`
    pub fn forward(&self, frames: Tensor<4>) -> Encoded {
        let mut levels: Vec<Tensor<4>> = Vec::with_capacity(self.levels.len());
        let mut global = None;
        let mut x = frames;
        for level in &self.levels {
            let response = level.convolution.respond(x, Conv3x3::halving(Padding::Edge));
            let step = level.global.forward(response.means, global);
            x = bias_leaky_relu(response.maps, step.bias, LEAK);
            levels.push(x.clone());
            global = Some(step.global);
        }
        Encoded { levels, global: global.expect("a validated net has at least one level") }
    }

    pub(super) fn convolutions(&self) -> impl Iterator<Item = &Convolution> {
        self.levels.iter().map(|l| &l.convolution)
    }
}
