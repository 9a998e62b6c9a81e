//! 3×3 correlation with a quarter of the multiplications (Winograd's F(4×4, 3×3); Lavin and Gray 2016).
//!
//! A tile of 4×4 results takes 6×6 pixels. Both tile and kernel are transformed so that the correlation becomes 36 products, one
//! for each *frequency*, which are summed over the channels; the sums are transformed back. Vectors run along sixteen tiles.
//! A kernel whose first or last row (column) is zero has no first (last) row (column) of frequencies: the 2×2 kernels of an
//! enlarging convolution take 25 products.

mod correlate;
mod weight_gradient;

use std::ops::Range;

pub(super) use self::correlate::{Part, correlate, image_gradient, pays};
pub(super) use self::weight_gradient::{PartGradient, pays as pays_for_weights, weight_gradient};
use super::conv::Sizes;
use super::tile::{Instructions, TILE, Window, prefetch};
use crate::conv::Padding;

/// Results of a tile along an axis.
const RESULTS: usize = 4;
/// Pixels that a tile reads along an axis; frequencies of an axis.
const SPAN: usize = RESULTS + 2;
/// All frequencies.
const FREQUENCIES: usize = SPAN * SPAN;

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
    /// Of so many images of results.
    fn new(images: usize, [height, width]: [usize; 2]) -> Self {
        Self { images, down: height.div_ceil(RESULTS), along: width.div_ceil(RESULTS) }
    }

    fn tiles(&self) -> usize {
        self.images * self.down * self.along
    }

    fn groups(&self) -> usize {
        self.tiles().div_ceil(TILE)
    }

    /// What stands in a group's lanes, from the first lane on.
    fn pieces(&self, group: usize) -> impl Iterator<Item = Piece> {
        let (first, end) = (group * TILE, (group * TILE + TILE).min(self.tiles()));
        let lines = first / self.along..end.div_ceil(self.along);
        lines.map(move |line| {
            let start = first.max(line * self.along);
            Piece {
                n: line / self.down,
                down: line % self.down,
                along: start % self.along,
                count: end.min((line + 1) * self.along) - start,
                lane: start - first,
            }
        })
    }
}

/// The image that tiles are read from.
struct Pixels<'a> {
    x: &'a [f32],
    s: &'a Sizes,
    /// Pixels beyond the image's edge at which the first tile starts.
    border: usize,
    /// How far behind each pixel is the one that is read next.
    ahead: usize,
}

impl Pixels<'_> {
    /// The pixel that is read `p` pixels behind the first tile's start, or `None` for zero.
    fn source(&self, p: usize, length: usize) -> Option<usize> {
        match self.s.geometry.padding {
            Padding::Edge => Some(p.saturating_sub(self.border).min(length - 1)),
            Padding::Zero => p.checked_sub(self.border).filter(|&p| p < length),
        }
    }

    /// Writes the frequencies of a piece in one channel, at `to + frequency · step` and the fifteen numbers behind; those of
    /// spare lanes mean nothing. `window` may hold anything.
    fn spread(
        &self,
        instructions: Instructions,
        channel: usize,
        piece: &Piece,
        window: &mut Window,
        out: &mut [f32],
        [to, step]: [usize; 2],
    ) {
        /// Pixels in a row of sixteen tiles.
        const MOST: usize = RESULTS * TILE + 2;
        let Sizes { inputs, h, w, .. } = *self.s;
        let plane = (piece.n * inputs + channel) * h * w;
        let left = RESULTS * piece.along;
        // Which of the row's pixels are in the image, from which one on.
        let (start, end) = (self.border.saturating_sub(left), (w + self.border - left).min(MOST));
        let from = (left + start) - self.border;
        for (y, row) in window.0.iter_mut().enumerate() {
            let row = &mut row[Window::SECOND - 1..][..MOST];
            let Some(line) = self.source(RESULTS * piece.down + y, h).map(|y| plane + y * w) else {
                row.fill(0.0);
                continue;
            };
            prefetch(self.x, line + from + self.ahead, MOST);
            let line = &self.x[line..][..w];
            let inside = &line[from..][..end - start];
            if let [first, middle @ .., last] = inside
                && middle.len() == MOST - 2
            {
                // Whole vectors.
                row[0] = *first;
                row[1..MOST - 1].copy_from_slice(&middle[..MOST - 2]);
                row[MOST - 1] = *last;
            } else {
                row[start..end].copy_from_slice(inside);
                let beside = |p: usize| self.source(left + p, w).map_or(0.0, |x| line[x]);
                row[..start].fill(beside(0));
                row[end..].fill(beside(MOST - 1));
            }
        }
        instructions.spread(window, out, [to + piece.lane, step]);
    }
}

#[cfg(test)]
mod tests {
    use std::mem::MaybeUninit;

    use super::*;
    use crate::conv::Conv3x3;
    use crate::kernel::correlate::Target;
    use crate::kernel::rows::filled;

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
                let target = Target { image: 2 * outputs * h * w, channel: 2 * h * w, row: 2 * w, column: 2 };
                // SAFETY: the two parts have every result; the test would see what they leave.
                let found = unsafe {
                    filled(2 * n * outputs * h * w, |out| {
                        out.fill(MaybeUninit::new(f32::NAN));
                        correlate(&x, &s, extents, &parts, out, &target);
                    })
                };
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

    #[test]
    fn gradients_are_adjoint_to_the_correlation() {
        let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| f64::from(a * b)).sum::<f64>();
        let size = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| f64::from((a * b).abs())).sum::<f64>();
        for (n, inputs, outputs, h, w) in
            [(1, 1, 1, 1, 1), (2, 3, 5, 7, 9), (3, 2, 17, 4, 31), (1, 75, 3, 5, 64), (2, 2, 2, 3, 130), (9, 1, 1, 130, 5)]
        {
            for padding in [Padding::Edge, Padding::Zero] {
                let s = Sizes { n, inputs, outputs, h, w, geometry: Conv3x3::same(padding) };
                let (x, weights) = (wave(n * inputs * h * w, 0.0), wave(outputs * inputs * 9, 1.0));
                let gradient = wave(n * outputs * h * w, 2.0);
                let whole = [Extent::Whole; 2];
                let kernel = |o: usize, c: usize| s.kernel(&weights, o, c).try_into().expect("nine weights");
                let target = s.output_target();
                let part = Part { start: 0, extents: whole, kernel };
                // SAFETY: the one part has every result.
                let results = unsafe { filled(n * outputs * h * w, |out| correlate(&x, &s, |_| whole, &[part], out, &target)) };
                let of_image = image_gradient(&gradient, &s, outputs, |_| whole, kernel);
                let part = PartGradient { start: 0, extents: whole };
                let of_weights = weight_gradient(&x, &gradient, &s, &[part], &target);
                let (expected, scale) = (dot(&gradient, &results), size(&gradient, &results));
                for (name, found) in [("image", dot(&x, &of_image)), ("weights", dot(&weights, &of_weights))] {
                    assert!((found - expected).abs() < 1e-5 * scale.max(1.0), "{s:?}, {name}: {found} instead of {expected}");
                }
            }
        }
    }
}
