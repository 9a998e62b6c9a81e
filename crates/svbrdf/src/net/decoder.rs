//! The expanding half of the per-frame U-Net, up to full-resolution features.

use burn::module::Module;
use burn::tensor::{Device, Tensor, TensorData};
use ops::activation::bias_leaky_relu;
use ops::conv::{Conv3x3, Padding};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::convolution::Convolution;
use super::encoder::Encoded;
use super::global_track::GlobalTrack;
use super::{LEAK, SvbrdfNetConfig};

/// Innermost blocks with dropout while training (spec 4.1).
const DROPOUT_BLOCKS: usize = 3;

#[derive(Module, Debug)]
struct DecoderBlock {
    enlarged: Convolution,
    refined: Convolution,
    global: GlobalTrack,
}

/// Blocks of nearest ×2 enlargement and two convolutions, joined by the encoder's levels.
#[derive(Module, Debug)]
pub struct Decoder {
    blocks: Vec<DecoderBlock>,
    dropout: f32,
}

/// Features at full resolution, per frame or pooled.
#[derive(Clone, Debug)]
pub struct Features {
    /// `[N, C, H, W]`, before activation; per frame C is the net's width, and 6 more with the frames' colours.
    pub maps: Tensor<4>,
    /// `[N, global]`
    pub global: Tensor<2>,
}

impl Decoder {
    pub(super) fn init(config: &SvbrdfNetConfig, device: &Device, rng: &mut ChaCha8Rng) -> Self {
        let (encoder, decoder, global) = (config.encoder_widths(), config.decoder_widths(), config.global_width());
        let levels = encoder.len();
        let blocks = (0..levels)
            .map(|i| {
                let from = if i == 0 { encoder[levels - 1] } else { decoder[i - 1] + encoder[levels - 1 - i] };
                let width = decoder[i];
                DecoderBlock {
                    enlarged: Convolution::init(from, width, config, device, rng),
                    refined: Convolution::init(width, width, config, device, rng),
                    global: GlobalTrack::init(width, Some(global), global, device, rng),
                }
            })
            .collect();
        Self { blocks, dropout: config.dropout }
    }

    /// Decodes what the encoder saw into features of `height × width` pixels; `dropout` draws the masks while training.
    ///
    /// # Shapes
    /// See [`Features`].
    pub fn forward(&self, encoded: Encoded, [height, width]: [usize; 2], mut dropout: Option<&mut ChaCha8Rng>) -> Features {
        let Encoded { mut levels, mut global } = encoded;
        let mut x = levels.pop().expect("a validated net has at least one level");
        let last = self.blocks.len() - 1;
        for (i, block) in self.blocks.iter().enumerate() {
            // The level that this block reaches: its size, and its maps for the next block.
            let skip = levels.pop();
            let [h, w] = skip.as_ref().map_or([height, width], |s| [s.dims()[2], s.dims()[3]]);
            let enlarged = block.enlarged.enlarge(x, [h, w]);
            let response = block.refined.respond(bias_leaky_relu(enlarged, None, LEAK), SAME);
            let step = block.global.forward(response.means, Some(global));
            global = step.global;
            // Slope 1 only adds the bias: warping interpolates features that are not yet activated.
            x = bias_leaky_relu(response.maps, step.bias, if i == last { 1.0 } else { LEAK });
            if let Some(rng) = dropout.as_deref_mut().filter(|_| i < DROPOUT_BLOCKS && self.dropout > 0.0) {
                x = drop_values(x, self.dropout, rng);
            }
            x = match skip {
                Some(skip) => Tensor::cat(vec![x, skip], 1),
                None => x,
            };
        }
        Features { maps: x, global }
    }

    pub(super) fn convolutions(&self) -> impl Iterator<Item = &Convolution> {
        self.blocks.iter().flat_map(|b| [&b.enlarged, &b.refined])
    }
}

const SAME: Conv3x3 = Conv3x3::same(Padding::Edge);

/// Zeroes values with probability `share` and scales the rest up, by a mask from the caller's stream.
fn drop_values(x: Tensor<4>, share: f32, rng: &mut ChaCha8Rng) -> Tensor<4> {
    let shape = x.dims();
    let kept = 1.0 / (1.0 - share);
    let mask: Vec<f32> = (0..shape.iter().product()).map(|_| if rng.random::<f32>() < share { 0.0 } else { kept }).collect();
    let mask = Tensor::from_data(TensorData::new(mask, shape), &x.device());
    x * mask
}
