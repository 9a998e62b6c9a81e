//! The global track: image-wide statistics that run beside the convolutions (Deschaintre et al. 2018, paper §6).

use burn::module::{Module, Param};
use burn::tensor::{Device, Tensor};
use rand_chacha::ChaCha8Rng;

use super::convolution::gaussian;

/// Standard deviation of the initial bias (spec 4.1).
const BIAS_STD: f32 = 0.002;
/// Initial standard deviation, times √inputs, of the connection back into the maps (spec 4.1).
const INJECTION_STD: f32 = 0.01;

/// α of the scaled exponential linear unit (Klambauer et al. 2017).
const SELU_ALPHA: f32 = 1.673_263_2;
/// γ of the scaled exponential linear unit.
const SELU_GAMMA: f32 = 1.050_701;

/// γ·x above 0, γ·α·(eˣ − 1) below.
///
/// burn's own takes eˣ of every value and masks it afterwards: beyond 88 that is infinite, and its masked gradient 0 · ∞ is NaN.
fn selu(x: Tensor<2>) -> Tensor<2> {
    let below = (x.clone().clamp_max(0.0).exp() - 1.0) * (SELU_GAMMA * SELU_ALPHA);
    x.clamp_min(0.0) * SELU_GAMMA + below
}

/// One layer's part of the global track.
#[derive(Module, Debug)]
pub struct GlobalTrack {
    /// `[channels + previous, global]`
    weight: Param<Tensor<2>>,
    /// `[global]`
    bias: Param<Tensor<1>>,
    /// `[previous, channels]`, from the previous global vector into this layer's maps; absent in the first layer.
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
    /// Draws the part of a layer with `channels` maps, whose global vector follows one of `previous` numbers; the first layer's
    /// follows none.
    pub fn init(channels: usize, previous: Option<usize>, global: usize, device: &Device, rng: &mut ChaCha8Rng) -> Self {
        let inputs = channels + previous.unwrap_or(0);
        Self {
            weight: gaussian([inputs, global], 1.0 / (inputs as f32).sqrt(), device, rng),
            bias: gaussian([global], BIAS_STD, device, rng),
            injection: previous.map(|p| gaussian([p, channels], INJECTION_STD / (p as f32).sqrt(), device, rng)),
        }
    }

    /// Means and the previous global vector → the layer's bias and the next global vector.
    ///
    /// # Shapes
    /// `means [N, channels]`, `previous [N, previous]`
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

#[cfg(test)]
mod tests {
    use super::*;
    use burn::tensor::TensorData;
    use ops::planes::values;

    #[test]
    fn selu_has_its_values_and_finite_slopes_at_any_size() {
        let device = Device::flex().autodiff();
        let x = Tensor::<2>::from_data(TensorData::from([[-200.0f32, -1.0, 2.0, 200.0]]), &device).require_grad();
        let y = selu(x.clone());
        let expected = [-1.758_099, -1.111_331, 2.101_402, 210.140_2];
        assert!(values(y.clone()).iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-4));
        let slopes = values(x.grad(&y.sum().backward()).expect("x is tracked"));
        let expected = [0.0, 0.646_768, 1.050_701, 1.050_701];
        assert!(slopes.iter().zip(expected).all(|(a, b): (&f32, f32)| (a - b).abs() < 1e-5), "{slopes:?}");
    }
}
