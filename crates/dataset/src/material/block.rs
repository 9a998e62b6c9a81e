//! Sixteen samples at a time. Where the texels lie is worked out for all pixels together; a texel's numbers are summed side
//! by side, pixel by pixel, and turned into lanes of pixels at the end.
//!
//! Every sample has the bits that it has alone.

#![allow(clippy::needless_range_loop, reason = "lockstep loops over a dozen arrays are plainest with one index")]

use render::block::{LANES as PIXELS, Lane, TexelBlock};

use super::encoding::{Lanes, STORED, Stored, VECTOR, add_first, around_centre, normal_z, unit};
use super::levels::{Corners, Level, octave_of};
use super::stored::{Wrap, filtered};

/// Values of a block, lane by lane.
type Samples = [Lane; STORED];

/// [`super::encoding::Sum`] of a block: the first eight numbers pixel by pixel, the ninth of all pixels.
struct Sums {
    first: [[f32; VECTOR]; PIXELS],
    ninth: Lane,
}

/// The four texels around every place of a block, row by row.
struct BlockCorners {
    /// [`Level::place`] of each.
    taps: [[u32; PIXELS]; 4],
    weights: [Lane; 4],
    /// Signs of the normal's x and y.
    signs: [Lane; 2],
    /// Whether a place's texels lie on both sides of a mirror.
    seams: bool,
}

impl<T: Stored> Level<T> {
    /// The four texels around every place of a block.
    #[inline(always)]
    fn corners_block(&self, places: [&Lane; 2], wrap: Wrap) -> BlockCorners {
        // Two loops, so that none holds the branch.
        match wrap {
            Wrap::Repeat => self.corners_wrapped(places, Wrap::Repeat),
            Wrap::Mirror => self.corners_wrapped(places, Wrap::Mirror),
        }
    }

    #[inline(always)]
    fn corners_wrapped(&self, [x, y]: [&Lane; 2], wrap: Wrap) -> BlockCorners {
        let mut corners =
            BlockCorners { taps: [[0; PIXELS]; 4], weights: [[0.0; PIXELS]; 4], signs: [[1.0; PIXELS]; 2], seams: false };
        let mut seams = [false; PIXELS];
        for k in 0..PIXELS {
            // Spelt out: loops over four would be unrolled before the one over pixels is vectorised.
            let Corners { columns, rows, weights } = self.corners(x[k], y[k], wrap);
            let place = |row: usize, column: usize| self.place(rows.index[row], columns.index[column]);
            corners.taps[0][k] = place(0, 0);
            corners.taps[1][k] = place(0, 1);
            corners.taps[2][k] = place(1, 0);
            corners.taps[3][k] = place(1, 1);
            corners.weights[0][k] = weights[0];
            corners.weights[1][k] = weights[1];
            corners.weights[2][k] = weights[2];
            corners.weights[3][k] = weights[3];
            corners.signs[0][k] = columns.sign[0];
            corners.signs[1][k] = rows.sign[0];
            seams[k] = columns.seam() | rows.seam();
        }
        corners.seams = seams.contains(&true);
        corners
    }

    /// Σ weight·stored of the first eight numbers of a pixel's four texels; leaves the ninth numbers in `ninths`.
    #[inline(always)]
    fn first(&self, corners: &BlockCorners, k: usize, ninths: &mut [[i32; PIXELS]; 4]) -> [f32; VECTOR] {
        let mut sum = [0.0; VECTOR];
        for tap in 0..4 {
            let texel = self.stored(corners.taps[tap][k]);
            add_first(&mut sum, texel, corners.weights[tap][k]);
            ninths[tap][k] = texel[VECTOR].into();
        }
        sum
    }
}

impl Sums {
    /// The weighted sums of four texels each.
    #[inline(always)]
    fn of<T: Stored>(level: &Level<T>, corners: &BlockCorners) -> Self {
        let (mut first, mut ninth, mut ninths) = ([[0.0; VECTOR]; PIXELS], [0.0; PIXELS], [[0; PIXELS]; 4]);
        for k in 0..PIXELS {
            first[k] = level.first(corners, k, &mut ninths);
        }
        for k in 0..PIXELS {
            ninth[k] = four(&ninths, &corners.weights, k);
        }
        Self { first, ninth }
    }

    /// Those of two levels, mixed as [`super::encoding::Sum::mix`] does.
    #[inline(always)]
    fn mixed<T: Stored>([fine, coarser]: [&Level<T>; 2], [a, b]: [&BlockCorners; 2], share: &Lane) -> Self {
        let (mut first, mut ninth) = ([[0.0; VECTOR]; PIXELS], [0.0; PIXELS]);
        let (mut fine_ninths, mut coarser_ninths) = ([[0; PIXELS]; 4], [[0; PIXELS]; 4]);
        for k in 0..PIXELS {
            let mut sum = fine.first(a, k, &mut fine_ninths);
            let other = coarser.first(b, k, &mut coarser_ninths);
            for lane in 0..VECTOR {
                sum[lane] += share[k] * (other[lane] - sum[lane]);
            }
            first[k] = sum;
        }
        for k in 0..PIXELS {
            let sum = four(&fine_ninths, &a.weights, k);
            ninth[k] = sum + share[k] * (four(&coarser_ninths, &b.weights, k) - sum);
        }
        Self { first, ninth }
    }

