//! 3×3 convolution on the CPU: forward, gradient of the input, gradient of the weights.
//!
//! The input is copied once into a padded, stride-split buffer (`rows`), after which every kernel tap is a
//! constant offset and a row of output pixels reads a row of consecutive inputs. Where Winograd's algorithm pays
//! (`winograd`), it is taken; images narrower than a register tile have their own way (`columns`).

use super::correlate::{Part, Target, Weights, correlate};
use super::rows::{filled, padded_field, padded_rows};
use super::tile::TILE;
use super::transposed::input_gradient;
use super::weight_gradient::correlate_gradient;
use super::winograd::{self, Extent};
use super::{columns, enlarging, phases};
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
    if s.narrow() {
        return columns::forward(x, w, s);
    }
    let rows = padded_rows(x, s);
    let field = padded_field(&rows, s);
    let part = Part::new(&field, 0, s.outputs, Weights { data: w, output: s.taps(), place: &|tap| tap });
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
    if s.narrow() {
        return columns::backward_input(gradient, w, s);
    }
    input_gradient(gradient, w, s)
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
    if s.narrow() {
        return columns::backward_weight(x, gradient, s);
    }
    let rows = padded_rows(x, s);
    correlate_gradient(&rows, &padded_field(&rows, s), gradient, s.outputs, &s.output_target())
}
