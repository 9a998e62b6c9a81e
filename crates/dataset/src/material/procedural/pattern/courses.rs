//! Rectangles that fill the tile: courses (bricks, tiles, planks) and herringbone.

use std::f32::consts::FRAC_1_SQRT_2;

use crate::material::procedural::draw::Draw;
use crate::material::procedural::field::TILE;
use crate::material::procedural::noise::hash;

/// The rectangle that covers a position. Lengths in reference texels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Slab {
    /// Identity of the rectangle.
    pub id: u32,
    /// Position in the rectangle's frame, from its centre; x along its first side.
    pub at: [f32; 2],
    /// Half extents in that frame.
    pub half: [f32; 2],
}

impl Slab {
    /// Distance inwards from the border of the rectangle with corners rounded by `radius`; negative outside.
    #[inline]
    pub fn inside(&self, radius: f32) -> f32 {
        let dx = self.at[0].abs() - self.half[0] + radius;
        let dy = self.at[1].abs() - self.half[1] + radius;
        let outside = (dx.max(0.0).powi(2) + dy.max(0.0).powi(2)).sqrt();
        radius - outside - dx.max(dy).min(0.0)
    }
}

/// Rows of rectangles with joints of their own.
#[derive(Clone, Debug)]
pub struct Courses {
    row_height: f32,
    /// Joint positions of every row in [0, TILE), ascending.
    joints: Vec<Vec<f32>>,
    seed: u32,
}

impl Courses {
    /// `columns × rows` equal rectangles; every row is shifted by `shift` of a rectangle against the row above.
    ///
    /// The shift is rounded so that the rows close at the tile's edge.
    pub fn bond(columns: usize, rows: usize, shift: f32, seed: u32) -> Self {
        let width = TILE / columns as f32;
        let shift = if shift == 0.0 { 0.0 } else { (shift * rows as f32).round() / rows as f32 };
        let row = |r: usize| sorted((0..columns).map(|c| (c as f32 + shift * r as f32) * width).collect());
        Self { row_height: TILE / rows as f32, joints: (0..rows).map(row).collect(), seed }
    }

    /// Alternating long and short rectangles (a Flemish bond); the long ones are centred over the short ones. `rows` is even.
    pub fn flemish(pairs: usize, rows: usize, short: f32, seed: u32) -> Self {
        let pair = TILE / pairs as f32;
        let row = |r: usize| {
            let start = if r.is_multiple_of(2) { 0.0 } else { 0.5 * pair };
            sorted((0..pairs).flat_map(|p| [start + p as f32 * pair, start + (p as f32 + short) * pair]).collect())
        };
        Self { row_height: TILE / rows as f32, joints: (0..rows).map(row).collect(), seed }
    }

    /// `rows` rows cut at random places into `pieces` parts each, none shorter than half the mean.
    pub fn random(pieces: usize, rows: usize, draw: &mut Draw) -> Self {
        let mean = TILE / pieces as f32;
        let mut row = || {
            let start = draw.between(0.0, TILE);
            sorted((0..pieces).map(|p| start + (p as f32 + draw.between(-0.25, 0.25)) * mean).collect())
        };
        let joints = (0..rows).map(|_| row()).collect();
        Self { row_height: TILE / rows as f32, joints, seed: draw.seed() }
    }

    /// The rectangle at a position (wraps around).
    #[inline]
    pub fn at(&self, x: f32, y: f32) -> Slab {
        let rows = self.joints.len();
        let (x, y) = (x - TILE * (x / TILE).floor(), y - TILE * (y / TILE).floor());
        let row = ((y / self.row_height) as usize).min(rows - 1);
        let joints = &self.joints[row];
        let next = joints.iter().position(|&j| x < j).unwrap_or(joints.len());
        let (index, left) = match next {
            0 => (joints.len() - 1, joints[joints.len() - 1] - TILE),
            n => (n - 1, joints[n - 1]),
        };
        let right = if next == joints.len() { joints[0] + TILE } else { joints[next] };
        Slab {
            id: hash(self.seed, row as u32, index as u32),
            at: [x - 0.5 * (left + right), y - (row as f32 + 0.5) * self.row_height],
            half: [0.5 * (right - left), 0.5 * self.row_height],
        }
    }
}

fn sorted(joints: Vec<f32>) -> Vec<f32> {
    let mut joints: Vec<f32> =
        joints.iter().map(|j| j - TILE * (j / TILE).floor()).map(|j| if j >= TILE { 0.0 } else { j }).collect();
    joints.sort_by(f32::total_cmp);
    joints
}

