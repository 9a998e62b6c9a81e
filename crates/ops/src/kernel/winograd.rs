//! 3×3 correlation with a quarter of the multiplications (Winograd's F(4×4, 3×3); Lavin and Gray 2016).
//!
//! A tile of 4×4 results takes 6×6 pixels. Both tile and kernel are transformed so that the correlation becomes 36 products, one
//! for each *frequency*, which are summed over the channels; the sums are transformed back. Vectors run along sixteen tiles.
//! A kernel whose first or last row (column) is zero has no first (last) row (column) of frequencies: the 2×2 kernels of an
//! enlarging convolution take 25 products.

use std::ops::Range;

use rayon::prelude::*;

use super::conv::Sizes;
use super::correlate::{Shared, Target, blocks, store};
use super::rows::{Rows, split_rows, zeros};
use super::tile::{Instructions, MOST_OUTPUTS, Offsets, POINTS, TILE};
use crate::conv::{Conv3x3, Padding};

/// Results of a tile along an axis.
const RESULTS: usize = 4;
/// Pixels that a tile reads along an axis; frequencies of an axis.
const SPAN: usize = RESULTS + 2;
/// All frequencies.
const FREQUENCIES: usize = SPAN * SPAN;
/// Tiles below which transforming the kernels costs more than it saves.
const FEWEST_TILES: usize = 192;
/// Kernels below which transforming the pixels costs more than it saves.
const FEWEST_KERNELS: usize = 512;
/// Kernels above which they come from memory too slowly, transformed.
const MOST_KERNELS: usize = 80_000;

/// One number of each tile.
type Lanes = [f32; TILE];

/// The rows or columns that a kernel doesn't fill with zeros.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Extent {
    /// All three.
    Whole,
    /// The first two.
    First,
    /// The last two.
    Last,
}

impl Extent {
    fn frequencies(self) -> Range<usize> {
        match self {
            Self::Whole => 0..SPAN,
            Self::First => 0..SPAN - 1,
            Self::Last => 1..SPAN,
        }
    }
}

/// Extents of a kernel's rows and columns.
pub(super) type Extents = [Extent; 2];

/// Which frequencies kernels of both extents have.
fn used(extents: Extents, others: Extents) -> impl Iterator<Item = usize> + Clone {
    let axis = move |axis: usize| {
        let (a, b) = (extents[axis].frequencies(), others[axis].frequencies());
        a.start.max(b.start)..a.end.min(b.end)
    };
    axis(0).flat_map(move |v| axis(1).map(move |u| v * SPAN + u))
}

/// Kernels whose results go to elements of their own: the first one, their extents, and `kernel(output, input)`.
pub(super) struct Part<K> {
    pub start: usize,
    pub extents: Extents,
    pub kernel: K,
}

/// Whether a correlation of stride and dilation 1 with so many channels in and out (phases count) gains from this.
pub(super) fn pays(s: &Sizes, inputs: usize, outputs: usize) -> bool {
    if s.geometry.stride * s.geometry.dilation != 1 {
        return false;
    }
    let tiles = s.n * s.h.div_ceil(RESULTS) * s.w.div_ceil(RESULTS);
    let kernels = inputs * outputs;
    s.w >= RESULTS * TILE / 2 && tiles >= FEWEST_TILES && (FEWEST_KERNELS..=MOST_KERNELS).contains(&kernels)
}

