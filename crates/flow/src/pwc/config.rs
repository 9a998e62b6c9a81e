//! The architecture as a value: what is stored beside weights and read from config files.

use burn::tensor::Device;
use rand::Rng;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{
    Pwc, context,
    context::Context,
    cost::Matching,
    estimator::Estimator,
    pyramid::Pyramid,
    upsample::{UPSAMPLED_CHANNELS, Upsampler},
};

/// Most convolutions of an estimator.
const LONGEST_ESTIMATOR: usize = 16;

/// What the pyramid sees.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Input {
    /// Gamma-encoded RGB as it comes.
    #[default]
    Plain,
    /// Deviation from the local mean over the local deviation (window of 17 px).
    LocalContrast,
}

/// What a convolution of an estimator sees.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Connections {
    /// The output of the convolution before it. The context net sees the last one and the flow.
    #[default]
    Sequential,
    /// The outputs of all convolutions before it, newest first, and the estimator's inputs. So does the context net, without
    /// the flow.
    Dense,
}

impl Connections {
    /// Channels after a convolution of `width` on `inputs`.
    pub(crate) fn after(self, inputs: usize, width: usize) -> usize {
        match self {
            Self::Sequential => width,
            Self::Dense => width + inputs,
        }
    }
}

/// How a level's flow and features reach the next finer level.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Upsampling {
    /// By interpolation.
    #[default]
    Bilinear,
    /// By learned transposed convolutions, which narrow the features to two channels.
    Deconvolution,
}

/// What an estimator predicts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Prediction {
    /// What the upsampled flow lacks.
    #[default]
    Residual,
    /// The flow itself.
    Direct,
}

/// Architecture of PWC-Net. Every key has a default: the net of the paper.
///
/// # Source
/// Sun et al. 2018; spec 3.1. Departs: `match_head`, `feature_normalisation` and `input = "local-contrast"` (all off by
/// default) teach matching within minutes instead of days.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct PwcConfig {
    /// Feature channels per pyramid level, finest (half resolution) first.
    #[schemars(extend("unit" = "channels"))]
    pub channels: Vec<usize>,
    /// Convolutions per pyramid level; the first one halves.
    pub convs_per_level: usize,
    /// Widths of the estimators' convolutions.
    pub estimator: Vec<usize>,
    /// What a convolution of an estimator sees: `"sequential"` or `"dense"`.
    pub connections: Connections,
    /// How flow and features reach the next finer level: `"bilinear"` or `"deconvolution"`.
    pub upsampling: Upsampling,
    /// What an estimator predicts: `"residual"` or `"direct"`.
    pub prediction: Prediction,
    /// The coarsest estimator sees the first image's features beside the cost volume, as the finer ones do.
    pub coarsest_features: bool,
    /// Radius of the cost volume in pixels of the level.
    #[schemars(extend("unit" = "pixels of a level"))]
    pub radius: usize,
    /// Widths of the context net's dilated convolutions (dilations 1, 2, 4, 8, 16, 1); empty: no context net.
    pub context: Vec<usize>,
    /// What the pyramid sees.
    pub input: Input,
    /// Normalise features before they are correlated.
    pub feature_normalisation: bool,
    /// Add the soft-argmax of the cost volume (learned sharpness) to the flow.
    pub match_head: bool,
}

/// An architecture that can't be built.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PwcConfigError {
    /// Too few or too many pyramid levels.
    #[error("a flow net needs 2 to 8 pyramid levels, `channels` lists {0}")]
    Levels(usize),
    /// A width of zero or without bound.
    #[error("`{key}` holds {found}; widths must lie between 1 and 1024")]
    Width {
        /// The config key.
        key: &'static str,
        /// The value.
        found: usize,
    },
    /// No or too many convolutions in an estimator.
    #[error("`estimator` lists {0} widths; give 1 to {most}, for example [64, 32]", most = LONGEST_ESTIMATOR)]
    Estimator(usize),
    /// Too many dilated convolutions.
    #[error("`context` lists {0} widths; the context net has at most 6")]
    Context(usize),
    /// Cost volume of no or too large extent.
    #[error("`radius` is {0}; the cost volume reaches 1 to 9 pixels of a level")]
    Radius(usize),
    /// Pyramid levels without or with too many convolutions.
    #[error("`convs_per_level` is {0}; give 1 to 8")]
    ConvsPerLevel(usize),
    /// Features that would pile up from level to level.
    #[error(
        "dense connections hand on hundreds of features, which only deconvolutions narrow; set `upsampling = \"deconvolution\"` or `connections = \"sequential\"`"
    )]
    DenseBilinear,
    /// A displacement without the flow that it starts from.
    #[error("`match_head` finds what the upsampled flow lacks; set `prediction = \"residual\"` or `match_head = false`")]
    DirectMatchHead,
}

