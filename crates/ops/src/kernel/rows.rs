//! The memory that the inner loops read: padded rows of pixels, or columns of an image too narrow for a register tile.

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

/// One long row per kernel tap (9 per channel) that holds what all output pixels of the batch see through it.
pub(super) fn column_rows(x: &[f32], s: &Sizes) -> Rows {
    columns(9, s.inputs, s.n * s.oh() * s.ow(), |channel, k, column| {
        for_each_source(s, k, |n, y, x_, o| column[o] = x[((n * s.inputs + channel) * s.h + y) * s.w + x_]);
    })
}

/// The reverse of [`column_rows`]: one long row per tap that holds, for all input pixels of the batch, the sum of what the tap
/// brings back to them from a gradient `[N, groups · planes, oh · ow]`. `taps` has the plane and kernel position of each tap of
/// a group.
pub(super) fn reverse_columns(gradient: &[f32], groups: usize, planes: usize, taps: &[(usize, usize)], s: &Sizes) -> Rows {
    let area = s.oh() * s.ow();
    columns(taps.len(), groups, s.n * s.h * s.w, |group, tap, column| {
        let (plane, k) = taps[tap];
        for_each_source(s, k, |n, y, x, o| {
            let image = (n * groups + group) * planes + plane;
            column[(n * s.h + y) * s.w + x] += gradient[image * area + o - n * area];
        });
    })
}

/// `count` columns of so many pixels for each group, filled by `fill(group, index, column)`.
fn columns(count: usize, groups: usize, pixels: usize, fill: impl Fn(usize, usize, &mut [f32]) + Sync) -> Rows {
    let step = pixels.next_multiple_of(TILE);
    let mut data = zeros(groups * count * step);
    data.par_chunks_mut(count * step).enumerate().for_each(|(group, columns)| {
        columns.chunks_mut(step).enumerate().for_each(|(index, column)| fill(group, index, column));
    });
    Rows { data, image_step: 0, row_step: step, images: 1 }
}

/// The taps that read some columns, in their order.
pub(super) fn column_field(rows: &Rows, columns: impl Iterator<Item = usize>, pixels: usize) -> Field {
    Field { offsets: Offsets::new(columns.map(|column| column * rows.row_step)), height: 1, width: pixels }
}

/// Calls `f(image, source row, source column, output pixel)` for every output pixel that kernel tap `k` (0–8) sees.
fn for_each_source(s: &Sizes, k: usize, mut f: impl FnMut(usize, usize, usize, usize)) {
    let Conv3x3 { stride, dilation, .. } = s.geometry;
    let (oh, ow) = (s.oh(), s.ow());
    for n in 0..s.n {
        for y in 0..oh {
            let Some(sy) = s.source(y * stride + k / 3 * dilation, s.h) else { continue };
            for x in 0..ow {
                let Some(sx) = s.source(x * stride + k % 3 * dilation, s.w) else { continue };
                f(n, sy, sx, (n * oh + y) * ow + x);
            }
        }
    }
}
