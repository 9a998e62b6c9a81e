//! The correlation itself, and the gradient of its image.

use std::mem::MaybeUninit;
use std::ops::Range;

use rayon::prelude::*;

use super::{Extent, Extents, FREQUENCIES, Grid, Piece, Pixels, RESULTS, SPAN, used};
use crate::conv::{Conv3x3, Padding};
use crate::kernel::conv::Sizes;
use crate::kernel::correlate::{Shared, Target, blocks, store};
use crate::kernel::rows::{filled, zeros};
use crate::kernel::tile::{Instructions, Offsets, POINTS, TILE, Window};
use crate::kernel::vectorise::vectorised;

/// Kernels below which transforming the pixels costs more than it saves.
const FEWEST_KERNELS: usize = 128;
/// Kernels whose frequencies stay in the caches while tiles come and go.
const MOST_CACHED: usize = 80_000;
/// Groups of tiles that meet them together, if there are many.
const GROUPS: usize = 2;
/// Blocks of outputs that then read a frequency's pixels while they are in the first-level cache.
const BLOCKS: usize = 11;
/// The same of kernels that are transformed when they are needed: so few that their frequencies stay in the second-level cache.
const FEW_BLOCKS: usize = 4;
/// Groups of tiles that share them.
const MOST_GROUPS: usize = 16;
/// Channels that are summed up before the next ones.
const CHANNELS: usize = 128;

/// One number of each tile.
type Lanes = [f32; TILE];

/// Kernels whose results go to elements of their own: the first one, their extents, and `kernel(output, input)`.
pub(in crate::kernel) struct Part<K> {
    pub start: usize,
    pub extents: Extents,
    pub kernel: K,
}

/// Whether a correlation of stride and dilation 1 with so many channels in and out (phases count) gains from this, given the
/// tiles below which transforming the kernels costs more than it saves.
pub(in crate::kernel) fn pays(s: &Sizes, inputs: usize, outputs: usize, fewest_tiles: usize) -> bool {
    let tiles = Grid::new(s.n, [s.h, s.w]).tiles();
    s.geometry.stride * s.geometry.dilation == 1 && tiles >= fewest_tiles && inputs * outputs >= FEWEST_KERNELS
}

/// `out[n, o, y, x] = Σ_{c, k} kernel(o, c)[k] · x[n, c, y, x; k]` for an image as large as the result, for all parts.
///
/// `s` has the image's sizes and padding, `inputs` its channels, `outputs` those of each part. `extents(c)` are extents that the
/// kernels of input channel `c` have beside those of their part.
pub(in crate::kernel) fn correlate<K: Fn(usize, usize) -> [f32; 9] + Sync>(
    x: &[f32],
    s: &Sizes,
    extents: impl Fn(usize) -> Extents + Sync,
    parts: &[Part<K>],
    out: &mut [MaybeUninit<f32>],
    target: &Target,
) {
    let most = |step: usize, length: usize| step * (length - 1);
    let last = most(target.image, s.n) + most(target.channel, s.outputs) + most(target.row, s.h) + most(target.column, s.w);
    assert!(parts.iter().all(|part| part.start + last < out.len()));
    let out = Shared::new(out);
    run(Pixels { x, s, border: 1, ahead: s.h * s.w }, extents, parts, &|run: Run| {
        let to = run.start + run.n * target.image + run.output * target.channel + run.y * target.row + run.x * target.column;
        // SAFETY: the largest index was checked; every result is written once.
        unsafe { store(run.values, out.pointer().add(to), target.column) };
    });
}

/// Some results in a row.
struct Run<'a> {
    /// Of the part.
    start: usize,
    n: usize,
    output: usize,
    y: usize,
    x: usize,
    values: &'a [f32],
}