impl Default for PwcConfig {
    fn default() -> Self {
        Self::paper()
    }
}

impl PwcConfig {
    /// The full net: six levels, 5.03 M parameters.
    pub fn paper() -> Self {
        Self {
            channels: vec![16, 32, 64, 96, 128, 192],
            convs_per_level: 3,
            estimator: vec![128, 128, 96, 64, 32],
            connections: Connections::Sequential,
            upsampling: Upsampling::Bilinear,
            prediction: Prediction::Residual,
            coarsest_features: true,
            radius: 4,
            context: vec![128, 128, 128, 96, 64, 32],
            input: Input::Plain,
            feature_normalisation: false,
            match_head: false,
        }
    }

    /// The net that Sun et al. published (PWC-DC-Net): 9.37 M parameters, to which the tensors of their PyTorch release
    /// correspond one to one.
    ///
    /// | published, at level `l` from 1 (finest) to 6 | here |
    /// |---|---|
    /// | `conv{l}a.0`, `conv{l}aa.0`, `conv{l}b.0`; of level 6 `conv6aa.0`, `conv6a.0`, `conv6b.0` | `pyramid.levels.{l - 1}.convs.0` … `2` |
    /// | `conv{l}_{k}.0` | `estimators.{6 - l}.convs.{k}` |
    /// | `predict_flow{l}` | `estimators.{6 - l}.predict` |
    /// | `deconv{l}`, `upfeat{l}` | `upsamplers.{6 - l}.flow`, `upsamplers.{6 - l}.features` |
    /// | `dc_conv1.0` … `dc_conv6.0`, `dc_conv7` | `context.convs.0` … `5`, `context.predict` |
    ///
    /// Nothing reads the release's `deconv2`. Its images are BGR: the input channels of `conv1a.0.weight` are to be reversed
    /// for this net, which sees RGB. Its first version lacks the `aa` convolutions: `convs_per_level = 2`.
    /// [`from_release`](super::release::from_release) does all of this.
    ///
    /// # Source
    /// Sun et al. 2018 and their release. Departs: the release's warp keeps samples up to 1e-4 px outside.
    pub fn published() -> Self {
        Self {
            channels: vec![16, 32, 64, 96, 128, 196],
            connections: Connections::Dense,
            upsampling: Upsampling::Deconvolution,
            prediction: Prediction::Direct,
            coarsest_features: false,
            ..Self::paper()
        }
    }

    /// Half the width, four levels, no context net, all learning aids: 0.5 M parameters that learn within minutes.
    pub fn slim() -> Self {
        Self {
            channels: vec![8, 16, 32, 48],
            convs_per_level: 2,
            estimator: vec![64, 64, 48, 32, 16],
            context: Vec::new(),
            input: Input::LocalContrast,
            feature_normalisation: true,
            match_head: true,
            ..Self::paper()
        }
    }

    /// Is this a net that can be built?
    ///
    /// # Errors
    /// Names the key that can't be and what it may be.
    pub fn validate(&self) -> Result<(), PwcConfigError> {
        let widths = [("channels", &self.channels), ("estimator", &self.estimator), ("context", &self.context)];
        for (key, widths) in widths {
            if let Some(&found) = widths.iter().find(|w| !(1..=1024).contains(*w)) {
                return Err(PwcConfigError::Width { key, found });
            }
        }
        match self {
            c if !(2..=8).contains(&c.channels.len()) => Err(PwcConfigError::Levels(c.channels.len())),
            c if !(1..=LONGEST_ESTIMATOR).contains(&c.estimator.len()) => Err(PwcConfigError::Estimator(c.estimator.len())),
            c if c.context.len() >= context::DILATIONS.len() => Err(PwcConfigError::Context(c.context.len())),
            c if !(1..=9).contains(&c.radius) => Err(PwcConfigError::Radius(c.radius)),
            c if !(1..=8).contains(&c.convs_per_level) => Err(PwcConfigError::ConvsPerLevel(c.convs_per_level)),
            Self { connections: Connections::Dense, upsampling: Upsampling::Bilinear, .. } => {
                Err(PwcConfigError::DenseBilinear)
            }
            Self { prediction: Prediction::Direct, match_head: true, .. } => Err(PwcConfigError::DirectMatchHead),
            _ => Ok(()),
        }
    }

