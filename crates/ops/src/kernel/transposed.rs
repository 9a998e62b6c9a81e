//! The gradient of a convolution's input: the output's gradient correlated with the kernel, backwards.
//!
//! The image is computed at once, and what the repeated border took part in, row by row and column by column of the border,
//! is added: rows of pixels stay as long as the image's, which is a whole number of register tiles more often than not.

use rayon::prelude::*;

use super::conv::Sizes;
use super::correlate::{Part, Target, correlate};
use super::rows::{Field, Rows, filled, zeros};
use super::tile::{Offsets, TILE};
use crate::conv::{Conv3x3, Padding};

/// Most taps of an output: four phases of 2×2 when it enlarges.
const MOST_TAPS: usize = 16;

/// One weight's place: which of its output's planes in the gradient it multiplies, and its row and column in the 3×3 kernel.
pub struct Tap {
    pub plane: usize,
    pub row: usize,
    pub column: usize,
}

/// Planes of a gradient with zeros around each: every tap of every padded pixel reads one of them or a value.
pub struct Bordered {
    pub rows: Rows,
    planes: usize,
    plane: usize,
    border: usize,
    height: usize,
    width: usize,
}

impl Bordered {
    /// `fill(plane, y, row)` fills row `y` of a plane, counted through all images.
    pub fn new(
        images: usize,
        planes: usize,
        [height, width]: [usize; 2],
        geometry: Conv3x3,
        fill: impl Fn(usize, usize, &mut [f32]) + Sync,
    ) -> Self {
        let border = 2 * geometry.dilation / geometry.stride + 1;
        let row = width + 2 * border + TILE;
        let plane = (height + 2 * border) * row;
        let mut data = zeros(images * planes * plane + TILE);
        data[..images * planes * plane].par_chunks_mut(plane).enumerate().for_each(|(i, plane)| {
            for y in 0..height {
                fill(i, y, &mut plane[(y + border) * row + border..][..width]);
            }
        });
        let rows = Rows { data, image_step: planes * plane, row_step: row, images };
        Self { rows, planes, plane, border, height, width }
    }

    /// Where a place of a plane stands; up to the border outside.
    pub fn at(&self, plane: usize, y: isize, x: isize) -> usize {
        let inside = |v: isize| v.strict_add_unsigned(self.border).cast_unsigned();
        plane * self.plane + inside(y) * self.rows.row_step + inside(x)
    }

    /// The distance between an image's neighbouring planes.
    pub fn plane_step(&self) -> usize {
        self.plane
    }

    /// Some columns as planes of one row each; plane `p` of the gradient becomes planes `p · columns.len()` and following.
    fn columns(&self, columns: &[Line], geometry: Conv3x3) -> Self {
        let count = columns.len();
        Self::new(self.rows.images, self.planes * count, [1, self.height], geometry, |plane, _, row| {
            let (plane, column) = (plane / count, &columns[plane % count]);
            let from = self.at(plane, 0, column.index);
            row.iter_mut().zip(self.rows.data[from..].iter().step_by(self.rows.row_step)).for_each(|(t, f)| *t = *f);
        })
    }
}

/// A row or column of the gradient that one tap reads for a row or column of the border.
struct Line {
    tap: usize,
    index: isize,
}

/// `distance / stride` where that is whole.
fn steps(distance: usize, back: usize, stride: usize) -> Option<isize> {
    let (distance, stride) = (distance as isize - back as isize, stride as isize);
    (distance % stride == 0).then_some(distance / stride)
}