/// Hands every result to `sink`, once. There are as many as pixels, and more on all sides if tiles start further out.
fn run<K: Fn(usize, usize) -> [f32; 9] + Sync, S: Fn(Run) + Sync>(
    pixels: Pixels,
    extents: impl Fn(usize) -> Extents + Sync,
    parts: &[Part<K>],
    sink: &S,
) {
    let s = pixels.s;
    let size = [s.h, s.w].map(|length| length + 2 * (pixels.border - 1));
    let grid = Grid::new(s.n, size);
    let job = Job { instructions: Instructions::detect(), pixels, grid: &grid, size, sink };
    let blocks = blocks(s.outputs);
    let cached = s.inputs * s.outputs * parts.len() <= MOST_CACHED;
    let reads: Vec<Vec<Reads>> = parts.iter().map(|part| part.reads(s, &extents)).collect();
    let owners: Vec<Owner<K>> = parts
        .iter()
        .zip(&reads)
        .flat_map(|(part, reads)| {
            blocks.chunks(if cached { BLOCKS } else { FEW_BLOCKS }).map(move |blocks| Owner { part, reads, blocks })
        })
        .collect();
    let size = job.spectrum_size();
    if cached {
        let packed = |owner: &Owner<K>| owner.reads.iter().map(|reads| owner.packed(reads)).collect();
        let packed: Vec<Vec<Packed>> = owners.par_iter().map(packed).collect();
        let together = (grid.groups() / 64).clamp(1, GROUPS);
        let scratch = || (zeros(together * size), Vec::new(), Window::default());
        (0..grid.groups().div_ceil(together)).into_par_iter().for_each_init(scratch, |(spectra, sums, window), task| {
            let groups = task * together..((task + 1) * together).min(grid.groups());
            for (group, spectrum) in groups.clone().zip(spectra.chunks_exact_mut(size)) {
                job.spread(group, spectrum, window);
            }
            for (owner, packed) in owners.iter().zip(&packed) {
                sums.clear();
                owner
                    .reads
                    .iter()
                    .zip(packed)
                    .for_each(|(reads, packed)| job.add(owner, reads, packed, groups.len(), spectra, sums));
                job.finish(owner, groups.clone(), sums);
            }
        });
        return;
    }
    let together = grid.groups().div_ceil(grid.groups().div_ceil(MOST_GROUPS));
    let mut spectra = zeros(together * size);
    for first in (0..grid.groups()).step_by(together) {
        let groups = first..(first + together).min(grid.groups());
        let spectra = &mut spectra[..groups.len() * size];
        let each = spectra.par_chunks_mut(size).zip(groups.clone());
        each.for_each_init(Window::default, |window, (spectrum, group)| job.spread(group, spectrum, window));
        owners.par_iter().for_each_init(Vec::new, |sums, owner| {
            sums.clear();
            owner.reads.iter().for_each(|reads| job.add(owner, reads, &owner.packed(reads), groups.len(), spectra, sums));
            job.finish(owner, groups.clone(), sums);
        });
    }
}

/// What is common to all tasks of a correlation.
struct Job<'a, S> {
    instructions: Instructions,
    pixels: Pixels<'a>,
    grid: &'a Grid,
    /// Rows and columns of results.
    size: [usize; 2],
    sink: &'a S,
}

/// Blocks of outputs of one part.
struct Owner<'p, K> {
    part: &'p Part<K>,
    reads: &'p [Reads],
    blocks: &'p [(usize, usize)],
}

/// Some channels, and what a part has of them.
struct Reads {
    /// Each channel, and which of the part's frequencies, counted, may differ from zero in it.
    channels: Vec<(usize, Vec<usize>)>,
    /// For each of the part's frequencies, where it reads those channels.
    offsets: Vec<(usize, Offsets)>,
}

/// The kernels between those channels and an owner's outputs, for each frequency of the part: block by block, channel by channel.
type Packed = Vec<Vec<f32>>;

