//! 3×3 convolution with edge or zero padding, stride and dilation: the one convolution both nets use.

use burn::backend::Dispatch;
use burn::tensor::{
    Tensor,
    module::conv2d,
    ops::{ConvOptions, PadMode},
};

use crate::kernel::{self, NetKernels};

/// What surrounds the image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Padding {
    /// The border pixel repeats (SVBRDF net, spec 4.1).
    Edge,
    /// Zeros (PWC-Net).
    Zero,
}

/// Geometry of a 3×3 convolution. The padding is always `dilation` on each side, so the output is `ceil(size / stride)`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Conv3x3 {
    /// Distance between output samples in input pixels.
    pub stride: usize,
    /// Distance between taps in input pixels.
    pub dilation: usize,
    /// What surrounds the image.
    pub padding: Padding,
}

impl Conv3x3 {
    /// Stride 1, dilation 1.
    pub fn same(padding: Padding) -> Self {
        Self { stride: 1, dilation: 1, padding }
    }

    /// Stride 2, dilation 1.
    pub fn halving(padding: Padding) -> Self {
        Self { stride: 2, dilation: 1, padding }
    }

    /// Output length for an input length.
    pub fn output(&self, length: usize) -> usize {
        length.div_ceil(self.stride)
    }
}

/// Convolves without bias.
///
/// # Shapes
/// `x [N, I, H, W]`, `weight [O, I, 3, 3]` → `[N, O, ceil(H / stride), ceil(W / stride)]`
pub fn conv3x3(x: Tensor<4>, weight: Tensor<4>, geometry: Conv3x3) -> Tensor<4> {
    if kernel::available(&x) {
        return Tensor::from_dispatch(Dispatch::conv3x3(x.into_dispatch(), weight.into_dispatch(), geometry));
    }
    reference(x, weight, geometry)
}

/// The composed route: any device, the meaning of [`conv3x3`].
pub fn reference(x: Tensor<4>, weight: Tensor<4>, geometry: Conv3x3) -> Tensor<4> {
    let Conv3x3 { stride, dilation, padding } = geometry;
    let (x, pad) = match padding {
        Padding::Edge => (x.pad((dilation, dilation, dilation, dilation), PadMode::Edge), 0),
        Padding::Zero => (x, dilation),
    };
    conv2d(x, weight, None, ConvOptions::new([stride, stride], [pad, pad], [dilation, dilation], 1))
}