/// Blocks `ratio` times as long as wide, laid at right angles to each other.
#[derive(Clone, Copy, Debug)]
pub struct Herringbone {
    cells: i32,
    ratio: i32,
    diagonal: bool,
    seed: u32,
}

impl Herringbone {
    /// Blocks about `width` reference texels wide; `diagonal` turns the pattern by 45°.
    pub fn new(width: f32, ratio: usize, diagonal: bool, seed: u32) -> Self {
        let period = 2 * ratio;
        let edge = if diagonal { TILE * FRAC_1_SQRT_2 } else { TILE };
        let periods = (edge / width / period as f32).round().max(1.0) as usize;
        Self { cells: (periods * period) as i32, ratio: ratio as i32, diagonal, seed }
    }

    /// The block at a position (wraps around).
    #[inline]
    pub fn at(&self, x: f32, y: f32) -> Slab {
        // Turned by 45°, one tile to the right is one period along both turned axes, so the pattern still closes.
        let (u, v) = if self.diagonal { (x + y, y - x) } else { (x, y) };
        let unit = TILE / self.cells as f32;
        let texels = if self.diagonal { unit * FRAC_1_SQRT_2 } else { unit };
        let (u, v) = (u / unit, v / unit);
        let (i, j) = (u.floor() as i32, v.floor() as i32);
        let k = (i - j).rem_euclid(2 * self.ratio);
        let half_length = 0.5 * self.ratio as f32;
        let (first, along, across, turned) = if k < self.ratio {
            ([i - k, j], u - (i - k) as f32, v - j as f32, 0)
        } else {
            // Down a column k falls by one per row, so the block starts where k is 2·ratio − 1.
            let above = 2 * self.ratio - 1 - k;
            ([i, j - above], v - (j - above) as f32, u - i as f32, 1)
        };
        let [a, b] = first.map(|c| c.rem_euclid(self.cells) as u32);
        Slab {
            id: hash(self.seed ^ turned, a, b),
            at: [(along - half_length) * texels, (across - 0.5) * texels],
            half: [half_length * texels, 0.5 * texels],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::material::procedural::noise::unit;

    fn positions() -> impl Iterator<Item = (f32, f32)> {
        (0..2000).map(|k| (unit(k, 0) * TILE, unit(k, 1) * TILE))
    }

    /// Every position lies in its rectangle, and one tile further lies the same rectangle.
    fn covers(at: impl Fn(f32, f32) -> Slab) {
        for (x, y) in positions() {
            let slab = at(x, y);
            assert!((0..2).all(|k| slab.at[k].abs() <= slab.half[k] + 1e-2), "{x} {y}: {slab:?}");
            if slab.inside(0.0) > 0.5 {
                let next = at(x + TILE, y - TILE);
                assert_eq!(next.id, slab.id, "{x} {y}");
                assert!((0..2).all(|k| (next.at[k] - slab.at[k]).abs() < 0.05), "{x} {y}");
            }
        }
    }

    #[test]
    fn courses_cover_the_tile() {
        let mut draw = Draw::new(1, 1, 64);
        for courses in [
            Courses::bond(5, 8, 0.5, 1),
            Courses::bond(4, 7, 1.0 / 3.0, 2),
            Courses::bond(6, 6, 0.0, 3),
            Courses::flemish(3, 8, 0.66, 4),
            Courses::random(2, 7, &mut draw),
        ] {
            covers(|x, y| courses.at(x, y));
        }
    }

    #[test]
    fn herringbones_cover_the_tile() {
        for (ratio, diagonal) in [(2, false), (3, true), (5, false), (4, true)] {
            let pattern = Herringbone::new(50.0, ratio, diagonal, 9);
            covers(|x, y| pattern.at(x, y));
        }
    }

    /// One brick has one identity: 40 bricks are 40 identities, each seen on an equal share of the tile.
    #[test]
    fn a_bond_has_as_many_bricks_as_asked() {
        let courses = Courses::bond(5, 8, 0.5, 1);
        let mut ids: Vec<u32> = positions().map(|(x, y)| courses.at(x, y).id).collect();
        ids.sort_unstable();
        ids.dedup();
        assert_eq!(ids.len(), 40);
    }

    #[test]
    fn the_way_in_is_measured_from_the_rounded_outline() {
        let slab = |x: f32, y: f32| Slab { id: 1, at: [x, y], half: [20.0, 10.0] };
        assert_eq!(slab(0.0, 0.0).inside(0.0), 10.0);
        assert_eq!(slab(18.0, 0.0).inside(3.0), 2.0);
        assert!((slab(20.0, 10.0).inside(4.0) - (4.0 - 4.0 * 2f32.sqrt())).abs() < 1e-5);
        assert!(slab(23.0, 0.0).inside(0.0) < 0.0);
    }
}
