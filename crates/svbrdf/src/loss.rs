//! What the net learns from: L = 0.1·L_s + L_r + L_t (paper Eq. 6, spec 4.2).

use burn::tensor::Tensor;
use render::brdf::BrdfModel;
use render::svbrdf::Svbrdf;
use render::views::LossViews;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::net::Prediction;

/// Added to albedos under the logarithm (spec 4.2).
const ALBEDO_FLOOR: f32 = 0.01;
/// Share of the diffuse and specular renderings among all, for [`LossKind::SingleMean`]: 9 of 15.
const RENDERING_SHARE: f32 = 9.0 / 15.0;

/// How the renderings' errors are averaged.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum LossKind {
    /// L_r over the 9 diffuse and specular renderings and L_t over the 6 top renderings, each with its own weight (paper).
    #[default]
    Paper,
    /// One mean over all 15 renderings with the weight of `rendering`, as the authors' code computes it.
    SingleMean,
}

/// Factors of the three terms.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct LossWeights {
    /// L_s, distance of the maps.
    pub maps: f32,
    /// L_r, diffuse and specular renderings.
    pub rendering: f32,
    /// L_t, renderings from the top.
    pub top: f32,
    /// Logits in tanh's flat ends ([`Prediction::excess`]); 0 in the paper. Small budgets with
    /// high learning rates need it: outputs that tipped over have no other gradient.
    pub excess: f32,
}

impl Default for LossWeights {
    fn default() -> Self {
        Self { maps: 0.1, rendering: 1.0, top: 1.0, excess: 0.0 }
    }
}

/// The loss of the SVBRDF net.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct LossConfig {
    /// How the renderings' errors are averaged.
    pub kind: LossKind,
    /// Factors of the terms.
    pub weights: LossWeights,
}

/// Every term by itself, each a tensor of one element.
#[derive(Clone, Debug)]
pub struct SvbrdfLoss {
    /// Mean |n − n*|, components in [−1, 1].
    pub normal: Tensor<1>,
    /// Mean |ln(0.01 + ρd) − ln(0.01 + ρd*)|.
    pub diffuse: Tensor<1>,
    /// Mean |r − r*| with r mapped to [−1, 1].
    pub roughness: Tensor<1>,
    /// Mean |ln(0.01 + ρs) − ln(0.01 + ρs*)|.
    pub specular: Tensor<1>,
    /// L_s, the sum of the four.
    pub maps: Tensor<1>,
    /// L_r.
    pub rendering: Tensor<1>,
    /// L_t.
    pub top: Tensor<1>,
    /// Mean square of the logits' part in tanh's flat ends.
    pub excess: Tensor<1>,
    /// What is minimised.
    pub total: Tensor<1>,
}

impl LossConfig {
    /// The loss of a prediction against its target, rendered from `views`.
    pub fn evaluate(&self, prediction: &Prediction, target: &Svbrdf, views: &LossViews, model: BrdfModel) -> SvbrdfLoss {
        let predicted = &prediction.maps;
        // The fused route runs on the CPU; other devices keep their maps where they are.
        let renderings = if ops::kernel::available(&predicted.roughness) {
            render::fused::rendering_losses(predicted, target, views, model)
        } else {
            render::loss::rendering_losses(predicted, target, views, model)
        };
        let loss = self.combine(predicted, target, renderings.rendering, renderings.top);
        let excess = prediction.excess();
        let total = match self.weights.excess {
            weight if weight > 0.0 => loss.total + excess.clone() * weight,
            _ => loss.total,
        };
        SvbrdfLoss { excess, total, ..loss }
    }

    /// Joins the map terms with the renderings' errors, without any excess.
    ///
    /// `rendering` and `top` are L_r and L_t, one element each.
    pub fn combine(&self, predicted: &Svbrdf, target: &Svbrdf, rendering: Tensor<1>, top: Tensor<1>) -> SvbrdfLoss {
        let normal = mean_distance(predicted.normal.clone(), target.normal.clone());
        let diffuse = mean_log_distance(predicted.diffuse.clone(), target.diffuse.clone());
        let roughness = mean_distance(predicted.roughness.clone(), target.roughness.clone()) * 2.0;
        let specular = mean_log_distance(predicted.specular.clone(), target.specular.clone());
        let maps = normal.clone() + diffuse.clone() + roughness.clone() + specular.clone();
        let LossWeights { maps: w_maps, rendering: w_rendering, top: w_top, .. } = self.weights;
        let renderings = match self.kind {
            LossKind::Paper => rendering.clone() * w_rendering + top.clone() * w_top,
            LossKind::SingleMean => (rendering.clone() * RENDERING_SHARE + top.clone() * (1.0 - RENDERING_SHARE)) * w_rendering,
        };
        let total = maps.clone() * w_maps + renderings;
        let excess = Tensor::zeros_like(&total);
        SvbrdfLoss { normal, diffuse, roughness, specular, maps, rendering, top, excess, total }
    }
}

/// Every term as a number, for logs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SvbrdfLossValues {
    /// See [`SvbrdfLoss`].
    pub normal: f32,
    /// See [`SvbrdfLoss`].
    pub diffuse: f32,
    /// See [`SvbrdfLoss`].
    pub roughness: f32,
    /// See [`SvbrdfLoss`].
    pub specular: f32,
    /// See [`SvbrdfLoss`].
    pub maps: f32,
    /// See [`SvbrdfLoss`].
    pub rendering: f32,
    /// See [`SvbrdfLoss`].
    pub top: f32,
    /// See [`SvbrdfLoss`].
    pub excess: f32,
    /// See [`SvbrdfLoss`].
    pub total: f32,
}

impl SvbrdfLoss {
    /// The terms as numbers.
    pub fn values(&self) -> SvbrdfLossValues {
        let v = |t: &Tensor<1>| ops::planes::values(t.clone().detach())[0];
        SvbrdfLossValues {
            normal: v(&self.normal),
            diffuse: v(&self.diffuse),
            roughness: v(&self.roughness),
            specular: v(&self.specular),
            maps: v(&self.maps),
            rendering: v(&self.rendering),
            top: v(&self.top),
            excess: v(&self.excess),
            total: v(&self.total),
        }
    }
}

fn mean_distance(a: Tensor<4>, b: Tensor<4>) -> Tensor<1> {
    (a - b).abs().mean()
}

fn mean_log_distance(a: Tensor<4>, b: Tensor<4>) -> Tensor<1> {
    mean_distance((a + ALBEDO_FLOOR).log(), (b + ALBEDO_FLOOR).log())
}
