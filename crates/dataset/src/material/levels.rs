//! Mip levels: the same tile at ever coarser texels, averaged in linear light.

use rayon::prelude::*;

use super::encoding::{Lanes, NORMAL, STORED, Stored, Sum, decoded, encode, normal_z};
use super::stored::{Pair, Wrap};

/// Binary logarithms of the levels' texel sizes.
///
/// Beyond 4 texels every second level is left out: without them a 4096² tile of 8 bit costs 199 MB instead of 201 MB (the
/// budget is 200 MB). [`sampled`] makes up for them; frames of a scan at 256² don't look so far down the chain.
pub(crate) const LEVEL_LOG2: [u32; 8] = [0, 1, 2, 4, 6, 8, 10, 12];

/// One level of a tile.
#[derive(Clone, Debug)]
pub(crate) struct Level<T> {
    pub width: usize,
    pub height: usize,
    /// Texels of this level per texel of level 0, along x and y.
    pub scale: [f32; 2],
    /// Row-major texels of [`STORED`] numbers, [`Level::pitch`] numbers from row to row.
    pub data: Vec<T>,
    /// Numbers from the start of a row to that of the next one.
    pub pitch: u32,
}

/// The two columns and two rows of texels around a place, and the weights of their four texels, row by row.
pub(super) struct Corners {
    pub columns: Pair,
    pub rows: Pair,
    pub weights: [f32; 4],
}

impl Corners {
    /// Signs of the normal's x and y; `None` where the texels lie on both sides of a mirror.
    #[inline(always)]
    pub fn sign(&self) -> Option<[f32; 2]> {
        let seam = self.columns.seam() | self.rows.seam();
        (!seam).then_some([self.columns.sign[0], self.rows.sign[0]])
    }
}

/// Rows of texels whose length is a multiple of this, in bytes, would meet in few places of the caches: a column of pixels that
/// walks over them finds none of them there a second time.
const UNEVEN: usize = 256;
/// Bytes of a cache line.
const LINE: usize = 64;

/// [`Level::pitch`] in bytes of a level whose texels take `bytes` each.
pub(super) fn pitch_bytes(width: usize, bytes: usize) -> usize {
    let row = width * bytes;
    if row > 0 && row.is_multiple_of(UNEVEN) { row + LINE } else { row }
}

impl<T: Stored> Level<T> {
    /// An empty level of the given size.
    fn new(width: usize, height: usize, scale: [f32; 2]) -> Self {
        let number = size_of::<T>();
        let pitch = pitch_bytes(width, STORED * number) / number;
        Self { width, height, scale, data: vec![T::default(); pitch * height], pitch: pitch as u32 }
    }

    /// Fills a level from a function of (column, row).
    pub(crate) fn from_fn(width: usize, height: usize, lanes: impl Fn(usize, usize) -> Lanes + Sync) -> Self {
        let mut level = Self::new(width, height, [1.0; 2]);
        level.fill(lanes);
        level
    }

    fn fill(&mut self, lanes: impl Fn(usize, usize) -> Lanes + Sync) {
        let width = self.width;
        self.data.par_chunks_mut(self.pitch as usize).enumerate().for_each(|(y, row)| {
            for (x, texel) in row[..width * STORED].chunks_exact_mut(STORED).enumerate() {
                encode(&lanes(x, y), texel);
            }
        });
    }

    /// The decoded texel at a column and row.
    pub(crate) fn texel(&self, x: usize, y: usize) -> Lanes {
        let mut sum = Sum::default();
        sum.add(self.stored(self.place(y as u32, x as u32)), 1.0);
        decoded::<T>(&sum.mean::<T>([1.0; 2]))
    }

    /// Where a texel's numbers begin.
    #[inline(always)]
    pub(super) fn place(&self, row: u32, column: u32) -> u32 {
        row * self.pitch + column * STORED as u32
    }

