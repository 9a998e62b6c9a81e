//! Roof tiles.

use std::f32::consts::PI;

use crate::material::maps::MaterialMaps;
use crate::material::procedural::colour::{Ramp, Rgb, mix, scale, srgb};
use crate::material::procedural::draw::Draw;
use crate::material::procedural::field::{Field, TILE, lerp, smoothstep};
use crate::material::procedural::noise::{Fbm, unit};
use crate::material::procedural::pattern::courses::Courses;
use crate::material::procedural::surface::{Coat, Water, paint};

/// Pantiles or flat tiles and slates in courses that lie over each other, weathered, with lichen at times.
pub fn roof_tiles(draw: &mut Draw) -> MaterialMaps {
    let size = draw.size;
    let pantiles = draw.chance(0.65);
    let columns = if pantiles { draw.whole(8, 18) } else { draw.whole(6, 14) };
    let rows = 2 * (columns as f32 * draw.between(0.25, 0.45)).round() as usize;
    let courses = Courses::bond(columns, rows, if pantiles { 0.0 } else { 0.5 }, draw.seed());
    let width = TILE / columns as f32;
    let (curve, thick) = (width * draw.between(0.07, 0.24), draw.between(5.0, 12.0));
    let (wx, wy) = (draw.noise(60.0, 3), draw.noise(60.0, 3));
    let (coarse, grit) = (draw.noise(110.0, 6), draw.fbm(Fbm::new(9.0, 3).gain(0.8)));
    let (wobble, rugged, lift) = (draw.between(1.0, 5.0), draw.between(0.4, 1.6), draw.between(0.0, 4.0));
    let mut tiles: Vec<(u32, f32)> = Vec::with_capacity(size * size);
    let mut texel = 0;
    let height = Field::from_fn(size, |x, y| {
        let t = texel;
        texel += 1;
        let slab = courses.at(x + wobble * wx.data[t], y + wobble * wy.data[t]);
        let [u, v] = [0, 1].map(|k| slab.at[k] / slab.half[k]);
        // Each tile rests on the one below it and rises towards its lower edge.
        let rise = thick * (0.5 + 0.5 * v) * smoothstep(1.0, 0.93, v) + lift * (unit(slab.id, 1) - 0.5);
        let profile = if pantiles { curve * (PI * u).cos() } else { -1.5 * smoothstep(0.93, 1.0, u.abs()) * thick };
        tiles.push((slab.id, v));
        rise + profile + rugged * (grit.data[t] + 1.5 * coarse.data[t])
    });
    let relief = height.relief(9.0);
    let bases: &[Rgb] = match draw.whole(0, 3) {
        0 | 1 => &[srgb(132, 66, 40), srgb(156, 84, 50), srgb(104, 54, 38), srgb(172, 104, 62)],
        2 => &[srgb(70, 72, 78), srgb(86, 86, 88), srgb(56, 58, 66), srgb(100, 94, 88)],
        _ => &[srgb(92, 58, 42), srgb(66, 46, 38), srgb(116, 76, 52), srgb(84, 72, 58)],
    };
    let clay = Ramp(bases.iter().map(|&c| draw.near(c, 0.15)).collect());
    let share = if draw.chance(0.5) { draw.between(0.03, 0.25) } else { 0.0 };
    let growth = coarse.clone().plus(0.5, &grit).upper_share(share, 0.1);
    let lichen = draw.hsv([0.11, 0.25], [0.15, 0.6], [0.3, 0.6]);
    // Unglazed clay is as matt as anything.
    let rough = if draw.chance(0.5) { draw.between(0.92, 1.04) } else { draw.between(0.55, 0.92) };
    let (f0, soot) = (draw.between(0.03, 0.045), draw.between(0.1, 0.6));
    let water = Water::draw(draw, 0.2);
    paint(height, |t| {
        let (id, v) = tiles[t];
        let shade = (1.0 + 0.1 * relief.data[t]).clamp(0.35, 1.2) * (1.0 - soot * smoothstep(0.2, -1.0, v + coarse.data[t]));
        let tone = shade * (0.8 + 0.4 * unit(id, 2) + 0.3 * grit.data[t] + 0.25 * coarse.data[t]);
        let colour = mix(clay.at(unit(id, 3) + 0.2 * coarse.data[t]), lichen, 0.8 * growth.data[t]);
        // Lichen is matter than any clay.
        let matt = lerp(rough + 0.05 * grit.data[t], 1.0, growth.data[t]);
        water.over(Coat::dielectric(scale(colour, tone), matt, f0), relief.data[t])
    })
}
