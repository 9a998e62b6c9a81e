//! The estimator of one level: from cost, features and the upsampled flow to a residual flow.

use burn::{
    module::Module,
    tensor::{Device, Tensor},
};
use rand::Rng;

use super::Conv;

/// Convolutions of decreasing width and the prediction of the residual.
#[derive(Module, Debug)]
pub struct Estimator {
    convs: Vec<Conv>,
    predict: Conv,
}

/// What an estimator says.
#[derive(Clone, Debug)]
pub(crate) struct Estimate {
    /// Residual flow in units of 20 px, `[N, 2, H, W]`.
    pub(crate) residual: Tensor<4>,
    /// Features of the last convolution; the next level and the context net read them.
    pub(crate) features: Tensor<4>,
}

impl Estimator {
    pub(crate) fn new(inputs: usize, widths: &[usize], device: &Device, rng: &mut impl Rng) -> Self {
        let mut channels = inputs;
        let convs =
            widths.iter().map(|&width| Conv::new(std::mem::replace(&mut channels, width), width, device, rng)).collect();
        Self { convs, predict: Conv::small(channels, 2, device, rng) }
    }

    /// # Shapes
    /// `[N, inputs, H, W]`
    pub(crate) fn forward(&self, inputs: Tensor<4>) -> Estimate {
        let features = self.convs.iter().fold(inputs, |x, conv| conv.forward(x));
        Estimate { residual: self.predict.linear(features.clone()), features }
    }
}
