//! 3×3 convolution on the CPU: forward, gradient of the input, gradient of the weights.
//!
//! The input is copied once into a padded, stride-split buffer (`rows`), after which every kernel tap is a
//! constant offset and a row of output pixels reads a row of consecutive inputs. Images narrower than a register tile are laid
//! out as columns (one row holding all pixels of the batch) and use the same inner loops.

use super::correlate::{Part, Target, correlate};
use super::enlarging;
use super::phases;
use super::rows::{column_field, column_rows, filled, padded_field, padded_rows, reverse_columns, zeros};
use super::tile::TILE;
use super::transposed::{Bordered, Tap, input_gradient};
use super::weight_gradient::correlate_gradient;
use super::winograd::{self, Extent};
use crate::conv::{Conv3x3, Padding};

/// Tiles below which [`winograd`] costs more than it saves.
const FEWEST_TILES: usize = 16;

/// Sizes of one convolution.
#[derive(Clone, Copy, Debug)]
pub struct Sizes {
    /// Images.
    pub n: usize,
    /// Input channels.
    pub inputs: usize,
    /// Output channels.
    pub outputs: usize,
    /// Input rows.
    pub h: usize,
    /// Input columns.
    pub w: usize,
    /// Stride, dilation, padding.
    pub geometry: Conv3x3,
}

impl Sizes {
    pub(super) fn oh(&self) -> usize {
        self.geometry.output(self.h)
    }
    pub(super) fn ow(&self) -> usize {
        self.geometry.output(self.w)
    }
    pub(super) fn taps(&self) -> usize {
        9 * self.inputs
    }
    pub(super) fn narrow(&self) -> bool {
        self.ow() < TILE
    }
    /// The 3×3 kernel of an output and an input channel in `w [O, I, 3, 3]`.
    pub(super) fn kernel<'w>(&self, w: &'w [f32], output: usize, input: usize) -> &'w [f32] {
        &w[(output * self.inputs + input) * 9..][..9]
    }
    /// `[N, O, oh, ow]`
    pub(super) fn output_target(&self) -> Target {
        let area = self.oh() * self.ow();
        Target { image: self.outputs * area, channel: area, row: self.ow(), column: 1 }
    }
    /// Index of the source pixel that padded coordinate `p` shows, or `None` for zero padding.
    pub(super) fn source(&self, p: usize, length: usize) -> Option<usize> {
        let d = self.geometry.dilation;
        match self.geometry.padding {
            Padding::Edge => Some(p.saturating_sub(d).min(length - 1)),
            Padding::Zero => (p >= d && p - d < length).then(|| p - d),
        }
    }
}

/// Moves the axes of `[a][b][inner]` to `[b][a][inner]`.
pub(super) fn swap_axes(x: &[f32], a: usize, b: usize, inner: usize) -> Vec<f32> {
    let mut out = zeros(x.len());
    for i in 0..a {
        for j in 0..b {
            out[(j * a + i) * inner..][..inner].copy_from_slice(&x[(i * b + j) * inner..][..inner]);
        }
    }
    out
}

/// `x [N, I, H, W]`, `w [O, I, 3, 3]` → `[N, O, oh, ow]`
pub fn forward(x: &[f32], w: &[f32], s: &Sizes) -> Vec<f32> {
    if s.geometry.enlarge {
        return enlarging::forward(x, w, s);
    }
    if phases::applies(s) {
        return phases::forward(x, w, s);
    }
    let area = s.oh() * s.ow();
    let count = s.n * s.outputs * area;
    let kernel = |o: usize, c: usize| s.kernel(w, o, c).try_into().expect("a kernel has nine weights");
    if winograd::pays(s, s.inputs, s.outputs, FEWEST_TILES) {
        let part = winograd::Part { start: 0, extents: [Extent::Whole; 2], kernel };
        // SAFETY: the one part has every result.
        return unsafe {
            filled(count, |out| winograd::correlate(x, s, |_| [Extent::Whole; 2], &[part], out, &s.output_target()))
        };
    }
    let weights = |o: usize, c: usize, taps: &mut [f32]| taps.copy_from_slice(s.kernel(w, o, c));
    if s.narrow() {
        let (rows, pixels) = (column_rows(x, s), s.n * area);
        let part = Part::new(column_field(&rows, 0..s.taps(), pixels), 0, s.outputs, 9, weights);
        // SAFETY: the one part has every result.
        let out = unsafe { filled(count, |out| correlate(&rows, s.outputs, &[part], out, &Target::columns(pixels))) };
        return swap_axes(&out, s.outputs, s.n, area);
    }
    let rows = padded_rows(x, s);
    let part = Part::new(padded_field(&rows, s), 0, s.outputs, 9, weights);
    // SAFETY: the one part has every result.
    unsafe { filled(count, |out| correlate(&rows, s.outputs, &[part], out, &s.output_target())) }
}

