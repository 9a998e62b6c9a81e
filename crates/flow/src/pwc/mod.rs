//! PWC-Net: pyramid, warping, cost volume (Sun et al. 2018; the variant of the paper's authors and the net as published).

pub mod config;
pub mod context;
pub mod conv;
pub mod cost;
pub mod estimator;
pub mod pyramid;
pub mod release;
mod teach;
pub mod upsample;

pub use config::{Connections, Input, Prediction, PwcConfig, PwcConfigError, Upsampling};
pub use conv::Conv;

use burn::{
    module::Module,
    tensor::{Tensor, ops::PadMode},
};
use context::Context;
use cost::{Match, Matching};
use estimator::{Estimate, Estimator};
use ops::{activation::bias_leaky_relu, resample::upsample_bilinear, warp::warp};
use pyramid::{Pyramid, normalise, prepare};
use rand::Rng;
use teach::Teacher;
use upsample::Upsampler;

use crate::{
    pwc::conv::LEAKY_SLOPE,
    target::{FLOW_UNIT_PX, FlowTarget},
};

/// The net. Built by [`PwcConfig::init`].
#[derive(Module, Debug)]
pub struct Pwc {
    pyramid: Pyramid,
    matchings: Vec<Matching>,
    estimators: Vec<Estimator>,
    /// From each level but the finest to the next; none where flow and features are interpolated.
    upsamplers: Vec<Upsampler>,
    context: Option<Context>,
    #[module(skip)]
    config: PwcConfig,
}

/// What the net says at one level.
#[derive(Clone, Debug)]
pub struct LevelFlow {
    /// Flow `[N, 2, h, w]` in units of 20 px of the full resolution.
    pub flow: Tensor<4>,
    /// Logits over the displacements of the cost volume `[N, (2r + 1)², h, w]`.
    pub logits: Tensor<4>,
    /// The flow by which the second features were warped before, in the unit of `flow`, without gradient; `None` at the
    /// coarsest level, which starts from zero.
    pub start: Option<Tensor<4>>,
    /// Full-resolution pixels per pixel of this level.
    pub factor: usize,
}

/// Flows of all levels, coarse to fine. They cover the image padded to the multiple that the net needs.
#[derive(Clone, Debug)]
pub struct PwcOutput {
    /// Coarse to fine; the last at a quarter of the resolution.
    pub levels: Vec<LevelFlow>,
}

/// Features of both images at one level.
struct PairFeatures {
    first: Tensor<4>,
    match_first: Tensor<4>,
    match_second: Tensor<4>,
}

/// What a level hands to the next finer one.
struct Carried {
    flow: Tensor<4>,
    features: Tensor<4>,
}

impl Pwc {
    /// The flow from `first` to where its points lie in `second`, at all levels.
    ///
    /// # Shapes
    /// `first, second [N, 3, H, W]`, gamma-encoded RGB in \[0, 1\], any H and W.
    pub fn forward(&self, first: Tensor<4>, second: Tensor<4>) -> PwcOutput {
        self.estimate(first, second, None)
    }

    /// As [`forward`](Self::forward), but each level starts, with probability `share` per image, from the true flow (off by
    /// up to 3 px of the level) instead of the coarser level's, so that fine levels learn to match before coarse ones can.
    ///
    /// Always draws the same count of numbers from `rng`.
    pub fn forward_teaching(
        &self,
        first: Tensor<4>,
        second: Tensor<4>,
        target: &FlowTarget,
        share: f64,
        rng: &mut impl Rng,
    ) -> PwcOutput {
        let images = first.dims()[0];
        let teacher = Teacher::draw(target, images, self.estimators.len(), share, rng);
        self.estimate(first, second, Some(&teacher))
    }

    /// The flow in pixels at full resolution.
    ///
    /// # Shapes
    /// `first, second [N, 3, H, W]` → `[N, 2, H, W]`
    pub fn flow(&self, first: Tensor<4>, second: Tensor<4>) -> Tensor<4> {
        let [n, _, h, w] = first.dims();
        let output = self.forward(first, second);
        let finest = output.levels.last().expect("a net has at least one flow level");
        let full = upsample_bilinear(finest.flow.clone(), finest.factor) * FLOW_UNIT_PX;
        full.slice([0..n, 0..2, 0..h, 0..w])
    }

