//! Shapes thrown onto the tile, the higher one on top: leaves, blades, pits, scratches.

use std::f32::consts::TAU;

use crate::material::procedural::draw::Draw;
use crate::material::procedural::field::{TILE, wrap};

/// Where one shape lies. Lengths in reference texels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stamp {
    /// Centre.
    pub at: [f32; 2],
    /// Cosine and sine of the turn of its long axis from x (towards y, down).
    pub turn: [f32; 2],
    /// Half length and half width.
    pub half: [f32; 2],
    /// Height of its base.
    pub base: f32,
    /// Identity, not 0.
    pub id: u32,
}

/// The top shape at one texel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Identity of the shape; 0 where there is none.
    pub id: u32,
    /// Position along and across the shape, each −1 to 1.
    pub at: [f32; 2],
    /// Height of the surface.
    pub height: f32,
}

impl Stamp {
    /// A shape at a random place and turn.
    pub fn random(draw: &mut Draw, half: [f32; 2], base: f32) -> Self {
        let at = [draw.between(0.0, TILE), draw.between(0.0, TILE)];
        Self::turned(draw, at, [0.0, TAU], half, base)
    }

    /// A shape at a place, turned by an angle (radians) from a range.
    pub fn turned(draw: &mut Draw, at: [f32; 2], angles: [f32; 2], half: [f32; 2], base: f32) -> Self {
        let angle = draw.between(angles[0], angles[1]);
        Self { at, turn: [angle.cos(), angle.sin()], half, base, id: draw.seed().max(1) }
    }
}

/// Lays the shapes on a ground of height `ground`.
///
/// `shape(along, across, id)` is the height of the shape over its base, `None` outside of it; both coordinates are in −1..1.
pub fn scatter(size: usize, ground: f32, stamps: &[Stamp], shape: impl Fn(f32, f32, u32) -> Option<f32>) -> Vec<Hit> {
    let mut hits = vec![Hit { id: 0, at: [0.0; 2], height: ground }; size * size];
    let per_texel = size as f32 / TILE;
    for stamp in stamps {
        let [cos, sin] = stamp.turn;
        let [length, width] = stamp.half.map(|h| h * per_texel);
        let reach = [(length * cos).abs() + (width * sin).abs(), (length * sin).abs() + (width * cos).abs()];
        let centre = stamp.at.map(|c| c * per_texel - 0.5);
        for y in (centre[1] - reach[1]).ceil() as i32..=(centre[1] + reach[1]).floor() as i32 {
            let dy = y as f32 - centre[1];
            let row = wrap(y, size) * size;
            for x in (centre[0] - reach[0]).ceil() as i32..=(centre[0] + reach[0]).floor() as i32 {
                let dx = x as f32 - centre[0];
                let at = [(dx * cos + dy * sin) / length, (dy * cos - dx * sin) / width];
                if at[0].abs() > 1.0 || at[1].abs() > 1.0 {
                    continue;
                }
                let Some(height) = shape(at[0], at[1], stamp.id) else { continue };
                let hit = &mut hits[row + wrap(x, size)];
                if stamp.base + height >= hit.height {
                    *hit = Hit { id: stamp.id, at, height: stamp.base + height };
                }
            }
        }
    }
    hits
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A disc over the corner covers all four corners of the tile, and the higher of two shapes is on top.
    #[test]
    fn shapes_wrap_around_and_the_higher_one_wins() {
        let stamp = |at: [f32; 2], base: f32, id: u32| Stamp { at, turn: [1.0, 0.0], half: [200.0, 200.0], base, id };
        let stamps = [stamp([0.0, 0.0], 2.0, 1), stamp([100.0, 0.0], 1.0, 2)];
        let hits = scatter(64, 0.0, &stamps, |a, b, _| (a * a + b * b < 1.0).then_some(0.5));
        for corner in [0, 63, 63 * 64, 63 * 64 + 63] {
            assert_eq!((hits[corner].id, hits[corner].height), (1, 2.5));
        }
        assert_eq!(hits[16].id, 2, "only the second disc reaches 264 texels to the right");
        assert_eq!((hits[32 * 64 + 32].id, hits[32 * 64 + 32].height), (0, 0.0));
    }
}
