//! Correlation of pixel rows with kernels: the forward pass, and the gradient of the input.

use std::mem::MaybeUninit;

use rayon::prelude::*;

use super::rows::{Field, Rows};
use super::tile::{Instructions, TILE};

/// Tasks that a correlation is split into at least, if it has as many blocks of outputs and rows.
const TASKS: usize = 16;
/// Taps that are added to all sums of a task before the next ones: what they read of a register tile stays in the first-level
/// cache.
const TAPS: usize = 128;
/// Pixels of a task.
const SEGMENT: usize = 8 * TILE;

/// Output channels split into nearly equal blocks that register tiles hold.
pub(super) fn blocks(outputs: usize) -> Vec<(usize, usize)> {
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

impl Target {
    /// One row of so many pixels for each channel.
    pub fn columns(pixels: usize) -> Self {
        Self { image: 0, channel: pixels, row: 0, column: 1 }
    }
}

/// Weights wherever they lie: that of output `o` and tap `k` is `data[o · output + place(k)]`.
pub(super) struct Weights<'w> {
    pub data: &'w [f32],
    pub output: usize,
    pub place: &'w (dyn Fn(usize) -> usize + Sync),
}

/// One kernel of a correlation: what it reads, its weights, and the target's element that its first result goes to.
pub(super) struct Part<'f> {
    field: &'f Field,
    start: usize,
    /// The weights of each block of outputs, tap by tap.
    packed: Vec<Vec<f32>>,
}

impl<'f> Part<'f> {
    /// For so many outputs.
    pub fn new(field: &'f Field, start: usize, outputs: usize, weights: Weights) -> Self {
        let Weights { data, output, place } = weights;
        let pack = |&(a, b): &(usize, usize)| {
            let mut packed = vec![0.0; field.offsets.len() * (b - a)];
            for (tap, packed) in packed.chunks_exact_mut(b - a).enumerate() {
                let first = a * output + place(tap);
                packed.iter_mut().enumerate().for_each(|(o, to)| *to = data[first + o * output]);
            }
            packed
        };
        Self { packed: blocks(outputs).par_iter().map(pack).collect(), field, start }
    }
}

/// A pointer that tasks may share because each writes pixels of its own.
#[derive(Clone, Copy)]
pub(super) struct Shared(*mut f32);
// SAFETY: every task writes elements of its own (see `correlate` here and in `winograd`).
unsafe impl Send for Shared {}
// SAFETY: as above.
unsafe impl Sync for Shared {}
impl Shared {
    pub fn new(out: &mut [MaybeUninit<f32>]) -> Self {
        Self(out.as_mut_ptr().cast())
    }
    pub fn pointer(self) -> *mut f32 {
        self.0
    }
}

/// `out[n, o, y, x] = Σ_k weight(o, k) · rows[n, y, x; k]` for all outputs of all parts, which write elements of their own.
pub(super) fn correlate(rows: &Rows, outputs: usize, parts: &[Part], out: &mut [MaybeUninit<f32>], target: &Target) {
    let instructions = Instructions::detect();
    let blocks = blocks(outputs);
    for Part { field: Field { height, width, .. }, start, .. } in parts.iter().filter(|_| rows.images > 0) {
        let last = (rows.images - 1) * target.image + (outputs - 1) * target.channel;
        assert!(start + last + (height - 1) * target.row + (width - 1) * target.column < out.len());
    }
    let shared = Shared::new(out);
    let most = |size: fn(&Field) -> usize| parts.iter().map(|p| size(p.field)).max().unwrap_or(0);
    let (height, width) = (most(|f| f.height), most(|f| f.width));
    let segments = width.div_ceil(SEGMENT);
    let places = rows.images * height * segments;
    let work: Vec<(&Part, usize)> = parts.iter().flat_map(|part| (0..blocks.len()).map(move |block| (part, block))).collect();
    let splits = TASKS.div_ceil(places.max(1)).min(work.len());
    (0..places * splits).into_par_iter().for_each_init(Vec::new, |sums: &mut Vec<[f32; TILE]>, task| {
        let (place, split) = (task % places, task / places);
        let (n, y, first) = (place / segments / height, place / segments % height, place % segments * SEGMENT);
        let base = n * rows.image_step + y * rows.row_step + first;
        // Pieces of work that read the same pixels.
        let work = &work[split * work.len() / splits..(split + 1) * work.len() / splits];
        for work in work.chunk_by(|(a, _), (b, _)| std::ptr::eq(a.field, b.field)) {
            let Field { offsets, height, width } = work[0].0.field;
            if y >= *height || first >= *width {
                continue;
            }
            let count = SEGMENT.min(width - first);
            let (tiles, outputs) = (count.div_ceil(TILE), work.iter().map(|&(_, block)| blocks[block].1 - blocks[block].0));
            sums.clear();
            sums.resize(outputs.sum::<usize>() * tiles, [0.0; TILE]);
            for (chunk, taps) in offsets.chunks(TAPS).enumerate() {
                for tile in 0..tiles {
                    let mut sums = &mut sums[..];
                    for &(part, block) in work {
                        let outputs = blocks[block].1 - blocks[block].0;
                        let (to, rest) = sums.split_at_mut(outputs * tiles);
                        let weights = &part.packed[block][chunk * TAPS * outputs..][..taps.offsets.len() * outputs];
                        instructions.correlate(
                            outputs,
                            &rows.data,
                            base + tile * TILE,
                            taps,
                            weights,
                            &mut to[tile * outputs..],
                        );
                        sums = rest;
                    }
                }
            }
            let mut sums = &sums[..];
            for &(part, block) in work {
                let (a, b) = blocks[block];
                let (from, rest) = sums.split_at((b - a) * tiles);
                for (i, results) in from.iter().enumerate() {
                    let (tile, o) = (i / (b - a), a + i % (b - a));
                    let x = first + tile * TILE;
                    let to = part.start + n * target.image + o * target.channel + y * target.row + x * target.column;
                    // SAFETY: the largest index was checked above; (part, n, y, x) belong to this task alone, and what is written stays
                    // in the row.
                    unsafe { store(&results[..TILE.min(width - x)], shared.pointer().add(to), target.column) };
                }
                sums = rest;
            }
        }
    });
}

/// Writes values `step` elements apart.
///
/// # Safety
/// All of them must lie in memory that nobody else reads or writes.
#[inline(always)]
pub(super) unsafe fn store(values: &[f32], to: *mut f32, step: usize) {
    // SAFETY: the caller's promise.
    unsafe {
        if step == 1 {
            std::ptr::copy_nonoverlapping(values.as_ptr(), to, values.len());
        } else {
            values.iter().enumerate().for_each(|(i, v)| *to.add(i * step) = *v);
        }
    }
}
