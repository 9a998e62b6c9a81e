//! The gradient of the weights: products of the gradient's and the pixels' frequencies, summed over all tiles.

use rayon::prelude::*;

use super::{Extent, Extents, FREQUENCIES, Grid, Pixels, RESULTS, SPAN, used};
use crate::kernel::conv::Sizes;
use crate::kernel::correlate::Target;
use crate::kernel::rows::zeros;
use crate::kernel::tile::{Instructions, Outputs, POINTS, TILE, Window, prefetch};

/// Groups of tiles whose frequencies are held at a time: so many that adding up their products costs little, few enough that they
/// stay in the caches.
const CHUNK: usize = 8;
/// Tiles of a chunk.
const TILES: usize = CHUNK * TILE;
/// Memory of one frequency of one channel: spare lanes of the last piece come behind.
const STEP: usize = TILES + TILE;
/// Input channels whose products are held at a time.
///
/// All vectors' blocks of taps fill it.
const STRIP: usize = 72;
/// Shares of the tiles that are summed apart, if their sums are small.
const SHARES: usize = 16;
/// Numbers that all sums may have together, if they are several.
const MOST_SUMS: usize = 1 << 20;
/// Tiles below which transforming pixels and gradient costs more than it saves.
const FEWEST_TILES: usize = 64;

/// Where the gradient of a [`Part`](super::Part)'s results lies.
pub(in crate::kernel) struct PartGradient {
    pub start: usize,
    pub extents: Extents,
}

/// Whether the weights' gradient of a convolution of stride and dilation 1 gains from this.
pub(in crate::kernel) fn pays(s: &Sizes) -> bool {
    s.geometry.stride * s.geometry.dilation == 1 && Grid::new(s.n, [s.h, s.w]).tiles() >= FEWEST_TILES
}

/// `[part, outputs, inputs, 9]` from a gradient in which the results of each part lie as `layout` says, as
/// [`correlate`](super::correlate) writes them; `s` has the image's sizes and padding, and the outputs of each part.
///
/// Shares of the tiles are fixed and added in their order, so sums don't depend on the number of threads.
pub(in crate::kernel) fn weight_gradient(
    x: &[f32],
    gradient: &[f32],
    s: &Sizes,
    parts: &[PartGradient],
    layout: &Target,
) -> Vec<f32> {
    let instructions = Instructions::detect();
    let grid = Grid::new(s.n, [s.h, s.w]);
    let pixels = Pixels { x, s, border: 1, ahead: RESULTS * TILE };
    let results = Results { gradient, s, layout, grid: &grid };
    let blocks = s.outputs.div_ceil(TILE);
    let owners: Vec<Owner> =
        parts.iter().flat_map(|part| (0..blocks).map(|block| Owner::new(part, block, s, layout))).collect();
    let chunks = grid.groups().div_ceil(CHUNK);
    let shares = (MOST_SUMS / (owners.len() * s.inputs * 9 * TILE)).clamp(1, SHARES.min(chunks));
    let sum = |share: usize| {
        let mut sums = vec![[[0.0; TILE]; 9]; owners.len() * s.inputs];
        let mut spectrum = zeros(s.inputs * FREQUENCIES * STEP);
        let mut gradients = vec![[0.0; TILE]; owners.len() * FREQUENCIES * TILES];
        for chunk in share * chunks / shares..(share + 1) * chunks / shares {
            let groups = chunk * CHUNK..((chunk + 1) * CHUNK).min(grid.groups());
            spectrum.par_chunks_mut(FREQUENCIES * STEP).enumerate().for_each_init(
                Window::default,
                |window, (channel, spectrum)| {
                    for (i, piece) in groups.clone().enumerate().flat_map(|(i, group)| grid.pieces(group).map(move |p| (i, p)))
                    {
                        pixels.spread(instructions, channel, &piece, window, spectrum, [i * TILE, STEP]);
                    }
                },
            );
            gradients.par_chunks_mut(FREQUENCIES * TILES).zip(&owners).for_each(|(spectrum, owner)| {
                let mut tiles = [[[0.0; TILE]; RESULTS * RESULTS]; TILE];
                for (group, first) in groups.clone().zip((0..).step_by(TILE)) {
                    results.fill(group, owner, &mut tiles);
                    for (tile, pixels) in tiles.iter().enumerate() {
                        instructions.spread_results(pixels, &mut spectrum[first + tile..], TILES);
                    }
                }
            });
            let owned = sums.par_chunks_mut(s.inputs).zip(gradients.par_chunks(FREQUENCIES * TILES)).zip(&owners);
            owned.for_each(|((sums, gradients), owner)| {
                let strips = sums.par_chunks_mut(STRIP).zip(spectrum.par_chunks(STRIP * FREQUENCIES * STEP));
                strips.for_each_init(Products::new, |products, (sums, spectrum)| {
                    products.fill(instructions, spectrum, sums.len(), gradients, groups.len() * TILE, owner.extents);
                    sums.iter_mut().enumerate().for_each(|(channel, kernels)| products.add_kernels(channel, kernels));
                });
            });
        }
        sums
    };
    let sums: Vec<Vec<Kernels>> = (0..shares).into_par_iter().map(sum).collect();
    let mut out = zeros(parts.len() * s.outputs * s.inputs * 9);
    out.par_chunks_mut(s.inputs * 9).enumerate().for_each(|(i, out)| {
        let (part, o) = (i / s.outputs, i % s.outputs);
        let owner = part * blocks + o / TILE;
        for sums in &sums {
            let taps = sums[owner * s.inputs..][..s.inputs].as_flattened();
            out.iter_mut().zip(taps).for_each(|(out, tap)| *out += tap[o % TILE]);
        }
    });
    out
}

