//! A dilated convolution between zeros as one of dilation 1, which needs fewer multiplications (`winograd`).
//!
//! Every `dilation`-th row makes an image of its own that no tap leaves; in it every `dilation`-th pixel of a row stands beside
//! the one before, and a zero between these pieces is all that their taps see of each other.

use std::mem::MaybeUninit;

use rayon::prelude::*;

use super::conv::{self, Sizes};
use super::rows::filled;
use crate::conv::{Conv3x3, Padding};

/// Whether a convolution can be done so.
pub(super) fn applies(s: &Sizes) -> bool {
    let Conv3x3 { stride, dilation, padding, enlarge } = s.geometry;
    (2..=s.h.min(s.w)).contains(&dilation) && stride == 1 && padding == Padding::Zero && !enlarge
}

/// `x [N, I, H, W]`, `w [O, I, 3, 3]` → `[N, O, H, W]`
pub(super) fn forward(x: &[f32], w: &[f32], s: &Sizes) -> Vec<f32> {
    join(&conv::forward(&split(x, s.inputs, s), w, &dense(s)), s.outputs, s)
}

/// Gradient of the input: `gradient [N, O, H, W]` → `[N, I, H, W]`
pub(super) fn backward_input(gradient: &[f32], w: &[f32], s: &Sizes) -> Vec<f32> {
    join(&conv::backward_input(&split(gradient, s.outputs, s), w, &dense(s)), s.inputs, s)
}

/// Gradient of the weights: `x [N, I, H, W]`, `gradient [N, O, H, W]` → `[O, I, 3, 3]`
pub(super) fn backward_weight(x: &[f32], gradient: &[f32], s: &Sizes) -> Vec<f32> {
    conv::backward_weight(&split(x, s.inputs, s), &split(gradient, s.outputs, s), &dense(s))
}

/// From one piece of a row to the next.
fn pitch(s: &Sizes) -> usize {
    s.w.div_ceil(s.geometry.dilation) + 1
}

/// The convolution of dilation 1.
fn dense(s: &Sizes) -> Sizes {
    let d = s.geometry.dilation;
    Sizes { n: s.n * d, h: s.h.div_ceil(d), w: d * pitch(s) - 1, geometry: Conv3x3::same(Padding::Zero), ..*s }
}

/// `[N, C, H, W]` → `[N, phase, C, h, w]`; rows that end early are filled up with zeros, which is what lies there anyway.
fn split(x: &[f32], channels: usize, s: &Sizes) -> Vec<f32> {
    let (d, pitch, Sizes { n, h, w, .. }) = (s.geometry.dilation, pitch(s), dense(s));
    // Where each pixel comes from; a zero comes from behind the row.
    let source = |i: usize| if i % pitch + 1 == pitch { s.w } else { i % pitch * d + i / pitch };
    let sources: Vec<usize> = (0..w).map(source).collect();
    let fill = |out: &mut [MaybeUninit<f32>]| {
        out.par_chunks_mut(h * w).enumerate().for_each(|(plane, to)| {
            let (image, channel) = (plane / channels, plane % channels);
            for (y, to) in to.chunks_exact_mut(w).enumerate().map(|(y, to)| (y * d + image % d, to)) {
                let row = if y < s.h { &x[((image / d * channels + channel) * s.h + y) * s.w..][..s.w] } else { &[] };
                to.iter_mut().zip(&sources).for_each(|(to, &from)| _ = to.write(row.get(from).copied().unwrap_or(0.0)));
            }
        });
    };
    // SAFETY: every row of every plane is written.
    unsafe { filled(n * channels * h * w, fill) }
}

/// The reverse of [`split`].
fn join(phases: &[f32], channels: usize, s: &Sizes) -> Vec<f32> {
    let (d, pitch, Sizes { h, w, .. }) = (s.geometry.dilation, pitch(s), dense(s));
    let sources: Vec<usize> = (0..s.w).map(|x| x % d * pitch + x / d).collect();
    let fill = |out: &mut [MaybeUninit<f32>]| {
        out.par_chunks_mut(s.h * s.w).enumerate().for_each(|(plane, to)| {
            let (n, channel) = (plane / channels, plane % channels);
            for (y, to) in to.chunks_exact_mut(s.w).enumerate() {
                let row = &phases[(((n * d + y % d) * channels + channel) * h + y / d) * w..][..w];
                to.iter_mut().zip(&sources).for_each(|(to, &from)| _ = to.write(row[from]));
            }
        });
    };
    // SAFETY: every row of every plane is written.
    unsafe { filled(s.n * channels * s.h * s.w, fill) }
}
