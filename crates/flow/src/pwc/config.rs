//! The architecture as a value: what is stored beside weights and read from config files.

use burn::tensor::Device;
use rand::Rng;
use serde::{Deserialize, Serialize};

use super::{Pwc, context, context::Context, cost::Matching, estimator::Estimator, pyramid::Pyramid};

/// What the pyramid sees.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Input {
    /// Gamma-encoded RGB as it comes.
    #[default]
    Plain,
    /// Deviation from the local mean over the local deviation (window of 17 px).
    LocalContrast,
}

/// Architecture of PWC-Net. Every key has a default: the net of the paper.
///
/// # Source
/// Sun et al. 2018; spec 3.1. Departs: `match_head`, `feature_normalisation` and `input = "local-contrast"` (all off by
/// default) teach matching within minutes instead of days.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PwcConfig {
    /// Feature channels per pyramid level, finest (half resolution) first.
    pub channels: Vec<usize>,
    /// Convolutions per pyramid level; the first one halves.
    pub convs_per_level: usize,
    /// Widths of the estimators' convolutions.
    pub estimator: Vec<usize>,
    /// Radius of the cost volume in pixels of the level.
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
    /// No convolution in an estimator.
    #[error("`estimator` is empty; list at least one width, for example [64, 32]")]
    NoEstimator,
    /// Too many dilated convolutions.
    #[error("`context` lists {0} widths; the context net has at most 6")]
    Context(usize),
    /// Cost volume of no or too large extent.
    #[error("`radius` is {0}; the cost volume reaches 1 to 9 pixels of a level")]
    Radius(usize),
    /// Pyramid levels without or with too many convolutions.
    #[error("`convs_per_level` is {0}; give 1 to 8")]
    ConvsPerLevel(usize),
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
            radius: 4,
            context: vec![128, 128, 128, 96, 64, 32],
            input: Input::Plain,
            feature_normalisation: false,
            match_head: false,
        }
    }

    /// Half the width, four levels, no context net, all learning aids: 0.5 M parameters that learn within minutes.
    pub fn slim() -> Self {
        Self {
            channels: vec![8, 16, 32, 48],
            convs_per_level: 2,
            estimator: vec![64, 64, 48, 32, 16],
            radius: 4,
            context: Vec::new(),
            input: Input::LocalContrast,
            feature_normalisation: true,
            match_head: true,
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
            c if c.estimator.is_empty() => Err(PwcConfigError::NoEstimator),
            c if c.context.len() >= context::DILATIONS.len() => Err(PwcConfigError::Context(c.context.len())),
            c if !(1..=9).contains(&c.radius) => Err(PwcConfigError::Radius(c.radius)),
            c if !(1..=8).contains(&c.convs_per_level) => Err(PwcConfigError::ConvsPerLevel(c.convs_per_level)),
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
        let predicting = |inputs: usize, widths: &[usize]| -> usize {
            let from = std::iter::once(inputs).chain(widths.iter().copied());
            from.zip(widths.iter().copied().chain([2])).map(|(inputs, outputs)| conv(inputs, outputs)).sum()
        };
        let from = std::iter::once(3).chain(self.channels.iter().copied());
        let level = |(from, width): (usize, &usize)| conv(from, *width) + (self.convs_per_level - 1) * conv(*width, *width);
        let pyramid: usize = from.zip(&self.channels).map(level).sum();
        let estimators: usize = self.estimator_inputs().map(|inputs| predicting(inputs, &self.estimator)).sum();
        let context = if self.context.is_empty() { 0 } else { predicting(self.estimated() + 2, &self.context) };
        pyramid + estimators + context + if self.match_head { self.flow_levels() } else { 0 }
    }

    /// Features that an estimator hands on.
    fn estimated(&self) -> usize {
        *self.estimator.last().expect("validated")
    }

    /// Channels that the estimators see, coarse to fine.
    fn estimator_inputs(&self) -> impl Iterator<Item = usize> {
        let displacements = (2 * self.radius + 1).pow(2);
        (1..self.channels.len()).rev().map(move |level| {
            let coarser = if level + 1 == self.channels.len() { 0 } else { 2 + self.estimated() };
            displacements + self.channels[level] + coarser
        })
    }

    /// Builds the net with random weights (Kaiming for leaky ReLU).
    ///
    /// # Panics
    /// If the config isn't [valid](Self::validate).
    pub fn init(&self, device: &Device, rng: &mut impl Rng) -> Pwc {
        self.validate().expect("the config was validated");
        let pyramid = Pyramid::new(&self.channels, self.convs_per_level, device, rng);
        let estimators = self.estimator_inputs().map(|inputs| Estimator::new(inputs, &self.estimator, device, rng)).collect();
        let matchings = (0..self.flow_levels()).map(|_| Matching::new(self.radius, self.match_head, device)).collect();
        let context = (!self.context.is_empty()).then(|| Context::new(self.estimated() + 2, &self.context, device, rng));
        Pwc { pyramid, matchings, estimators, context, config: self.clone() }
    }
}

impl Pwc {
    /// The architecture this net was built from.
    pub fn config(&self) -> &PwcConfig {
        &self.config
    }
}
