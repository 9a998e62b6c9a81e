//! Leather and paper.

use crate::material::maps::MaterialMaps;
use crate::material::procedural::colour::{mix, scale};
use crate::material::procedural::draw::Draw;
use crate::material::procedural::field::{Field, TILE, smoothstep};
use crate::material::procedural::noise::{Fbm, unit};
use crate::material::procedural::pattern::scatter::{Stamp, scatter};
use crate::material::procedural::surface::{Coat, paint};

/// Leather: cushion-like cells of two sizes between creases, rubbed on top.
pub fn leather(draw: &mut Draw) -> MaterialMaps {
    let size = draw.size;
    let cell = draw.scale_between(10.0, 34.0);
    let (large, small) = (draw.worley(cell), draw.worley(0.45 * cell));
    let (wx, wy) = (draw.noise(cell * 1.4, 3), draw.noise(cell * 1.4, 3));
    let (creases, cloud) = (draw.ridged(Fbm::new(240.0, 4)), draw.noise(200.0, 6));
    let pores = draw.fbm(Fbm::new(6.0, 1));
    let (sway, fine) = (0.35 * cell, draw.between(0.15, 0.5));
    let mut cells: Vec<(u32, f32)> = Vec::with_capacity(size * size);
    let mut texel = 0;
    let depth = 0.1 * cell * draw.scale_between(0.25, 1.2);
    let wrinkle = draw.between(0.0, 1.6);
    let height = Field::from_fn(size, |x, y| {
        let t = texel;
        texel += 1;
        let (x, y) = (x + sway * wx.data[t], y + sway * wy.data[t]);
        let (a, b) = (large.at(x, y), small.at(x, y));
        let cushion = smoothstep(0.0, 0.32, a.border).powf(0.7);
        let grain = smoothstep(0.0, 0.3, b.border).powf(0.7);
        cells.push((a.id, cushion * (1.0 - fine) + fine * grain));
        let fold = smoothstep(0.75, 1.0, creases.data[t]);
        depth * (cushion * (0.8 + 0.4 * unit(a.id, 1)) + fine * grain) - wrinkle * fold
            + 0.15 * pores.data[t]
            + 1.5 * cloud.data[t]
    });
    let dye = if draw.chance(0.65) {
        draw.hsv([0.02, 0.1], [0.3, 0.85], [0.15, 0.6])
    } else {
        draw.hsv([0.0, 1.0], [0.0, 0.6], [0.06, 0.9])
    };
    let (deep, rubbed) =
        (scale(draw.near(dye, 0.2), 0.55), mix(draw.near(dye, 0.15), [0.75, 0.66, 0.55], draw.between(0.0, 0.3)));
    let (wear, mottle) = (draw.between(0.1, 0.7), draw.between(0.1, 0.35));
    let (rough, f0) = (draw.between(0.2, 0.55), draw.between(0.035, 0.055));
    paint(height, |t| {
        let (id, top) = cells[t];
        let fold = smoothstep(0.75, 1.0, creases.data[t]);
        let base = mix(deep, dye, (0.25 + 0.85 * top).min(1.0));
        let shine = wear * smoothstep(0.0, 0.5, cloud.data[t]) * top;
        let tone = 1.0 + mottle * (cloud.data[t] + 0.5 * (unit(id, 2) - 0.5) + 0.6 * pores.data[t]) - 0.3 * fold;
        let colour = scale(mix(base, rubbed, shine.min(1.0)), tone);
        Coat::dielectric(colour, rough + 0.14 * (1.0 - top) - 0.12 * shine + 0.06 * pores.data[t], f0)
    })
}

/// Paper or cardboard: fibres, clouds, at times crumpled: low texture.
pub fn paper(draw: &mut Draw) -> MaterialMaps {
    let size = draw.size;
    let colour = match draw.whole(0, 2) {
        0 if draw.chance(0.3) => draw.grey([0.9, 0.99]),
        0 => draw.hsv([0.07, 0.14], [0.0, 0.08], [0.88, 0.99]),
        1 => draw.hsv([0.07, 0.1], [0.3, 0.6], [0.45, 0.75]),
        _ => draw.hsv([0.0, 1.0], [0.1, 0.8], [0.15, 0.9]),
    };
    let (tooth, cloud) = (draw.fbm(Fbm::new(9.0, 3).gain(0.7)), draw.noise(50.0, 5));
    let crumpled = if draw.chance(0.35) { draw.between(2.0, 8.0) } else { 0.0 };
    let (facet, toothed) = (draw.between(70.0, 170.0), draw.scale_between(0.1, 2.0));
    let facets = draw.worley(facet);
    let (wx, wy) = (draw.noise(90.0, 4), draw.noise(90.0, 4));
    let mut texel = 0;
    let height = Field::from_fn(size, |x, y| {
        let t = texel;
        texel += 1;
        let facet = facets.at(x + 14.0 * wx.data[t], y + 14.0 * wy.data[t]);
        // A fold is a ridge where two tilted facets meet: the height is continuous, its slope is not.
        let fold = if crumpled > 0.0 { (unit(facet.id, 1) - 0.5) * facet.border } else { 0.0 };
        4.0 * crumpled * fold + toothed * (0.35 * tooth.data[t] + 0.4 * cloud.data[t])
    });
    let fibres = fibres(draw);
    let (mottle, fibre_tone) = (draw.scale_between(0.004, 0.06), draw.between(-0.2, 0.05));
    let (rough, uneven, f0) = (draw.between(0.35, 0.9), draw.between(0.05, 1.0), draw.between(0.03, 0.045));
    paint(height, |t| {
        let tone = 1.0 + mottle * (cloud.data[t] + tooth.data[t]) + fibre_tone * fibres.data[t];
        Coat::dielectric(scale(colour, tone), rough + uneven * (0.05 * tooth.data[t] + 0.04 * cloud.data[t]), f0)
    })
}

/// Short curved fibres in the pulp.
fn fibres(draw: &mut Draw) -> Field {
    let count = draw.whole(50, 900);
    let stamps: Vec<Stamp> = (0..count)
        .map(|_| {
            let at = [draw.between(0.0, TILE), draw.between(0.0, TILE)];
            let half = [draw.scale_between(4.0, 16.0), draw.between(2.0, 4.0)];
            Stamp::turned(draw, at, [0.0, 6.3], half, 0.0)
        })
        .collect();
    let hits = scatter(draw.size, 0.0, &stamps, |a, b, id| {
        let curve = b - (unit(id, 1) - 0.5) * 1.6 * (a * a - 0.5);
        (curve.abs() < 0.3).then(|| (1.0 - curve.abs() / 0.3) * (1.0 - a * a))
    });
    Field { size: draw.size, data: hits.iter().map(|h| h.height).collect() }
}
