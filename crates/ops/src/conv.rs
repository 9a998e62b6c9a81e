//! 3×3 convolution with edge or zero padding, stride and dilation: the one convolution both nets use.

use burn::backend::Dispatch;
use burn::tensor::{
    FloatDType, Tensor,
    module::conv2d,
    ops::{ConvOptions, PadMode},
};

use crate::compute::Compute;
use crate::kernel::{self, NetKernels};
use crate::resample::upsample_nearest2;

/// What surrounds the image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Padding {
    /// The border pixel repeats (SVBRDF net, spec 4.1).
    Edge,
    /// Zeros (PWC-Net).
    Zero,
}

/// Geometry of a 3×3 convolution. The padding is always `dilation` on each side, so the output is `ceil(size / stride)`, or
/// twice the size.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Conv3x3 {
    /// Distance between output samples in input pixels.
    pub stride: usize,
    /// Distance between taps in input pixels.
    pub dilation: usize,
    /// What surrounds the image.
    pub padding: Padding,
    /// The image is read as if each of its pixels were a block of 2×2 (with stride and dilation 1): the enlargement costs
    /// nothing then, and less than half of the multiplications.
    pub enlarge: bool,
}

impl Conv3x3 {
    /// Stride 1, dilation 1.
    pub const fn same(padding: Padding) -> Self {
        Self { stride: 1, dilation: 1, padding, enlarge: false }
    }

    /// Stride 2, dilation 1.
    pub const fn halving(padding: Padding) -> Self {
        Self { stride: 2, ..Self::same(padding) }
    }

    /// Nearest ×2 enlargement, then stride 1, dilation 1.
    pub const fn enlarging(padding: Padding) -> Self {
        Self { enlarge: true, ..Self::same(padding) }
    }

    /// Output length for an input length.
    pub fn output(&self, length: usize) -> usize {
        if self.enlarge { 2 * length } else { length.div_ceil(self.stride) }
    }
}

/// Convolves without bias, in the format of [`Compute::within`].
///
/// # Shapes
/// `x [N, I, H, W]`, `weight [O, I, 3, 3]` → `[N, O, ceil(H / stride), ceil(W / stride)]`, or `[N, O, 2H, 2W]`
///
/// # Panics
/// If the image is to be enlarged and read with a stride or dilation.
pub fn conv3x3(x: Tensor<4>, weight: Tensor<4>, geometry: Conv3x3) -> Tensor<4> {
    assert!(
        !geometry.enlarge || (geometry.stride, geometry.dilation) == (1, 1),
        "{geometry:?}: expected stride and dilation 1"
    );
    match Compute::current().rounded() {
        None => single(x, weight, geometry),
        // As a GPU multiplies halves: the sums are single.
        Some(format) if kernel::available(&x) => {
            let round = |t: Tensor<4>| t.cast(format).cast(FloatDType::F32);
            round(single(round(x), round(weight), geometry))
        }
        Some(format) => reference(x.cast(format), weight.cast(format), geometry).cast(FloatDType::F32),
    }
}

fn single(x: Tensor<4>, weight: Tensor<4>, geometry: Conv3x3) -> Tensor<4> {
    if kernel::available(&x) {
        return Tensor::from_dispatch(Dispatch::conv3x3(x.into_dispatch(), weight.into_dispatch(), geometry));
    }
    reference(x, weight, geometry)
}

/// The composed route: any device, the meaning of [`conv3x3`].
pub fn reference(x: Tensor<4>, weight: Tensor<4>, geometry: Conv3x3) -> Tensor<4> {
    let Conv3x3 { stride, dilation, padding, enlarge } = geometry;
    let x = if enlarge { upsample_nearest2(x) } else { x };
    let (x, pad) = match padding {
        Padding::Edge => (x.pad((dilation, dilation, dilation, dilation), PadMode::Edge), 0),
        Padding::Zero => (x, dilation),
    };
    conv2d(x, weight, None, ConvOptions::new([stride, stride], [pad, pad], [dilation, dilation], 1))
}
