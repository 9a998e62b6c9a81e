//! Poolings of frames that arrive one after another: what is kept of them doesn't grow with their number.

use burn::tensor::Tensor;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Features;

/// What reduces the frames' features to one. Beside the paper's maximum these are variants for ablations.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Pooling {
    /// Element-wise maximum (paper §6).
    Max,
    /// Element-wise mean.
    Mean,
    /// Maximum, mean and variance one after the other: the head reads three times the channels.
    MaxMeanVariance,
    /// A mean with learnt weights: see [`Attention`](super::attention::Attention).
    Attention,
}

impl Pooling {
    /// Numbers that the head reads of each channel.
    pub(super) fn statistics(self) -> usize {
        match self {
            Self::Max | Self::Mean | Self::Attention => 1,
            Self::MaxMeanVariance => 3,
        }
    }

    /// Pixels aligned with less confidence take no part: attention can weigh the doubtful ones, the others would trust them.
    pub(super) fn least_confidence(self) -> f32 {
        match self {
            Self::Max | Self::Mean | Self::MaxMeanVariance => 0.5,
            Self::Attention => f32::MIN_POSITIVE,
        }
    }
}

/// Frames in the guidance frame's pixels. A global vector is a map of one pixel.
#[derive(Clone, Debug)]
pub(super) struct Observed {
    /// `[K, C, H, W]`
    pub values: Tensor<4>,
    /// `[K, 1, H, W]`: 1 where a value takes part, else 0.
    pub part: Tensor<4>,
    /// `[K, 1, H, W]`: how sure the alignment is, in [0, 1].
    pub confidence: Tensor<4>,
}

impl Observed {
    /// Frames that take part everywhere and are surely aligned, such as the guidance frame.
    pub fn whole(values: Tensor<4>) -> Self {
        let [k, _, h, w] = values.dims();
        let ones = Tensor::ones([k, 1, h, w], &values.device());
        Self { values, part: ones.clone(), confidence: ones }
    }
}

/// The same for the maps and for the global vector.
#[derive(Clone, Debug)]
pub(super) struct Both<T> {
    pub maps: T,
    pub global: T,
}

impl<T> Both<T> {
    pub fn map<U>(self, f: impl Fn(T) -> U) -> Both<U> {
        Both { maps: f(self.maps), global: f(self.global) }
    }

    pub fn zip<U>(self, other: Both<U>) -> Both<(T, U)> {
        Both { maps: (self.maps, other.maps), global: (self.global, other.global) }
    }
}

impl From<Features> for Both<Observed> {
    /// Frames that take part everywhere.
    fn from(features: Features) -> Self {
        Self { maps: Observed::whole(features.maps), global: Observed::whole(as_maps(features.global)) }
    }
}

impl From<Both<Tensor<4>>> for Features {
    fn from(Both { maps, global }: Both<Tensor<4>>) -> Self {
        let [n, g, _, _] = global.dims();
        Self { maps, global: global.reshape([n, g]) }
    }
}

/// `[K, G]` → `[K, G, 1, 1]`
pub(super) fn as_maps(global: Tensor<2>) -> Tensor<4> {
    let [k, g] = global.dims();
    global.reshape([k, g, 1, 1])
}

/// A mean whose weights are the softmax of scores, over the frames so far. With equal scores it is the plain mean.
///
/// # Source
/// Milakov & Gimelshein 2018, Online normalizer calculation for softmax.
#[derive(Clone, Debug)]
pub(super) struct WeightedMean {
    /// `[1, C, H, W]`, Σ exp(score − top) · value
    sum: Tensor<4>,
    /// `[1, 1, H, W]`, Σ exp(score − top)
    weight: Tensor<4>,
    /// `[1, 1, H, W]`, the largest score so far: no exponential exceeds 1. The mean doesn't depend on it, so it has no gradient.
    top: Tensor<4>,
}

impl WeightedMean {
    /// One frame that takes part everywhere, `score [1, 1, H, W]`.
    pub fn new(frame: Observed, score: Tensor<4>) -> Self {
        let top = score.clone().detach();
        let weight = (score - top.clone()).exp();
        Self { sum: frame.values * weight.clone(), weight, top }
    }

