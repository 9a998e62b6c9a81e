//! Sixteen samples at a time: the sums of [`Level::bilinear`] as loops over pixels, which vectorise.
//!
//! Every sample has the bits that it has alone.

#![allow(clippy::needless_range_loop, reason = "lockstep loops over a dozen arrays are plainest with one index")]

use render::block::{LANES as PIXELS, Lane, TexelBlock};

use super::encoding::{NORMAL, ROUGHNESS, STORED, Stored, WORDS, normal_z};
use super::levels::{Level, octave_of};
use super::stored::{Wrap, filtered};

/// Decoded values of a block, lane by lane.
type Samples = [Lane; STORED];

/// Lanes that are summed as (value · weight) · value rather than value² · weight, as [`super::encoding::Sum`] does.
const WEIGHTED_FIRST: usize = 4;

impl<T: Stored> Level<T> {
    /// [`Level::bilinear`] at every place of a block.
    #[inline(always)]
    fn bilinear_block(&self, x: &Lane, y: &Lane, wrap: Wrap) -> Samples {
        let (mut taps, mut weights, mut signs) = ([[0; PIXELS]; 4], [[0.0; PIXELS]; 4], [[1.0; PIXELS]; 2]);
        let mut seams = false;
        for k in 0..PIXELS {
            let (columns, rows, corner) = self.corners(x[k], y[k], wrap);
            let index = |row: usize, column: usize| rows.index[row] * self.width + columns.index[column];
            for tap in 0..4 {
                taps[tap][k] = index(tap / 2, tap % 2);
                weights[tap][k] = corner[tap];
            }
            (signs[0][k], signs[1][k]) = (columns.sign[0], rows.sign[0]);
            seams |= columns.seam() || rows.seam();
        }
        let mut lanes = self.sums(&taps, &weights);
        let (square, direction) = (1.0 / (T::MAX * T::MAX), 1.0 / (T::MAX - T::CENTRE));
        for k in 0..PIXELS {
            for lane in 0..ROUGHNESS {
                lanes[lane][k] *= square;
            }
            lanes[ROUGHNESS][k] *= 1.0 / T::MAX;
            lanes[NORMAL][k] = (lanes[NORMAL][k] - T::CENTRE) * direction * signs[0][k];
            lanes[NORMAL + 1][k] = (lanes[NORMAL + 1][k] - T::CENTRE) * direction * signs[1][k];
        }
        if seams {
            // Rare: where taps lie on both sides of a mirror, each has its own sign.
            for k in 0..PIXELS {
                let alone = self.bilinear(x[k], y[k], wrap);
                (0..STORED).for_each(|lane| lanes[lane][k] = alone[lane]);
            }
        }
        lanes
    }

    /// Σ weight·stored² of the colours and Σ weight·stored of roughness and normal over the four taps.
    #[inline(always)]
    fn sums(&self, taps: &[[usize; PIXELS]; 4], weights: &[Lane; 4]) -> Samples {
        let mut sums = [[0.0; PIXELS]; STORED];
        for tap in 0..4 {
            let mut words = [[0u32; PIXELS]; WORDS];
            for k in 0..PIXELS {
                let texel = self.data[taps[tap][k] * STORED..].first_chunk();
                let packed = T::words(texel.expect("levels end with spare numbers for the last tap"));
                (0..WORDS).for_each(|word| words[word][k] = packed[word]);
            }
            // Spelt out: with a lane that is known only when it runs, the loop over pixels would not be vectorised.
            let weight = &weights[tap];
            add::<T, 0>(&words, weight, &mut sums);
            add::<T, 1>(&words, weight, &mut sums);
            add::<T, 2>(&words, weight, &mut sums);
            add::<T, 3>(&words, weight, &mut sums);
            add::<T, 4>(&words, weight, &mut sums);
            add::<T, 5>(&words, weight, &mut sums);
            add::<T, 6>(&words, weight, &mut sums);
            add::<T, 7>(&words, weight, &mut sums);
            add::<T, 8>(&words, weight, &mut sums);
        }
        sums
    }
}

/// Adds what a tap gives to one lane.
#[inline(always)]
fn add<T: Stored, const LANE: usize>(words: &[[u32; PIXELS]; WORDS], weight: &Lane, sums: &mut Samples) {
    for k in 0..PIXELS {
        let value = T::number::<LANE>(words[T::word(LANE)][k]);
        sums[LANE][k] += match LANE {
            ..WEIGHTED_FIRST => value * value * weight[k],
            WEIGHTED_FIRST..ROUGHNESS => value * weight[k] * value,
            _ => value * weight[k],
        };
    }
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
    if octave >= 2 || octaves != [octave; PIXELS] {
        let mut lanes = [[0.0; PIXELS]; STORED];
        for k in 0..PIXELS {
            let alone = filtered(levels, x[k], y[k], footprint[k], wrap);
            (0..STORED).for_each(|lane| lanes[lane][k] = alone[lane]);
        }
        return lanes;
    }
    let mut lanes = levels[octave].bilinear_block(x, y, wrap);
    if weights != [0.0; PIXELS] {
        let coarser = levels[octave + 1].bilinear_block(x, y, wrap);
        for lane in 0..STORED {
            for k in 0..PIXELS {
                lanes[lane][k] += weights[k] * (coarser[lane][k] - lanes[lane][k]);
            }
        }
    }
    lanes
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
