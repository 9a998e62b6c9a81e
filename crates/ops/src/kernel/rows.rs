//! The memory that the inner loops read: padded rows of pixels.

use std::mem::MaybeUninit;

use rayon::prelude::*;

use super::conv::Sizes;
use super::tile::{Offsets, TILE};
use crate::conv::{Conv3x3, Padding};

/// Pixel rows that the inner loops read: where row `y` of image `n` starts.
pub(super) struct Rows {
    pub data: Vec<f32>,
    pub image_step: usize,
    pub row_step: usize,
    pub images: usize,
}

/// What a kernel reads for each of its outputs: taps relative to the output's row and column in [`Rows`].
pub(super) struct Field {
    pub offsets: Offsets,
    pub height: usize,
    pub width: usize,
}

/// Numbers that `fill` writes: zeroing them before would take as long as writing them.
///
/// # Safety
/// `fill` must write all of them.
pub(super) unsafe fn filled(n: usize, fill: impl FnOnce(&mut [MaybeUninit<f32>])) -> Vec<f32> {
    let mut numbers = Vec::with_capacity(n);
    fill(&mut numbers.spare_capacity_mut()[..n]);
    // SAFETY: so many were allocated, and the caller promises that they are written.
    unsafe { numbers.set_len(n) };
    numbers
}

/// Zeroed memory; large blocks come from the system already zero.
pub(super) fn zeros(n: usize) -> Vec<f32> {
    vec![0.0; n]
}

/// The input as padded rows, one plane per channel, each padded row split into `stride` interleaved phases.
pub(super) fn padded_rows(x: &[f32], s: &Sizes) -> Rows {
    let Conv3x3 { stride, dilation, .. } = s.geometry;
    let (ph, pw) = (s.h + 2 * dilation, s.w + 2 * dilation);
    let phase = pw.div_ceil(stride) + TILE;
    let row = stride * phase;
    let plane = ph * row;
    let mut data = zeros(s.n * s.inputs * plane + TILE);
    data[..s.n * s.inputs * plane].par_chunks_mut(plane).enumerate().for_each(|(i, padded)| {
        let image = &x[i * s.h * s.w..][..s.h * s.w];
        for py in 0..ph {
            let Some(y) = s.source(py, s.h) else { continue };
            let (from, to) = (&image[y * s.w..][..s.w], &mut padded[py * row..][..row]);
            if stride == 1 {
                to[dilation..dilation + s.w].copy_from_slice(from);
            } else {
                for first in 0..stride.min(s.w) {
                    let start = (first + dilation) % stride * phase + (first + dilation) / stride;
                    let pixels = from[first..].iter().step_by(stride);
                    to[start..].iter_mut().zip(pixels).for_each(|(to, from)| *to = *from);
                }
            }
            if s.geometry.padding == Padding::Edge {
                for px in (0..dilation).chain(dilation + s.w..pw) {
                    to[px % stride * phase + px / stride] = from[px.saturating_sub(dilation).min(s.w - 1)];
                }
            }
        }
    });
    Rows { data, image_step: s.inputs * plane, row_step: stride * row, images: s.n }
}

/// The kernel's taps in [`padded_rows`].
pub(super) fn padded_field(rows: &Rows, s: &Sizes) -> Field {
    let Conv3x3 { stride, dilation, .. } = s.geometry;
    let (plane, row) = (rows.image_step / s.inputs, rows.row_step / stride);
    let phase = row / stride;
    let offset = |k: usize| {
        let (channel, ky, kx) = (k / 9, k % 9 / 3 * dilation, k % 3 * dilation);
        channel * plane + ky * row + kx % stride * phase + kx / stride
    };
    Field { offsets: Offsets::new((0..s.taps()).map(offset)), height: s.oh(), width: s.ow() }
}