/// `out[n, o, y, x] = Σ_{c, k} kernel(o, c)[k] · x[n, c, y, x; k]` for an image as large as the result, for all parts.
///
/// `s` has the image's sizes and padding, `inputs` its channels, `outputs` those of each part. `extents(c)` are extents that the
/// kernels of input channel `c` have beside those of their part.
pub(super) fn correlate<K: Fn(usize, usize) -> [f32; 9] + Sync>(
    x: &[f32],
    s: &Sizes,
    extents: impl Fn(usize) -> Extents + Sync,
    parts: &[Part<K>],
    out: &mut [f32],
    target: &Target,
) {
    let instructions = Instructions::detect();
    let grid = Grid::new(s);
    let rows = split_rows(x, s, RESULTS, [RESULTS * grid.down + 2, RESULTS * grid.along + 2]);
    let blocks = blocks(s.outputs);
    // The channels that each frequency of each part reads, and the kernels of every block of outputs, frequency by frequency.
    let reads: Vec<Vec<Offsets>> = parts.iter().map(|part| part.reads(s, &extents)).collect();
    let packed: Vec<Vec<Vec<f32>>> = (0..parts.len() * blocks.len())
        .into_par_iter()
        .map(|i| parts[i / blocks.len()].packed(s, &extents, blocks[i % blocks.len()]))
        .collect();
    let most = |step: usize, length: usize| step * (length - 1);
    let last = most(target.image, s.n) + most(target.channel, s.outputs) + most(target.row, s.h) + most(target.column, s.w);
    assert!(parts.iter().all(|part| part.start + last < out.len()));
    let shared = Shared::new(out);
    (0..grid.groups()).into_par_iter().for_each_init(
        || (vec![0.0; FREQUENCIES * (s.inputs + 1) * TILE], vec![[[0.0; TILE]; MOST_OUTPUTS]; FREQUENCIES]),
        |(spectrum, sums), group| {
            let pieces: Vec<Piece> = grid.pieces(group).collect();
            transform(instructions, &rows, s, &pieces, spectrum);
            for (part, (Part { start, extents, .. }, reads)) in parts.iter().zip(&reads).enumerate() {
                // What another part left behind.
                sums.fill([[0.0; TILE]; MOST_OUTPUTS]);
                for (block, &(a, b)) in blocks.iter().enumerate() {
                    let weights = &packed[part * blocks.len() + block];
                    for (frequency, weights) in used(*extents, [Extent::Whole; 2]).zip(weights) {
                        let base = frequency * (s.inputs + 1) * TILE;
                        instructions.correlate(b - a, spectrum, base, &reads[frequency], weights, &mut sums[frequency]);
                    }
                    for o in a..b {
                        let results =
                            instructions.gather(&sums.as_flattened().as_flattened()[(o - a) * TILE..], MOST_OUTPUTS * TILE);
                        for (y, row) in results.iter().map(interleaved).enumerate() {
                            for Piece { n, down, along, count, lane } in pieces.iter().filter(|p| RESULTS * p.down + y < s.h) {
                                let (line, left) = (RESULTS * down + y, RESULTS * along);
                                let to =
                                    start + n * target.image + o * target.channel + line * target.row + left * target.column;
                                let row = &row.as_flattened()[RESULTS * lane..][..(RESULTS * count).min(s.w - left)];
                                // SAFETY: the largest index was checked above; the tiles of a part belong to this task alone.
                                unsafe { store(row, shared.pointer().add(to), target.column) };
                            }
                        }
                    }
                }
            }
        },
    );
}

/// The gradient of the image, without its border, from a gradient `[N, planes, H, W]` of the results: `kernel(plane, input)` is
/// the forward kernel, `extents(plane)` what it fills.
pub(super) fn image_gradient(
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
    let mut out = zeros(s.n * s.inputs * s.h * s.w);
    let part = Part { start: 0, extents: [Extent::Whole; 2], kernel };
    correlate(gradient, &back, |plane| extents(plane).map(turned), &[part], &mut out, &back.output_target());
    out
}

/// The tiles of all images, in groups of sixteen.
struct Grid {
    images: usize,
    down: usize,
    along: usize,
}

/// Neighbouring tiles of one row that stand in neighbouring lanes.
struct Piece {
    n: usize,
    down: usize,
    along: usize,
    count: usize,
    lane: usize,
}

impl Grid {
    fn new(s: &Sizes) -> Self {
        Self { images: s.n, down: s.h.div_ceil(RESULTS), along: s.w.div_ceil(RESULTS) }
    }

    /// Groups that a row of tiles takes, or rows that a group takes.
    fn shares(&self) -> (usize, usize) {
        (self.along.div_ceil(TILE), (TILE / self.along).max(1))
    }

    fn groups(&self) -> usize {
        let (segments, together) = self.shares();
        (self.images * self.down).div_ceil(together) * segments
    }

    fn pieces(&self, group: usize) -> impl Iterator<Item = Piece> {
        let (segments, together) = self.shares();
        let (first, along) = (group / segments * together, group % segments * TILE);
        (first..(first + together).min(self.images * self.down)).enumerate().map(move |(i, line)| Piece {
            n: line / self.down,
            down: line % self.down,
            along,
            count: TILE.min(self.along - along),
            lane: i * self.along,
        })
    }
}

/// Writes the frequencies of some tiles, `[frequency][channel][tile]`; a piece's spare lanes are overwritten by what follows.
fn transform(instructions: Instructions, rows: &Rows, s: &Sizes, pieces: &[Piece], spectrum: &mut [f32]) {
    let (plane, row) = (rows.image_step / s.inputs, rows.row_step);
    for channel in 0..s.inputs {
        for piece in pieces {
            let corner = piece.n * rows.image_step + channel * plane + RESULTS * piece.down * row + piece.along;
            let to = [channel * TILE + piece.lane, (s.inputs + 1) * TILE];
            instructions.spread(&rows.data, [corner, row, row / RESULTS], spectrum, to);
        }
    }
}

/// `[x][tile]` → `[tile][x]`
#[inline(always)]
fn interleaved(row: &[Lanes; RESULTS]) -> [[f32; RESULTS]; TILE] {
    std::array::from_fn(|tile| std::array::from_fn(|x| row[x][tile]))
}

