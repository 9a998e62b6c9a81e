//! The SVBRDF net (paper §6, Fig. 5): encoder and decoder per frame, warp and pooling across frames, head.

pub mod attention;
pub mod convolution;
pub mod decoder;
pub mod encoder;
pub mod fusion;
pub mod global_track;
pub mod head;
mod least_squares;
pub mod pooling;
mod size;

use burn::module::Module;
use burn::tensor::{Device, Int, Tensor};
use rand_chacha::ChaCha8Rng;
use render::svbrdf::{Svbrdf, SvbrdfImage};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use decoder::Features;
pub use fusion::{FusionError, KeyFrame, Warps};
pub use head::Prediction;
pub use pooling::{Pooled, Pooling};

use crate::constants::ConstantMaps;
use attention::Attention;
use decoder::Decoder;
use encoder::Encoder;
use head::Head;
use least_squares::LeastSquares;

/// Negative slope of every leaky ReLU (spec 4.1).
pub const LEAK: f32 = 0.2;
/// Widths of the encoder's levels over the net's width.
const ENCODER: [usize; 8] = [1, 2, 4, 8, 8, 8, 8, 8];
/// Widths of the decoder's blocks over the net's width, innermost first.
const DECODER: [usize; 8] = [8, 8, 8, 8, 4, 2, 1, 1];
/// Widths of the head at width 64.
const HEAD: [usize; 5] = [64, 64, 48, 32, 16];
/// Width that [`HEAD`] belongs to.
const PAPER_WIDTH: usize = 64;
/// Narrowest layer of a scaled head, unless the net itself is narrower.
const NARROWEST_HEAD: usize = 16;

/// What keeps the size of activations in check.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Normalisation {
    /// Filters of unit norm (paper Eq. 5).
    Weight,
    /// Instance normalisation (Deschaintre et al. 2018; ablation of Table 2).
    Instance,
}

/// How frames come together.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Fusion {
    /// Features are warped into the guidance frame; invalid ones take no part (the paper's method).
    Features,
    /// Frames are warped before the net sees them, with their mask (ablation of Table 2).
    Frames,
    /// No warp: every frame shows the whole sample (Deschaintre et al. 2019).
    None,
}

/// Whether the head sees the frames' colours beside the U-Net's features.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum PixelFeatures {
    /// Only the U-Net's features (paper).
    None,
    /// Each frame's linear colours and their negatives are warped and pooled too, so the head knows every pixel's brightest and
    /// darkest observation from the first step on: what a small budget needs.
    Extremes,
}

/// Where the outputs start before any training.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum OutputStart {
    /// Zero bias: mid-grey albedos and roughness, flat normals (paper).
    Zero,
    /// The medians of the training targets, set by [`SvbrdfNet::starting_at`].
    Medians,
    /// Medians, but albedos that suit the untrained features best, set by [`SvbrdfNet::fitted_to`]: what a small budget needs.
    LeastSquares,
}

/// Initial state of the last layer.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct OutputConfig {
    /// Initial bias.
    pub start: OutputStart,
    /// Factor on the Xavier initialisation of the weights.
    pub gain: f32,
}

impl Default for OutputConfig {
    fn default() -> Self {
        Self { start: OutputStart::Zero, gain: 0.02 }
    }
}

/// The net's shape. The defaults are the paper's.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SvbrdfNetConfig {
    /// Features per pixel and unit of all widths (64 in the paper).
    pub width: usize,
    /// Halvings of the U-Net, 1 to 8.
    pub levels: usize,
    /// What keeps activations in check.
    pub normalisation: Normalisation,
    /// Norm of every filter under weight normalisation: 1 in the paper; √2 keeps activations from fading through the leaky
    /// ReLUs, which helps small budgets.
    pub filter_gain: f32,
    /// How frames come together.
    pub fusion: Fusion,
    /// Whether the head sees the frames' colours too.
    pub pixel_features: PixelFeatures,
    /// What reduces the frames to one.
    pub pooling: Pooling,
    /// Share of values dropped in the three innermost decoder blocks while training; small budgets want 0.
    #[schemars(extend("unit" = "share of values"))]
    pub dropout: f32,
    /// Initial state of the last layer.
    pub output: OutputConfig,
}

