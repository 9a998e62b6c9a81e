//! 3×3 convolution on the CPU: forward, gradient of the input, gradient of the weights.
//!
//! The input is copied once into a padded, stride-split buffer, after which every kernel tap is a constant offset and a row
//! of output pixels reads a row of consecutive inputs. Images narrower than a register tile are laid out as columns
//! (one row holding all output pixels of the batch) and use the same inner loops.

use rayon::prelude::*;

use super::tile::{DOT, Instructions, LANES, MOST_OUTPUTS, Offsets, TILE};
use crate::conv::{Conv3x3, Padding};

/// Input channels per weight-gradient task: enough work to share out, few enough that a chunk of their rows stays in cache.
const CHANNELS: usize = 16;
/// Pixels per weight-gradient chunk: three gradient rows and one channel's input rows stay in the first-level cache.
const CHUNK: usize = 2048;

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
    fn oh(&self) -> usize {
        self.geometry.output(self.h)
    }
    fn ow(&self) -> usize {
        self.geometry.output(self.w)
    }
    fn taps(&self) -> usize {
        9 * self.inputs
    }
    fn narrow(&self) -> bool {
        self.ow() < TILE
    }
    /// Index of the source pixel that padded coordinate `p` shows, or `None` for zero padding.
    fn source(&self, p: usize, length: usize) -> Option<usize> {
        let d = self.geometry.dilation;
        match self.geometry.padding {
            Padding::Edge => Some(p.saturating_sub(d).min(length - 1)),
            Padding::Zero => (p >= d && p - d < length).then(|| p - d),
        }
    }
}

/// Pixel rows that the inner loops read: where output row `y` of image `n` starts, and each tap's offset from there.
struct Rows {
    data: Vec<f32>,
    image_step: usize,
    row_step: usize,
    images: usize,
    height: usize,
    width: usize,
    offsets: Offsets,
}

/// Zeroed memory; large blocks come from the system already zero.
fn zeros(n: usize) -> Vec<f32> {
    vec![0.0; n]
}

/// The input as padded rows, one plane per channel, each padded row split into `stride` interleaved phases.
fn padded_rows(x: &[f32], s: &Sizes) -> Rows {
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
                for (x, &v) in from.iter().enumerate() {
                    to[(x + dilation) % stride * phase + (x + dilation) / stride] = v;
                }
            }
            if s.geometry.padding == Padding::Edge {
                for px in (0..dilation).chain(dilation + s.w..pw) {
                    to[px % stride * phase + px / stride] = from[px.saturating_sub(dilation).min(s.w - 1)];
                }
            }
        }
    });
    let offset = |k: usize| {
        let (channel, ky, kx) = (k / 9, k % 9 / 3 * dilation, k % 3 * dilation);
        channel * plane + ky * row + kx % stride * phase + kx / stride
    };
    Rows {
        data,
        image_step: s.inputs * plane,
        row_step: stride * row,
        images: s.n,
        height: s.oh(),
        width: s.ow(),
        offsets: Offsets::new((0..s.taps()).map(offset)),
    }
}

