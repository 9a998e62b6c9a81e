//! Bias and leaky ReLU as one step.

use burn::backend::Dispatch;
use burn::tensor::{Tensor, activation::leaky_relu};

use crate::kernel::{self, NetKernels};

/// `leaky(x + bias)`.
///
/// # Shapes
/// `x [N, C, H, W]`, `bias [N, C]` or `[1, C]`.
pub fn bias_leaky_relu(x: Tensor<4>, bias: Option<Tensor<2>>, slope: f32) -> Tensor<4> {
    if kernel::available(&x) {
        let [_, c, _, _] = x.dims();
        let bias = bias.unwrap_or_else(|| Tensor::zeros([1, c], &x.device()));
        return Tensor::from_dispatch(Dispatch::bias_leaky_relu(x.into_dispatch(), bias.into_dispatch(), slope));
    }
    reference(x, bias, slope)
}

/// The composed route: any device, the meaning of [`bias_leaky_relu`].
pub fn reference(x: Tensor<4>, bias: Option<Tensor<2>>, slope: f32) -> Tensor<4> {
    let x = match bias {
        Some(bias) => {
            let [n, c] = bias.dims();
            x + bias.reshape([n, c, 1, 1])
        }
        None => x,
    };
    leaky_relu(x, f64::from(slope))
}