impl Default for SvbrdfNetConfig {
    fn default() -> Self {
        Self {
            width: PAPER_WIDTH,
            levels: ENCODER.len(),
            normalisation: Normalisation::Weight,
            filter_gain: 1.0,
            fusion: Fusion::Features,
            pixel_features: PixelFeatures::None,
            pooling: Pooling::Max,
            dropout: 0.5,
            output: OutputConfig::default(),
        }
    }
}

/// A net that can't be built.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum NetConfigError {
    /// The width is out of range.
    #[error("svbrdf net: width is {found}, expected 4 to 256 (64 in the paper, 16 for small budgets)")]
    Width {
        /// The value found.
        found: usize,
    },
    /// The number of levels is out of range.
    #[error("svbrdf net: levels is {found}, expected 1 to 8")]
    Levels {
        /// The value found.
        found: usize,
    },
    /// The dropout share is no share.
    #[error("svbrdf net: dropout is {found}, expected at least 0 and less than 1")]
    Dropout {
        /// The value found.
        found: f32,
    },
    /// The gain isn't a positive number.
    #[error("svbrdf net: output.gain is {found}, expected a number above 0 and at most 10 (0.02 in the paper's code)")]
    Gain {
        /// The value found.
        found: f32,
    },
}

impl SvbrdfNetConfig {
    /// Checks the values before any work.
    ///
    /// # Errors
    /// Names the first value that is out of range.
    pub fn validate(&self) -> Result<(), NetConfigError> {
        if !(4..=256).contains(&self.width) {
            return Err(NetConfigError::Width { found: self.width });
        }
        if !(1..=ENCODER.len()).contains(&self.levels) {
            return Err(NetConfigError::Levels { found: self.levels });
        }
        if !(0.0..1.0).contains(&self.dropout) {
            return Err(NetConfigError::Dropout { found: self.dropout });
        }
        if !(self.output.gain > 0.0 && self.output.gain <= 10.0) {
            return Err(NetConfigError::Gain { found: self.output.gain });
        }
        Ok(())
    }

    /// Draws a net's initial weights from `rng`.
    ///
    /// # Errors
    /// See [`Self::validate`].
    pub fn init(&self, device: &Device, rng: &mut ChaCha8Rng) -> Result<SvbrdfNet, NetConfigError> {
        self.validate()?;
        Ok(SvbrdfNet {
            encoder: Encoder::init(self, self.input_channels(), device, rng),
            decoder: Decoder::init(self, device, rng),
            head: Head::init(self, device, rng),
            attention: (self.pooling == Pooling::Attention).then(|| Attention::init(self, device)),
            config: self.clone(),
        })
    }

    /// RGB, two coordinates and, for warped frames, their mask.
    fn input_channels(&self) -> usize {
        match self.fusion {
            Fusion::Features | Fusion::None => 5,
            Fusion::Frames => 6,
        }
    }

    /// Channels that are warped and pooled.
    fn feature_channels(&self) -> usize {
        match self.pixel_features {
            PixelFeatures::None => self.width,
            PixelFeatures::Extremes => self.width + 6,
        }
    }

    /// Pooled channels that come from the frames' colours, whatever their statistics.
    fn pooled_colours(&self) -> usize {
        self.pooling.statistics() * (self.feature_channels() - self.width)
    }

    fn encoder_widths(&self) -> Vec<usize> {
        ENCODER[..self.levels].iter().map(|f| f * self.width).collect()
    }

    fn decoder_widths(&self) -> Vec<usize> {
        DECODER[DECODER.len() - self.levels..].iter().map(|f| f * self.width).collect()
    }

