//! Matching: the cost volume as logits over displacements, and the displacement they expect.

use burn::{
    module::{Module, Param},
    tensor::{Device, Tensor, TensorData, activation::softmax},
};
use ops::cost_volume::cost_volume;

/// Factor from a correlation of normalised features to logits, at the start of training.
const INITIAL_SHARPNESS: f32 = 12.0;

/// What the cost volume of one level says.
#[derive(Clone, Debug)]
pub(crate) struct Match {
    /// Correlations `[N, (2r + 1)², H, W]`.
    pub(crate) cost: Tensor<4>,
    /// Logits over displacements, the same shape.
    pub(crate) logits: Tensor<4>,
}

/// Correlation of one level with a learned sharpness.
#[derive(Module, Debug)]
pub struct Matching {
    sharpness: Option<Param<Tensor<1>>>,
    radius: usize,
}

impl Matching {
    pub(crate) fn new(radius: usize, match_head: bool, device: &Device) -> Self {
        let sharpness = match_head.then(|| Param::from_data(TensorData::from([INITIAL_SHARPNESS]), device));
        Self { sharpness, radius }
    }

    /// # Shapes
    /// `first, second [N, C, H, W]`, the second warped by what is already known.
    pub(crate) fn forward(&self, first: Tensor<4>, second: Tensor<4>) -> Match {
        let cost = cost_volume(first, second, self.radius);
        let logits = match &self.sharpness {
            Some(sharpness) => cost.clone() * sharpness.val().reshape([1, 1, 1, 1]),
            None => cost.clone() * INITIAL_SHARPNESS,
        };
        Match { cost, logits }
    }

    /// The mean displacement under the softmax of the logits (soft-argmax), in pixels of the level; `None` without match
    /// head.
    ///
    /// # Shapes
    /// `[N, (2r + 1)², H, W]` → `[N, 2, H, W]`
    pub(crate) fn expected(&self, logits: &Tensor<4>) -> Option<Tensor<4>> {
        self.sharpness.as_ref()?;
        let [n, displacements, h, w] = logits.dims();
        let device = logits.device();
        let side = 2 * self.radius + 1;
        let offset = |i: usize| i as f32 - self.radius as f32;
        let (xs, ys): (Vec<f32>, Vec<f32>) = (0..displacements).map(|i| (offset(i % side), offset(i / side))).unzip();
        let offsets = TensorData::new([xs, ys].concat(), [1, 2, displacements]);
        let offsets = Tensor::<3>::from_data(offsets, &device).expand([n, 2, displacements]);
        let probability = softmax(logits.clone(), 1).reshape([n, displacements, h * w]);
        Some(offsets.matmul(probability).reshape([n, 2, h, w]))
    }
}
