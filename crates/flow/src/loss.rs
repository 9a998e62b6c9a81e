//! What training minimises: flow errors at all levels, and how well the cost volumes match.

use burn::tensor::{Int, Tensor, activation::log_softmax};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{
    pwc::{LevelFlow, PwcOutput},
    target::{FLOW_UNIT_PX, FlowTarget, LevelTarget},
};

/// Under the root, so that the gradient at no error is 0 and not NaN; 0.002 px.
const ROOT_FLOOR: f32 = 1e-8;
/// Offset and exponent of the robust error.
///
/// # Source
/// Sun et al. 2018, fine-tuning loss.
const ROBUST_OFFSET: f32 = 0.01;
const ROBUST_EXPONENT: f32 = 0.4;

/// How the error of one flow vector is measured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum FlowError {
    /// Euclidean length.
    #[default]
    Euclidean,
    /// (|x|₁ + 0.01)^0.4, which forgives large errors.
    Robust,
}

/// The flow loss as a value of a config file.
///
/// # Source
/// Spec 3.1. Departs: `matching_weight`, a cross-entropy on the cost volumes, because the flow error alone doesn't teach
/// matching within minutes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct FlowLossConfig {
    /// How the error of one flow vector is measured.
    pub error: FlowError,
    /// Weight per level, coarse to fine; a net with fewer levels takes the last ones.
    pub level_weights: Vec<f32>,
    /// Weight of the cross-entropy between the cost volumes and the true displacement; 0 leaves it out.
    pub matching_weight: f32,
}

impl Default for FlowLossConfig {
    fn default() -> Self {
        Self { error: FlowError::Euclidean, level_weights: vec![0.32, 0.08, 0.02, 0.01, 0.005], matching_weight: 0.0 }
    }
}

/// Loss weights that can't be.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FlowLossConfigError {
    /// Not enough weights for the net.
    #[error("`level_weights` lists {found} weights, the net has {needed} flow levels")]
    TooFew {
        /// Levels of the net.
        needed: usize,
        /// Weights given.
        found: usize,
    },
    /// A weight below zero or no number.
    #[error("a loss weight (`level_weights`, `matching_weight`) is {0}; weights are numbers of 0 or more")]
    Weight(f32),
}

/// The terms of the loss, each of shape `[1]`.
#[derive(Clone, Debug)]
pub struct FlowLoss {
    /// The sum of all terms.
    pub total: Tensor<1>,
    /// Weighted flow error per level, coarse to fine.
    pub levels: Vec<Tensor<1>>,
    /// Weighted cross-entropy of the cost volumes, summed over levels; `None` if its weight is 0.
    pub matching: Option<Tensor<1>>,
}

impl FlowLossConfig {
    /// The loss that goes with [`PwcConfig::slim`](crate::pwc::PwcConfig::slim).
    pub fn teaching() -> Self {
        Self { matching_weight: 1.0, ..Self::default() }
    }

    /// Do the weights fit a net of so many flow levels?
    ///
    /// # Errors
    /// Says which weight doesn't.
    pub fn validate(&self, flow_levels: usize) -> Result<(), FlowLossConfigError> {
        let mut weights = self.level_weights.iter().chain([&self.matching_weight]);
        if let Some(&weight) = weights.find(|w| !w.is_finite() || **w < 0.0) {
            return Err(FlowLossConfigError::Weight(weight));
        }
        let found = self.level_weights.len();
        if found < flow_levels {
            return Err(FlowLossConfigError::TooFew { needed: flow_levels, found });
        }
        Ok(())
    }

