//! Bricks, pavers, cobbles and flagstones.

use crate::material::maps::MaterialMaps;
use crate::material::procedural::colour::{Ramp, Rgb, mix, scale, srgb};
use crate::material::procedural::draw::Draw;
use crate::material::procedural::field::{Field, lerp, smoothstep};
use crate::material::procedural::noise::{Fbm, unit};
use crate::material::procedural::pattern::courses::{Courses, Herringbone, Slab};
use crate::material::procedural::surface::{Coat, Water, paint};
use crate::material::procedural::worley::Worley;

/// Fired-clay or concrete bricks in mortar: running, third, stack or Flemish bond.
pub fn bricks(draw: &mut Draw) -> MaterialMaps {
    let rows = draw.pick(&[8, 10, 12, 12, 14, 16, 18]);
    let columns = (rows as f32 / draw.between(2.1, 3.2)).round() as usize;
    let seed = draw.seed();
    let courses = match draw.whole(0, 5) {
        0 => Courses::flemish((columns * 2 / 3).max(2), rows, 0.66, seed),
        1 => Courses::bond(columns, rows, 0.0, seed),
        2 => Courses::bond(columns, rows, 1.0 / 3.0, seed),
        _ => Courses::bond(columns, rows, 0.5, seed),
    };
    let mortar = draw.between(4.0, 9.0);
    let bricks = Blocks {
        gap: mortar,
        wobble: draw.between(1.0, 4.0),
        chips: draw.between(0.0, 7.0),
        tilt: draw.between(0.3, 1.5),
        rise: draw.between(2.0, 7.0),
    };
    let clay = brick_clay(draw);
    let joint = draw.pick(&[srgb(168, 160, 148), srgb(128, 122, 114), srgb(200, 192, 178), srgb(92, 88, 84)]);
    let joint = draw.near(joint, 0.15);
    bricks.build(draw, &clay, joint, |x, y| courses.at(x, y))
}

/// Paving blocks in a herringbone, straight or diagonal.
pub fn pavers(draw: &mut Draw) -> MaterialMaps {
    let pattern = Herringbone::new(draw.between(42.0, 85.0), draw.pick(&[2, 2, 3]), draw.chance(0.5), draw.seed());
    let blocks = Blocks {
        gap: draw.between(3.0, 6.0),
        wobble: draw.between(0.5, 1.5),
        chips: draw.between(0.0, 4.0),
        tilt: draw.between(0.3, 1.2),
        rise: draw.between(3.0, 6.0),
    };
    let clay = if draw.chance(0.5) {
        brick_clay(draw)
    } else {
        let grey = draw.hsv([0.05, 0.13], [0.02, 0.15], [0.4, 0.7]);
        Ramp((0..4).map(|_| draw.near(grey, 0.25)).collect())
    };
    let sand = draw.hsv([0.08, 0.12], [0.1, 0.4], [0.25, 0.6]);
    blocks.build(draw, &clay, sand, |x, y| pattern.at(x, y))
}

fn brick_clay(draw: &mut Draw) -> Ramp {
    let bases: &[Rgb] = match draw.whole(0, 5) {
        0 | 1 => &[srgb(140, 62, 44), srgb(168, 82, 56), srgb(118, 52, 42), srgb(182, 102, 74)],
        2 => &[srgb(96, 50, 42), srgb(74, 46, 42), srgb(122, 64, 48), srgb(60, 44, 44)],
        3 => &[srgb(190, 156, 108), srgb(204, 172, 126), srgb(172, 132, 88), srgb(214, 190, 150)],
        4 => &[srgb(206, 202, 194), srgb(192, 188, 180), srgb(220, 216, 208), srgb(178, 170, 160)],
        _ => &[srgb(98, 98, 98), srgb(120, 116, 112), srgb(76, 78, 82), srgb(136, 128, 118)],
    };
    Ramp(bases.iter().map(|&c| draw.near(c, 0.12)).collect())
}

/// How blocks stand in their joints. Lengths in reference texels.
struct Blocks {
    gap: f32,
    /// Displacement of their edges.
    wobble: f32,
    /// Depth of broken edges.
    chips: f32,
    /// Height difference across a tilted block and between blocks.
    tilt: f32,
    /// Height over the joint.
    rise: f32,
}

