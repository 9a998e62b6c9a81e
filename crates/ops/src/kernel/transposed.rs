//! The gradient of a convolution's input: the output's gradient correlated with the kernel, backwards.
//!
//! The image is computed at once, and what the repeated border took part in, row by row and column by column of the border,
//! is added: rows of pixels stay as long as the image's, which is a whole number of register tiles more often than not.

use rayon::prelude::*;

use super::conv::Sizes;
use super::correlate::{Part, Target, Weights, correlate};
use super::rows::{Field, Rows, filled, zeros};
use super::tile::{Offsets, TILE};
use crate::conv::{Conv3x3, Padding};

/// Planes of a gradient with zeros around each: every tap of every padded pixel reads one of them or a value.
struct Bordered {
    rows: Rows,
    planes: usize,
    plane: usize,
    border: usize,
    height: usize,
    width: usize,
}

impl Bordered {
    /// `fill(plane, y, row)` fills row `y` of a plane, counted through all images.
    fn new(
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
    fn at(&self, plane: usize, y: isize, x: isize) -> usize {
        let inside = |v: isize| v.strict_add_unsigned(self.border).cast_unsigned();
        plane * self.plane + inside(y) * self.rows.row_step + inside(x)
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

/// `gradient [N, O, oh, ow]`, `w [O, I, 3, 3]` → `[N, I, H, W]`
pub fn input_gradient(gradient: &[f32], w: &[f32], s: &Sizes) -> Vec<f32> {
    let Conv3x3 { stride, dilation, padding, .. } = s.geometry;
    let (oh, ow) = (s.oh(), s.ow());
    let gradient = Bordered::new(s.n, s.outputs, [oh, ow], s.geometry, |plane, y, row| {
        row.copy_from_slice(&gradient[(plane * oh + y) * ow..][..ow]);
    });
    // What a correlation over the taps that `place(row, column, output)` finds a start for reads, and these taps, the same for
    // all outputs.
    let field = |[height, width]: [usize; 2], place: &dyn Fn(usize, usize, usize) -> Option<usize>| {
        let taps: Vec<usize> = (0..9).filter(|&k| place(k / 3, k % 3, 0).is_some()).collect();
        let offsets = (0..s.outputs).flat_map(|o| taps.iter().filter_map(move |&k| place(k / 3, k % 3, o)));
        (Field { offsets: Offsets::new(offsets), height, width }, taps)
    };
    // Pixel stride·i + phase takes from output i + (phase + dilation − k·dilation) / stride.
    let phases = |length: usize| 0..stride.min(length);
    let inner = |phase: usize, k: usize| steps(phase + dilation, k * dilation, stride);
    let starts: Vec<(usize, usize)> = phases(s.h).flat_map(|py| phases(s.w).map(move |px| (py, px))).collect();
    let fields: Vec<_> = starts
        .iter()
        .map(|&(py, px)| {
            let size = [(s.h - py).div_ceil(stride), (s.w - px).div_ceil(stride)];
            field(size, &|row, column, o| Some(gradient.at(o, inner(py, row)?, inner(px, column)?)))
        })
        .collect();
    let area = s.h * s.w;
    let target = Target { image: s.inputs * area, channel: area, row: stride * s.w, column: stride };
    let parts: Vec<Part> = fields.iter().zip(&starts).map(|(field, (py, px))| part(field, py * s.w + px, w, s)).collect();
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
        let fields = phases(padded).map(|phase| {
            field([1, (padded - phase).div_ceil(stride)], &|row, column, o| {
                let line = lines.iter().find(|line| line.tap == row)?;
                Some(gradient.at(o, line.index, steps(phase, column * dilation, stride)?))
            })
        });
        let fields: Vec<_> = fields.collect();
        let parts: Vec<Part> = fields.iter().enumerate().map(|(phase, field)| part(field, phase, w, s)).collect();
        let sums = along(&gradient, &parts, padded, stride, s);
        add(&mut out, &sums, padded, s, |i| repeated(p, s.h) * s.w + repeated(i, s.w));
    }
    for (p, lines) in border(s.w).filter_map(|p| Some((p, lines(p, gradient.width)?))) {
        let strip = gradient.columns(&lines, s.geometry);
        let fields = phases(s.h).map(|phase| {
            field([1, (s.h - phase).div_ceil(stride)], &|row, column, o| {
                let line = lines.iter().position(|line| line.tap == column)?;
                Some(strip.at(o * lines.len() + line, 0, inner(phase, row)?))
            })
        });
        let fields: Vec<_> = fields.collect();
        let parts: Vec<Part> = fields.iter().enumerate().map(|(phase, field)| part(field, phase, w, s)).collect();
        let sums = along(&strip, &parts, s.h, stride, s);
        add(&mut out, &sums, s.h, s, |i| i * s.w + repeated(p, s.w));
    }
    out
}

/// The part of a correlation that reads a field over some taps of each output.
fn part<'f>((field, taps): &'f (Field, Vec<usize>), start: usize, w: &[f32], s: &Sizes) -> Part<'f> {
    let place = |i: usize| i / taps.len() * s.taps() + taps[i % taps.len()];
    Part::new(field, start, s.inputs, Weights { data: w, output: 9, place: &place })
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
