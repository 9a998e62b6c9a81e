//! A 3×3 convolution with bias, zero padding and (usually) leaky ReLU: the one layer PWC-Net is made of.

use burn::{
    module::{Module, Param},
    tensor::{Device, Tensor, TensorData},
};
use ops::{
    activation::bias_leaky_relu,
    conv::{Conv3x3, Padding, conv3x3},
};
use rand::Rng;
use rand_distr::{Distribution, Normal};

/// Slope of leaky ReLU on the negative side.
///
/// # Source
/// Sun et al. 2018 (PWC-Net).
pub(crate) const LEAKY_SLOPE: f32 = 0.1;

/// Weights `[out, in, 3, 3]` and bias `[out]`.
#[derive(Module, Debug)]
pub struct Conv {
    weight: Param<Tensor<4>>,
    bias: Param<Tensor<1>>,
    stride: usize,
    dilation: usize,
}

impl Conv {
    /// Kaiming initialisation for leaky ReLU, zero bias.
    pub(crate) fn new(inputs: usize, outputs: usize, device: &Device, rng: &mut impl Rng) -> Self {
        let fan_in = (inputs * 9) as f32;
        let deviation = (2.0 / ((1.0 + LEAKY_SLOPE * LEAKY_SLOPE) * fan_in)).sqrt();
        Self::with_deviation(inputs, outputs, deviation, device, rng)
    }

    /// A layer whose output starts small, for residuals.
    pub(crate) fn small(inputs: usize, outputs: usize, device: &Device, rng: &mut impl Rng) -> Self {
        Self::with_deviation(inputs, outputs, 0.01, device, rng)
    }

    fn with_deviation(inputs: usize, outputs: usize, deviation: f32, device: &Device, rng: &mut impl Rng) -> Self {
        let normal = Normal::new(0.0f32, deviation).expect("the deviation is finite and positive");
        let values: Vec<f32> = (0..outputs * inputs * 9).map(|_| normal.sample(rng)).collect();
        Self {
            weight: Param::from_data(TensorData::new(values, [outputs, inputs, 3, 3]), device),
            bias: Param::from_data(TensorData::new(vec![0.0f32; outputs], [outputs]), device),
            stride: 1,
            dilation: 1,
        }
    }

    /// The same layer, its output halved in size.
    pub(crate) fn halving(self) -> Self {
        Self { stride: 2, ..self }
    }

    /// The same layer with taps further apart.
    pub(crate) fn dilated(self, dilation: usize) -> Self {
        Self { dilation, ..self }
    }

    fn convolve(&self, x: Tensor<4>) -> (Tensor<4>, Tensor<2>) {
        let geometry = Conv3x3 { stride: self.stride, dilation: self.dilation, ..Conv3x3::same(Padding::Zero) };
        let bias = self.bias.val();
        let channels = bias.dims()[0];
        (conv3x3(x, self.weight.val(), geometry), bias.reshape([1, channels]))
    }

    /// Convolution, bias, leaky ReLU.
    ///
    /// # Shapes
    /// `[N, in, H, W]` → `[N, out, ceil(H / stride), ceil(W / stride)]`
    pub fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let (y, bias) = self.convolve(x);
        bias_leaky_relu(y, Some(bias), LEAKY_SLOPE)
    }

    /// Convolution and bias.
    ///
    /// # Shapes
    /// As [`forward`](Self::forward).
    pub fn linear(&self, x: Tensor<4>) -> Tensor<4> {
        let (y, bias) = self.convolve(x);
        let channels = bias.dims()[1];
        y + bias.reshape([1, channels, 1, 1])
    }
}