impl Blocks {
    fn build(&self, draw: &mut Draw, clay: &Ramp, joint: Rgb, slab: impl Fn(f32, f32) -> Slab) -> MaterialMaps {
        let size = draw.size;
        let (wx, wy) = (draw.noise(70.0, 4), draw.noise(70.0, 4));
        let (coarse, grit) = (draw.noise(90.0, 5), draw.fbm(Fbm::new(14.0, 3).gain(0.75)));
        let pits = draw.fbm(Fbm::new(10.0, 2)).upper_share(draw.between(0.03, 0.12), 0.08);
        let rugged = draw.between(0.25, 1.0);
        let (radius, bevel) = (draw.between(2.0, 7.0), draw.between(3.0, 7.0));
        let (mut ids, mut faces) = (Vec::with_capacity(size * size), Vec::with_capacity(size * size));
        let mut texel = 0;
        let height = Field::from_fn(size, |x, y| {
            let s = slab(x + self.wobble * wx.data[texel], y + self.wobble * wy.data[texel]);
            let broken = self.chips * (coarse.data[texel] * 1.5 + grit.data[texel] * 0.6 - 0.35).max(0.0);
            let face = smoothstep(0.0, bevel, s.inside(radius) - 0.5 * self.gap - broken);
            let lean = (unit(s.id, 1) - 0.5) * s.at[0] / s.half[0] + (unit(s.id, 2) - 0.5) * s.at[1] / s.half[1];
            let top = self.rise + self.tilt * (unit(s.id, 3) + lean) + rugged * grit.data[texel] + 1.2 * coarse.data[texel]
                - 2.0 * rugged * pits.data[texel];
            let bed = 1.2 * coarse.data[texel] + 1.6 * grit.data[texel];
            ids.push(s.id);
            faces.push(face);
            texel += 1;
            lerp(bed, top, face)
        });
        let relief = height.relief(10.0);
        let (soot, rough, pitted) = (draw.between(0.0, 0.5), draw.between(0.45, 0.9), draw.between(0.05, 0.45));
        let water = Water::draw(draw, 0.25);
        let (f0, bloom) = (draw.between(0.02, 0.045), if draw.chance(0.3) { draw.between(0.1, 0.35) } else { 0.0 });
        paint(height, |t| {
            let mottle = 0.16 * coarse.data[t] + 0.22 * grit.data[t];
            let tone = (0.75 + 0.5 * unit(ids[t], 5)) * (1.0 + 1.1 * mottle) * (1.0 - pitted * pits.data[t]);
            let mut block = scale(clay.at(unit(ids[t], 4) + 0.3 * coarse.data[t]), tone);
            block = mix(block, [0.65, 0.62, 0.58], bloom * smoothstep(0.1, 0.7, coarse.data[t] + 0.3 * grit.data[t]));
            let mortar = scale(joint, 1.0 + 0.5 * grit.data[t]);
            let cavity = 1.0 + (0.12 * relief.data[t]).clamp(-0.45, 0.15);
            let dirt = 1.0 - soot * smoothstep(-0.1, 0.5, -coarse.data[t]);
            let base = scale(mix(mortar, block, faces[t]), cavity * dirt);
            let roughness = lerp(0.92, rough, faces[t]) - 0.12 * grit.data[t] + 0.06 * coarse.data[t];
            water.over(Coat::dielectric(base, roughness, f0), relief.data[t])
        })
    }
}

/// Rounded cobbles in sand or soil.
pub fn cobbles(draw: &mut Draw) -> MaterialMaps {
    let width = draw.scale_between(55.0, 130.0);
    let stones = draw.worley(width);
    let stone = draw.hsv([0.04, 0.14], [0.02, 0.22], [0.28, 0.68]);
    let bed = draw.hsv([0.07, 0.12], [0.15, 0.5], [0.2, 0.5]);
    let shape = Stones {
        dome: draw.between(0.35, 0.6),
        reach: draw.between(0.5, 0.66),
        gap: draw.between(2.0, 7.0),
        rise: draw.between(5.0, 16.0),
        wobble: draw.between(3.0, 8.0),
        rugged: draw.between(0.3, 1.4),
    };
    shape.build(draw, &stones, stone, bed)
}

