//! The context net: dilated convolutions that see far and refine the finest flow.

use burn::{
    module::Module,
    tensor::{Device, Tensor},
};
use rand::Rng;

use super::Conv;

/// Dilations of the context net's convolutions, the predicting one last.
///
/// # Source
/// Sun et al. 2018; spec 3.1.
pub(crate) const DILATIONS: [usize; 7] = [1, 2, 4, 8, 16, 1, 1];

/// Dilated convolutions and the prediction of a residual.
#[derive(Module, Debug)]
pub struct Context {
    convs: Vec<Conv>,
    predict: Conv,
}

impl Context {
    /// `widths` are those of all but the predicting convolution.
    pub(crate) fn new(inputs: usize, widths: &[usize], device: &Device, rng: &mut impl Rng) -> Self {
        let mut channels = inputs;
        let convs = widths
            .iter()
            .zip(DILATIONS)
            .map(|(&width, dilation)| Conv::new(std::mem::replace(&mut channels, width), width, device, rng).dilated(dilation))
            .collect();
        Self { convs, predict: Conv::small(channels, 2, device, rng) }
    }

    /// What the flow lacks, in its unit.
    ///
    /// # Shapes
    /// `[N, inputs, H, W]` → `[N, 2, H, W]`
    pub(crate) fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        self.predict.linear(self.convs.iter().fold(x, |x, conv| conv.forward(x)))
    }
}
