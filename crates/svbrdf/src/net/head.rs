//! From pooled features to maps.

use burn::module::{Module, Param};
use burn::tensor::{Device, Tensor, TensorData};
use ops::activation::bias_leaky_relu;
use ops::conv::{Conv3x3, Padding, conv3x3};
use ops::planes::values;
use rand_chacha::ChaCha8Rng;
use render::svbrdf::Svbrdf;

use super::convolution::{Convolution, gaussian};
use super::global_track::GlobalTrack;
use super::least_squares::{ALBEDOS, AlbedoRows};
use super::{Features, LEAK, SvbrdfNetConfig};
use crate::constants::{ConstantMaps, OUTPUTS};

/// Largest slope |nx / nz| or |ny / nz| the net can express (paper §6: tanh × 3).
pub const NORMAL_SLOPE: f32 = 3.0;
/// Logits beyond this (|tanh| > 0.98) pass less than 4 % of the gradient.
const FLAT: f32 = 2.3;

const SAME: Conv3x3 = Conv3x3::same(Padding::Edge);

#[derive(Module, Debug)]
struct HeadLayer {
    convolution: Convolution,
    global: GlobalTrack,
}

/// Convolutions with global track, the last one with bias and tanh.
#[derive(Module, Debug)]
pub struct Head {
    layers: Vec<HeadLayer>,
    /// `[9, C, 3, 3]`, not normalised; the last of C are pooled colours where the net has them, 6 per statistic.
    weight: Param<Tensor<4>>,
    /// `[9]`
    bias: Param<Tensor<1>>,
    /// Channels of a statistic that come from the U-Net; colours follow.
    features: usize,
    /// Statistics that the pooling gives one after the other.
    statistics: usize,
}

/// Maps with the net's bounded outputs they were made of.
#[derive(Clone, Debug)]
pub struct Prediction {
    /// The maps, one per batch entry.
    pub maps: Svbrdf,
    /// `[1, 9, H, W]`, before tanh: nx, ny, diffuse ×3, roughness, specular ×3.
    pub logits: Tensor<4>,
}

impl Prediction {
    /// The share of outputs in tanh's flat ends (|tanh| > 0.98). A share that climbs early in training means the net tips over.
    pub fn saturation(&self) -> f32 {
        let logits = self.logits.clone().detach().abs();
        values(logits.greater_elem(FLAT).float().mean())[0]
    }

    /// Mean square of the logits' part in tanh's flat ends, `[1]`: the way back for outputs that no other loss can move.
    pub fn excess(&self) -> Tensor<1> {
        (self.logits.clone().abs() - FLAT).clamp_min(0.0).square().mean()
    }
}

impl Head {
    pub(super) fn init(config: &SvbrdfNetConfig, device: &Device, rng: &mut ChaCha8Rng) -> Self {
        let widths = config.head_widths();
        let layers = (0..widths.len())
            .map(|i| {
                let (from, previous) = config.head_inputs(i);
                HeadLayer {
                    convolution: Convolution::init(from, widths[i], config, device, rng),
                    global: GlobalTrack::init(widths[i], Some(previous), config.global_width(), device, rng),
                }
            })
            .collect();
        let inputs = *widths.last().expect("the head has layers") + config.pooled_colours();
        // Xavier normal: √(2 / (fan in + fan out)), times the configured gain (spec 4.1: 0.02).
        let std = config.output.gain * (2.0 / (9 * (inputs + OUTPUTS)) as f32).sqrt();
        let weight = gaussian([OUTPUTS, inputs, 3, 3], std, device, rng);
        let bias = Param::from_data(TensorData::new(vec![0.0f32; OUTPUTS], [OUTPUTS]), device);
        Self { layers, weight, bias, features: config.width, statistics: config.pooling.statistics() }
    }

    /// The same head whose outputs start at `constants`.
    pub(super) fn starting_at(mut self, constants: &ConstantMaps) -> Self {
        let device = self.bias.val().device();
        let bias = TensorData::new(constants.output_bias().to_vec(), [OUTPUTS]);
        self.bias = Param::from_data(bias, &device);
        self
    }

    /// The same head with other albedos.
    pub(super) fn with_albedos(mut self, rows: AlbedoRows) -> Self {
        let (device, shape) = (self.bias.val().device(), self.weight.dims());
        let (mut weight, mut bias) = (values(self.weight.val()), values(self.bias.val()));
        let length = weight.len() / OUTPUTS;
        for (i, output) in ALBEDOS.into_iter().enumerate() {
            weight[output * length..][..length].copy_from_slice(&rows.weight[i * length..][..length]);
            bias[output] = rows.bias[i];
        }
        self.weight = Param::from_data(TensorData::new(weight, shape), &device);
        self.bias = Param::from_data(TensorData::new(bias, [OUTPUTS]), &device);
        self
    }

    /// What the last layer reads.
    ///
    /// # Shapes
    /// See [`Pooled::features`](super::Pooled::features) → `[1, C, H, W]`
    pub(super) fn last_inputs(&self, pooled: Features) -> Tensor<4> {
        let Features { maps: pooled, mut global } = pooled;
        let [n, c, h, w] = pooled.dims();
        let each = c / self.statistics;
        let colours = |i: usize| pooled.clone().slice([0..n, i * each + self.features..(i + 1) * each, 0..h, 0..w]);
        let colours: Vec<_> = (0..self.statistics).filter(|_| each > self.features).map(colours).collect();
        let mut x = bias_leaky_relu(pooled, None, LEAK);
        for layer in &self.layers {
            let response = layer.convolution.respond(x, SAME);
            let step = layer.global.forward(response.means, Some(global));
            x = bias_leaky_relu(response.maps, step.bias, LEAK);
            global = step.global;
        }
        if colours.is_empty() { x } else { Tensor::cat(std::iter::once(x).chain(colours).collect(), 1) }
    }

    /// Decodes pooled features.
    ///
    /// # Shapes
    /// See [`Pooled::features`](super::Pooled::features); maps `[1, …, H, W]`
    pub fn forward(&self, pooled: Features) -> Prediction {
        let inputs = self.last_inputs(pooled);
        let logits = conv3x3(inputs, self.weight.val(), SAME) + self.bias.val().reshape([1, OUTPUTS, 1, 1]);
        Prediction { maps: to_maps(logits.clone().tanh()), logits }
    }

    pub(super) fn convolutions(&self) -> impl Iterator<Item = &Convolution> {
        self.layers.iter().map(|l| &l.convolution)
    }

    pub(super) fn output_parameters(&self) -> usize {
        self.weight.lazy_shape().num_elements()
    }
}

/// Bounded outputs → maps: (3·nx, 3·ny, 1) normalised; albedos and roughness from [−1, 1] to [0, 1].
///
/// # Shapes
/// `[N, 9, H, W]` in [−1, 1]
fn to_maps(outputs: Tensor<4>) -> Svbrdf {
    let [n, _, h, w] = outputs.dims();
    let slopes = outputs.clone().slice([0..n, 0..2, 0..h, 0..w]) * NORMAL_SLOPE;
    let length = slopes.clone().square().sum_dim(1).add_scalar(1.0).sqrt();
    let z = Tensor::ones([n, 1, h, w], &outputs.device());
    let normal = Tensor::cat(vec![slopes, z], 1) / length;
    let unit = outputs * 0.5 + 0.5;
    let channels = |range: std::ops::Range<usize>| unit.clone().slice([0..n, range, 0..h, 0..w]);
    Svbrdf { normal, diffuse: channels(2..5), roughness: channels(5..6), specular: channels(6..9) }
}
