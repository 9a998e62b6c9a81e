//! Cost volume on the CPU: forward and both gradients, as sums in registers over a tile of pixels along a row.

use std::mem::MaybeUninit;

use rayon::prelude::*;

use super::bands::bands;
use super::rows::filled;
use super::vectorise::vectorised;

/// Pixels that are computed together.
const TILE: usize = 8;
type Tile = [f32; TILE];
/// Channels whose gradients are computed together.
const BLOCK: usize = 8;

/// Sizes of a cost volume.
#[derive(Clone, Copy, Debug)]
pub struct Sizes {
    /// Images.
    pub n: usize,
    /// Feature channels.
    pub c: usize,
    /// Rows.
    pub h: usize,
    /// Columns.
    pub w: usize,
    /// Largest displacement in pixels.
    pub radius: usize,
}

impl Sizes {
    fn side(&self) -> usize {
        2 * self.radius + 1
    }
}

/// Images with a zero border of `radius`, and zeros behind it up to whole tiles. The rows of all channels of an image's row follow
/// each other: they are read together.
struct Padded {
    data: Vec<f32>,
    /// Numbers of one channel's row.
    row: usize,
    /// Numbers of a row of all channels, which are whole blocks.
    line: usize,
    lines: usize,
}

impl Padded {
    fn new(x: &[f32], channels: usize, s: &Sizes) -> Self {
        let row = s.w.next_multiple_of(TILE) + 2 * s.radius;
        let (line, lines) = (channels.next_multiple_of(BLOCK) * row, s.h + 2 * s.radius);
        let mut data = vec![0.0f32; s.n * lines * line];
        data.par_chunks_mut(line).enumerate().for_each(|(i, to)| {
            let (n, y) = (i / lines, i % lines);
            if (s.radius..s.radius + s.h).contains(&y) {
                for (channel, to) in to.chunks_exact_mut(row).take(channels).enumerate() {
                    let from = ((n * channels + channel) * s.h + y - s.radius) * s.w;
                    to[s.radius..][..s.w].copy_from_slice(&x[from..][..s.w]);
                }
            }
        });
        Self { data, row, line, lines }
    }

    /// Where column `x` of a channel's row stands, counted from the border's corner.
    fn at(&self, n: usize, y: usize, channel: usize, x: usize) -> usize {
        (n * self.lines + y) * self.line + channel * self.row + x
    }
}

/// The first pixels of a row.
#[inline(always)]
fn tile(row: &[f32]) -> &Tile {
    row.first_chunk().expect("rows are padded to whole tiles")
}

/// Writes what a tile has of a row that may be shorter.
#[inline(always)]
fn store(to: &mut [MaybeUninit<f32>], x: usize, tile: &Tile, scale: f32) {
    to[x..].iter_mut().zip(tile).for_each(|(to, from)| _ = to.write(from * scale));
}

/// `[N, C, H, W]` twice → `[N, side², H, W]`
pub fn forward(a: &[f32], b: &[f32], s: &Sizes) -> Vec<f32> {
    let (side, r) = (s.side(), s.radius);
    let (a, b) = (Padded::new(a, s.c, s), Padded::new(b, s.c, s));
    let fill = |out: &mut [MaybeUninit<f32>]| {
        bands(out, [s.h, s.w], side * side, 1).into_par_iter().enumerate().for_each(|(task, mut out)| {
            let (n, y) = (task / s.h, task % s.h);
            vectorised(
                #[inline(always)]
                || {
                    for (x, dy) in (0..s.w).step_by(TILE).flat_map(|x| (0..side).map(move |dy| (x, dy))) {
                        let (from, to) = (&a.data[a.at(n, y + r, 0, x + r)..], &b.data[b.at(n, y + dy, 0, x)..]);
                        let rows = &mut out[dy * side..][..side];
                        match side {
                            3 => meet::<3>(from, to, a.row, s.c, rows, x),
                            5 => meet::<5>(from, to, a.row, s.c, rows, x),
                            7 => meet::<7>(from, to, a.row, s.c, rows, x),
                            9 => meet::<9>(from, to, a.row, s.c, rows, x),
                            _ => (0..side).for_each(|dx| meet::<1>(from, &to[dx..], a.row, s.c, &mut rows[dx..], x)),
                        }
                    }
                },
            );
        });
    };
    // SAFETY: every row of every plane is written, tile by tile.
    unsafe { filled(s.n * side * side * s.h * s.w, fill) }
}