/// Irregular flat slabs of natural stone.
pub fn flagstones(draw: &mut Draw) -> MaterialMaps {
    let stretch = draw.between(0.8, 1.5);
    let stones = Worley::new(draw.scale_between(100.0, 210.0), [stretch, 1.0 / stretch], 0.8, draw.seed());
    let stone = draw.hsv([0.02, 0.15], [0.03, 0.35], [0.25, 0.72]);
    let bed = draw.hsv([0.06, 0.12], [0.05, 0.4], [0.2, 0.65]);
    let shape = Stones {
        dome: draw.between(0.06, 0.14),
        reach: 2.0,
        gap: draw.between(4.0, 9.0),
        rise: draw.between(4.0, 8.0),
        wobble: draw.between(8.0, 16.0),
        rugged: draw.between(0.5, 2.4),
    };
    shape.build(draw, &stones, stone, bed)
}

/// The shape of stones in their bed. Lengths in reference texels.
struct Stones {
    /// Width of the rounded rim as a share of the stone.
    dome: f32,
    /// Where corners are cut off, as a share of the mean stone (see `CellSample::rounded`).
    reach: f32,
    gap: f32,
    rise: f32,
    wobble: f32,
    /// Amplitude of the broken surface.
    rugged: f32,
}

impl Stones {
    fn build(&self, draw: &mut Draw, stones: &Worley, stone: Rgb, bed: Rgb) -> MaterialMaps {
        let size = draw.size;
        let (wx, wy) = (draw.noise(60.0, 4), draw.noise(60.0, 4));
        let (coarse, grit) = (draw.noise(120.0, 5), draw.fbm(Fbm::new(16.0, 3).gain(0.75)));
        let cleft = draw.ridged(Fbm::new(90.0, 4));
        let rim = self.dome * stones.unit_texels();
        let (mut ids, mut faces) = (Vec::with_capacity(size * size), Vec::with_capacity(size * size));
        let mut texel = 0;
        let height = Field::from_fn(size, |x, y| {
            let cell = stones.at(x + self.wobble * wx.data[texel], y + self.wobble * wy.data[texel]);
            let inside = cell.rounded(self.reach) * stones.unit_texels() - 0.5 * self.gap;
            let rise = (inside / rim).clamp(0.0, 1.0);
            let dome = (1.0 - (1.0 - rise).powi(2)).max(0.0).sqrt();
            let lean = [1, 2].map(|k| unit(cell.id, k) - 0.5);
            let lean = (lean[0] * cell.offset[0] + lean[1] * cell.offset[1]) * self.rise * 0.5;
            let rough = self.rugged * (cleft.data[texel] + 1.2 * grit.data[texel]);
            let top = dome * (self.rise * (0.8 + 0.4 * unit(cell.id, 3)) + lean) + rough * (0.3 + 0.7 * dome);
            ids.push(cell.id);
            faces.push(smoothstep(0.0, 3.0, inside));
            texel += 1;
            top.max(0.12 * self.rise + 1.6 * grit.data[texel - 1] + 1.5 * coarse.data[texel - 1])
        });
        let relief = height.relief(12.0);
        let ramp = Ramp((0..5).map(|_| draw.near(stone, 0.45)).collect());
        let (rough, f0, speckle) = (draw.between(0.35, 0.8), draw.between(0.025, 0.05), draw.between(0.1, 0.5));
        let water = Water::draw(draw, 0.3);
        paint(height, |t| {
            let tone = 1.0 + 0.35 * cleft.data[t].min(0.5) + speckle * grit.data[t] + 0.25 * coarse.data[t];
            let top = scale(ramp.at(unit(ids[t], 4) + 0.25 * coarse.data[t]), tone.max(0.2));
            let soil = scale(bed, 1.0 + 0.7 * grit.data[t]);
            let cavity = 1.0 + (0.09 * relief.data[t]).clamp(-0.6, 0.25);
            let base = scale(mix(soil, top, faces[t]), cavity);
            let roughness = lerp(0.93, rough, faces[t]) - 0.1 * grit.data[t] - 0.02 * relief.data[t].clamp(-2.0, 2.0);
            water.over(Coat::dielectric(base, roughness, f0), relief.data[t])
        })
    }
}
