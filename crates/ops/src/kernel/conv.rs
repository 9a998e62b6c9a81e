//! 3×3 convolution on the CPU: forward, gradient of the input, gradient of the weights.
//!
//! The input is copied once into a padded, stride-split buffer, after which every kernel tap is a constant offset and a row
//! of output pixels reads a row of consecutive inputs. Images narrower than a register tile are laid out as columns
//! (one row holding all output pixels of the batch) and use the same inner loops. The enlarging convolution builds on them too.

use rayon::prelude::*;

use super::enlarging;
use super::tile::{Instructions, MOST_OUTPUTS, Offsets, Outputs, TILE};
use super::transposed::{Bordered, Tap, input_gradient};
use crate::conv::{Conv3x3, Padding};

/// Taps per weight-gradient task: so many that turning the gradient costs little beside them, few enough that their sums and
/// rows stay in the second-level cache.
const TAPS: usize = 36 * 9;
/// Pixels that are added to all of a task's sums before the next ones: their gradient stays in the first-level cache.
const CHUNK: usize = 256;
/// Weight-gradient tasks that a convolution of few channels is split into, along its pixels.
const TASKS: usize = 16;

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
    /// `[N, O, oh, ow]`
    fn output_target(&self) -> Target {
        let area = self.oh() * self.ow();
        Target { image: self.outputs * area, channel: area, row: self.ow(), column: 1 }
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
    Rows { data, image_step: s.inputs * plane, row_step: stride * row, images: s.n }
}

/// The kernel's taps in [`padded_rows`].
fn padded_field(rows: &Rows, s: &Sizes) -> Field {
    let Conv3x3 { stride, dilation, .. } = s.geometry;
    let (plane, row) = (rows.image_step / s.inputs, rows.row_step / stride);
    let phase = row / stride;
    let offset = |k: usize| {
        let (channel, ky, kx) = (k / 9, k % 9 / 3 * dilation, k % 3 * dilation);
        channel * plane + ky * row + kx % stride * phase + kx / stride
    };
    Field { offsets: Offsets::new((0..s.taps()).map(offset)), height: s.oh(), width: s.ow() }
}