impl<S: Fn(Run)> Job<'_, S> {
    /// Memory from one frequency of a group to the next: all channels, and the spare lanes of the last one.
    fn step(&self) -> usize {
        (self.pixels.s.inputs + 1) * TILE
    }

    fn spectrum_size(&self) -> usize {
        FREQUENCIES * self.step()
    }

    /// Writes the frequencies of a group's pixels, `[frequency][channel][tile]`.
    fn spread(&self, group: usize, spectrum: &mut [f32], window: &mut Window) {
        let pieces: Vec<Piece> = self.grid.pieces(group).collect();
        for channel in 0..self.pixels.s.inputs {
            for piece in &pieces {
                // A piece's spare lanes are overwritten by what follows.
                self.pixels.spread(self.instructions, channel, piece, window, spectrum, [channel * TILE, self.step()]);
            }
        }
    }

    /// Adds the products of the spectra of so many groups with an owner's kernels to its sums, `[group][frequency][output][tile]`,
    /// which start from zero if there are none.
    fn add<K>(
        &self,
        owner: &Owner<K>,
        reads: &Reads,
        packed: &[Vec<f32>],
        groups: usize,
        spectra: &[f32],
        sums: &mut Vec<Lanes>,
    ) {
        let ((first, _), step) = (owner.outputs(), owner.step());
        sums.resize(groups * FREQUENCIES * step, [0.0; TILE]);
        for ((frequency, offsets), packed) in reads.offsets.iter().zip(packed) {
            let Some(taps) = offsets.chunks(CHANNELS).next() else { continue };
            for (group, sums) in sums.chunks_exact_mut(FREQUENCIES * step).enumerate() {
                let base = group * self.spectrum_size() + frequency * self.step();
                for &(a, b) in owner.blocks {
                    let weights = &packed[(a - first) * offsets.len()..(b - first) * offsets.len()];
                    self.instructions.correlate(b - a, spectra, base, taps, weights, &mut sums[frequency * step + a - first..]);
                }
            }
        }
    }

    /// Writes the results of an owner.
    fn finish<K>(&self, owner: &Owner<K>, groups: Range<usize>, sums: &[Lanes]) {
        let ((first, end), step) = (owner.outputs(), owner.step());
        for (group, sums) in groups.zip(sums.chunks_exact(FREQUENCIES * step)) {
            for o in first..end {
                let results = self.instructions.gather(sums[o - first..].as_flattened(), step * TILE);
                self.write(group, owner.part.start, o, &results);
            }
        }
    }

    /// Hands out the results of one output in a group of tiles.
    fn write(&self, group: usize, start: usize, output: usize, results: &[[f32; RESULTS * TILE]; RESULTS]) {
        let [height, width] = self.size;
        for Piece { n, down, along, count, lane } in self.grid.pieces(group) {
            let x = RESULTS * along;
            for (y, row) in (RESULTS * down..height).zip(results) {
                let values = &row[RESULTS * lane..][..(RESULTS * count).min(width - x)];
                (self.sink)(Run { start, n, output, y, x, values });
            }
        }
    }
}

