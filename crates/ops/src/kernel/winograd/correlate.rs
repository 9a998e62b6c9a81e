//! The correlation itself, and the gradient of its image.

use std::mem::MaybeUninit;
use std::ops::Range;
use std::sync::Arc;

use rayon::prelude::*;

use super::{Extent, Extents, FREQUENCIES, Grid, Piece, Pixels, RESULTS, SPAN, used};
use crate::conv::{Conv3x3, Padding};
use crate::kernel::conv::Sizes;
use crate::kernel::correlate::{Shared, Target, blocks, store};
use crate::kernel::rows::{filled, zeros};
use crate::kernel::tile::{Instructions, MOST_OUTPUTS, Offsets, Outputs, POINTS, TILE, Window};

/// Kernels below which transforming the pixels costs more than it saves.
const FEWEST_KERNELS: usize = 128;
/// Kernels whose frequencies stay in the caches while tiles come and go.
const MOST_CACHED: usize = 80_000;
/// Most groups of tiles that share the frequencies of kernels which don't.
const MOST_GROUPS: usize = 16;

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
    let owners: Vec<Owner> = parts
        .iter()
        .flat_map(|part| {
            let reads: Arc<[Offsets]> = part.reads(s, &extents).into();
            blocks.iter().map(move |&block| Owner { start: part.start, extents: part.extents, block, reads: reads.clone() })
        })
        .collect();
    let pack = |i: usize| parts[i / blocks.len()].packed(s, &extents, owners[i].block);
    let size = job.spectrum_size();
    if s.inputs * s.outputs * parts.len() <= MOST_CACHED {
        let packed: Vec<Vec<Vec<f32>>> = (0..owners.len()).into_par_iter().map(pack).collect();
        let scratch = || (zeros(size), Sums::new(1), Window::default());
        (0..grid.groups()).into_par_iter().for_each_init(scratch, |(spectrum, sums, window), group| {
            job.spread(group, spectrum, window);
            for (owner, packed) in owners.iter().zip(&packed) {
                job.finish(owner, packed, group..group + 1, spectrum, sums);
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
        let each = (0..owners.len()).into_par_iter();
        each.for_each_init(|| Sums::new(together), |sums, i| job.finish(&owners[i], &pack(i), groups.clone(), spectra, sums));
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

/// A block of outputs of one part.
struct Owner {
    start: usize,
    extents: Extents,
    block: (usize, usize),
    /// The channels that each frequency reads.
    reads: Arc<[Offsets]>,
}

/// Sums of some groups of tiles, `[group][frequency][output][tile]`.
struct Sums(Vec<[[Lanes; MOST_OUTPUTS]; FREQUENCIES]>);

impl Sums {
    fn new(groups: usize) -> Self {
        Self(vec![[[[0.0; TILE]; MOST_OUTPUTS]; FREQUENCIES]; groups])
    }
}

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

    /// Multiplies the spectra of some groups with an owner's kernels and writes its results.
    fn finish(&self, owner: &Owner, packed: &[Vec<f32>], groups: Range<usize>, spectra: &[f32], sums: &mut Sums) {
        let (a, b) = owner.block;
        let sums = &mut sums.0[..groups.len()];
        if owner.extents != [Extent::Whole; 2] {
            // What another part left behind.
            sums.as_flattened_mut().fill([[0.0; TILE]; MOST_OUTPUTS]);
        }
        for (frequency, weights) in used(owner.extents, [Extent::Whole; 2]).zip(packed) {
            for (group, sums) in sums.iter_mut().enumerate() {
                let base = group * self.spectrum_size() + frequency * self.step();
                self.instructions.correlate(b - a, spectra, base, &owner.reads[frequency], weights, &mut sums[frequency]);
            }
        }
        for (group, sums) in groups.zip(sums) {
            for o in a..b {
                let sums = &sums.as_flattened().as_flattened()[(o - a) * TILE..];
                let results = self.instructions.gather(sums, MOST_OUTPUTS * TILE);
                self.write(group, owner.start, o, &results);
            }
        }
    }

    /// Hands out the results of one output in a group of tiles.
    fn write(&self, group: usize, start: usize, output: usize, results: &[[Lanes; RESULTS]; RESULTS]) {
        let [height, width] = self.size;
        for Piece { n, down, along, count, lane } in self.grid.pieces(group) {
            let x = RESULTS * along;
            for (y, row) in (RESULTS * down..height).zip(results) {
                let row = interleaved(row);
                let values = &row.as_flattened()[RESULTS * lane..][..(RESULTS * count).min(width - x)];
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

/// `[x][tile]` → `[tile][x]`
#[inline(always)]
fn interleaved(row: &[Lanes; RESULTS]) -> [[f32; RESULTS]; TILE] {
    std::array::from_fn(|tile| std::array::from_fn(|x| row[x][tile]))
}

/// Frequencies of three weights in a row: their polynomial at each point, over the product of the point's distances from others.
fn spread_weights([a, b, c]: [&Outputs; 3]) -> [Outputs; SPAN] {
    let [p, q] = POINTS.map(|point| point * point);
    let (near, far) = (1.0 / (2.0 * p * (p - q)), 1.0 / (2.0 * q * (q - p)));
    let mut frequencies = [[0.0; TILE]; SPAN];
    for o in 0..TILE {
        let (even, odd) = (near * (a[o] + p * c[o]), near * POINTS[0] * b[o]);
        let (wide_even, wide_odd) = (far * (a[o] + q * c[o]), far * POINTS[1] * b[o]);
        let all = [a[o] / (p * q), even + odd, even - odd, wide_even + wide_odd, wide_even - wide_odd, c[o]];
        frequencies.iter_mut().zip(all).for_each(|(to, frequency)| to[o] = frequency);
    }
    frequencies
}

/// All frequencies of some kernels.
fn spread_kernels(kernels: &[Outputs; 9]) -> [[Outputs; SPAN]; SPAN] {
    let columns: [[Outputs; SPAN]; 3] =
        std::array::from_fn(|x| spread_weights([&kernels[x], &kernels[3 + x], &kernels[6 + x]]));
    std::array::from_fn(|v| spread_weights([&columns[0][v], &columns[1][v], &columns[2][v]]))
}

impl<K: Fn(usize, usize) -> [f32; 9]> Part<K> {
    /// For each frequency, the channels in which it may differ from zero.
    fn reads(&self, s: &Sizes, extents: impl Fn(usize) -> Extents) -> Vec<Offsets> {
        let mut channels = vec![Vec::new(); FREQUENCIES];
        for c in 0..s.inputs {
            used(self.extents, extents(c)).for_each(|frequency| channels[frequency].push(c * TILE));
        }
        channels.into_iter().map(|channels| Offsets::new(channels.into_iter())).collect()
    }

    /// The kernels of a block of outputs for each frequency of this part, channel by channel.
    fn packed(&self, s: &Sizes, extents: impl Fn(usize) -> Extents, (a, b): (usize, usize)) -> Vec<Vec<f32>> {
        let mut packed: Vec<Vec<f32>> = (0..FREQUENCIES).map(|_| Vec::new()).collect();
        used(self.extents, [Extent::Whole; 2]).for_each(|frequency| packed[frequency].reserve(s.inputs * (b - a)));
        let mut kernels = [[0.0; TILE]; 9];
        for c in 0..s.inputs {
            for o in a..b {
                let kernel = (self.kernel)(o, c);
                kernels.iter_mut().zip(kernel).for_each(|(to, weight)| to[o - a] = weight);
            }
            let frequencies = spread_kernels(&kernels);
            for frequency in used(self.extents, extents(c)) {
                packed[frequency].extend_from_slice(&frequencies[frequency / SPAN][frequency % SPAN][..b - a]);
            }
        }
        used(self.extents, [Extent::Whole; 2]).map(|frequency| std::mem::take(&mut packed[frequency])).collect()
    }
}