/// The input as one long row per tap that holds all output pixels of the batch.
fn column_rows(x: &[f32], s: &Sizes) -> Rows {
    let (oh, ow) = (s.oh(), s.ow());
    let pixels = s.n * oh * ow;
    let step = pixels.next_multiple_of(TILE);
    let mut data = zeros(s.taps() * step);
    data.par_chunks_mut(9 * step).enumerate().for_each(|(c, columns)| {
        for (k, column) in columns.chunks_mut(step).enumerate() {
            for_each_source(s, k, |n, y, x_, o| column[o] = x[((n * s.inputs + c) * s.h + y) * s.w + x_]);
        }
    });
    Rows {
        data,
        image_step: 0,
        row_step: 0,
        images: 1,
        height: 1,
        width: pixels,
        offsets: Offsets::new((0..s.taps()).map(|k| k * step)),
    }
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

/// Output channels split into nearly equal blocks of at most [`MOST_OUTPUTS`].
fn blocks(outputs: usize) -> Vec<(usize, usize)> {
    let count = outputs.div_ceil(MOST_OUTPUTS);
    (0..count).map(|b| (outputs * b / count, outputs * (b + 1) / count)).collect()
}

/// Where the results of a correlation go: strides of image, channel and row.
struct Target {
    image: usize,
    channel: usize,
    row: usize,
}

/// A pointer that tasks may share because each writes pixels of its own.
#[derive(Clone, Copy)]
struct Shared(*mut f32);
// SAFETY: every task writes a disjoint set of output rows (see `correlate`).
unsafe impl Send for Shared {}
// SAFETY: as above.
unsafe impl Sync for Shared {}
impl Shared {
    fn pointer(self) -> *mut f32 {
        self.0
    }
}

/// `out[n, o, y, x] = Σ_k weight(o, k) · rows[n, y, x; k]` for all outputs.
fn correlate(rows: &Rows, outputs: usize, weight: impl Fn(usize, usize) -> f32 + Sync, out: &mut [f32], target: &Target) {
    let instructions = Instructions::detect();
    let taps = rows.offsets.len();
    let blocks = blocks(outputs);
    let packed: Vec<Vec<f32>> =
        blocks.par_iter().map(|&(a, b)| (0..taps * (b - a)).map(|i| weight(a + i % (b - a), i / (b - a))).collect()).collect();
    assert!(
        rows.images == 0
            || (rows.images - 1) * target.image + (outputs - 1) * target.channel + (rows.height - 1) * target.row + rows.width
                <= out.len()
    );
    let shared = Shared(out.as_mut_ptr());
    let segment = if rows.height == 1 { 8 * TILE } else { rows.width };
    let segments = rows.width.div_ceil(segment);
    (0..rows.images * rows.height * segments).into_par_iter().for_each(|task| {
        let (n, y, part) = (task / segments / rows.height, task / segments % rows.height, task % segments);
        let base = n * rows.image_step + y * rows.row_step;
        let mut acc = [[0.0; TILE]; MOST_OUTPUTS];
        for (&(a, b), weights) in blocks.iter().zip(&packed) {
            for x in (part * segment..rows.width.min((part + 1) * segment)).step_by(TILE) {
                instructions.correlate(b - a, &rows.data, base + x, &rows.offsets, weights, &mut acc);
                let count = TILE.min(rows.width - x);
                for (r, o) in (a..b).enumerate() {
                    let start = n * target.image + o * target.channel + y * target.row + x;
                    // SAFETY: the largest index was checked above; (n, y, x) belong to this task alone, and `count` stays in the row.
                    unsafe { std::ptr::copy_nonoverlapping(acc[r].as_ptr(), shared.pointer().add(start), count) };
                }
            }
        }
    });
}

/// Moves the axes of `[a][b][inner]` to `[b][a][inner]`.
fn swap_axes(x: &[f32], a: usize, b: usize, inner: usize) -> Vec<f32> {
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
    let (area, taps) = (s.oh() * s.ow(), s.taps());
    let mut out = zeros(s.n * s.outputs * area);
    let weight = |o: usize, k: usize| w[o * taps + k];
    if s.narrow() {
        correlate(&column_rows(x, s), s.outputs, weight, &mut out, &Target { image: 0, channel: s.n * area, row: 0 });
        return swap_axes(&out, s.outputs, s.n, area);
    }
    correlate(&padded_rows(x, s), s.outputs, weight, &mut out, &Target { image: s.outputs * area, channel: area, row: s.ow() });
    out
}

/// Gradient of the input: `gradient [N, O, oh, ow]` → `[N, I, H, W]`
pub fn backward_input(gradient: &[f32], w: &[f32], s: &Sizes) -> Vec<f32> {
    if s.narrow() { backward_input_narrow(gradient, w, s) } else { backward_input_wide(gradient, w, s) }
}

fn backward_input_narrow(gradient: &[f32], w: &[f32], s: &Sizes) -> Vec<f32> {
    let (area, taps) = (s.oh() * s.ow(), s.taps());
    let pixels = s.n * area;
    let step = pixels.next_multiple_of(TILE);
    let mut data = zeros(s.outputs * step);
    for o in 0..s.outputs {
        for n in 0..s.n {
            data[o * step + n * area..][..area].copy_from_slice(&gradient[(n * s.outputs + o) * area..][..area]);
        }
    }
    let rows = Rows {
        data,
        image_step: 0,
        row_step: 0,
        images: 1,
        height: 1,
        width: pixels,
        offsets: Offsets::new((0..s.outputs).map(|o| o * step)),
    };
    let mut columns = zeros(taps * pixels);
    correlate(&rows, taps, |k, o| w[o * taps + k], &mut columns, &Target { image: 0, channel: pixels, row: 0 });
    let mut by_channel = zeros(s.inputs * s.n * s.h * s.w);
    by_channel.par_chunks_mut(s.n * s.h * s.w).enumerate().for_each(|(c, gx)| {
        for k in 0..9 {
            let column = &columns[(c * 9 + k) * pixels..][..pixels];
            for_each_source(s, k, |n, y, x, o| gx[(n * s.h + y) * s.w + x] += column[o]);
        }
    });
    swap_axes(&by_channel, s.inputs, s.n, s.h * s.w)
}

fn backward_input_wide(gradient: &[f32], w: &[f32], s: &Sizes) -> Vec<f32> {
    let Conv3x3 { stride, dilation, .. } = s.geometry;
    let (oh, ow) = (s.oh(), s.ow());
    let (ph, pw) = (s.h + 2 * dilation, s.w + 2 * dilation);
    // The gradient with a border wide enough that every tap of every padded input pixel reads a zero or a value.
    let border = 2 * dilation / stride + 1;
    let row = ow + 2 * border + TILE;
    let plane = (oh + 2 * border) * row;
    let mut data = zeros(s.n * s.outputs * plane + TILE);
    data[..s.n * s.outputs * plane].par_chunks_mut(plane).enumerate().for_each(|(i, padded)| {
        for y in 0..oh {
            padded[(y + border) * row + border..][..ow].copy_from_slice(&gradient[(i * oh + y) * ow..][..ow]);
        }
    });
    let mut padded = zeros(s.n * s.inputs * ph * pw);
    let mut rows = Rows {
        data,
        image_step: s.outputs * plane,
        row_step: row,
        images: s.n,
        height: 0,
        width: 0,
        offsets: Offsets::new(std::iter::empty()),
    };
    for phase_y in 0..stride {
        for phase_x in 0..stride {
            let hits = |k: usize, phase: usize| k * dilation % stride == phase;
            let kernel: Vec<usize> = (0..9).filter(|k| hits(k / 3, phase_y) && hits(k % 3, phase_x)).collect();
            rows.height = (ph - phase_y).div_ceil(stride);
            rows.width = (pw - phase_x).div_ceil(stride);
            // Padded input pixel (stride·i + phase) takes from output i + (phase − k·dilation) / stride.
            let shift = |k: usize, phase: usize| border - (k * dilation - phase) / stride;
            rows.offsets = Offsets::new((0..s.outputs * kernel.len()).map(|i| {
                let (o, k) = (i / kernel.len(), kernel[i % kernel.len()]);
                o * plane + shift(k / 3, phase_y) * row + shift(k % 3, phase_x)
            }));
            let weight = |c: usize, i: usize| w[(i / kernel.len() * s.inputs + c) * 9 + kernel[i % kernel.len()]];
            let (height, width) = (rows.height, rows.width);
            let mut out = zeros(s.n * s.inputs * height * width);
            correlate(
                &rows,
                s.inputs,
                weight,
                &mut out,
                &Target { image: s.inputs * height * width, channel: height * width, row: width },
            );
            padded.par_chunks_mut(ph * pw).zip(out.par_chunks(height * width)).for_each(|(to, from)| {
                for i in 0..height {
                    let target = &mut to[(stride * i + phase_y) * pw + phase_x..];
                    target.iter_mut().step_by(stride).zip(&from[i * width..][..width]).for_each(|(t, f)| *t = *f);
                }
            });
        }
    }
    fold(&padded, s)
}

/// Adds the gradient of padding pixels to the pixels they repeat (edge) or drops it (zero).
fn fold(padded: &[f32], s: &Sizes) -> Vec<f32> {
    let d = s.geometry.dilation;
    let (ph, pw) = (s.h + 2 * d, s.w + 2 * d);
    let mut out = zeros(s.n * s.inputs * s.h * s.w);
    out.par_chunks_mut(s.h * s.w).zip(padded.par_chunks(ph * pw)).for_each(|(to, from)| {
        for y in 0..s.h {
            to[y * s.w..][..s.w].copy_from_slice(&from[(y + d) * pw + d..][..s.w]);
        }
        if s.geometry.padding == Padding::Edge {
            for py in 0..ph {
                let y = py.saturating_sub(d).min(s.h - 1);
                let inner = py >= d && py < d + s.h;
                for px in (0..pw).filter(|px| !inner || *px < d || *px >= d + s.w) {
                    to[y * s.w + px.saturating_sub(d).min(s.w - 1)] += from[py * pw + px];
                }
            }
        }
    });
    out
}

/// Gradient of the weights: `x [N, I, H, W]`, `gradient [N, O, oh, ow]` → `[O, I, 3, 3]`
pub fn backward_weight(x: &[f32], gradient: &[f32], s: &Sizes) -> Vec<f32> {
    let area = s.oh() * s.ow();
    if s.narrow() {
        let by_output = swap_axes(gradient, s.n, s.outputs, area);
        return correlate_gradient(&column_rows(x, s), &by_output, s, &Target { image: 0, channel: s.n * area, row: 0 });
    }
    correlate_gradient(&padded_rows(x, s), gradient, s, &Target { image: s.outputs * area, channel: area, row: s.ow() })
}

/// `gw[o, k] = Σ_{n, y, x} gradient[n, o, y, x] · rows[n, y, x; k]`. Each task owns its outputs and taps, so sums have one order.
fn correlate_gradient(rows: &Rows, gradient: &[f32], s: &Sizes, layout: &Target) -> Vec<f32> {
    let instructions = Instructions::detect();
    let taps = s.taps();
    let groups = s.inputs.div_ceil(CHANNELS);
    let chunk_rows = (CHUNK / rows.width).max(1);
    let tiles: Vec<Vec<f32>> = (0..s.outputs.div_ceil(DOT) * groups)
        .into_par_iter()
        .map(|task| {
            let (first, group) = (task / groups * DOT, task % groups);
            let count = DOT.min(s.outputs - first);
            let tap_range = group * CHANNELS * 9..((group + 1) * CHANNELS * 9).min(taps);
            let mut acc = vec![[[[0.0f32; LANES]; DOT]; DOT]; tap_range.len() / DOT];
            for n in 0..rows.images {
                for start in (0..rows.height).step_by(chunk_rows) {
                    for (a, k) in acc.iter_mut().zip(tap_range.clone().step_by(DOT)) {
                        for y in start..rows.height.min(start + chunk_rows) {
                            let row = |i: usize| {
                                &gradient[n * layout.image + (first + i.min(count - 1)) * layout.channel + y * layout.row..]
                                    [..rows.width]
                            };
                            let base = n * rows.image_step + y * rows.row_step;
                            let tap = |j: usize| &rows.data[base + rows.offsets.at(k + j)..][..rows.width];
                            instructions.dot(count, [row(0), row(1), row(2)], [tap(0), tap(1), tap(2)], a);
                        }
                    }
                }
            }
            (0..count).flat_map(|i| acc.iter().flat_map(move |a| a[i].iter().map(|lanes| lanes.iter().sum::<f32>()))).collect()
        })
        .collect();
    let mut out = zeros(s.outputs * taps);
    for (task, tile) in tiles.iter().enumerate() {
        let (first, group) = (task / groups * DOT, task % groups);
        let count = DOT.min(s.outputs - first);
        for (i, part) in tile.chunks(tile.len() / count).enumerate() {
            out[(first + i) * taps + group * CHANNELS * 9..][..part.len()].copy_from_slice(part);
        }
    }
    out
}
