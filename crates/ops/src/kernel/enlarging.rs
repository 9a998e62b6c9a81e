//! Nearest ×2 enlargement and 3×3 convolution as one: four kernels of 2×2 taps on the small image, one for each position in
//! an enlarged pixel's block.
//!
//! Two of a kernel's three taps along an axis fall into the same block, so their weights add up. That is exact, borders
//! included, and takes 16 instead of 36 multiplications per small pixel.

use rayon::prelude::*;

use super::conv::{Sizes, input_gradient_narrow, swap_axes};
use super::correlate::{Part, Target, correlate};
use super::rows::{Field, Rows, column_field, column_rows, filled, padded_rows, zeros};
use super::tile::{Offsets, TILE};
use super::transposed::{Bordered, Tap, input_gradient};
use super::weight_gradient::correlate_gradient;
use super::winograd::{self, Extent, Extents};
use crate::conv::Conv3x3;

/// Positions in a block of 2×2.
const PHASES: usize = 4;
/// Tiles below which [`winograd`] costs more than it saves.
const FEWEST_TILES: usize = 16;
/// The same for the gradient of the input, whose border takes tiles of its own.
const FEWEST_TILES_BACK: usize = 1024;

/// The taps of a 3×3 kernel, along one axis, that fall into small pixel `tap` (0, 1) of those that phase `phase` reads.
fn merged(phase: usize, tap: usize) -> std::ops::Range<usize> {
    match (phase, tap) {
        (0, 0) => 0..1,
        (0, _) => 1..3,
        (_, 0) => 0..2,
        _ => 2..3,
    }
}

/// The 3×3 taps that a phase's tap (0–3) stands for.
fn taps_of(phase: usize, tap: usize) -> impl Iterator<Item = usize> {
    let columns = merged(phase % 2, tap % 2);
    merged(phase / 2, tap / 2).flat_map(move |ky| columns.clone().map(move |kx| 3 * ky + kx))
}

/// Where in the small image's 3×3 neighbourhood a phase's tap reads.
fn place(phase: usize, tap: usize) -> [usize; 2] {
    [phase / 2 + tap / 2, phase % 2 + tap % 2]
}

/// Fills the 2×2 weights of one phase of a 3×3 kernel.
fn merge(kernel: &[f32], phase: usize, taps: &mut [f32]) {
    let pair = |phase: usize, [a, b, c]: [f32; 3]| if phase == 0 { [a, b + c] } else { [a + b, c] };
    let [left, middle, right] = std::array::from_fn(|x| pair(phase / 2, [kernel[x], kernel[3 + x], kernel[6 + x]]));
    for row in 0..2 {
        taps[2 * row..][..2].copy_from_slice(&pair(phase % 2, [left[row], middle[row], right[row]]));
    }
}

/// The 3×3 kernel with a phase's weights where they read, and zeros elsewhere.
fn widened(kernel: &[f32], phase: usize) -> [f32; 9] {
    let (mut taps, mut wide) = ([0.0; 4], [0.0; 9]);
    merge(kernel, phase, &mut taps);
    for (tap, weight) in taps.into_iter().enumerate() {
        let [y, x] = place(phase, tap);
        wide[3 * y + x] = weight;
    }
    wide
}

/// What a phase's kernel fills of 3×3.
fn extents(phase: usize) -> Extents {
    [phase / 2, phase % 2].map(|phase| if phase == 0 { Extent::First } else { Extent::Last })
}

/// Where the results of a phase go in the enlarged image, beside [`phase_start`].
fn phase_target(s: &Sizes) -> Target {
    let area = PHASES * s.h * s.w;
    Target { image: s.outputs * area, channel: area, row: 4 * s.w, column: 2 }
}

/// Where the first result of a phase goes.
fn phase_start(phase: usize, s: &Sizes) -> usize {
    phase / 2 * 2 * s.w + phase % 2
}

/// What a phase reads in [`padded_rows`].
fn field(rows: &Rows, s: &Sizes, phase: usize) -> Field {
    let (plane, row) = (rows.image_step / s.inputs, rows.row_step);
    let offset = |k: usize| {
        let [y, x] = place(phase, k % 4);
        k / 4 * plane + y * row + x
    };
    Field { offsets: Offsets::new((0..4 * s.inputs).map(offset)), height: s.h, width: s.w }
}

