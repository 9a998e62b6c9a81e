//! The gradient of a convolution's weights: pixel rows times the gradient of the output, summed over all pixels.

use rayon::prelude::*;

use super::correlate::Target;
use super::rows::{Field, Rows, zeros};
use super::tile::{Instructions, Outputs, TILE};

/// Taps per task: so many that turning the gradient costs little beside them, few enough that their sums and rows stay in the
/// second-level cache.
const TAPS: usize = 320;
/// Pixels that are added to all of a task's sums before the next ones: their gradient stays in the first-level cache.
const CHUNK: usize = 256;
/// Tasks that a convolution of few channels is split into, along its pixels.
const TASKS: usize = 16;

/// `gw[o, k] = Σ_{n, y, x} gradient[n, o, y, x] · rows[n, y, x; k]`, `[outputs, taps]`; rows of the gradient are consecutive
/// (`layout.column` is 1).
///
/// A task owns [`TILE`] outputs, [`TAPS`] taps and a part of the pixels; parts are fixed and added in their order, so sums don't
/// depend on the number of threads.
pub(super) fn correlate_gradient(rows: &Rows, field: &Field, gradient: &[f32], outputs: usize, layout: &Target) -> Vec<f32> {
    let taps = field.offsets.len();
    let (blocks, groups) = (outputs.div_ceil(TILE), taps.div_ceil(TAPS));
    // A chunk is a part of a line of pixels, or several whole lines.
    let lines: Vec<(usize, usize)> = (0..rows.images).flat_map(|n| (0..field.height).map(move |y| (n, y))).collect();
    let segments = field.width.div_ceil(CHUNK);
    let together = (CHUNK / field.width).max(1);
    let chunks = lines.len().div_ceil(together) * segments;
    let parts = TASKS.div_ceil(blocks * groups).min(chunks);
    let sums: Vec<Vec<Outputs>> = (0..blocks * groups * parts)
        .into_par_iter()
        .map(|task| {
            let (owner, part) = (task / parts, task % parts);
            let (first, start) = (owner / groups * TILE, owner % groups * TAPS);
            let offsets = (start..taps.min(start + TAPS)).map(|k| field.offsets.at(k)).collect();
            let mut sums = TapSums::new(offsets);
            for chunk in part * chunks / parts..(part + 1) * chunks / parts {
                let x = chunk % segments * CHUNK;
                let lines = lines.iter().skip(chunk / segments * together).take(together);
                let from = |&(n, y): &(usize, usize)| n * layout.image + first * layout.channel + y * layout.row + x;
                sums.turn(
                    gradient,
                    lines.clone().map(from),
                    TILE.min(outputs - first),
                    layout.channel,
                    CHUNK.min(field.width - x),
                );
                sums.add(&rows.data, lines.map(|(n, y)| n * rows.image_step + y * rows.row_step + x));
            }
            sums.sums
        })
        .collect();
    let mut out = zeros(outputs * taps);
    out.par_chunks_mut(TILE * taps).zip(sums.par_chunks(groups * parts)).for_each(|(out, sums)| {
        for (task, sums) in sums.iter().enumerate() {
            let start = task / parts * TAPS;
            for (o, out) in out.chunks_exact_mut(taps).enumerate() {
                // Behind the task's taps stand repetitions of its last one.
                out[start..].iter_mut().zip(sums).take(TAPS).for_each(|(out, sum)| *out += sum[o]);
            }
        }
    });
    out
}

/// The sums of some taps for [`TILE`] outputs.
struct TapSums {
    instructions: Instructions,
    /// Of whole tiles of taps: the last tap is repeated.
    offsets: Vec<usize>,
    sums: Vec<Outputs>,
    /// The gradient of a chunk, pixel by pixel, in lines of some length.
    gradient: Vec<Outputs>,
    length: usize,
    /// Where the lines of a chunk start.
    lines: Vec<usize>,
}

impl TapSums {
    fn new(mut offsets: Vec<usize>) -> Self {
        let instructions = Instructions::detect();
        let whole = offsets.len().next_multiple_of(instructions.taps());
        offsets.resize(whole, offsets[offsets.len() - 1]);
        let (gradient, lines) = (Vec::with_capacity(CHUNK), Vec::with_capacity(CHUNK));
        Self { instructions, sums: vec![[0.0; TILE]; whole], offsets, gradient, length: 0, lines }
    }

    /// Takes the gradient of a chunk: lines of `length` pixels of some channels that are `step` apart.
    fn turn(&mut self, from: &[f32], lines: impl Iterator<Item = usize>, channels: usize, step: usize, length: usize) {
        self.length = length;
        self.gradient.clear();
        for line in lines {
            let start = self.gradient.len();
            self.gradient.resize(start + length, [0.0; TILE]);
            for channel in 0..channels {
                let pixels = &from[line + channel * step..][..length];
                self.gradient[start..].iter_mut().zip(pixels).for_each(|(to, from)| to[channel] = *from);
            }
        }
    }

    /// Adds what the chunk gives to every tap; its lines start there in `data`.
    fn add(&mut self, data: &[f32], lines: impl Iterator<Item = usize>) {
        self.lines.clear();
        self.lines.extend(lines);
        let taps = self.instructions.taps();
        for (sums, offsets) in self.sums.chunks_exact_mut(taps).zip(self.offsets.chunks_exact(taps)) {
            self.instructions.outer(data, offsets, &self.lines, self.length, &self.gradient, sums);
        }
    }
}