    /// Σ_level weight · mean_batch Σ_pixels error, over valid pixels, plus the matching term.
    ///
    /// # Panics
    /// If there are fewer weights than levels ([`validate`](Self::validate)).
    ///
    /// # Source
    /// Spec 3.1.
    pub fn forward(&self, output: &PwcOutput, target: &FlowTarget) -> FlowLoss {
        let skipped = self.level_weights.len() - output.levels.len();
        let weights = &self.level_weights[skipped..];
        let targets: Vec<LevelTarget> = output.levels.iter().map(|level| level_target(level, target)).collect();
        let levels: Vec<Tensor<1>> = output
            .levels
            .iter()
            .zip(&targets)
            .zip(weights)
            .map(|((level, target), &weight)| self.error_sum(level, target) * weight)
            .collect();
        let matching = (self.matching_weight > 0.0).then(|| {
            let terms = output.levels.iter().zip(&targets).map(|(level, target)| matching_entropy(level, target));
            sum(terms) * self.matching_weight
        });
        let total = sum(levels.iter().chain(&matching).cloned());
        FlowLoss { total, levels, matching }
    }

    /// Mean over the batch of the sum over valid pixels.
    fn error_sum(&self, level: &LevelFlow, target: &LevelTarget) -> Tensor<1> {
        let images = level.flow.dims()[0];
        let difference = level.flow.clone() - target.flow.clone();
        let error = match self.error {
            FlowError::Euclidean => (difference.powi_scalar(2).sum_dim(1) + ROOT_FLOOR).sqrt(),
            FlowError::Robust => (difference.abs().sum_dim(1) + ROBUST_OFFSET).powf_scalar(ROBUST_EXPONENT),
        };
        (error * target.valid.clone()).sum() / images as f32
    }
}

fn level_target(level: &LevelFlow, target: &FlowTarget) -> LevelTarget {
    let [.., h, w] = level.flow.dims();
    target.at_level(level.factor, h, w)
}

fn sum(terms: impl Iterator<Item = Tensor<1>>) -> Tensor<1> {
    terms.reduce(|a, b| a + b).expect("a net has at least one flow level")
}

/// Mean cross-entropy between the cost volume and the true displacement, over the pixels whose true displacement it holds
/// and whose source lies in the image.
fn matching_entropy(level: &LevelFlow, target: &LevelTarget) -> Tensor<1> {
    let [n, displacements, h, w] = level.logits.dims();
    let side = displacements.isqrt();
    let radius = (side / 2) as f32;
    let level_px = FLOW_UNIT_PX / level.factor as f32;

    let flow = target.flow.clone().detach() * level_px;
    let wanted = match &level.start {
        Some(start) => flow.clone() - start.clone() * level_px,
        None => flow.clone(),
    };
    let channel = |t: &Tensor<4>, c: usize| t.clone().slice([0..n, c..c + 1, 0..h, 0..w]);
    let (dx, dy) = (channel(&wanted, 0), channel(&wanted, 1));
    let held = within(&dx, radius).bool_and(within(&dy, radius));
    let source_x = channel(&flow, 0) + ramp(w, &flow).reshape([1, 1, 1, w]);
    let source_y = channel(&flow, 1) + ramp(h, &flow).reshape([1, 1, h, 1]);
    let inside = between(&source_x, w).bool_and(between(&source_y, h));
    let counted = held.bool_and(inside).float() * target.valid.clone();

    let step = |d: Tensor<4>| (d + radius).round().clamp(0.0, 2.0 * radius);
    let index = (step(dy) * side as f32 + step(dx)).int();
    let entropy = -log_softmax(level.logits.clone(), 1).gather(1, index);
    // One more than the count: a level without any counted pixel gives 0.
    (entropy * counted.clone()).sum() / (counted.sum() + 1.0)
}

/// 0, 1, … `length` − 1 on the device of `like`.
fn ramp(length: usize, like: &Tensor<4>) -> Tensor<1> {
    Tensor::<1, Int>::arange(0..length as i64, &like.device()).float()
}

/// Is the displacement nearest to one that the cost volume holds?
fn within(displacement: &Tensor<4>, radius: f32) -> Tensor<4, burn::tensor::Bool> {
    displacement.clone().abs().lower_elem(radius + 0.5)
}

/// Is the position in a pixel of the image?
fn between(position: &Tensor<4>, length: usize) -> Tensor<4, burn::tensor::Bool> {
    position.clone().greater_elem(-0.5).bool_and(position.clone().lower_elem(length as f32 - 0.5))
}

#[cfg(test)]
mod tests;
