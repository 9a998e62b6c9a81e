//! The global track: image-wide statistics that run beside the convolutions (Deschaintre et al. 2018, paper §6).

use burn::module::{Module, Param};
use burn::tensor::{Device, Tensor, activation::selu};
use rand_chacha::ChaCha8Rng;

use super::convolution::gaussian;

/// Standard deviation of the initial bias (spec 4.1).
const BIAS_STD: f32 = 0.002;
/// Initial standard deviation, times √inputs, of the connection back into the maps (spec 4.1).
const INJECTION_STD: f32 = 0.01;

/// One layer's part of the global track.
#[derive(Module, Debug)]
pub struct GlobalTrack {
    /// `[channels + previous, global]`
    weight: Param<Tensor<2>>,
    /// `[global]`
    bias: Param<Tensor<1>>,
    /// `[global, channels]`, from the previous global vector into this layer's maps; absent in the first layer.
    injection: Option<Param<Tensor<2>>>,
}

/// What the global track adds to a layer and hands to the next one.
pub struct GlobalStep {
    /// `[N, channels]`, to be added to the layer's maps.
    pub bias: Option<Tensor<2>>,
    /// `[N, global]`
    pub global: Tensor<2>,
}

impl GlobalTrack {
    /// Draws the part of a layer with `channels` maps; `first` has no global vector before it.
    pub fn init(channels: usize, global: usize, first: bool, device: &Device, rng: &mut ChaCha8Rng) -> Self {
        let inputs = if first { channels } else { channels + global };
        Self {
            weight: gaussian([inputs, global], 1.0 / (inputs as f32).sqrt(), device, rng),
            bias: gaussian([global], BIAS_STD, device, rng),
            injection: (!first).then(|| gaussian([global, channels], INJECTION_STD / (global as f32).sqrt(), device, rng)),
        }
    }

    /// Means and the previous global vector → the layer's bias and the next global vector.
    ///
    /// # Shapes
    /// `means [N, channels]`, `previous [N, global]`
    ///
    /// # Panics
    /// If `previous` is missing where the layer expects one.
    pub fn forward(&self, means: Tensor<2>, previous: Option<Tensor<2>>) -> GlobalStep {
        let (bias, inputs) = match (&self.injection, previous) {
            (Some(injection), Some(previous)) => {
                (Some(previous.clone().matmul(injection.val())), Tensor::cat(vec![means, previous], 1))
            }
            (None, _) => (None, means),
            (Some(_), None) => panic!("a global track after the first layer needs the previous global vector"),
        };
        let global = selu(inputs.matmul(self.weight.val()) + self.bias.val().unsqueeze());
        GlobalStep { bias, global }
    }
}
