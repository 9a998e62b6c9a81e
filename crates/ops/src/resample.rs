//! Resizing tensors: the few filters the nets use.

use burn::tensor::{
    Tensor,
    module::interpolate,
    ops::{InterpolateMode, InterpolateOptions},
};

/// Every pixel becomes a 2×2 block.
///
/// # Shapes
/// `[N, C, H, W]` → `[N, C, 2H, 2W]`
pub fn upsample_nearest2(x: Tensor<4>) -> Tensor<4> {
    let [n, c, h, w] = x.dims();
    x.reshape([n, c, h * w, 1])
        .repeat_dim(3, 2)
        .reshape([n, c, h, 2 * w])
        .reshape([n, c, h, 1, 2 * w])
        .repeat_dim(3, 2)
        .reshape([n, c, 2 * h, 2 * w])
}

/// Bilinear enlargement with half-pixel alignment.
///
/// # Shapes
/// `[N, C, H, W]` → `[N, C, factor·H, factor·W]`
pub fn upsample_bilinear(x: Tensor<4>, factor: usize) -> Tensor<4> {
    let options = InterpolateOptions::new(InterpolateMode::Bilinear)
        .with_scale_factor([factor as f32, factor as f32])
        .with_align_corners(false);
    interpolate(x, options)
}

/// Mean over blocks of `factor × factor` pixels; rows and columns that fill no whole block are left out.
///
/// # Shapes
/// `[N, C, H, W]` → `[N, C, H / factor, W / factor]`
pub fn area_downsample(x: Tensor<4>, factor: usize) -> Tensor<4> {
    let [n, c, h, w] = x.dims();
    let (oh, ow) = (h / factor, w / factor);
    let whole = x.slice([0..n, 0..c, 0..oh * factor, 0..ow * factor]);
    whole.reshape([n * c * oh, factor, ow, factor]).mean_dims(&[1, 3]).reshape([n, c, oh, ow])
}