    /// Takes in K more frames, `score [K, 1, H, W]`.
    pub fn add(self, frames: Observed, score: Tensor<4>) -> Self {
        let absent = frames.part.clone().lower_elem(0.5);
        // An absent value's score mustn't become the largest one.
        let score = score.clone().mask_where(absent, self.top.clone().expand(score.dims()));
        let top = self.top.clone().max_pair(score.clone().detach().max_dim(0));
        let fade = (self.top - top.clone()).exp();
        let weight = (score - top.clone()).exp() * frames.part;
        Self {
            sum: self.sum * fade.clone() + (frames.values * weight.clone()).sum_dim(0),
            weight: self.weight * fade + weight.sum_dim(0),
            top,
        }
    }

    /// `[1, C, H, W]`
    pub fn mean(self) -> Tensor<4> {
        self.sum / self.weight
    }
}

/// Mean and variance of the frames so far.
///
/// # Source
/// Chan, Golub, LeVeque 1983: nothing cancels, as in mean square − squared mean.
#[derive(Clone, Debug)]
pub(super) struct Moments {
    /// `[1, 1, H, W]`
    count: Tensor<4>,
    /// `[1, C, H, W]`
    mean: Tensor<4>,
    /// `[1, C, H, W]`, Σ (value − mean)²
    squares: Tensor<4>,
}

impl Moments {
    /// One frame that takes part everywhere.
    pub fn new(frame: Observed) -> Self {
        Self { count: frame.part, squares: frame.values.zeros_like(), mean: frame.values }
    }

    /// Takes in K more frames.
    pub fn add(self, frames: Observed) -> Self {
        let Observed { values, part, .. } = frames;
        let added = part.clone().sum_dim(0);
        let mean = (values.clone() * part.clone()).sum_dim(0) / added.clone().clamp_min(1.0);
        let squares = ((values - mean.clone()).square() * part).sum_dim(0);
        let gap = mean - self.mean.clone();
        let count = self.count.clone() + added.clone();
        let share = added / count.clone();
        Self {
            mean: self.mean + gap.clone() * share.clone(),
            squares: self.squares + squares + gap.square() * (self.count * share),
            count,
        }
    }

    /// Mean and variance (of the frames themselves: 0 of a single one), `[1, 2·C, H, W]`.
    pub fn mean_and_variance(self) -> Tensor<4> {
        Tensor::cat(vec![self.mean, self.squares / self.count], 1)
    }
}

/// What is kept of the frames so far; made by [`SvbrdfNet::begin`](super::SvbrdfNet::begin).
#[derive(Clone, Debug)]
pub struct Pooled(pub(super) State);

/// One variant per kind of statistics.
#[derive(Clone, Debug)]
#[allow(clippy::large_enum_variant, reason = "a scan has one of it")]
pub(super) enum State {
    Maximum(Features),
    Weighted(Both<WeightedMean>),
    Moments { maximum: Features, moments: Both<Moments> },
}