    /// The numbers at a [`Level::place`].
    #[inline(always)]
    pub(super) fn stored(&self, place: u32) -> &[T; STORED] {
        self.data[place as usize..].first_chunk().expect("places lie within the level")
    }

    /// This level averaged to `width × height` texels; `base` is the size of level 0.
    fn shrink(&self, width: usize, height: usize, base: [usize; 2]) -> Self {
        let mut level = Self::new(width, height, [width as f32 / base[0] as f32, height as f32 / base[1] as f32]);
        let (columns, rows) = (spans(self.width, width), spans(self.height, height));
        level.fill(|x, y| {
            let mut sum = [0.0; STORED];
            let mut z = 0.0;
            for (row, row_weight) in rows[y].clone() {
                for (column, weight) in columns[x].clone() {
                    let lanes = self.texel(column, row);
                    z += weight * row_weight * normal_z(lanes[NORMAL], lanes[NORMAL + 1]);
                    sum.iter_mut().zip(lanes).for_each(|(s, l)| *s += weight * row_weight * l);
                }
            }
            let length = (sum[NORMAL].powi(2) + sum[NORMAL + 1].powi(2) + z * z).sqrt().max(1e-6);
            sum[NORMAL] /= length;
            sum[NORMAL + 1] /= length;
            sum
        });
        level
    }

    /// The bilinear sample at (x, y) in texels of level 0, x and y in this level's wrap; not yet [`decoded`].
    #[inline(always)]
    pub(crate) fn bilinear(&self, x: f32, y: f32, wrap: Wrap) -> Lanes {
        self.mean(&self.corners(x, y, wrap))
    }

    /// The weighted mean of four texels, not yet [`decoded`].
    #[inline(always)]
    pub(super) fn mean(&self, corners: &Corners) -> Lanes {
        let Corners { columns, rows, .. } = corners;
        let mut lanes = self.sum(corners).mean::<T>([columns.sign[0], rows.sign[0]]);
        if corners.sign().is_none() {
            self.mirror_seam(&mut lanes, corners);
        }
        lanes
    }

    /// The weighted sum of four texels.
    #[inline(always)]
    pub(super) fn sum(&self, corners: &Corners) -> Sum {
        let mut sum = Sum::default();
        for (tap, weight) in self.taps(corners).into_iter().zip(corners.weights) {
            sum.add(self.stored(tap), weight);
        }
        sum
    }

    /// Places of the four texels, row by row.
    #[inline(always)]
    pub(super) fn taps(&self, Corners { columns, rows, .. }: &Corners) -> [u32; 4] {
        let place = |row: usize, column: usize| self.place(rows.index[row], columns.index[column]);
        [place(0, 0), place(0, 1), place(1, 0), place(1, 1)]
    }