/// The gradient of the image from a gradient `[N, planes, H, W]` of the results: `kernel(plane, input)` is the forward kernel,
/// `extents(plane)` what it fills.
pub(in crate::kernel) fn image_gradient(
    gradient: &[f32],
    s: &Sizes,
    planes: usize,
    extents: impl Fn(usize) -> Extents + Sync,
    kernel: impl Fn(usize, usize) -> [f32; 9] + Sync,
) -> Vec<f32> {
    let turned = |extent: Extent| match extent {
        Extent::Whole => Extent::Whole,
        Extent::First => Extent::Last,
        Extent::Last => Extent::First,
    };
    let kernel = |input: usize, plane: usize| {
        let mut kernel = kernel(plane, input);
        kernel.reverse();
        kernel
    };
    let back = Sizes { inputs: planes, outputs: s.inputs, geometry: Conv3x3::same(Padding::Zero), ..*s };
    let part = Part { start: 0, extents: [Extent::Whole; 2], kernel };
    let extents = |plane: usize| extents(plane).map(turned);
    let count = s.n * s.inputs * s.h * s.w;
    let ahead = s.h * s.w;
    if s.geometry.padding == Padding::Zero {
        // SAFETY: the one part has every result.
        return unsafe { filled(count, |out| correlate(gradient, &back, extents, &[part], out, &back.output_target())) };
    }
    // The border repeats pixels of the image, so what it takes is added to theirs: `[N, I, 2, W + 2]` and `[N, I, 2, H]`.
    let (mut rows, mut columns) = (Vec::new(), Vec::new());
    let fill = |out: &mut [MaybeUninit<f32>], rows: &mut [MaybeUninit<f32>], columns: &mut [MaybeUninit<f32>]| {
        let [inside, above, beside] = [out, rows, columns].map(Shared::new);
        run(Pixels { x: gradient, s: &back, border: 2, ahead }, extents, &[part], &|run: Run| {
            let (plane, end) = (run.n * s.inputs + run.output, run.x + run.values.len());
            // SAFETY: rows and columns are those of a padded image, and every pixel of it is written once.
            unsafe {
                if run.y == 0 || run.y == s.h + 1 {
                    let line = 2 * plane + usize::from(run.y > 0);
                    return store(run.values, above.pointer().add(line * (s.w + 2) + run.x), 1);
                }
                let y = run.y - 1;
                if run.x == 0 {
                    *beside.pointer().add(2 * plane * s.h + y) = run.values[0];
                }
                if end == s.w + 2 {
                    *beside.pointer().add((2 * plane + 1) * s.h + y) = run.values[run.values.len() - 1];
                }
                let (from, to) = (run.x.max(1), end.min(s.w + 1));
                if from < to {
                    let values = &run.values[from - run.x..to - run.x];
                    store(values, inside.pointer().add((plane * s.h + y) * s.w + from - 1), 1);
                }
            }
        });
    };
    let planes = s.n * s.inputs;
    // SAFETY: the image and its border are all that the padded image has.
    let mut out = unsafe {
        filled(count, |out| {
            rows = filled(planes * 2 * (s.w + 2), |rows| {
                columns = filled(planes * 2 * s.h, |columns| fill(out, rows, columns));
            });
        })
    };
    let borders = rows.par_chunks(2 * (s.w + 2)).zip(columns.par_chunks(2 * s.h));
    out.par_chunks_mut(s.h * s.w).zip(borders).for_each(|(out, (rows, columns))| {
        for (y, row) in [0, s.h - 1].into_iter().zip(rows.chunks_exact(s.w + 2)) {
            row.iter().enumerate().for_each(|(x, v)| out[y * s.w + x.saturating_sub(1).min(s.w - 1)] += v);
        }
        for (x, column) in [0, s.w - 1].into_iter().zip(columns.chunks_exact(s.h)) {
            column.iter().enumerate().for_each(|(y, v)| out[y * s.w + x] += v);
        }
    });
    out
}

/// Frequencies of three weights in a row: their polynomial at each point, over the product of the point's distances from others.
#[inline(always)]
fn spread_weights<const L: usize>([a, b, c]: [&[f32; L]; 3]) -> [[f32; L]; SPAN] {
    let [p, q] = POINTS.map(|point| point * point);
    let (near, far) = (1.0 / (2.0 * p * (p - q)), 1.0 / (2.0 * q * (q - p)));
    let mut frequencies = [[0.0; L]; SPAN];
    for o in 0..L {
        let (even, odd) = (near * (a[o] + p * c[o]), near * POINTS[0] * b[o]);
        let (wide_even, wide_odd) = (far * (a[o] + q * c[o]), far * POINTS[1] * b[o]);
        let all = [a[o] / (p * q), even + odd, even - odd, wide_even + wide_odd, wide_even - wide_odd, c[o]];
        frequencies.iter_mut().zip(all).for_each(|(to, frequency)| to[o] = frequency);
    }
    frequencies
}

