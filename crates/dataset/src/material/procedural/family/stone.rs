//! Cut stone of visible crystals.

use crate::material::maps::MaterialMaps;
use crate::material::procedural::colour::{Rgb, mix, scale};
use crate::material::procedural::draw::Draw;
use crate::material::procedural::field::Field;
use crate::material::procedural::noise::{Fbm, hash, unit};
use crate::material::procedural::surface::{Coat, paint};

/// Granite: feldspar, quartz and mica grown into each other; polished flat, honed or flamed.
pub fn granite(draw: &mut Draw) -> MaterialMaps {
    let size = draw.size;
    let grain = draw.scale_between(5.0, 18.0);
    let (large, small) = (draw.worley(grain), draw.worley(0.4 * grain));
    let (wx, wy, grit) = (draw.noise(grain, 2), draw.noise(grain, 2), draw.fbm(Fbm::new(5.0, 1)));
    let cloud = draw.noise(180.0, 4);
    let tinted = draw.chance(0.65);
    let feldspar = if tinted { draw.hsv([0.0, 0.1], [0.05, 0.5], [0.25, 0.8]) } else { draw.grey([0.12, 0.8]) };
    let shade = draw.between(0.5, 1.3);
    let quartz = if tinted { draw.near(scale(feldspar, shade), 0.2) } else { scale(feldspar, shade) };
    let mica = draw.grey([0.03, 0.2]);
    let minerals: [Rgb; 3] = [feldspar, mix(feldspar, quartz, 0.8), mica];
    let shares = [draw.between(0.35, 0.6), draw.between(0.72, 0.9)];
    let flow = draw.between(0.0, 0.25);
    let mut crystals: Vec<(u32, usize)> = Vec::with_capacity(size * size);
    let mut texel = 0;
    let bumps = Field::from_fn(size, |x, y| {
        let t = texel;
        texel += 1;
        let (x, y) = (x + 0.35 * grain * wx.data[t], y + 0.35 * grain * wy.data[t]);
        let (a, b) = (large.at(x, y), small.at(x, y));
        // Large crystals take the place of small ones.
        let id = if unit(a.id, 1) < 0.45 { a.id } else { hash(b.id, 1, 2) };
        let pick = unit(id, 2) + flow * cloud.data[t];
        let mineral = if pick < shares[0] {
            0
        } else if pick < shares[1] {
            1
        } else {
            2
        };
        crystals.push((id, mineral));
        unit(id, 3) - 0.5
    });
    let (rough, flamed) =
        if draw.chance(0.7) { (draw.scale_between(0.025, 0.3), 0.0) } else { (draw.between(0.4, 0.8), draw.between(0.3, 1.6)) };
    let (spread, f0) = (draw.between(0.3, 0.9), draw.between(0.038, 0.055));
    let height = bumps.zip(&grit, |bump, grit| flamed * (bump + 0.8 * grit));
    paint(height, |t| {
        let (id, mineral) = crystals[t];
        let tone = 1.0 + spread * (unit(id, 4) - 0.5) + 0.3 * grit.data[t];
        Coat::dielectric(scale(minerals[mineral], tone), rough * (0.9 + 0.2 * unit(id, 5)), f0)
    })
}