    fn estimate(&self, first: Tensor<4>, second: Tensor<4>, teacher: Option<&Teacher>) -> PwcOutput {
        let n = first.dims()[0];
        let images = pad_to_multiple(Tensor::cat(vec![first, second], 0), self.config.multiple());
        let pyramid = self.pyramid.forward(prepare(images, self.config.input));

        let mut carried: Option<Carried> = None;
        let mut levels = Vec::with_capacity(self.estimators.len());
        for (i, features) in pyramid.into_iter().skip(1).rev().enumerate() {
            let factor = 1 << (self.config.channels.len() - i);
            let start = carried.take().map(|c| self.begin(c, i, factor, teacher));
            let pair = self.split(features, n);
            let (level, next) = self.level(i, factor, pair, start);
            levels.push(level);
            carried = Some(next);
        }
        PwcOutput { levels }
    }

    /// Brings the coarser level's result to this level's resolution, perhaps replaced by the teacher's.
    fn begin(&self, coarse: Carried, index: usize, factor: usize, teacher: Option<&Teacher>) -> Carried {
        let Carried { flow, features } = coarse;
        let (flow, features) = match self.upsamplers.get(index - 1) {
            Some(upsampler) => upsampler.forward(flow, features),
            None => (upsample_bilinear(flow, 2), upsample_bilinear(features, 2)),
        };
        let flow = match teacher {
            Some(teacher) => teacher.guide(flow, index, factor),
            None => flow,
        };
        Carried { flow, features }
    }

    fn split(&self, features: Tensor<4>, n: usize) -> PairFeatures {
        let [_, c, h, w] = features.dims();
        let part = |t: &Tensor<4>, from: usize| t.clone().slice([from..from + n, 0..c, 0..h, 0..w]);
        let first = part(&features, 0);
        let matched = if self.config.feature_normalisation { normalise(features) } else { features };
        PairFeatures { first, match_first: part(&matched, 0), match_second: part(&matched, n) }
    }

    fn level(&self, index: usize, factor: usize, pair: PairFeatures, start: Option<Carried>) -> (LevelFlow, Carried) {
        let level_px = FLOW_UNIT_PX / factor as f32;
        let second = match &start {
            Some(start) => warp(pair.match_second, start.flow.clone() * level_px).values,
            None => pair.match_second,
        };
        let matching = &self.matchings[index];
        let Match { cost, logits } = matching.forward(pair.match_first, second);

        let mut inputs = vec![bias_leaky_relu(cost, None, LEAKY_SLOPE)];
        if start.is_some() || self.config.coarsest_features {
            inputs.push(pair.first);
        }
        let start_flow = start.map(|start| {
            inputs.extend([start.flow.clone(), start.features]);
            start.flow
        });
        let Estimate { predicted, features } = self.estimators[index].forward(Tensor::cat(inputs, 1));

        let mut flow = predicted;
        if let Some(expected) = matching.expected(&logits) {
            flow = flow + expected / level_px;
        }
        if let (Some(start), Prediction::Residual) = (&start_flow, self.config.prediction) {
            flow = flow + start.clone();
        }
        if let (Some(context), true) = (&self.context, index + 1 == self.estimators.len()) {
            let seen = match self.config.connections {
                Connections::Sequential => Tensor::cat(vec![features.clone(), flow.clone()], 1),
                Connections::Dense => features.clone(),
            };
            flow = flow + context.forward(seen);
        }
        let level = LevelFlow { flow: flow.clone(), logits, start: start_flow.map(Tensor::detach), factor };
        (level, Carried { flow, features })
    }
}

/// Repeats the right and bottom border until both sides are multiples of `multiple`.
fn pad_to_multiple(images: Tensor<4>, multiple: usize) -> Tensor<4> {
    let [.., h, w] = images.dims();
    let (bottom, right) = (h.next_multiple_of(multiple) - h, w.next_multiple_of(multiple) - w);
    if (bottom, right) == (0, 0) { images } else { images.pad((0, right, 0, bottom), PadMode::Edge) }
}

#[cfg(test)]
mod tests;