/// The kernels between one input and [`TILE`] outputs.
type Kernels = [Outputs; 9];

/// Up to [`TILE`] outputs of one part.
struct Owner {
    /// Where the gradient of the first one starts.
    start: usize,
    outputs: usize,
    extents: Extents,
}

impl Owner {
    fn new(part: &PartGradient, block: usize, s: &Sizes, layout: &Target) -> Self {
        let first = block * TILE;
        Self { start: part.start + first * layout.channel, outputs: TILE.min(s.outputs - first), extents: part.extents }
    }
}

/// The gradient of the results.
struct Results<'a> {
    gradient: &'a [f32],
    s: &'a Sizes,
    layout: &'a Target,
    grid: &'a Grid,
}

impl Results<'_> {
    /// An owner's gradient in a group of tiles; what lies beyond the image or in no tile is zero and has no part in the sums.
    fn fill(&self, group: usize, owner: &Owner, tiles: &mut [[Outputs; RESULTS * RESULTS]; TILE]) {
        tiles.as_flattened_mut().fill([0.0; TILE]);
        let Target { image, channel, row, column } = self.layout;
        for piece in self.grid.pieces(group) {
            let mut pixels = [[0.0; RESULTS]; TILE];
            let (top, left) = (RESULTS * piece.down, RESULTS * piece.along);
            let width = (RESULTS * piece.count).min(self.s.w - left);
            for o in 0..owner.outputs {
                for y in 0..RESULTS.min(self.s.h - top) {
                    let line = owner.start + piece.n * image + o * channel + (top + y) * row + left * column;
                    prefetch(self.gradient, line + channel, width * column);
                    let (to, from) = (&mut pixels.as_flattened_mut()[..width], &self.gradient[line..]);
                    if *column == 1 {
                        to.copy_from_slice(&from[..width]);
                    } else {
                        to.iter_mut().zip(from.iter().step_by(*column)).for_each(|(to, from)| *to = *from);
                    }
                    for (tile, pixels) in tiles[piece.lane..].iter_mut().zip(&pixels[..piece.count]) {
                        for (x, pixel) in pixels.iter().enumerate() {
                            tile[RESULTS * y + x][o] = *pixel;
                        }
                    }
                }
            }
        }
    }
}

/// The sums of products of some input channels with an owner's outputs, `[frequency][channel]`.
struct Products(Vec<[Outputs; STRIP]>);

impl Products {
    fn new() -> Self {
        Self(vec![[[0.0; TILE]; STRIP]; FREQUENCIES])
    }

    /// Sums over so many tiles.
    fn fill(
        &mut self,
        instructions: Instructions,
        spectrum: &[f32],
        channels: usize,
        gradients: &[Outputs],
        tiles: usize,
        extents: Extents,
    ) {
        let taps = instructions.taps();
        let mut offsets = [0; STRIP];
        self.0.fill([[0.0; TILE]; STRIP]);
        for frequency in used(extents, [Extent::Whole; 2]) {
            let gradient = &gradients[frequency * TILES..][..tiles];
            // The last block is filled up with the last channel.
            let start = |channel: usize| (channel.min(channels - 1) * FREQUENCIES + frequency) * STEP;
            offsets.iter_mut().enumerate().for_each(|(channel, offset)| *offset = start(channel));
            let blocks = self.0[frequency].chunks_exact_mut(taps).zip(offsets.chunks_exact(taps));
            for (sums, offsets) in blocks.take(channels.div_ceil(taps)) {
                instructions.outer(spectrum, offsets, &[0], tiles, gradient, sums);
            }
        }
    }

    /// Adds the kernels between one channel and all outputs.
    fn add_kernels(&self, channel: usize, kernels: &mut Kernels) {
        let columns: [[Outputs; 3]; SPAN] =
            std::array::from_fn(|u| gather_weights(std::array::from_fn(|v| &self.0[v * SPAN + u][channel])));
        for y in 0..3 {
            let row = gather_weights(std::array::from_fn(|u| &columns[u][y]));
            for (to, weights) in kernels[3 * y..].iter_mut().zip(row) {
                to.iter_mut().zip(weights).for_each(|(to, weight)| *to += weight);
            }
        }
    }
}

/// The gradient of [`spread_weights`](super::correlate): that of three weights from that of their frequencies.
fn gather_weights(frequencies: [&Outputs; SPAN]) -> [Outputs; 3] {
    let [p, q] = POINTS.map(|point| point * point);
    let (near, far) = (1.0 / (2.0 * p * (p - q)), 1.0 / (2.0 * q * (q - p)));
    let mut weights = [[0.0; TILE]; 3];
    for o in 0..TILE {
        let [a, b, c, d, e, f] = frequencies.map(|frequency| frequency[o]);
        let (even, odd) = (near * (b + c), near * (b - c));
        let (wide_even, wide_odd) = (far * (d + e), far * (d - e));
        weights[0][o] = a / (p * q) + even + wide_even;
        weights[1][o] = POINTS[0] * odd + POINTS[1] * wide_odd;
        weights[2][o] = p * even + q * wide_even + f;
    }
    weights
}
