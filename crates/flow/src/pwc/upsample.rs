//! Learned upsampling: from one level to the next finer one by transposed convolutions.

use burn::{
    module::{Module, Param},
    tensor::{Device, Tensor, TensorData, module::conv_transpose2d, ops::ConvTransposeOptions},
};
use rand::Rng;
use rand_distr::{Distribution, Normal};

/// Channels of the upsampled flow, and of the upsampled features.
pub(crate) const UPSAMPLED_CHANNELS: usize = 2;
const SIDE: usize = 4;
const TAPS: usize = SIDE * SIDE;
/// Of the 4×4 taps, those that reach one output pixel.
const TAPS_PER_OUTPUT: usize = 4;
/// Taps of bilinear interpolation to twice the size, along one side.
const BILINEAR: [f32; SIDE] = [0.25, 0.75, 0.75, 0.25];

/// Weights `[in, 2, 4, 4]` and bias `[2]` of a transposed convolution that doubles both sides.
#[derive(Module, Debug)]
pub struct Deconvolution {
    weight: Param<Tensor<4>>,
    bias: Param<Tensor<1>>,
}

impl Deconvolution {
    /// A layer that starts as bilinear interpolation of two channels.
    fn bilinear(device: &Device) -> Self {
        let taps = |i: usize| BILINEAR[i % TAPS / SIDE] * BILINEAR[i % SIDE];
        let same_channel = |i: usize| i / TAPS / UPSAMPLED_CHANNELS == i / TAPS % UPSAMPLED_CHANNELS;
        let weight = |i| if same_channel(i) { taps(i) } else { 0.0 };
        let values = (0..UPSAMPLED_CHANNELS * UPSAMPLED_CHANNELS * TAPS).map(weight).collect();
        Self::with_weights(values, UPSAMPLED_CHANNELS, device)
    }

    /// Random weights that keep the deviation of `inputs` independent channels; zero bias.
    fn random(inputs: usize, device: &Device, rng: &mut impl Rng) -> Self {
        let deviation = ((inputs * TAPS_PER_OUTPUT) as f32).sqrt().recip();
        let normal = Normal::new(0.0f32, deviation).expect("the deviation is finite and positive");
        let values = (0..inputs * UPSAMPLED_CHANNELS * TAPS).map(|_| normal.sample(rng)).collect();
        Self::with_weights(values, inputs, device)
    }

    fn with_weights(values: Vec<f32>, inputs: usize, device: &Device) -> Self {
        let weight = TensorData::new(values, [inputs, UPSAMPLED_CHANNELS, SIDE, SIDE]);
        let bias = TensorData::new(vec![0.0f32; UPSAMPLED_CHANNELS], [UPSAMPLED_CHANNELS]);
        Self { weight: Param::from_data(weight, device), bias: Param::from_data(bias, device) }
    }

    fn parameters(inputs: usize) -> usize {
        (inputs * TAPS + 1) * UPSAMPLED_CHANNELS
    }

    /// # Shapes
    /// `[N, in, H, W]` → `[N, 2, 2H, 2W]`
    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let options = ConvTransposeOptions::new([2, 2], [1, 1], [0, 0], [1, 1], 1);
        conv_transpose2d(x, self.weight.val(), Some(self.bias.val()), options)
    }
}

/// What brings a level's flow and features to the next finer level.
///
/// # Source
/// Sun et al. 2018, their PyTorch release: `deconv`, `upfeat`.
#[derive(Module, Debug)]
pub struct Upsampler {
    flow: Deconvolution,
    features: Deconvolution,
}

impl Upsampler {
    /// `inputs` are the channels of the features.
    pub(crate) fn new(inputs: usize, device: &Device, rng: &mut impl Rng) -> Self {
        Self { flow: Deconvolution::bilinear(device), features: Deconvolution::random(inputs, device, rng) }
    }

    /// How many weights it has.
    pub(crate) fn parameters(inputs: usize) -> usize {
        Deconvolution::parameters(UPSAMPLED_CHANNELS) + Deconvolution::parameters(inputs)
    }

    /// Flow and features at twice the size.
    ///
    /// # Shapes
    /// `flow [N, 2, H, W]`, `features [N, inputs, H, W]` → twice `[N, 2, 2H, 2W]`
    pub(crate) fn forward(&self, flow: Tensor<4>, features: Tensor<4>) -> (Tensor<4>, Tensor<4>) {
        (self.flow.forward(flow), self.features.forward(features))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ops::{planes::values, resample::upsample_bilinear};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn noise(shape: [usize; 4], device: &Device) -> Tensor<4> {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let data: Vec<f32> = (0..shape.iter().product()).map(|_| rng.random()).collect();
        Tensor::from_data(TensorData::new(data, shape), device)
    }

    #[test]
    fn a_fresh_deconvolution_of_the_flow_interpolates() {
        let device = Device::flex();
        let flow = noise([2, 2, 5, 3], &device);
        // Outside of the flow there are zeros instead of the repeated border.
        let inner = |t: Tensor<4>| t.slice([0..2, 0..2, 1..9, 1..5]);
        let found = inner(Deconvolution::bilinear(&device).forward(flow.clone()));
        let difference = found - inner(upsample_bilinear(flow, 2));
        assert!(values(difference.abs().max())[0] < 1e-6);
    }

    #[test]
    fn an_input_pixel_reaches_four_by_four_outputs() {
        let device = Device::flex();
        let weights: Vec<f32> = (0..2 * TAPS).map(|i| i as f32).collect();
        let layer = Deconvolution::with_weights(weights, 1, &device);
        let pixel = Tensor::<4>::from_data([[[[0.0, 0.0], [0.0, 1.0], [0.0, 0.0]]]], &device);
        let out = layer.forward(pixel);
        assert_eq!(out.dims(), [1, 2, 6, 4]);
        // The pixel at (1, 1) covers rows and columns 1 to 4, of which column 4 lies outside.
        let second = values(out.slice([0..1, 1..2, 1..5, 1..4]));
        assert_eq!(second, [16., 17., 18., 20., 21., 22., 24., 25., 26., 28., 29., 30.]);
    }

    #[test]
    fn random_weights_keep_the_deviation() {
        let device = Device::flex();
        let layer = Deconvolution::random(96, &device, &mut ChaCha8Rng::seed_from_u64(1));
        let out = values(layer.forward(noise([1, 96, 16, 16], &device) * 12f32.sqrt() - 3f32.sqrt()));
        let energy = out.iter().map(|v| v * v).sum::<f32>() / out.len() as f32;
        assert!((0.8..1.2).contains(&energy), "{energy}");
    }
}