    /// The values that the means stand for, lane by lane.
    #[inline(always)]
    fn decoded<T: Stored>(&self, signs: &[Lane; 2]) -> Samples {
        let mut samples = [[0.0; PIXELS]; STORED];
        for (pixels, at) in self.first.as_chunks().0.iter().zip((0..PIXELS).step_by(VECTOR)) {
            let lanes = transposed(pixels);
            for lane in 0..VECTOR {
                samples[lane][at..at + VECTOR].copy_from_slice(&lanes[lane]);
            }
        }
        samples[VECTOR] = self.ninth;
        for k in 0..PIXELS {
            samples[0][k] *= unit::<T>(0);
            samples[1][k] *= unit::<T>(1);
            samples[2][k] *= unit::<T>(2);
            samples[3][k] *= unit::<T>(3);
            samples[4][k] *= unit::<T>(4);
            samples[5][k] *= unit::<T>(5);
            samples[6][k] *= unit::<T>(6);
            samples[7][k] = around_centre::<T>(samples[7][k], signs[0][k]) * unit::<T>(7);
            samples[8][k] = around_centre::<T>(samples[8][k], signs[1][k]) * unit::<T>(8);
        }
        samples
    }
}

/// Rows and columns exchanged, by interleaving halves thrice.
#[inline(always)]
fn transposed(rows: &[[f32; VECTOR]; VECTOR]) -> [[f32; VECTOR]; VECTOR] {
    let [a, b, c, d, e, f, g, h] = rows;
    let [(a, e), (b, f), (c, g), (d, h)] = [interleaved(a, e), interleaved(b, f), interleaved(c, g), interleaved(d, h)];
    let [(a, c), (e, g), (b, d), (f, h)] = [interleaved(&a, &c), interleaved(&e, &g), interleaved(&b, &d), interleaved(&f, &h)];
    let [(a, b), (c, d), (e, f), (g, h)] = [interleaved(&a, &b), interleaved(&c, &d), interleaved(&e, &f), interleaved(&g, &h)];
    [a, b, c, d, e, f, g, h]
}

#[inline(always)]
fn interleaved(a: &[f32; VECTOR], b: &[f32; VECTOR]) -> ([f32; VECTOR], [f32; VECTOR]) {
    ([a[0], b[0], a[1], b[1], a[2], b[2], a[3], b[3]], [a[4], b[4], a[5], b[5], a[6], b[6], a[7], b[7]])
}

/// Σ weight·number over a pixel's four texels.
#[inline(always)]
fn four(numbers: &[[i32; PIXELS]; 4], weights: &[Lane; 4], k: usize) -> f32 {
    let term = |tap: usize| numbers[tap][k] as f32 * weights[tap][k];
    term(0) + term(1) + term(2) + term(3)
}

/// The samples of a block whose pixels don't go together. Rare, and out of line so that it leaves the registers to the others.
#[inline(never)]
fn one_by_one(sample: impl Fn(usize) -> Lanes) -> Samples {
    let mut samples = [[0.0; PIXELS]; STORED];
    for k in 0..PIXELS {
        let alone = sample(k);
        (0..STORED).for_each(|lane| samples[lane][k] = alone[lane]);
    }
    samples
}

/// [`filtered`] at every place of a block.
#[inline(always)]
fn filtered_block<T: Stored>(levels: &[Level<T>], [x, y]: [&Lane; 2], footprint: &Lane, wrap: Wrap) -> Samples {
    let (mut octaves, mut weights) = ([0; PIXELS], [0.0; PIXELS]);
    for k in 0..PIXELS {
        if footprint[k] > 1.0 {
            (octaves[k], weights[k]) = octave_of(footprint[k], levels.len());
        }
    }
    let octave = octaves[0];
    let alone = || one_by_one(|k| filtered(levels, x[k], y[k], footprint[k], wrap));
    if octave >= 2 || octaves != [octave; PIXELS] {
        return alone();
    }
    let fine = levels[octave].corners_block([x, y], wrap);
    if fine.seams {
        return alone();
    }
    if weights == [0.0; PIXELS] {
        return Sums::of(&levels[octave], &fine).decoded::<T>(&fine.signs);
    }
    let coarser = levels[octave + 1].corners_block([x, y], wrap);
    if coarser.seams || coarser.signs != fine.signs {
        return alone();
    }
    let levels = [&levels[octave], &levels[octave + 1]];
    Sums::mixed(levels, [&fine, &coarser], &weights).decoded::<T>(&fine.signs)
}

/// The reflectances of a block: [`filtered`] and the normal's z.
#[inline(always)]
pub(super) fn texels<T: Stored>(levels: &[Level<T>], places: [&Lane; 2], footprint: &Lane, wrap: Wrap) -> TexelBlock {
    let [dr, dg, db, sr, sg, sb, roughness, nx, ny] = filtered_block(levels, places, footprint, wrap);
    let mut nz = [0.0; PIXELS];
    for k in 0..PIXELS {
        nz[k] = normal_z(nx[k], ny[k]);
    }
    TexelBlock { normal: [nx, ny, nz], diffuse: [dr, dg, db], roughness, specular: [sr, sg, sb] }
}