/// The input as one long row per tap that holds all output pixels of the batch.
fn column_rows(x: &[f32], s: &Sizes) -> (Rows, Field) {
    let (oh, ow) = (s.oh(), s.ow());
    let pixels = s.n * oh * ow;
    let step = pixels.next_multiple_of(TILE);
    let mut data = zeros(s.taps() * step);
    data.par_chunks_mut(9 * step).enumerate().for_each(|(c, columns)| {
        for (k, column) in columns.chunks_mut(step).enumerate() {
            for_each_source(s, k, |n, y, x_, o| column[o] = x[((n * s.inputs + c) * s.h + y) * s.w + x_]);
        }
    });
    let offsets = Offsets::new((0..s.taps()).map(|k| k * step));
    (Rows { data, image_step: 0, row_step: 0, images: 1 }, Field { offsets, height: 1, width: pixels })
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

/// Output channels split into nearly equal blocks that register tiles hold.
fn blocks(outputs: usize) -> Vec<(usize, usize)> {
    let count = outputs.div_ceil(Instructions::detect().most_outputs());
    (0..count).map(|b| (outputs * b / count, outputs * (b + 1) / count)).collect()
}

/// Where the results of a correlation go: strides of image, channel, row and column.
pub(super) struct Target {
    pub image: usize,
    pub channel: usize,
    pub row: usize,
    pub column: usize,
}

/// One kernel of a correlation: what it reads, its weights, and the target's element that its first result goes to.
pub(super) struct Part {
    field: Field,
    start: usize,
    /// The weights of each block of outputs, tap by tap.
    packed: Vec<Vec<f32>>,
}

impl Part {
    /// `weight(output, tap)` for so many outputs.
    pub fn new(field: Field, start: usize, outputs: usize, weight: impl Fn(usize, usize) -> f32 + Sync) -> Self {
        let taps = field.offsets.len();
        let pack = |&(a, b): &(usize, usize)| (0..taps * (b - a)).map(|i| weight(a + i % (b - a), i / (b - a))).collect();
        Self { packed: blocks(outputs).par_iter().map(pack).collect(), field, start }
    }
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

/// `out[n, o, y, x] = Σ_k weight(o, k) · rows[n, y, x; k]` for all outputs of all parts, which write elements of their own.
pub(super) fn correlate(rows: &Rows, outputs: usize, parts: &[Part], out: &mut [f32], target: &Target) {
    let instructions = Instructions::detect();
    let blocks = blocks(outputs);
    for Part { field: Field { height, width, .. }, start, .. } in parts.iter().filter(|_| rows.images > 0) {
        let last = (rows.images - 1) * target.image + (outputs - 1) * target.channel;
        assert!(start + last + (height - 1) * target.row + (width - 1) * target.column < out.len());
    }
    let shared = Shared(out.as_mut_ptr());
    let most = |size: fn(&Field) -> usize| parts.iter().map(|p| size(&p.field)).max().unwrap_or(0);
    let (height, width) = (most(|f| f.height), most(|f| f.width));
    let segment = if height == 1 { 8 * TILE } else { width };
    let segments = width.div_ceil(segment);
    (0..rows.images * height * segments).into_par_iter().for_each(|task| {
        let (n, y, first) = (task / segments / height, task / segments % height, task % segments * segment);
        let base = n * rows.image_step + y * rows.row_step;
        let mut acc = [[0.0; TILE]; MOST_OUTPUTS];
        for (block, &(a, b)) in blocks.iter().enumerate() {
            for Part { field, start, packed } in parts.iter().filter(|p| y < p.field.height) {
                for x in (first..field.width.min(first + segment)).step_by(TILE) {
                    instructions.correlate(b - a, &rows.data, base + x, &field.offsets, &packed[block], &mut acc);
                    let count = TILE.min(field.width - x);
                    for (results, o) in acc.iter().zip(a..b) {
                        let to = start + n * target.image + o * target.channel + y * target.row + x * target.column;
                        // SAFETY: the largest index was checked above; (part, n, y, x) belong to this task alone, and `count` stays in
                        // the row.
                        unsafe { store(&results[..count], shared.pointer().add(to), target.column) };
                    }
                }
            }
        }
    });
}

/// Writes values `step` elements apart.
///
/// # Safety
/// All of them must lie in memory that nobody else reads or writes.
#[inline(always)]
unsafe fn store(values: &[f32], to: *mut f32, step: usize) {
    // SAFETY: the caller's promise.
    unsafe {
        if step == 1 {
            std::ptr::copy_nonoverlapping(values.as_ptr(), to, values.len());
        } else {
            values.iter().enumerate().for_each(|(i, v)| *to.add(i * step) = *v);
        }
    }
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
    if s.geometry.enlarge {
        return enlarging::forward(x, w, s);
    }
    let (area, taps) = (s.oh() * s.ow(), s.taps());
    let mut out = zeros(s.n * s.outputs * area);
    let weight = |o: usize, k: usize| w[o * taps + k];
    if s.narrow() {
        let (rows, field) = column_rows(x, s);
        let target = Target { image: 0, channel: s.n * area, row: 0, column: 1 };
        correlate(&rows, s.outputs, &[Part::new(field, 0, s.outputs, weight)], &mut out, &target);
        return swap_axes(&out, s.outputs, s.n, area);
    }
    let rows = padded_rows(x, s);
    let part = Part::new(padded_field(&rows, s), 0, s.outputs, weight);
    correlate(&rows, s.outputs, &[part], &mut out, &s.output_target());
    out
}

/// Gradient of the input: `gradient [N, O, oh, ow]` → `[N, I, H, W]`
pub fn backward_input(gradient: &[f32], w: &[f32], s: &Sizes) -> Vec<f32> {
    match s {
        s if s.geometry.enlarge => enlarging::backward_input(gradient, w, s),
        s if s.narrow() => backward_input_narrow(gradient, w, s),
        s => backward_input_wide(gradient, w, s),
    }
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
    let rows = Rows { data, image_step: 0, row_step: 0, images: 1 };
    let field = Field { offsets: Offsets::new((0..s.outputs).map(|o| o * step)), height: 1, width: pixels };
    let mut columns = zeros(taps * pixels);
    let target = Target { image: 0, channel: pixels, row: 0, column: 1 };
    correlate(&rows, taps, &[Part::new(field, 0, taps, |k, o| w[o * taps + k])], &mut columns, &target);
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
    let (oh, ow) = (s.oh(), s.ow());
    let bordered = Bordered::new(s.n, s.outputs, [oh, ow], s.geometry, |plane, y, row| {
        row.copy_from_slice(&gradient[(plane * oh + y) * ow..][..ow]);
    });
    let taps: Vec<Tap> = (0..s.outputs * 9).map(|i| Tap { plane: i / 9, row: i % 9 / 3, column: i % 3 }).collect();
    input_gradient(&bordered, &taps, |channel, i| w[(i / 9 * s.inputs + channel) * 9 + i % 9], s)
}

/// Gradient of the weights: `x [N, I, H, W]`, `gradient [N, O, oh, ow]` → `[O, I, 3, 3]`
pub fn backward_weight(x: &[f32], gradient: &[f32], s: &Sizes) -> Vec<f32> {
    if s.geometry.enlarge {
        return enlarging::backward_weight(x, gradient, s);
    }
    let area = s.oh() * s.ow();
    if s.narrow() {
        let by_output = swap_axes(gradient, s.n, s.outputs, area);
        let (rows, field) = column_rows(x, s);
        let layout = Target { image: 0, channel: s.n * area, row: 0, column: 1 };
        return correlate_gradient(&rows, &field, &by_output, s.outputs, &layout);
    }
    let rows = padded_rows(x, s);
    correlate_gradient(&rows, &padded_field(&rows, s), gradient, s.outputs, &s.output_target())
}

/// `gw[o, k] = Σ_{n, y, x} gradient[n, o, y, x] · rows[n, y, x; k]`, `[outputs, taps]`; rows of the gradient are consecutive
/// (`layout.column` is 1).
///
/// A task owns [`TILE`] outputs, [`TAPS`] taps and a part of the pixels; parts are fixed and added in their order, so sums don't
/// depend on the number of threads.
pub(super) fn correlate_gradient(rows: &Rows, field: &Field, gradient: &[f32], outputs: usize, layout: &Target) -> Vec<f32> {
    let taps = field.offsets.len();
    let (blocks, groups) = (outputs.div_ceil(TILE), taps.div_ceil(TAPS));
    let lines = rows.images * field.height;
    let segments = field.width.div_ceil(CHUNK);
    let chunks = lines * segments;
    let parts = TASKS.div_ceil(blocks * groups).min(chunks);
    let sums: Vec<Vec<Outputs>> = (0..blocks * groups * parts)
        .into_par_iter()
        .map(|task| {
            let (owner, part) = (task / parts, task % parts);
            let (first, start) = (owner / groups * TILE, owner % groups * TAPS);
            let offsets = (start..taps.min(start + TAPS)).map(|k| field.offsets.at(k)).collect();
            let mut sums = TapSums::new(offsets);
            for chunk in part * chunks / parts..(part + 1) * chunks / parts {
                let (n, y, x) = (chunk / segments / field.height, chunk / segments % field.height, chunk % segments * CHUNK);
                let from = n * layout.image + first * layout.channel + y * layout.row + x;
                let channels = TILE.min(outputs - first);
                let pixels = CHUNK.min(field.width - x);
                sums.turn((0..channels).map(|o| &gradient[from + o * layout.channel..][..pixels]), pixels);
                sums.add(&rows.data, n * rows.image_step + y * rows.row_step + x);
            }
            sums.sums
        })
        .collect();
    let mut out = zeros(outputs * taps);
    for (task, sums) in sums.iter().enumerate() {
        let (first, start) = (task / parts / groups * TILE, task / parts % groups * TAPS);
        for (o, out) in out.chunks_exact_mut(taps).skip(first).take(TILE).enumerate() {
            out[start..].iter_mut().zip(sums).for_each(|(out, sum)| *out += sum[o]);
        }
    }
    out
}

/// The sums of some taps for [`TILE`] outputs.
struct TapSums {
    instructions: Instructions,
    /// Of whole tiles of taps: the last tap is repeated.
    offsets: Vec<usize>,
    sums: Vec<Outputs>,
    /// The gradient of a chunk, pixel by pixel.
    gradient: Vec<Outputs>,
}

impl TapSums {
    fn new(mut offsets: Vec<usize>) -> Self {
        let instructions = Instructions::detect();
        let whole = offsets.len().next_multiple_of(instructions.taps());
        offsets.resize(whole, offsets[offsets.len() - 1]);
        Self { instructions, sums: vec![[0.0; TILE]; whole], offsets, gradient: Vec::with_capacity(CHUNK) }
    }

    /// Takes the gradient of a chunk of pixels, channel by channel.
    fn turn<'a>(&mut self, channels: impl Iterator<Item = &'a [f32]>, pixels: usize) {
        self.gradient.clear();
        self.gradient.resize(pixels, [0.0; TILE]);
        for (o, channel) in channels.enumerate() {
            self.gradient.iter_mut().zip(channel).for_each(|(to, from)| to[o] = *from);
        }
    }

    /// Adds what the chunk gives to every tap; `base` is where its first pixel stands in `data`.
    fn add(&mut self, data: &[f32], base: usize) {
        let taps = self.instructions.taps();
        let mut starts = vec![0; taps];
        for (sums, offsets) in self.sums.chunks_exact_mut(taps).zip(self.offsets.chunks_exact(taps)) {
            starts.iter_mut().zip(offsets).for_each(|(start, offset)| *start = base + offset);
            self.instructions.outer(data, &starts, &self.gradient, sums);
        }
    }
}