/// `x [N, I, H, W]`, `w [O, I, 3, 3]` → `[N, O, 2H, 2W]`
pub fn forward(x: &[f32], w: &[f32], s: &Sizes) -> Vec<f32> {
    let weights = |phase: usize| move |o: usize, c: usize, taps: &mut [f32]| merge(s.kernel(w, o, c), phase, taps);
    let area = s.h * s.w;
    let (count, target) = (s.n * s.outputs * PHASES * area, phase_target(s));
    if winograd::pays(s, s.inputs, PHASES * s.outputs, FEWEST_TILES) {
        let part = |phase: usize| {
            let kernel = move |o: usize, c: usize| widened(s.kernel(w, o, c), phase);
            winograd::Part { start: phase_start(phase, s), extents: extents(phase), kernel }
        };
        let parts: [_; PHASES] = std::array::from_fn(part);
        // SAFETY: the four parts have every result.
        return unsafe {
            filled(count, |out| winograd::correlate(x, &small_sizes(s), |_| [Extent::Whole; 2], &parts, out, &target))
        };
    }
    if s.w < TILE {
        let (small, pixels) = (small_sizes(s), s.n * area);
        let rows = column_rows(x, &small);
        let part = |phase: usize| {
            let columns = (0..4 * s.inputs).map(|k| {
                let [y, x] = place(phase, k % 4);
                k / 4 * 9 + 3 * y + x
            });
            Part::new(column_field(&rows, columns, pixels), phase * s.outputs * pixels, s.outputs, 4, weights(phase))
        };
        let parts: [_; PHASES] = std::array::from_fn(part);
        // SAFETY: the four parts have every result.
        let out = unsafe { filled(count, |out| correlate(&rows, s.outputs, &parts, out, &Target::columns(pixels))) };
        return interleaved(&swap_axes(&out, PHASES * s.outputs, s.n, area), s);
    }
    let rows = padded_rows(x, s);
    let part = |phase: usize| Part::new(field(&rows, s, phase), phase_start(phase, s), s.outputs, 4, weights(phase));
    let parts: [_; PHASES] = std::array::from_fn(part);
    // SAFETY: the four parts have every result.
    unsafe { filled(count, |out| correlate(&rows, s.outputs, &parts, out, &target)) }
}

/// Gradient of the input: `gradient [N, O, 2H, 2W]` → `[N, I, H, W]`
pub fn backward_input(gradient: &[f32], w: &[f32], s: &Sizes) -> Vec<f32> {
    let weights = |c: usize, o: usize, taps: &mut [f32]| {
        taps.chunks_exact_mut(4).enumerate().for_each(|(phase, taps)| merge(s.kernel(w, o, c), phase, taps));
    };
    let taps = (0..PHASES * 4).map(|i| (i / 4, place(i / 4, i % 4)));
    if winograd::pays(s, PHASES * s.outputs, s.inputs, FEWEST_TILES_BACK) {
        let kernel = |plane: usize, c: usize| widened(s.kernel(w, plane / PHASES, c), plane % PHASES);
        let extents = |plane: usize| extents(plane % PHASES);
        return winograd::image_gradient(&split(gradient, s), s, PHASES * s.outputs, extents, kernel);
    }
    if s.w < TILE {
        let planes = split(gradient, s);
        let taps: Vec<(usize, usize)> = taps.map(|(plane, [y, x])| (plane, 3 * y + x)).collect();
        return input_gradient_narrow(&planes, PHASES, &taps, weights, &small_sizes(s));
    }
    let taps: Vec<Tap> = taps.map(|(plane, [row, column])| Tap { plane, row, column }).collect();
    input_gradient(&phase_rows(gradient, s), &taps, weights, s)
}