    /// Sizes are padded to a multiple of this inside the net.
    pub fn multiple(&self) -> usize {
        1 << self.channels.len()
    }

    /// How many flows the net gives, coarse to fine; the finest at a quarter of the resolution.
    pub fn flow_levels(&self) -> usize {
        self.channels.len() - 1
    }

    /// How many weights the net has.
    pub fn parameters(&self) -> usize {
        let conv = |inputs: usize, outputs: usize| (inputs * 9 + 1) * outputs;
        let predicting = |inputs: usize, widths: &[usize], connections: Connections| -> usize {
            let mut channels = inputs;
            let convs = widths.iter().map(|&width| {
                let inputs = channels;
                channels = connections.after(inputs, width);
                conv(inputs, width)
            });
            convs.sum::<usize>() + conv(channels, 2)
        };
        let from = std::iter::once(3).chain(self.channels.iter().copied());
        let level = |(from, width): (usize, &usize)| conv(from, *width) + (self.convs_per_level - 1) * conv(*width, *width);
        let pyramid: usize = from.zip(&self.channels).map(level).sum();
        let estimator = |inputs| predicting(inputs, &self.estimator, self.connections);
        let estimators: usize = self.estimator_inputs().map(estimator).sum();
        let upsamplers: usize = self.upsampler_inputs().map(Upsampler::parameters).sum();
        let context = match self.context.as_slice() {
            [] => 0,
            widths => predicting(self.context_inputs(), widths, Connections::Sequential),
        };
        pyramid + estimators + upsamplers + context + if self.match_head { self.flow_levels() } else { 0 }
    }

    /// Channels that the estimators see, coarse to fine.
    fn estimator_inputs(&self) -> impl Iterator<Item = usize> {
        let displacements = (2 * self.radius + 1).pow(2);
        // Flow and features. Those that are interpolated are an output of sequential convolutions, whatever their inputs.
        let upsampled = match self.upsampling {
            Upsampling::Bilinear => 2 + self.handed_on(0),
            Upsampling::Deconvolution => 2 * UPSAMPLED_CHANNELS,
        };
        (1..self.channels.len()).rev().map(move |level| {
            let features = self.channels[level];
            match level + 1 == self.channels.len() {
                true if self.coarsest_features => displacements + features,
                true => displacements,
                false => displacements + features + upsampled,
            }
        })
    }

    /// Features that an estimator of so many inputs hands on.
    fn handed_on(&self, inputs: usize) -> usize {
        self.estimator.iter().fold(inputs, |channels, &width| self.connections.after(channels, width))
    }

    /// Features that the deconvolutions see, coarse to fine; nothing where they interpolate.
    fn upsampler_inputs(&self) -> impl Iterator<Item = usize> {
        let upsamplers = match self.upsampling {
            Upsampling::Bilinear => 0,
            Upsampling::Deconvolution => self.flow_levels() - 1,
        };
        self.estimator_inputs().take(upsamplers).map(|inputs| self.handed_on(inputs))
    }

    /// Channels that the context net sees.
    fn context_inputs(&self) -> usize {
        let finest = self.estimator_inputs().last().expect("validated");
        match self.connections {
            Connections::Sequential => self.handed_on(finest) + 2,
            Connections::Dense => self.handed_on(finest),
        }
    }

    /// Builds the net with random weights (Kaiming for leaky ReLU; a flow's deconvolution interpolates).
    ///
    /// # Panics
    /// If the config isn't [valid](Self::validate).
    pub fn init(&self, device: &Device, rng: &mut impl Rng) -> Pwc {
        self.validate().expect("the config was validated");
        let pyramid = Pyramid::new(&self.channels, self.convs_per_level, device, rng);
        let estimator = |inputs| Estimator::new(inputs, &self.estimator, self.connections, device, rng);
        let estimators = self.estimator_inputs().map(estimator).collect();
        let upsamplers = self.upsampler_inputs().map(|inputs| Upsampler::new(inputs, device, rng)).collect();
        let matchings = (0..self.flow_levels()).map(|_| Matching::new(self.radius, self.match_head, device)).collect();
        let context = (!self.context.is_empty()).then(|| Context::new(self.context_inputs(), &self.context, device, rng));
        Pwc { pyramid, matchings, estimators, upsamplers, context, config: self.clone() }
    }
}

impl Pwc {
    /// The architecture this net was built from.
    pub fn config(&self) -> &PwcConfig {
        &self.config
    }
}
