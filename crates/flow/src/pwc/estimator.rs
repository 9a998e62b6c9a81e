//! The estimator of one level: from cost, features and the upsampled flow to a residual flow or the flow itself.

use burn::{
    module::Module,
    tensor::{Device, Tensor},
};
use rand::Rng;

use super::{Connections, Conv};

/// Convolutions of decreasing width and the prediction.
#[derive(Module, Debug)]
pub struct Estimator {
    convs: Vec<Conv>,
    predict: Conv,
    #[module(skip)]
    connections: Connections,
}

/// What an estimator says.
#[derive(Clone, Debug)]
pub(crate) struct Estimate {
    /// The prediction in units of 20 px, `[N, 2, H, W]`.
    pub(crate) predicted: Tensor<4>,
    /// What the prediction was made from; the next level and the context net read it.
    pub(crate) features: Tensor<4>,
}

impl Estimator {
    pub(crate) fn new(inputs: usize, widths: &[usize], connections: Connections, device: &Device, rng: &mut impl Rng) -> Self {
        let mut channels = inputs;
        let conv = |&width| {
            let inputs = channels;
            channels = connections.after(inputs, width);
            Conv::new(inputs, width, device, rng)
        };
        let convs = widths.iter().map(conv).collect();
        Self { convs, predict: Conv::small(channels, 2, device, rng), connections }
    }

    /// # Shapes
    /// `[N, inputs, H, W]`
    pub(crate) fn forward(&self, inputs: Tensor<4>) -> Estimate {
        let features = self.convs.iter().fold(inputs, |x, conv| match self.connections {
            Connections::Sequential => conv.forward(x),
            Connections::Dense => Tensor::cat(vec![conv.forward(x.clone()), x], 1),
        });
        Estimate { predicted: self.predict.linear(features.clone()), features }
    }
}