/// One tile of `a` and as many displacements of `b` in a row: means over the channels, whose rows are `row` apart. A loaded
/// tile serves all displacements.
#[inline(always)]
fn meet<const SIDE: usize>(a: &[f32], b: &[f32], row: usize, channels: usize, out: &mut [&mut [MaybeUninit<f32>]], x: usize) {
    let mut sums = [[0.0; TILE]; SIDE];
    for (a, b) in a.chunks(row).zip(b.chunks(row)).take(channels) {
        let (a, b) = (tile(a), &b[..SIDE + TILE - 1]);
        for d in 0..SIDE {
            for l in 0..TILE {
                sums[d][l] += a[l] * b[d + l];
            }
        }
    }
    out.iter_mut().zip(&sums).for_each(|(to, sums)| store(to, x, sums, 1.0 / channels as f32));
}

/// Gradients of both inputs from `gradient [N, side², H, W]`.
pub fn backward(a: &[f32], b: &[f32], gradient: &[f32], s: &Sizes) -> (Vec<f32>, Vec<f32>) {
    let (side, r) = (s.side(), s.radius);
    let gradient = Padded::new(gradient, side * side, s);
    // a's pixel p meets b at p + d under gradient p.
    let ga = input_gradient(&gradient, &Padded::new(b, s.c, s), s, |dy, dx| [[r, r], [dy, dx]]);
    // b's pixel q meets a at q − d under gradient q − d.
    let gb = input_gradient(&gradient, &Padded::new(a, s.c, s), s, |dy, dx| [[2 * r - dy, 2 * r - dx]; 2]);
    (ga, gb)
}

/// The gradient of one input: for every displacement, the volume's gradient times the other input. `places(dy, dx)` says by how
/// many rows and columns either is read further than the pixel itself.
fn input_gradient(gradient: &Padded, other: &Padded, s: &Sizes, places: impl Fn(usize, usize) -> [[usize; 2]; 2]) -> Vec<f32> {
    let side = s.side();
    let offsets: Vec<[usize; 2]> = (0..side * side)
        .map(|d| {
            let [[gy, gx], [oy, ox]] = places(d / side, d % side);
            [gradient.at(0, gy, d, gx), other.at(0, oy, 0, ox)]
        })
        .collect();
    let fill = |out: &mut [MaybeUninit<f32>]| {
        bands(out, [s.h, s.w], s.c, 1).into_par_iter().enumerate().for_each(|(task, mut out)| {
            let (n, y) = (task / s.h, task % s.h);
            vectorised(
                #[inline(always)]
                || {
                    for x in (0..s.w).step_by(TILE) {
                        let gradient = &gradient.data[gradient.at(n, y, 0, x)..];
                        for (block, out) in out.chunks_mut(BLOCK).enumerate() {
                            let rows = &other.data[other.at(n, y, block * BLOCK, x)..];
                            let sums = weigh(gradient, rows, other.row, &offsets);
                            out.iter_mut().zip(&sums).for_each(|(to, sums)| store(to, x, sums, 1.0 / s.c as f32));
                        }
                    }
                },
            );
        });
    };
    // SAFETY: every row of every plane is written, tile by tile.
    unsafe { filled(s.n * s.c * s.h * s.w, fill) }
}

/// The sums over all displacements of a block of channels, whose rows are `row` apart. A loaded tile of the gradient serves all
/// channels.
#[inline(always)]
fn weigh(gradient: &[f32], other: &[f32], row: usize, offsets: &[[usize; 2]]) -> [Tile; BLOCK] {
    let mut sums = [[0.0; TILE]; BLOCK];
    for &[g, o] in offsets {
        let gradient = tile(&gradient[g..]);
        for c in 0..BLOCK {
            let other = tile(&other[o + c * row..]);
            for l in 0..TILE {
                sums[c][l] += gradient[l] * other[l];
            }
        }
    }
    sums
}
