//! Nearest ×2 enlargement and 3×3 convolution as one: four kernels of 2×2 taps on the small image, one for each position in
//! an enlarged pixel's block.
//!
//! Two of a kernel's three taps along an axis fall into the same block, so their weights add up. That is exact, borders
//! included, and takes 16 instead of 36 multiplications per small pixel.

use rayon::prelude::*;

use super::columns;
use super::conv::Sizes;
use super::correlate::Target;
use super::rows::{filled, zeros};
use super::winograd::{self, Extent, Extents};
use crate::conv::Conv3x3;

/// Positions in a block of 2×2.
const PHASES: usize = 4;
/// Tiles below which [`winograd`] costs more than it saves.
const FEWEST_TILES: usize = 128;
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

/// `x [N, I, H, W]`, `w [O, I, 3, 3]` → `[N, O, 2H, 2W]`
pub fn forward(x: &[f32], w: &[f32], s: &Sizes) -> Vec<f32> {
    if winograd::pays(s, s.inputs, PHASES * s.outputs, FEWEST_TILES) {
        let part = |phase: usize| {
            let kernel = move |o: usize, c: usize| widened(s.kernel(w, o, c), phase);
            winograd::Part { start: phase_start(phase, s), extents: extents(phase), kernel }
        };
        let parts: [_; PHASES] = std::array::from_fn(part);
        let (count, target) = (s.n * s.outputs * PHASES * s.h * s.w, phase_target(s));
        // SAFETY: the four parts have every result.
        return unsafe {
            filled(count, |out| winograd::correlate(x, &small_sizes(s), |_| [Extent::Whole; 2], &parts, out, &target))
        };
    }
    columns::forward(x, w, s)
}

/// Gradient of the input: `gradient [N, O, 2H, 2W]` → `[N, I, H, W]`
pub fn backward_input(gradient: &[f32], w: &[f32], s: &Sizes) -> Vec<f32> {
    if winograd::pays(s, PHASES * s.outputs, s.inputs, FEWEST_TILES_BACK) {
        let kernel = |plane: usize, c: usize| widened(s.kernel(w, plane / PHASES, c), plane % PHASES);
        let extents = |plane: usize| extents(plane % PHASES);
        return winograd::image_gradient(&split(gradient, s), s, PHASES * s.outputs, extents, kernel);
    }
    columns::backward_input(gradient, w, s)
}

/// Gradient of the weights: `x [N, I, H, W]`, `gradient [N, O, 2H, 2W]` → `[O, I, 3, 3]`
pub fn backward_weight(x: &[f32], gradient: &[f32], s: &Sizes) -> Vec<f32> {
    if !winograd::pays_for_weights(s) {
        return columns::backward_weight(x, gradient, s);
    }
    let part = |phase: usize| winograd::PartGradient { start: phase_start(phase, s), extents: extents(phase) };
    let parts: [_; PHASES] = std::array::from_fn(part);
    let sums = winograd::weight_gradient(x, gradient, &small_sizes(s), &parts, &phase_target(s));
    let mut out = zeros(s.outputs * s.inputs * 9);
    out.par_chunks_mut(9).enumerate().for_each(|(i, kernel)| {
        for phase in 0..PHASES {
            let sums = &sums[(phase * s.outputs * s.inputs + i) * 9..][..9];
            for tap in 0..4 {
                let [y, x] = place(phase, tap);
                taps_of(phase, tap).for_each(|k| kernel[k] += sums[3 * y + x]);
            }
        }
    });
    out
}

/// The convolution of the small image whose taps the phases share.
fn small_sizes(s: &Sizes) -> Sizes {
    Sizes { geometry: Conv3x3 { enlarge: false, ..s.geometry }, ..*s }
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
