//! Bilinear warping of features with validity, and the masked maximum over warped frames (paper §6).

use burn::backend::Dispatch;
use burn::tensor::{
    Int, Tensor,
    ops::{GridSampleOptions, GridSamplePaddingMode, InterpolateMode},
};

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

/// Samples `x` at `target pixel + flow`. Gradients reach the features and, away from pixel borders, the flow.
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
    let valid = inside(&px, w - 1).bool_and(inside(&py, h - 1)).float().reshape([n, 1, h, w]);
    // Clamping keeps far-away positions finite; they are masked below.
    let normalise = |p: Tensor<3>, last: usize| p.clamp(-2.0, last as f32 + 2.0) * (2.0 / last.max(1) as f32) - 1.0;
    let grid = Tensor::stack::<4>(vec![normalise(px, w - 1), normalise(py, h - 1)], 3);
    let options = GridSampleOptions::new(InterpolateMode::Bilinear)
        .with_padding_mode(GridSamplePaddingMode::Border)
        .with_align_corners(true);
    let valid = valid.detach();
    let values = x.grid_sample_2d(grid, options) * valid.clone().expand([n, c, h, w]);
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
