//! Correlation of two feature maps over a window of displacements (PWC-Net's cost volume, paper §5).

use burn::backend::Dispatch;
use burn::tensor::{Tensor, ops::PadMode};

use crate::kernel::{self, NetKernels};

/// Mean over channels of `a(x) · b(x + d)` for every displacement `d` in `[−radius, radius]²`.
///
/// # Shapes
/// `a, b [N, C, H, W]` → `[N, (2·radius + 1)², H, W]`; channel `(dy + radius)·(2·radius + 1) + dx + radius`. Outside of `b` counts as 0.
pub fn cost_volume(a: Tensor<4>, b: Tensor<4>, radius: usize) -> Tensor<4> {
    if kernel::available(&a) {
        return Tensor::from_dispatch(Dispatch::cost_volume(a.into_dispatch(), b.into_dispatch(), radius));
    }
    reference(a, b, radius)
}

/// The composed route: any device, the meaning of [`cost_volume`].
pub fn reference(a: Tensor<4>, b: Tensor<4>, radius: usize) -> Tensor<4> {
    let [n, c, h, w] = a.dims();
    let padded = b.pad((radius, radius, radius, radius), PadMode::Constant(0.0));
    let side = 2 * radius + 1;
    let planes = (0..side * side)
        .map(|i| {
            let (dy, dx) = (i / side, i % side);
            (a.clone() * padded.clone().slice([0..n, 0..c, dy..dy + h, dx..dx + w])).mean_dim(1)
        })
        .collect();
    Tensor::cat(planes, 1)
}
