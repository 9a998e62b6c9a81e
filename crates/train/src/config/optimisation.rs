//! How the weights of a stage move: schedule, optimiser, intervals, teacher forcing.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How the learning rate runs over a stage.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Schedule {
    /// A linear ramp over `warm_up` steps, then constant (paper §6).
    #[default]
    Constant,
    /// A ramp from a tenth over `warm_up` steps, then half a cosine down to zero at the last step.
    OneCycle,
}

/// Adam's constants.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Adam {
    /// Decay of the first moment.
    pub beta1: f64,
    /// Decay of the second moment.
    pub beta2: f64,
    /// Added to the root of the second moment.
    pub epsilon: f64,
}

impl Default for Adam {
    fn default() -> Self {
        Self { beta1: 0.9, beta2: 0.999, epsilon: 1e-8 }
    }
}

/// How a stage's weights move and how often the run reports.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Optimisation {
    /// Peak learning rate.
    pub learning_rate: f64,
    /// Its course.
    pub schedule: Schedule,
    /// Steps of the ramp at the start.
    #[schemars(extend("unit" = "steps"))]
    pub warm_up: usize,
    /// Adam's constants.
    pub adam: Adam,
    /// L2 penalty added to the gradient.
    pub weight_decay: f64,
    /// Largest norm of the whole gradient; 0 clips nothing.
    pub clip: f64,
    /// Batches whose gradients are averaged into one step; several devices (`--device cuda:0,cuda:1`) share them.
    #[schemars(extend("unit" = "batches"))]
    pub accumulate: usize,
    /// Decay of the moving average of the weights that evaluation uses; 0 keeps none.
    pub ema: f64,
    /// Steps between two rows of preview pictures.
    #[schemars(extend("unit" = "steps"))]
    pub preview_every: usize,
    /// Steps between two measurements on held-out materials; 0 measures only at the end.
    #[schemars(extend("unit" = "steps"))]
    pub validate_every: usize,
    /// Steps between two histograms of the weights and gradients of every layer for TensorBoard; 0 makes none.
    #[schemars(extend("unit" = "steps"))]
    pub histogram_every: usize,
}

impl Default for Optimisation {
    fn default() -> Self {
        Self {
            learning_rate: 1e-4,
            schedule: Schedule::Constant,
            warm_up: 0,
            adam: Adam::default(),
            weight_decay: 0.0,
            clip: 0.0,
            accumulate: 1,
            ema: 0.0,
            preview_every: 200,
            validate_every: 200,
            histogram_every: 200,
        }
    }
}

/// How a flow net is taught, whatever the pairs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Teaching {
    /// Probability at the start that a level begins from the true flow instead of the coarser level's.
    #[schemars(extend("unit" = "probability"))]
    pub forcing: f64,
    /// Share of the stage after which that probability has fallen to zero.
    #[schemars(extend("unit" = "share of the steps"))]
    pub until: f64,
}

impl Default for Teaching {
    fn default() -> Self {
        Self { forcing: 1.0, until: 0.7 }
    }
}

impl Teaching {
    /// The probability when the share `done` of the stage is done.
    pub fn share(&self, done: f64) -> f64 {
        if self.until > 0.0 { self.forcing * (1.0 - done / self.until).max(0.0) } else { 0.0 }
    }
}
