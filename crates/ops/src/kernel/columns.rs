//! Convolutions of so few pixels that rows of them don't fill a register tile, as products of matrices.
//!
//! Every pixel of the smaller side (the result's; the image's where it is enlarged) takes part in nine products per pair of
//! channels, one for each kernel tap, and every other pixel is a sum of some of them. That needs 9 multiplications per pixel where
//! an enlarged image would take 36, and no weight is touched before it is multiplied.

use rayon::prelude::*;

use super::conv::Sizes;
use super::correlate::{Part, Target, Weights, correlate};
use super::rows::{Field, Rows, filled, zeros};
use super::tile::{Offsets, TILE};

/// Taps of a kernel.
const TAPS: usize = 9;

/// Both sides of a convolution as each kernel tap joins them.
struct Sides {
    images: usize,
    /// Pixels of the smaller and of the larger side's planes.
    small: usize,
    large: usize,
    /// For every tap, pairs of a pixel of the smaller side and one of the larger.
    links: [Vec<[usize; 2]>; TAPS],
}

impl Sides {
    fn new(s: &Sizes) -> Self {
        let (oh, ow) = (s.oh(), s.ow());
        let scale = if s.geometry.enlarge { 2 } else { 1 };
        let tap = |k: usize| {
            let at = |o: usize, k: usize| o * s.geometry.stride + k * s.geometry.dilation;
            let pixels =
                (0..oh * ow).map(|o| (o, s.source(at(o / ow, k / 3), scale * s.h), s.source(at(o % ow, k % 3), scale * s.w)));
            let pairs = pixels.filter_map(|(o, y, x)| Some([o, y? / scale * s.w + x? / scale]));
            pairs.map(|[output, input]| if s.geometry.enlarge { [input, output] } else { [output, input] }).collect()
        };
        let (input, output) = (s.h * s.w, oh * ow);
        let (small, large) = if s.geometry.enlarge { (input, output) } else { (output, input) };
        Self { images: s.n, small, large, links: std::array::from_fn(tap) }
    }

    /// Pixels of the smaller side in all images.
    fn pixels(&self) -> usize {
        self.images * self.small
    }

    /// `[channel, tap, pixel]`: what each tap joins to the smaller side's pixels in planes `[N, channels, large]`.
    fn gathered(&self, planes: &[f32], channels: usize) -> Rows {
        rows(channels * TAPS, self.pixels(), |row, to| {
            let (channel, k) = (row / TAPS, row % TAPS);
            for (n, to) in to.chunks_exact_mut(self.small).enumerate() {
                let plane = &planes[(n * channels + channel) * self.large..][..self.large];
                self.links[k].iter().for_each(|&[small, large]| to[small] += plane[large]);
            }
        })
    }

    /// `[channel, pixel]` of planes `[N, channels, small]`.
    fn columns(&self, planes: &[f32], channels: usize) -> Rows {
        rows(channels, self.pixels(), |channel, to| {
            for (n, to) in to.chunks_exact_mut(self.small).enumerate() {
                to.copy_from_slice(&planes[(n * channels + channel) * self.small..][..self.small]);
            }
        })
    }

    /// Planes `[N, outputs, small]`: sums over channels and taps of planes `[N, channels, large]`.
    fn narrowed(&self, planes: &[f32], channels: usize, outputs: usize, weights: Weights) -> Vec<f32> {
        let (rows, pixels) = (self.gathered(planes, channels), self.pixels());
        let field = field(&rows, channels * TAPS, pixels);
        let part = Part::new(&field, 0, outputs, weights);
        // SAFETY: the one part has every result.
        let sums = unsafe { filled(outputs * pixels, |out| correlate(&rows, outputs, &[part], out, &Target::columns(pixels))) };
        let mut out = zeros(sums.len());
        out.par_chunks_mut(self.small).enumerate().for_each(|(i, to)| {
            let (n, output) = (i / outputs, i % outputs);
            to.copy_from_slice(&sums[output * pixels + n * self.small..][..self.small]);
        });
        out
    }

    /// Planes `[N, outputs, large]`: what each tap brings from planes `[N, channels, small]`. Of an output's weights `weights(o)`,
    /// taps take the place of outputs, and channels that of taps.
    fn widened<'w>(
        &self,
        planes: &[f32],
        channels: usize,
        outputs: usize,
        weights: impl Fn(usize) -> Weights<'w> + Sync,
    ) -> Vec<f32> {
        let (rows, pixels) = (self.columns(planes, channels), self.pixels());
        let field = field(&rows, channels, pixels);
        let part = |output: usize| Part::new(&field, output * TAPS * pixels, TAPS, weights(output));
        let parts: Vec<Part> = (0..outputs).into_par_iter().map(part).collect();
        // SAFETY: the parts have every result.
        let products =
            unsafe { filled(outputs * TAPS * pixels, |out| correlate(&rows, TAPS, &parts, out, &Target::columns(pixels))) };
        let mut out = zeros(self.images * outputs * self.large);
        out.par_chunks_mut(self.large).enumerate().for_each(|(i, to)| {
            let (n, output) = (i / outputs, i % outputs);
            for (k, links) in self.links.iter().enumerate() {
                let from = &products[(output * TAPS + k) * pixels + n * self.small..][..self.small];
                links.iter().for_each(|&[small, large]| to[large] += from[small]);
            }
        });
        out
    }
}

