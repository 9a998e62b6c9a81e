//! Correlation of pixel rows with kernels: the forward pass, and the gradient of the input.

use std::mem::MaybeUninit;

use rayon::prelude::*;

use super::rows::{Field, Rows};
use super::tile::{Instructions, MOST_OUTPUTS, TILE};

/// Tasks that a correlation is split into at least, if it has as many blocks of outputs and rows.
const TASKS: usize = 16;

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

/// One kernel of a correlation: what it reads, its weights, and the target's element that its first result goes to.
pub(super) struct Part {
    field: Field,
    start: usize,
    /// The weights of each block of outputs, tap by tap.
    packed: Vec<Vec<f32>>,
}

impl Part {
    /// For so many outputs; `weights(output, group, taps)` fills the weights of a group of `count` taps that follow each other.
    pub fn new(
        field: Field,
        start: usize,
        outputs: usize,
        count: usize,
        weights: impl Fn(usize, usize, &mut [f32]) + Sync,
    ) -> Self {
        let groups = field.offsets.len() / count.max(1);
        let pack = |&(a, b): &(usize, usize)| {
            let (height, mut taps) = (b - a, vec![0.0; count]);
            let mut packed = vec![0.0; groups * count * height];
            for (group, packed) in packed.chunks_exact_mut((count * height).max(1)).enumerate() {
                for output in a..b {
                    weights(output, group, &mut taps);
                    packed[output - a..].iter_mut().step_by(height).zip(&taps).for_each(|(to, from)| *to = *from);
                }
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
    let most = |size: fn(&Field) -> usize| parts.iter().map(|p| size(&p.field)).max().unwrap_or(0);
    let (height, width) = (most(|f| f.height), most(|f| f.width));
    let segment = if height == 1 { 8 * TILE } else { width };
    let segments = width.div_ceil(segment);
    let places = rows.images * height * segments;
    let splits = TASKS.div_ceil(places.max(1)).min(blocks.len());
    (0..places * splits).into_par_iter().for_each(|task| {
        let (place, split) = (task % places, task / places);
        let (n, y, first) = (place / segments / height, place / segments % height, place % segments * segment);
        let base = n * rows.image_step + y * rows.row_step;
        let mut acc = [[0.0; TILE]; MOST_OUTPUTS];
        for block in split * blocks.len() / splits..(split + 1) * blocks.len() / splits {
            let (a, b) = blocks[block];
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