/// Gradient of the input: `gradient [N, O, oh, ow]` → `[N, I, H, W]`
pub fn backward_input(gradient: &[f32], w: &[f32], s: &Sizes) -> Vec<f32> {
    if s.geometry.enlarge {
        return enlarging::backward_input(gradient, w, s);
    }
    if phases::applies(s) {
        return phases::backward_input(gradient, w, s);
    }
    if winograd::pays(s, s.outputs, s.inputs, FEWEST_TILES) {
        let kernel = |o: usize, c: usize| s.kernel(w, o, c).try_into().expect("a kernel has nine weights");
        return winograd::image_gradient(gradient, s, s.outputs, |_| [Extent::Whole; 2], kernel);
    }
    let weights = |c: usize, o: usize, taps: &mut [f32]| taps.copy_from_slice(s.kernel(w, o, c));
    if s.w < TILE {
        let taps: Vec<(usize, usize)> = (0..9).map(|k| (0, k)).collect();
        return input_gradient_narrow(gradient, 1, &taps, weights, s);
    }
    let taps: Vec<Tap> = (0..9).map(|k| Tap { plane: 0, row: k / 3, column: k % 3 }).collect();
    let (oh, ow) = (s.oh(), s.ow());
    let bordered = Bordered::new(s.n, s.outputs, [oh, ow], s.geometry, |plane, y, row| {
        row.copy_from_slice(&gradient[(plane * oh + y) * ow..][..ow]);
    });
    input_gradient(&bordered, &taps, weights, s)
}

/// Gradient of the input of a narrow image from `gradient [N, O · planes, oh · ow]`: each output has some taps, given by their
/// planes and kernel positions, and `weights(input, output, taps)` fills theirs.
pub(super) fn input_gradient_narrow(
    gradient: &[f32],
    planes: usize,
    taps: &[(usize, usize)],
    weights: impl Fn(usize, usize, &mut [f32]) + Sync,
    s: &Sizes,
) -> Vec<f32> {
    let (rows, pixels) = (reverse_columns(gradient, s.outputs, planes, taps, s), s.n * s.h * s.w);
    let field = column_field(&rows, 0..s.outputs * taps.len(), pixels);
    let part = Part::new(field, 0, s.inputs, taps.len(), weights);
    // SAFETY: the one part has every result.
    let out = unsafe { filled(s.inputs * pixels, |out| correlate(&rows, s.inputs, &[part], out, &Target::columns(pixels))) };
    swap_axes(&out, s.inputs, s.n, s.h * s.w)
}

/// Gradient of the weights: `x [N, I, H, W]`, `gradient [N, O, oh, ow]` → `[O, I, 3, 3]`
pub fn backward_weight(x: &[f32], gradient: &[f32], s: &Sizes) -> Vec<f32> {
    if s.geometry.enlarge {
        return enlarging::backward_weight(x, gradient, s);
    }
    if phases::applies(s) {
        return phases::backward_weight(x, gradient, s);
    }
    if winograd::pays_for_weights(s) {
        let part = winograd::PartGradient { start: 0, extents: [Extent::Whole; 2] };
        return winograd::weight_gradient(x, gradient, s, &[part], &s.output_target());
    }
    let rows = padded_rows(x, s);
    correlate_gradient(&rows, &padded_field(&rows, s), gradient, s.outputs, &s.output_target())
}