/// Gradient of the weights: `x [N, I, H, W]`, `gradient [N, O, 2H, 2W]` → `[O, I, 3, 3]`
pub fn backward_weight(x: &[f32], gradient: &[f32], s: &Sizes) -> Vec<f32> {
    let mut out = zeros(s.outputs * s.inputs * 9);
    // Adds what a phase's tap brings to the kernels, given `taps` numbers of each and where the tap's is.
    let mut add = |phase: usize, sums: &[f32], taps: usize, index: &(dyn Fn(usize) -> usize + Sync)| {
        out.par_chunks_mut(9 * s.inputs).zip(sums.par_chunks(taps * s.inputs)).for_each(|(kernels, sums)| {
            for (kernel, sums) in kernels.chunks_exact_mut(9).zip(sums.chunks_exact(taps)) {
                for tap in 0..4 {
                    taps_of(phase, tap).for_each(|k| kernel[k] += sums[index(tap)]);
                }
            }
        });
    };
    if winograd::pays_for_weights(s) {
        let part = |phase: usize| winograd::PartGradient { start: phase_start(phase, s), extents: extents(phase) };
        let parts: [_; PHASES] = std::array::from_fn(part);
        let sums = winograd::weight_gradient(x, gradient, &small_sizes(s), &parts, &phase_target(s));
        for (phase, sums) in sums.chunks_exact(s.outputs * s.inputs * 9).enumerate() {
            add(phase, sums, 9, &|tap| {
                let [y, x] = place(phase, tap);
                3 * y + x
            });
        }
        return out;
    }
    let (rows, phases) = (padded_rows(x, s), phase_rows(gradient, s));
    let Rows { image_step, row_step, .. } = phases.rows;
    let layout = Target { image: image_step, channel: PHASES * phases.plane_step(), row: row_step, column: 1 };
    for phase in 0..PHASES {
        let gradient = &phases.rows.data[phases.at(phase, 0, 0)..];
        let sums = correlate_gradient(&rows, &field(&rows, s, phase), gradient, s.outputs, &layout);
        add(phase, &sums, 4, &|tap| tap);
    }
    out
}

/// The gradient as planes of one phase each, `[N, O, phase, H, W]`.
fn phase_rows(gradient: &[f32], s: &Sizes) -> Bordered {
    Bordered::new(s.n, PHASES * s.outputs, [s.h, s.w], s.geometry, |plane, y, row| {
        let (channel, phase) = (plane / PHASES, plane % PHASES);
        let from = &gradient[(2 * (channel * s.h + y) + phase / 2) * 2 * s.w..][..2 * s.w];
        row.iter_mut().zip(from[phase % 2..].iter().step_by(2)).for_each(|(to, from)| *to = *from);
    })
}

/// The convolution of the small image whose taps the phases share.
fn small_sizes(s: &Sizes) -> Sizes {
    Sizes { geometry: Conv3x3 { enlarge: false, ..s.geometry }, ..*s }
}

/// The place of a small pixel's phase in an enlarged plane.
fn enlarged_pixel(phase: usize, i: usize, s: &Sizes) -> usize {
    (2 * (i / s.w) + phase / 2) * 2 * s.w + 2 * (i % s.w) + phase % 2
}

/// `[N, phase, O, H · W]` → `[N, O, 2H, 2W]`
fn interleaved(phases: &[f32], s: &Sizes) -> Vec<f32> {
    let area = s.h * s.w;
    let mut out = zeros(phases.len());
    for (i, plane) in phases.chunks_exact(area).enumerate() {
        let (n, phase, o) = (i / s.outputs / PHASES, i / s.outputs % PHASES, i % s.outputs);
        let to = &mut out[(n * s.outputs + o) * PHASES * area..][..PHASES * area];
        plane.iter().enumerate().for_each(|(i, v)| to[enlarged_pixel(phase, i, s)] = *v);
    }
    out
}

/// `[N, O, 2H, 2W]` → `[N, O, phase, H · W]`
fn split(planes: &[f32], s: &Sizes) -> Vec<f32> {
    let area = s.h * s.w;
    let mut out = zeros(planes.len());
    out.par_chunks_mut(PHASES * area).zip(planes.par_chunks(PHASES * area)).for_each(|(out, plane)| {
        for (y, row) in plane.chunks_exact(2 * s.w).enumerate() {
            for x in 0..2 {
                let to = &mut out[(y % 2 * 2 + x) * area + y / 2 * s.w..][..s.w];
                to.iter_mut().zip(row[x..].iter().step_by(2)).for_each(|(to, from)| *to = *from);
            }
        }
    });
    out
}