/// All frequencies of some kernels.
#[inline(always)]
fn spread_kernels<const L: usize>(kernels: &[[f32; L]; 9]) -> [[f32; L]; FREQUENCIES] {
    let columns: [_; 3] = std::array::from_fn(|x| spread_weights([&kernels[x], &kernels[3 + x], &kernels[6 + x]]));
    let mut all = [[0.0; L]; FREQUENCIES];
    for (v, row) in all.chunks_exact_mut(SPAN).enumerate() {
        row.copy_from_slice(&spread_weights([&columns[0][v], &columns[1][v], &columns[2][v]]));
    }
    all
}

impl<K> Part<K> {
    fn reads(&self, s: &Sizes, extents: impl Fn(usize) -> Extents) -> Vec<Reads> {
        let all: Vec<usize> = used(self.extents, [Extent::Whole; 2]).collect();
        let chunks = (0..s.inputs).step_by(CHANNELS).map(|first| first..s.inputs.min(first + CHANNELS));
        let reads = chunks.map(|chunk| {
            let used =
                |c: usize| used(self.extents, extents(c)).filter_map(|f| all.iter().position(|&other| other == f)).collect();
            let channels: Vec<(usize, Vec<usize>)> = chunk.map(|c| (c, used(c))).collect();
            let offsets = |i: usize| channels.iter().filter(move |(_, used)| used.contains(&i)).map(|(c, _)| c * TILE);
            let offsets = all.iter().enumerate().map(|(i, &frequency)| (frequency, Offsets::new(offsets(i)))).collect();
            Reads { channels, offsets }
        });
        reads.collect()
    }
}

impl<K: Fn(usize, usize) -> [f32; 9]> Owner<'_, K> {
    fn packed(&self, reads: &Reads) -> Packed {
        let (first, end) = self.outputs();
        // Whole vectors are written, and what is too much is written over by what follows.
        let size = |(_, offsets): &(usize, Offsets)| offsets.len() * (end - first) + TILE;
        let mut packed: Packed = reads.offsets.iter().map(|offsets| vec![0.0; size(offsets)]).collect();
        for &(a, b) in self.blocks {
            let starts = reads.offsets.iter().map(|(_, offsets)| offsets.len() * (a - first)).collect();
            vectorised(|| {
                if b - a <= TILE / 2 {
                    self.pack::<{ TILE / 2 }>((a, b), reads, starts, &mut packed);
                } else {
                    self.pack::<TILE>((a, b), reads, starts, &mut packed);
                }
            });
        }
        packed
    }

    /// The same for one block, given where its frequencies start.
    #[inline(always)]
    fn pack<const L: usize>(&self, (a, b): (usize, usize), reads: &Reads, mut starts: Vec<usize>, packed: &mut [Vec<f32>]) {
        let mut kernels = [[0.0; L]; 9];
        for (c, used) in &reads.channels {
            for o in a..b {
                let kernel = (self.part.kernel)(o, *c);
                kernels.iter_mut().zip(kernel).for_each(|(to, weight)| to[o - a] = weight);
            }
            let frequencies = spread_kernels(&kernels);
            for &i in used {
                packed[i][starts[i]..][..L].copy_from_slice(&frequencies[reads.offsets[i].0]);
                starts[i] += b - a;
            }
        }
    }
}

impl<K> Owner<'_, K> {
    /// The first output and the one behind the last.
    fn outputs(&self) -> (usize, usize) {
        (self.blocks[0].0, self.blocks[self.blocks.len() - 1].1)
    }

    /// Memory from one frequency's sums to the next one's; not a power of two, because those of one output would share a line of
    /// the cache.
    fn step(&self) -> usize {
        let (first, end) = self.outputs();
        end - first + 1
    }
}