/// `[N, I, H, W]` from a gradient with the same taps for every output; `weights(input, output, taps)` fills theirs.
pub fn input_gradient(
    gradient: &Bordered,
    taps: &[Tap],
    weights: impl Fn(usize, usize, &mut [f32]) + Sync,
    s: &Sizes,
) -> Vec<f32> {
    let Conv3x3 { stride, dilation, padding, .. } = s.geometry;
    let planes = gradient.planes / s.outputs;
    // The part of a correlation over those taps that `place(tap, output)` finds a start for; it is the same for all outputs.
    let part = |[height, width]: [usize; 2], start: usize, place: &dyn Fn(&Tap, usize) -> Option<usize>| {
        let chosen: Vec<usize> = (0..taps.len()).filter(|&i| place(&taps[i], 0).is_some()).collect();
        let offsets = (0..s.outputs).flat_map(|o| chosen.iter().filter_map(move |&i| place(&taps[i], o)));
        let field = Field { offsets: Offsets::new(offsets), height, width };
        Part::new(field, start, s.inputs, chosen.len(), |channel, o, to| {
            let mut all = [0.0; MOST_TAPS];
            weights(channel, o, &mut all[..taps.len()]);
            to.iter_mut().zip(&chosen).for_each(|(to, &i)| *to = all[i]);
        })
    };
    // Pixel stride·i + phase takes from output i + (phase + dilation − k·dilation) / stride.
    let phases = |length: usize| 0..stride.min(length);
    let inner = |phase: usize, k: usize| steps(phase + dilation, k * dilation, stride);
    let parts = phases(s.h).flat_map(|py| phases(s.w).map(move |px| (py, px))).map(|(py, px)| {
        part([(s.h - py).div_ceil(stride), (s.w - px).div_ceil(stride)], py * s.w + px, &|tap, o| {
            Some(gradient.at(o * planes + tap.plane, inner(py, tap.row)?, inner(px, tap.column)?))
        })
    });
    let area = s.h * s.w;
    let target = Target { image: s.inputs * area, channel: area, row: stride * s.w, column: stride };
    let parts = parts.collect::<Vec<_>>();
    // SAFETY: the parts have the pixels of all phases.
    let mut out = unsafe { filled(s.n * s.inputs * area, |out| correlate(&gradient.rows, s.inputs, &parts, out, &target)) };
    if padding == Padding::Zero {
        return out;
    }
    // Row or column `p` of the padded image repeats that of the image beside it.
    let border = |length: usize| (0..dilation).chain(dilation + length..length + 2 * dilation);
    let repeated = |p: usize, length: usize| p.saturating_sub(dilation).min(length - 1);
    let lines = |p: usize, length: usize| -> Option<Vec<Line>> {
        let read = |tap: usize| steps(p, tap * dilation, stride).map(|index| Line { tap, index });
        let lines: Vec<Line> = (0..3).filter_map(read).filter(|line| (0..length as isize).contains(&line.index)).collect();
        // A stride may leave a border unread.
        (!lines.is_empty()).then_some(lines)
    };
    let padded = s.w + 2 * dilation;
    for (p, lines) in border(s.h).filter_map(|p| Some((p, lines(p, gradient.height)?))) {
        let parts = phases(padded).map(|phase| {
            part([1, (padded - phase).div_ceil(stride)], phase, &|tap, o| {
                let line = lines.iter().find(|line| line.tap == tap.row)?;
                Some(gradient.at(o * planes + tap.plane, line.index, steps(phase, tap.column * dilation, stride)?))
            })
        });
        let sums = along(gradient, &parts.collect::<Vec<_>>(), padded, stride, s);
        add(&mut out, &sums, padded, s, |i| repeated(p, s.h) * s.w + repeated(i, s.w));
    }
    for (p, lines) in border(s.w).filter_map(|p| Some((p, lines(p, gradient.width)?))) {
        let strip = gradient.columns(&lines, s.geometry);
        let parts = phases(s.h).map(|phase| {
            part([1, (s.h - phase).div_ceil(stride)], phase, &|tap, o| {
                let line = lines.iter().position(|line| line.tap == tap.column)?;
                Some(strip.at((o * planes + tap.plane) * lines.len() + line, 0, inner(phase, tap.row)?))
            })
        });
        let sums = along(&strip, &parts.collect::<Vec<_>>(), s.h, stride, s);
        add(&mut out, &sums, s.h, s, |i| i * s.w + repeated(p, s.w));
    }
    out
}

/// A correlation along one row or column of the border, `[N, I, length]`.
fn along(gradient: &Bordered, parts: &[Part], length: usize, stride: usize, s: &Sizes) -> Vec<f32> {
    let target = Target { image: s.inputs * length, channel: length, row: 0, column: stride };
    // SAFETY: the parts have the pixels of all phases.
    unsafe { filled(s.n * s.inputs * length, |out| correlate(&gradient.rows, s.inputs, parts, out, &target)) }
}

/// Adds a border's sums to the pixels that it repeats.
fn add(out: &mut [f32], sums: &[f32], length: usize, s: &Sizes, pixel: impl Fn(usize) -> usize + Sync) {
    out.par_chunks_mut(s.h * s.w).zip(sums.par_chunks(length)).for_each(|(out, sums)| {
        sums.iter().enumerate().for_each(|(i, sum)| out[pixel(i)] += sum);
    });
}