/// So many rows of so many numbers, filled by `fill(row, numbers)` from zeros on.
fn rows(count: usize, length: usize, fill: impl Fn(usize, &mut [f32]) + Sync) -> Rows {
    // Not a power of two: what stands in one column would share a line of the cache.
    let step = length.next_multiple_of(TILE) + TILE;
    let mut data = zeros(count * step);
    data.par_chunks_mut(step).enumerate().for_each(|(row, to)| fill(row, &mut to[..length]));
    Rows { data, image_step: 0, row_step: step, images: 1 }
}

/// All of those rows as taps, for so many results.
fn field(rows: &Rows, count: usize, results: usize) -> Field {
    Field { offsets: Offsets::new((0..count).map(|row| row * rows.row_step)), height: 1, width: results }
}

/// `x [N, I, H, W]`, `w [O, I, 3, 3]` → `[N, O, oh, ow]`
pub fn forward(x: &[f32], w: &[f32], s: &Sizes) -> Vec<f32> {
    let (sides, taps) = (Sides::new(s), s.taps());
    if s.geometry.enlarge {
        let weights = |output: usize| Weights { data: &w[output * taps..], output: 1, place: &|input| TAPS * input };
        sides.widened(x, s.inputs, s.outputs, weights)
    } else {
        sides.narrowed(x, s.inputs, s.outputs, Weights { data: w, output: taps, place: &|tap| tap })
    }
}

/// Gradient of the input: `gradient [N, O, oh, ow]` → `[N, I, H, W]`
pub fn backward_input(gradient: &[f32], w: &[f32], s: &Sizes) -> Vec<f32> {
    let (sides, taps) = (Sides::new(s), s.taps());
    if s.geometry.enlarge {
        sides.narrowed(
            gradient,
            s.outputs,
            s.inputs,
            Weights { data: w, output: TAPS, place: &|tap| tap / TAPS * taps + tap % TAPS },
        )
    } else {
        let place = |output| output * taps;
        let weights = |input: usize| Weights { data: &w[input * TAPS..], output: 1, place: &place };
        sides.widened(gradient, s.outputs, s.inputs, weights)
    }
}

/// Gradient of the weights: `x [N, I, H, W]`, `gradient [N, O, oh, ow]` → `[O, I, 3, 3]`
///
/// Pixels take the place of taps, and what follows each other in memory that of pixels.
pub fn backward_weight(x: &[f32], gradient: &[f32], s: &Sizes) -> Vec<f32> {
    let (sides, taps) = (Sides::new(s), s.taps());
    let (pixels, small) = (sides.pixels(), sides.small);
    let plane = |n: usize, channel: usize| &x[(n * s.inputs + channel) * s.h * s.w..][..s.h * s.w];
    if s.geometry.enlarge {
        let (colours, sums) = (
            rows(pixels, s.inputs, |pixel, to| {
                to.iter_mut().enumerate().for_each(|(c, to)| *to = plane(pixel / small, c)[pixel % small]);
            }),
            sides.gathered(gradient, s.outputs),
        );
        let field = field(&colours, pixels, s.inputs);
        let part = |output: usize| {
            let data = &sums.data[output * TAPS * sums.row_step..];
            Part::new(&field, output * taps, TAPS, Weights { data, output: sums.row_step, place: &|pixel| pixel })
        };
        let parts: Vec<Part> = (0..s.outputs).into_par_iter().map(part).collect();
        let target = Target { image: 0, channel: 1, row: 0, column: TAPS };
        // SAFETY: the parts have every result.
        return unsafe { filled(s.outputs * taps, |out| correlate(&colours, TAPS, &parts, out, &target)) };
    }
    let mut seen = vec![[None; TAPS]; small];
    for (k, links) in sides.links.iter().enumerate() {
        links.iter().for_each(|&[small, large]| seen[small][k] = Some(large));
    }
    let colours = rows(pixels, taps, |pixel, to| {
        for (channel, to) in to.chunks_exact_mut(TAPS).enumerate() {
            let plane = plane(pixel / small, channel);
            to.iter_mut().zip(&seen[pixel % small]).for_each(|(to, from)| *to = from.map_or(0.0, |from| plane[from]));
        }
    });
    let field = field(&colours, pixels, taps);
    let part = Part::new(
        &field,
        0,
        s.outputs,
        Weights { data: gradient, output: small, place: &|pixel| pixel / small * s.outputs * small + pixel % small },
    );
    let target = Target { image: 0, channel: taps, row: 0, column: 1 };
    // SAFETY: the one part has every result.
    unsafe { filled(s.outputs * taps, |out| correlate(&colours, s.outputs, &[part], out, &target)) }
}