    fn head_widths(&self) -> Vec<usize> {
        let narrowest = NARROWEST_HEAD.min(self.width);
        HEAD.iter().map(|h| (h * self.width / PAPER_WIDTH).max(narrowest)).collect()
    }

    /// Channels that a layer of the head reads, and how long the global vector before it is.
    fn head_inputs(&self, layer: usize) -> (usize, usize) {
        match layer {
            0 => (self.pooling.statistics() * self.feature_channels(), self.pooling.statistics() * self.global_width()),
            _ => (self.head_widths()[layer - 1], self.global_width()),
        }
    }

    fn global_width(&self) -> usize {
        2 * self.width
    }
}

/// A known case for [`SvbrdfNet::fitted_to`]: what [`SvbrdfNet::forward`] takes and the maps it should give.
pub struct FitExemplar {
    /// `[K + 1, 3, H, W]`
    pub frames: Tensor<4>,
    /// `[K, 2, H, W]`
    pub flow: Tensor<4>,
    /// `[K, 1, H, W]`
    pub valid: Tensor<4>,
    /// The guidance frame's maps.
    pub target: SvbrdfImage,
}

/// The SVBRDF net.
#[derive(Module, Debug)]
pub struct SvbrdfNet {
    encoder: Encoder,
    decoder: Decoder,
    head: Head,
    /// Present for [`Pooling::Attention`].
    attention: Option<Attention>,
    #[module(skip)]
    config: SvbrdfNetConfig,
}

impl SvbrdfNet {
    /// The shape it was built from.
    pub fn config(&self) -> &SvbrdfNetConfig {
        &self.config
    }

    /// Maps of the guidance frame's pixels.
    ///
    /// # Shapes
    /// `frames [K + 1, 3, H, W]`, guidance first, gamma-encoded RGB in [0, 1]; `flow [K, 2, H, W]` backward, from guidance pixels into
    /// each key frame, NaN where invalid; `valid [K, 1, H, W]` in [0, 1] (see [`Warps::new`]). Any H and W; maps `[1, …, H, W]`.
    pub fn forward(&self, frames: Tensor<4>, flow: Tensor<4>, valid: Option<Tensor<4>>) -> Svbrdf {
        self.predict(frames, flow, valid, None).maps
    }

    /// Like [`Self::forward`], with the bounded outputs, and with dropout when it gets a random stream.
    pub fn predict(
        &self,
        frames: Tensor<4>,
        flow: Tensor<4>,
        valid: Option<Tensor<4>>,
        dropout: Option<&mut ChaCha8Rng>,
    ) -> Prediction {
        let pooled = self.pooled(frames, Warps::new(flow, valid, self.config.pooling), dropout);
        self.decode(pooled)
    }

    /// The features of all frames, merged in the guidance frame's pixels.
    fn pooled(&self, frames: Tensor<4>, warps: Warps, dropout: Option<&mut ChaCha8Rng>) -> Pooled {
        let [n, _, h, w] = frames.dims();
        let guided = Tensor::cat(vec![Tensor::zeros([1, 2, h, w], &warps.flow.device()), warps.flow.clone()], 0);
        let features = self.extract(self.frame_inputs(frames, guided), dropout);
        let [_, c, _, _] = features.maps.dims();
        let [_, g] = features.global.dims();
        if n == 1 {
            return self.begin(features);
        }
        let part = |range: std::ops::Range<usize>| Features {
            maps: features.maps.clone().slice([range.clone(), 0..c, 0..h, 0..w]),
            global: features.global.clone().slice([range, 0..g]),
        };
        self.pool(self.begin(part(0..1)), part(1..n), &warps)
    }