impl Pooled {
    /// The pooled features that the head reads.
    ///
    /// # Shapes
    /// Maps `[1, S·C, H, W]` and global vector `[1, S·G]` for the pooling's S statistics: 3 of [`Pooling::MaxMeanVariance`],
    /// else 1.
    pub fn features(self) -> Features {
        match self.0 {
            State::Maximum(maximum) => maximum,
            State::Weighted(means) => means.map(WeightedMean::mean).into(),
            State::Moments { maximum, moments } => {
                let rest = Features::from(moments.map(Moments::mean_and_variance));
                Features {
                    maps: Tensor::cat(vec![maximum.maps, rest.maps], 1),
                    global: Tensor::cat(vec![maximum.global, rest.global], 1),
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use burn::tensor::{Device, TensorData};
    use ops::gradcheck::largest_relative_error;
    use ops::planes::values;

    /// Three frames of two channels and two pixels; the second frame lacks the second pixel.
    const VALUES: [f32; 12] = [1.0, 1.0, -0.5, 0.3, 3.0, 5.0, 0.2, 0.9, 8.0, 8.0, 1.1, -0.7];
    const SHAPE: [usize; 4] = [3, 2, 1, 2];
    /// ln 1, ln 2, ln 3, beyond what an exponential can hold.
    const SCORES: [f32; 6] = [100.0, 100.0, 100.693_15, 900.0, 101.098_61, 101.098_61];

    fn tensor<const D: usize>(values: &[f32], shape: [usize; D], device: &Device) -> Tensor<D> {
        Tensor::from_data(TensorData::new(values.to_vec(), shape), device)
    }

    /// Frames `from..to`, of which the second lacks its second pixel.
    fn frames(x: Tensor<4>, from: usize, to: usize) -> Observed {
        let part = tensor(&[1.0, 1.0, 1.0, 0.0, 1.0, 1.0], [3, 1, 1, 2], &x.device());
        Observed { part: part.slice([from..to, 0..1, 0..1, 0..2]), ..Observed::whole(x.slice([from..to, 0..2, 0..1, 0..2])) }
    }

    /// The frames of `steps` one step after the other.
    fn moments(x: Tensor<4>, steps: &[usize]) -> Tensor<4> {
        let start = Moments::new(frames(x.clone(), 0, 1));
        steps.windows(2).fold(start, |m, s| m.add(frames(x.clone(), s[0], s[1]))).mean_and_variance()
    }

    fn weighted(x: Tensor<4>, scores: Tensor<4>, steps: &[usize]) -> Tensor<4> {
        let part = |from: usize, to: usize| (frames(x.clone(), from, to), scores.clone().slice([from..to, 0..1, 0..1, 0..2]));
        let (first, score) = part(0, 1);
        steps
            .windows(2)
            .fold(WeightedMean::new(first, score), |mean, s| {
                let (frames, score) = part(s[0], s[1]);
                mean.add(frames, score)
            })
            .mean()
    }

    fn assert_near(found: Tensor<4>, expected: &[f32]) {
        let found = values(found);
        assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-4 * b.abs().max(1.0)), "{found:?}");
    }

    #[test]
    fn poolings_have_their_hand_values_in_any_steps() {
        let device = Device::flex();
        let (x, scores) = (tensor(&VALUES, SHAPE, &device), tensor(&SCORES, [3, 1, 1, 2], &device));
        for steps in [[1, 3].as_slice(), &[1, 2, 3]] {
            let moments = moments(x.clone(), steps);
            assert_near(moments.clone().slice([0..1, 0..1, 0..1, 0..2]), &[4.0, 4.5]);
            assert_near(moments.slice([0..1, 2..3, 0..1, 0..2]), &[26.0 / 3.0, 12.25]);
            let equal = weighted(x.clone(), scores.zeros_like(), steps);
            assert_near(equal.slice([0..1, 0..1, 0..1, 0..2]), &[4.0, 4.5]);
            let weighted = weighted(x.clone(), scores.clone(), steps);
            assert_near(weighted.slice([0..1, 0..1, 0..1, 0..2]), &[31.0 / 6.0, 6.25]);
        }
    }

    /// Every statistic counts differently.
    fn weighed_sum(x: Tensor<4>) -> Tensor<1> {
        let shape = x.dims();
        let weights: Vec<f32> = (0..shape.iter().product()).map(|i| 0.3 + 0.2 * i as f32).collect();
        let weights = tensor(&weights, shape, &x.device());
        (x * weights).sum()
    }

    #[test]
    fn slopes_are_the_central_differences() {
        for steps in [[1, 3].as_slice(), &[1, 2, 3]] {
            let error = largest_relative_error(&VALUES, SHAPE, 1e-2, |x| weighed_sum(moments(x, steps)));
            assert!(error < 1e-2, "mean and variance: {error}");
            // The scores depend on the values, as attention's do.
            let attended = |x: Tensor<4>| weighed_sum(weighted(x.clone(), x.sum_dim(1) * 0.4, steps));
            let error = largest_relative_error(&VALUES, SHAPE, 1e-2, attended);
            assert!(error < 1e-2, "attention: {error}");
        }
    }

    #[test]
    fn a_single_frame_has_no_variance_and_finite_slopes() {
        let device = Device::flex().autodiff();
        let x = tensor(&VALUES, SHAPE, &device).require_grad();
        let pooled = moments(x.clone(), &[1]);
        assert_near(pooled.clone(), &[1.0, 1.0, -0.5, 0.3, 0.0, 0.0, 0.0, 0.0]);
        let slopes = values(x.grad(&pooled.sum().backward()).expect("x is tracked"));
        assert_eq!(slopes, [1.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    }
}
