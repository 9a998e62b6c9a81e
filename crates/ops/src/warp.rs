//! Bilinear warping of features with validity, and the masked maximum over warped frames (paper §6).

use burn::backend::Dispatch;
use burn::tensor::{Int, Tensor};

use crate::kernel::{self, NetKernels};

/// Features sampled at a flow's source positions.
#[derive(Clone, Debug)]
pub struct Warped {
    /// `[N, C, H, W]`; 0 where invalid.
    pub values: Tensor<4>,
    /// `[N, 1, H, W]`; 1 where all bilinear taps lie inside the source, else 0. Carries no gradient.
    pub valid: Tensor<4>,
}

/// Source positions `[N, H, W]` in pixels, x and y.
fn positions(flow: Tensor<4>) -> (Tensor<3>, Tensor<3>) {
    let [n, _, h, w] = flow.dims();
    let device = flow.device();
    let xs = Tensor::<1, Int>::arange(0..w as i64, &device).float().reshape([1, 1, w]);
    let ys = Tensor::<1, Int>::arange(0..h as i64, &device).float().reshape([1, h, 1]);
    let x = flow.clone().slice([0..n, 0..1, 0..h, 0..w]).reshape([n, h, w]) + xs;
    let y = flow.slice([0..n, 1..2, 0..h, 0..w]).reshape([n, h, w]) + ys;
    (x, y)
}

/// The first of the two pixels that lie around each position, and how far behind it the position is. On a pixel that is the pixel
/// itself, and its left neighbour on the last one, so positions have the slope of the only side that the last pixel has.
fn taps(positions: Tensor<3>, length: usize) -> (Tensor<3, Int>, Tensor<3>) {
    let first = positions.clone().detach().floor().clamp_max(length.saturating_sub(2) as f32);
    (first.clone().int(), positions - first)
}

/// Samples `x` at `target pixel + flow`. Gradients reach the features and the flow. Where a source position is a pixel's centre,
/// interpolation has a kink: the flow's gradient is that of the right and lower side there, and of the left and upper side in the
/// last column and row.
///
/// # Shapes
/// `x [N, C, H, W]`, `flow [N, 2, H, W]`. A NaN flow is invalid.
pub fn warp(x: Tensor<4>, flow: Tensor<4>) -> Warped {
    if kernel::available(&x) {
        let mask = |flow: Tensor<4>| -> Tensor<4> { Tensor::from_dispatch(Dispatch::warp_valid(flow.into_dispatch())) };
        let valid =
            if flow.device().is_autodiff() { Tensor::from_inner(mask(flow.clone().inner())) } else { mask(flow.clone()) };
        return Warped { values: Tensor::from_dispatch(Dispatch::warp(x.into_dispatch(), flow.into_dispatch())), valid };
    }
    reference_warp(x, flow)
}

/// The composed route: any device, the meaning of [`warp`].
pub fn reference_warp(x: Tensor<4>, flow: Tensor<4>) -> Warped {
    let [n, c, h, w] = x.dims();
    let broken = flow.clone().is_nan();
    let (px, py) = positions(flow.mask_fill(broken, -1e6));
    let inside =
        |p: &Tensor<3>, last: usize| p.clone().greater_equal_elem(0.0).bool_and(p.clone().lower_equal_elem(last as f32));
    let seen = inside(&px, w - 1).bool_and(inside(&py, h - 1));
    let (valid, outside) = (seen.clone().float().reshape([n, 1, h, w]), seen.bool_not());
    let [(left, fx), (top, fy)] = [(px, w), (py, h)].map(|(p, length)| taps(p.mask_fill(outside.clone(), 0.0), length));
    let pixels = x.reshape([n, c, h * w]);
    let at = |down: usize, right: usize| {
        let index = (top.clone() + down.min(h - 1) as i64) * w as i64 + left.clone() + right.min(w - 1) as i64;
        pixels.clone().gather(2, index.reshape([n, 1, h * w]).expand([n, c, h * w]))
    };
    let between = |a: Tensor<3>, b: Tensor<3>, share: &Tensor<3>| a.clone() + (b - a) * share.clone().reshape([n, 1, h * w]);
    let (upper, lower) = (between(at(0, 0), at(0, 1), &fx), between(at(1, 0), at(1, 1), &fx));
    let values = between(upper, lower, &fy).reshape([n, c, h, w]) * valid.clone();
    Warped { values, valid }
}

/// Element-wise maximum of the guidance features and all validly warped key-frame features.
///
/// # Shapes
/// `guidance [1, C, H, W]`, `features [K, C, H, W]`, `flow [K, 2, H, W]` → `[1, C, H, W]`
///
/// # Source
/// Paper §6. Departs: invalid pixels are masked instead of set to −1e38, so no huge number enters the graph.
pub fn warp_max(guidance: Tensor<4>, features: Tensor<4>, flow: Tensor<4>) -> Tensor<4> {
    if kernel::available(&features) {
        let (guidance, features) = (guidance.into_dispatch(), features.into_dispatch());
        let (maximum, _) = Dispatch::warp_max(guidance, features, flow.into_dispatch());
        return Tensor::from_dispatch(maximum);
    }
    reference_warp_max(guidance, features, flow)
}

/// The composed route: any device, the meaning of [`warp_max`].
pub fn reference_warp_max(guidance: Tensor<4>, features: Tensor<4>, flow: Tensor<4>) -> Tensor<4> {
    let [k, c, h, w] = features.dims();
    let Warped { values, valid } = reference_warp(features, flow);
    let mut pooled = guidance;
    for i in 0..k {
        let frame = values.clone().slice([i..i + 1, 0..c, 0..h, 0..w]);
        let seen = valid.clone().slice([i..i + 1, 0..1, 0..h, 0..w]).expand([1, c, h, w]).greater_elem(0.5);
        let candidate = pooled.clone().mask_where(seen, frame);
        pooled = pooled.max_pair(candidate);
    }
    pooled
}