    /// What the encoder reads: linear light in [−1, 1], coordinates and, for warped frames, their mask.
    ///
    /// # Shapes
    /// `frames [N, 3, H, W]` gamma-encoded, `flow [N, 2, H, W]` (read only where frames are warped) → `[N, 5 or 6, H, W]`
    pub fn frame_inputs(&self, frames: Tensor<4>, flow: Tensor<4>) -> Tensor<4> {
        let [n, _, h, w] = frames.dims();
        let device = frames.device();
        let linear = frames.powf_scalar(ops::colour::GAMMA) * 2.0 - 1.0;
        let seen = match self.config.fusion {
            Fusion::Features | Fusion::None => linear,
            Fusion::Frames => fusion::warped_frames(linear, flow),
        };
        // x from −1 to 1 rightwards, y from +1 to −1 downwards.
        let ramp = |length: usize, from: f32, to: f32| {
            let step = (to - from) / (length.max(2) - 1) as f32;
            Tensor::<1, Int>::arange(0..length as i64, &device).float() * step + from
        };
        let x = ramp(w, -1.0, 1.0).reshape([1, 1, 1, w]).expand([n, 1, h, w]);
        let y = ramp(h, 1.0, -1.0).reshape([1, 1, h, 1]).expand([n, 1, h, w]);
        Tensor::cat(vec![seen, x, y], 1)
    }

    /// Features of frames, each on its own, without dropout.
    ///
    /// # Shapes
    /// `inputs` from [`Self::frame_inputs`].
    pub fn features(&self, inputs: Tensor<4>) -> Features {
        self.extract(inputs, None)
    }

    fn extract(&self, inputs: Tensor<4>, dropout: Option<&mut ChaCha8Rng>) -> Features {
        let [n, _, h, w] = inputs.dims();
        let features = self.decoder.forward(self.encoder.forward(inputs.clone()), [h, w], dropout);
        match self.config.pixel_features {
            PixelFeatures::None => features,
            PixelFeatures::Extremes => {
                let colours = inputs.slice([0..n, 0..3, 0..h, 0..w]);
                Features { maps: Tensor::cat(vec![features.maps, colours.clone(), colours.neg()], 1), ..features }
            }
        }
    }

    /// Maps from pooled features.
    pub fn decode(&self, pooled: Pooled) -> Prediction {
        self.head.forward(pooled.features())
    }

    /// The same net whose outputs start at constant maps: the last layer's bias becomes their atanh.
    pub fn starting_at(mut self, constants: &ConstantMaps) -> Self {
        self.head = self.head.starting_at(constants);
        self
    }

    /// The same net with the last layer whose albedo logits come nearest to those of the exemplars' maps.
    ///
    /// Each exemplar holds what [`Self::forward`] takes, and the maps. Without any exemplar the net stays as it is.
    pub fn fitted_to<E>(mut self, exemplars: impl IntoIterator<Item = Result<FitExemplar, E>>) -> Result<Self, E> {
        let mut fit: Option<LeastSquares> = None;
        for exemplar in exemplars {
            let FitExemplar { frames, flow, valid, target } = exemplar?;
            let pooled = self.pooled(frames, Warps::new(flow, Some(valid), self.config.pooling), None);
            let inputs = self.head.last_inputs(pooled.features());
            let [_, channels, _, _] = inputs.dims();
            let inputs = ops::planes::Planes::from_tensor(inputs).remove(0);
            fit.get_or_insert_with(|| LeastSquares::new(channels)).add(&inputs, &target);
        }
        if let Some(rows) = fit.and_then(LeastSquares::solve) {
            self.head = self.head.with_albedos(rows);
        }
        Ok(self)
    }

    /// Number of filter weights of all convolutions (41 M at width 64).
    pub fn convolution_parameters(&self) -> usize {
        self.convolutions().map(convolution::Convolution::filter_parameters).sum::<usize>() + self.head.output_parameters()
    }

    /// All normalised convolutions, from the input to the head.
    pub fn convolutions(&self) -> impl Iterator<Item = &convolution::Convolution> {
        self.encoder.convolutions().chain(self.decoder.convolutions()).chain(self.head.convolutions())
    }
}
