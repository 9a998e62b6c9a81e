//! Weight normalisation: filters of one norm.

use burn::backend::Dispatch;
use burn::tensor::Tensor;

use crate::kernel::{self, NetKernels};

/// Added under the root of a filter's norm.
pub const EPSILON: f32 = 1e-8;

/// `gain · w / √(Σ w² + ε)` for each output's filter.
///
/// # Shapes
/// `weight [O, I, 3, 3]` → the same
///
/// # Source
/// Paper Eq. 5, with a gain.
pub fn normalised_filters(weight: Tensor<4>, gain: f32) -> Tensor<4> {
    if kernel::available(&weight) {
        return Tensor::from_dispatch(Dispatch::normalised_filters(weight.into_dispatch(), gain));
    }
    reference(weight, gain)
}

/// The composed route: any device, the meaning of [`normalised_filters`].
pub fn reference(weight: Tensor<4>, gain: f32) -> Tensor<4> {
    let [outputs, inputs, height, width] = weight.dims();
    let rows = weight.reshape([outputs, inputs * height * width]);
    let norm = rows.clone().square().sum_dim(1).add_scalar(EPSILON).sqrt();
    (rows / norm * gain).reshape([outputs, inputs, height, width])
}