    /// The four texels around (x, y) in texels of level 0.
    #[inline(always)]
    pub(super) fn corners(&self, x: f32, y: f32, wrap: Wrap) -> Corners {
        let x = (x + 0.5) * self.scale[0] - 0.5;
        let y = (y + 0.5) * self.scale[1] - 0.5;
        let ((x, fx), (y, fy)) = (whole_and_fraction(x), whole_and_fraction(y));
        let weights = [(1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy];
        Corners { columns: wrap.pair(x, self.width as i32), rows: wrap.pair(y, self.height as i32), weights }
    }

    /// Replaces the normal where the taps lie on both sides of a mirror: each tap has its own sign.
    #[cold]
    fn mirror_seam(&self, lanes: &mut Lanes, corners: &Corners) {
        let (taps, weights, signs) = (self.taps(corners), corners.weights, [corners.columns.sign, corners.rows.sign]);
        for axis in 0..2 {
            let lane = NORMAL + axis;
            lanes[lane] = 0.0;
            for tap in 0..4 {
                let stored = self.stored(taps[tap])[lane].widen() - T::CENTRE;
                let sign = signs[axis][if axis == 0 { tap % 2 } else { tap / 2 }];
                lanes[lane] += weights[tap] * sign * stored;
            }
        }
    }
}

/// Whole part (towards −∞) and fraction, as instructions that every processor has for vectors: `f32::floor` is a call into the
/// C library on plain x86-64, and casts that saturate are done one by one.
#[inline(always)]
pub(super) fn whole_and_fraction(value: f32) -> (i32, f32) {
    // 1.5·2²³: a sum with it has no room for a fraction, and its last bits are the nearest whole number.
    const ROUND: f32 = 12_582_912.0;
    // Far outside any camera's view; NaN becomes a number too.
    let value = if value > -FARTHEST { value.min(FARTHEST) } else { -FARTHEST };
    let sum = value + ROUND;
    let nearest = sum - ROUND;
    let above = nearest > value;
    let whole = sum.to_bits() as i32 - ROUND.to_bits() as i32 - i32::from(above);
    (whole, value - if above { nearest - 1.0 } else { nearest })
}

/// Largest texel coordinate that is told from others.
const FARTHEST: f32 = 4e6;

/// All levels of a tile, finest first.
pub(crate) fn chain<T: Stored>(finest: Level<T>) -> Vec<Level<T>> {
    let base = [finest.width, finest.height];
    let mut levels = vec![finest];
    for log2 in &LEVEL_LOG2[1..] {
        let size = base.map(|s| s >> log2);
        if size.contains(&0) {
            break;
        }
        let coarser = levels[levels.len() - 1].shrink(size[0], size[1], base);
        levels.push(coarser);
    }
    levels
}

/// For every target texel the source texels under it with their weights (which sum to 1).
fn spans(source: usize, target: usize) -> Vec<impl Iterator<Item = (usize, f32)> + Clone> {
    let scale = source as f64 / target as f64;
    (0..target)
        .map(|i| {
            let (low, high) = (i as f64 * scale, (i + 1) as f64 * scale);
            let last = (high.ceil() as usize).min(source);
            (low.floor() as usize..last).map(move |s| {
                let cover = ((s + 1) as f64).min(high) - (s as f64).max(low);
                (s, (cover.max(0.0) / scale) as f32)
            })
        })
        .collect()
}

/// Where a footprint lies in the whole chain: the binary logarithm of the finer of the two texel sizes around it, and the
/// weight of the coarser one.
#[inline(always)]
pub(crate) fn octave_of(footprint: f32, levels: usize) -> (usize, f32) {
    // Exponent and mantissa of the float are the logarithm's whole part and its (piecewise linear) fraction.
    let bits = footprint.to_bits();
    let octave = ((bits >> 23) as i32 - 127) as usize;
    let fraction = f32::from_bits((bits & 0x007f_ffff) | 0x3f80_0000) - 1.0;
    let last = LEVEL_LOG2[levels - 1] as usize;
    if octave < last { (octave, fraction) } else { (last, 0.0) }
}

/// The sample of a footprint of 4 texels or more, not yet [`decoded`]. Out of line: frames of a scan at 256² hardly ever need it.
#[inline(never)]
pub(crate) fn coarse<T: Stored>(levels: &[Level<T>], (octave, weight): (usize, f32), x: f32, y: f32, wrap: Wrap) -> Lanes {
    let mut lanes = sampled(levels, octave, x, y, wrap);
    if weight > 0.0 {
        mix(&mut lanes, &sampled(levels, octave + 1, x, y, wrap), weight);
    }
    lanes
}

/// Moves a sample towards another by a share of the way.
#[inline(always)]
pub(crate) fn mix(lanes: &mut Lanes, other: &Lanes, share: f32) {
    for lane in 0..STORED {
        lanes[lane] += share * (other[lane] - lanes[lane]);
    }
}

/// The bilinear sample of the level whose texels have the binary logarithm `octave`, at (x, y) in texels of level 0.
fn sampled<T: Stored>(levels: &[Level<T>], octave: usize, x: f32, y: f32, wrap: Wrap) -> Lanes {
    match LEVEL_LOG2.iter().position(|log2| *log2 as usize >= octave) {
        Some(level) if LEVEL_LOG2[level] as usize == octave => levels[level].bilinear(x, y, wrap),
        Some(level) => left_out(&levels[level - 1], octave, x, y, wrap),
        None => levels[levels.len() - 1].bilinear(x, y, wrap),
    }
}

/// The sample of a level that isn't stored, from the next finer one: a texel is the mean of four that lie a quarter of its
/// size from its centre along each axis.
fn left_out<T: Stored>(finer: &Level<T>, octave: usize, x: f32, y: f32, wrap: Wrap) -> Lanes {
    let quarter = (1u32 << (octave - 2)) as f32;
    let mut mean = [0.0; STORED];
    for (dx, dy) in [(-quarter, -quarter), (quarter, -quarter), (-quarter, quarter), (quarter, quarter)] {
        let lanes = finer.bilinear(x + dx, y + dy, wrap);
        mean.iter_mut().zip(lanes).for_each(|(m, l)| *m += 0.25 * l);
    }
    mean
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::material::encoding::ROUGHNESS;

    #[test]
    fn octaves_follow_the_footprint() {
        let expect = [
            (1.0, 0, 0.0),
            (1.5, 0, 0.5),
            (2.0, 1, 0.0),
            (3.0, 1, 0.5),
            (4.0, 2, 0.0),
            (8.0, 3, 0.0),
            (12.0, 3, 0.5),
            (16.0, 4, 0.0),
            (64.0, 6, 0.0),
        ];
        for (footprint, octave, weight) in expect {
            assert_eq!(octave_of(footprint, 8), (octave, weight), "{footprint}");
        }
        assert_eq!(octave_of(1e9, 8), (12, 0.0));
        assert_eq!(octave_of(64.0, 3), (2, 0.0));
        assert_eq!(octave_of(f32::INFINITY, 1), (0, 0.0));
    }

    #[test]
    fn a_level_that_is_left_out_is_the_mean_of_the_texels_under_it() {
        let value = |x: usize, y: usize| ((x * 5 + y * 11) % 17) as f32 / 16.0;
        let levels = chain(Level::<u16>::from_fn(32, 32, |x, y| [value(x, y); STORED]));
        for (column, row) in [(0, 0), (2, 1), (3, 3)] {
            let texels = (0..64).map(|i| value(8 * column + i % 8, 8 * row + i / 8));
            let mean = texels.sum::<f32>() / 64.0;
            let centre = |k: usize| 8.0 * k as f32 + 3.5;
            let found = decoded::<u16>(&sampled(&levels, 3, centre(column), centre(row), Wrap::Repeat));
            assert!((found[0] - mean).abs() < 1e-4, "{} instead of {mean}", found[0]);
        }
    }

    #[test]
    fn averages_are_linear_even_for_odd_sizes() {
        let mut values = Vec::new();
        let finest = Level::<u16>::from_fn(7, 5, |x, y| {
            let mut lanes = [0.0; STORED];
            lanes[0] = ((x * 3 + y * 5) % 11) as f32 / 10.0;
            lanes[ROUGHNESS] = lanes[0];
            lanes
        });
        for y in 0..5 {
            values.extend((0..7).map(|x| finest.texel(x, y)[0]));
        }
        let mean = values.iter().sum::<f32>() / 35.0;
        let levels = chain(finest);
        assert_eq!(levels.iter().map(|l| (l.width, l.height)).collect::<Vec<_>>(), [(7, 5), (3, 2), (1, 1)]);
        for lane in [0, ROUGHNESS] {
            assert!((levels[2].texel(0, 0)[lane] - mean).abs() < 1e-4, "lane {lane}");
        }
    }
}