/// Frequencies of three weights in a row: their polynomial at each point, over the product of the point's distances from others.
fn spread_weights([a, b, c]: [f32; 3]) -> [f32; SPAN] {
    let [p, q] = POINTS.map(|point| point * point);
    let pair = |[square, other]: [f32; 2], point: f32| {
        let scale = 1.0 / (2.0 * square * (square - other));
        [1.0, -1.0].map(|sign| (a + sign * point * b + square * c) * scale)
    };
    let ([near, opposite], [far, beyond]) = (pair([p, q], POINTS[0]), pair([q, p], POINTS[1]));
    [a / (p * q), near, opposite, far, beyond, c]
}

/// All frequencies of a kernel.
fn spread_kernel(kernel: [f32; 9]) -> [[f32; SPAN]; SPAN] {
    let columns: [[f32; SPAN]; 3] = std::array::from_fn(|x| spread_weights([kernel[x], kernel[3 + x], kernel[6 + x]]));
    std::array::from_fn(|v| spread_weights(columns.map(|column| column[v])))
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
        let mut packed = vec![Vec::new(); FREQUENCIES];
        let mut kernels = [[[0.0; SPAN]; SPAN]; MOST_OUTPUTS];
        for c in 0..s.inputs {
            kernels.iter_mut().zip(a..b).for_each(|(to, o)| *to = spread_kernel((self.kernel)(o, c)));
            for frequency in used(self.extents, extents(c)) {
                packed[frequency].extend(kernels[..b - a].iter().map(|kernel| kernel[frequency / SPAN][frequency % SPAN]));
            }
        }
        used(self.extents, [Extent::Whole; 2]).map(|frequency| std::mem::take(&mut packed[frequency])).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wave(count: usize, phase: f32) -> Vec<f32> {
        (0..count).map(|i| (((i * 7919) % 9973) as f32 * 0.31 + phase).sin()).collect()
    }

    /// A kernel without what lies beyond its extents.
    fn cut(kernel: &[f32], extents: [Extents; 2]) -> [f32; 9] {
        std::array::from_fn(|k| {
            let fills = |extents: Extents| {
                [(extents[0], k / 3), (extents[1], k % 3)].iter().all(|&(extent, line)| match extent {
                    Extent::Whole => true,
                    Extent::First => line < 2,
                    Extent::Last => line > 0,
                })
            };
            if extents.into_iter().all(fills) { kernel[k] } else { 0.0 }
        })
    }

    #[test]
    fn results_are_those_of_the_sum_over_taps_at_every_size_and_extent() {
        let all = [Extent::Whole, Extent::First, Extent::Last];
        let extents = |i: usize| [all[i % 3], all[i / 3 % 3]];
        for (n, inputs, outputs, h, w) in
            [(1, 1, 1, 1, 1), (2, 3, 5, 7, 9), (3, 2, 17, 4, 31), (1, 4, 3, 5, 64), (2, 2, 2, 3, 90)]
        {
            for padding in [Padding::Edge, Padding::Zero] {
                let s = Sizes { n, inputs, outputs, h, w, geometry: Conv3x3::same(padding) };
                let (x, weights) = (wave(n * inputs * h * w, 0.0), wave(2 * outputs * inputs * 9, 1.0));
                let of_part = |part: usize| if part == 0 { [Extent::Whole; 2] } else { [Extent::First, Extent::Last] };
                let kernel = |part: usize, o: usize, c: usize| {
                    let kernel = &weights[((part * outputs + o) * inputs + c) * 9..][..9];
                    cut(kernel, [of_part(part), extents(c)])
                };
                let parts: Vec<_> = [0, 1]
                    .map(|part| Part { start: part, extents: of_part(part), kernel: move |o, c| kernel(part, o, c) })
                    .into();
                // The parts' results stand side by side.
                let mut found = vec![f32::NAN; 2 * n * outputs * h * w];
                let target = Target { image: 2 * outputs * h * w, channel: 2 * h * w, row: 2 * w, column: 2 };
                correlate(&x, &s, extents, &parts, &mut found, &target);
                for (i, found) in found.into_iter().enumerate() {
                    let (part, pixel, o, image) =
                        (i % 2, i / 2 % (h * w), i / 2 / (h * w) % outputs, i / 2 / (h * w) / outputs);
                    let term = |(c, k): (usize, usize)| {
                        let source = s.source(pixel / w + k / 3, h).zip(s.source(pixel % w + k % 3, w));
                        source.map_or(0.0, |(y, x_)| kernel(part, o, c)[k] * x[((image * inputs + c) * h + y) * w + x_])
                    };
                    let expected: f32 = (0..inputs * 9).map(|i| term((i / 9, i % 9))).sum();
                    // The transforms cost two digits.
                    assert!(
                        (found - expected).abs() < 2e-5 * expected.abs().max(3.0),
                        "{s:?}, part {part}: {found} instead of {expected}"
                    );
                }
            }
        }
    }
}
