//! Plaster, stucco, concrete, rock, marble.

use crate::material::maps::MaterialMaps;
use crate::material::procedural::colour::{Ramp, Rgb, mix, scale, srgb};
use crate::material::procedural::draw::Draw;
use crate::material::procedural::field::{Field, TILE, smoothstep};
use crate::material::procedural::noise::{Fbm, unit};
use crate::material::procedural::pattern::scatter::{Stamp, scatter};
use crate::material::procedural::surface::{Coat, Water, paint};

/// Smooth trowelled plaster or wall paint: low texture.
pub fn plaster(draw: &mut Draw) -> MaterialMaps {
    let colour = wall_colour(draw);
    let (wx, wy) = (draw.noise(160.0, 3), draw.noise(160.0, 3));
    let trowel = draw.fbm(Fbm::stretched(220.0, 40.0, 4)).warped(&wx, &wy, 60.0);
    let (grain, cloud) = (draw.fbm(Fbm::new(7.0, 2)), draw.noise(300.0, 5));
    let (strokes, depth) = (draw.scale_between(0.1, 2.0), draw.scale_between(0.05, 1.0));
    let height = trowel.clone().map(|v| strokes * v).plus(depth, &grain);
    let rough = if draw.chance(0.3) { draw.between(0.92, 1.0) } else { draw.between(0.4, 0.92) };
    let (tone, f0) = (draw.between(0.01, 0.12), draw.between(0.025, 0.045));
    paint(height, |t| {
        let shade = 1.0 + tone * (cloud.data[t] + 0.6 * trowel.data[t] + 0.3 * grain.data[t]);
        Coat::dielectric(scale(colour, shade), rough - 0.06 * trowel.data[t] + 0.03 * grain.data[t], f0)
    })
}

fn wall_colour(draw: &mut Draw) -> Rgb {
    match draw.whole(0, 9) {
        0 => draw.grey([0.4, 0.98]),
        1..=6 => draw.hsv([0.05, 0.17], [0.0, 0.4], [0.35, 0.95]),
        _ => draw.hsv([0.0, 1.0], [0.1, 0.55], [0.25, 0.85]),
    }
}

/// Rough render: thrown lumps, some flattened with a trowel, dirt between them.
pub fn stucco(draw: &mut Draw) -> MaterialMaps {
    let size = draw.size;
    let colour = wall_colour(draw);
    let lump = draw.scale_between(11.0, 44.0);
    let (lumps, grit, stain) =
        (draw.fbm(Fbm::new(lump, 4).gain(0.55)), draw.fbm(Fbm::new(8.0, 2).gain(0.8)), draw.noise(240.0, 6));
    let (cut, rise) = (draw.between(0.25, 0.9), 0.13 * lump + draw.between(0.5, 1.5));
    let knocked = draw.chance(0.4);
    let mut texel = 0;
    let height = Field::from_fn(size, |_, _| {
        let t = texel;
        texel += 1;
        let lump = if knocked {
            smoothstep(-0.15, 0.2, lumps.data[t]) * cut + 0.12 * lumps.data[t]
        } else {
            1.3 * lumps.data[t] * lumps.data[t].abs().sqrt()
        };
        rise * lump + 0.5 * grit.data[t]
    });
    let relief = height.relief(0.5 * lump);
    let (dirt, rough, f0) = (draw.between(0.1, 0.5), draw.between(0.55, 0.97), draw.between(0.02, 0.04));
    let grime = draw.hsv([0.06, 0.13], [0.1, 0.4], [0.15, 0.4]);
    paint(height, |t| {
        let tone = 1.0 + 0.12 * stain.data[t] + 0.18 * grit.data[t];
        let deep = smoothstep(0.2, -1.4, relief.data[t]) * (0.7 + stain.data[t]).max(0.0);
        let base = mix(scale(colour, tone), grime, (dirt * deep).min(0.8));
        Coat::dielectric(base, rough - 0.03 * relief.data[t].clamp(-2.0, 2.0) + 0.05 * grit.data[t], f0)
    })
}

/// Cast concrete: clouds, air holes, fine aggregate, board marks and hairline cracks at times.
pub fn concrete(draw: &mut Draw) -> MaterialMaps {
    let size = draw.size;
    let grey = if draw.chance(0.3) { draw.grey([0.2, 0.8]) } else { draw.hsv([0.06, 0.16], [0.0, 0.25], [0.2, 0.75]) };
    let (cloud, stain) = (draw.noise(260.0, 7), draw.fbm(Fbm::stretched(60.0, 300.0, 5)));
    let grit = draw.fbm(Fbm::new(10.0, 3).gain(0.75));
    let holes = air_holes(draw);
    let boards = draw.chance(0.35).then(|| (draw.whole(4, 9) as f32, draw.fbm(Fbm::stretched(6.0, 260.0, 3))));
    let cracks =
        draw.ridged(Fbm::new(330.0, 5)).upper_share(if draw.chance(0.5) { draw.between(0.004, 0.015) } else { 0.0 }, 0.02);
    let (roughness_of_cast, swell) = (draw.scale_between(0.05, 0.9), draw.between(0.5, 2.0));
    let mut texel = 0;
    let height = Field::from_fn(size, |x, _| {
        let t = texel;
        texel += 1;
        let mut h = roughness_of_cast * grit.data[t] + swell * cloud.data[t] - 3.0 * holes.data[t] - 2.0 * cracks.data[t];
        if let Some((count, grain)) = &boards {
            let across = (x / TILE * count).fract();
            h += 0.8 * grain.data[t] + 1.2 * unit(3, (x / TILE * count) as u32)
                - 1.6 * smoothstep(0.012, 0.0, across.min(1.0 - across));
        }
        h
    });
    let relief = height.relief(8.0);
    let (contrast, speckle) = (draw.between(0.1, 0.35), draw.between(0.1, 0.4));
    let (rough, f0) = (draw.between(0.35, 0.8), draw.between(0.025, 0.045));
    let water = Water::draw(draw, 0.25);
    paint(height, |t| {
        let tone = 1.0
            + contrast * (cloud.data[t] + 0.6 * stain.data[t])
            + speckle * grit.data[t]
            + (0.1 * relief.data[t]).clamp(-0.3, 0.1);
        let dark = 1.0 - 0.55 * holes.data[t].min(1.0) - 0.6 * cracks.data[t];
        let roughness = rough + 0.15 * cloud.data[t] + 0.1 * grit.data[t];
        water.over(Coat::dielectric(scale(grey, tone.max(0.1) * dark), roughness, f0), relief.data[t])
    })
}

/// Round holes of many sizes: 1 at their deepest.
fn air_holes(draw: &mut Draw) -> Field {
    let count = draw.whole(20, 500);
    let largest = draw.between(3.0, 9.0);
    let stamps: Vec<Stamp> = (0..count)
        .map(|_| {
            let radius = draw.scale_between(1.2, largest);
            let half = [radius * draw.between(1.0, 1.5), radius];
            Stamp::random(draw, half, 0.0)
        })
        .collect();
    let hits = scatter(draw.size, 0.0, &stamps, |a, b, _| Some((1.0 - a * a - b * b).max(0.0).sqrt()));
    Field { size: draw.size, data: hits.iter().map(|h| h.height).collect() }
}

/// Natural rock: strata, cracks and weathering.
pub fn rock(draw: &mut Draw) -> MaterialMaps {
    let size = draw.size;
    let (wx, wy) = (draw.noise(260.0, 5), draw.noise(260.0, 5));
    let aspect = draw.between(1.0, 3.0);
    let crags = draw.ridged(Fbm::stretched(200.0 * aspect.sqrt(), 200.0 / aspect.sqrt(), 6).gain(0.55)).warped(&wx, &wy, 60.0);
    let strata = draw.fbm(Fbm::stretched(500.0, 40.0, 4)).warped(&wx, &wy, 110.0);
    let facet = draw.scale_between(60.0, 150.0);
    let facets = draw.worley(facet);
    let (grit, lichen) = (draw.fbm(Fbm::new(14.0, 4).gain(0.7)), draw.noise(120.0, 6));
    let (depth, layered, broken) = (draw.between(2.0, 11.0), draw.between(0.0, 6.0), draw.between(0.0, 8.0));
    let rugged = draw.between(0.4, 1.5);
    let mut texel = 0;
    let height = Field::from_fn(size, |x, y| {
        let t = texel;
        texel += 1;
        let facet = facets.at(x + 45.0 * wx.data[t], y + 45.0 * wy.data[t]);
        let plane =
            (unit(facet.id, 1) - 0.5) * facet.offset[0] + (unit(facet.id, 2) - 0.5) * facet.offset[1] + 0.4 * unit(facet.id, 3);
        let crack = smoothstep(0.05, 0.0, facet.border);
        let steps = 3.0 * strata.data[t];
        let steps = (steps.floor() + smoothstep(0.35, 0.65, steps - steps.floor())) / 3.0;
        depth * crags.data[t] + layered * steps + broken * (plane - 0.35 * crack) + rugged * grit.data[t]
    });
    let relief = height.relief(18.0);
    let base = if draw.chance(0.15) { draw.grey([0.2, 0.7]) } else { draw.hsv([0.03, 0.55], [0.02, 0.4], [0.25, 0.7]) };
    let pale = scale(mix(base, [0.7, 0.68, 0.64], 0.5), draw.between(0.4, 1.0));
    let ramp = Ramp(vec![scale(base, 0.35), scale(draw.near(base, 0.3), 0.75), base, mix(base, pale, 0.4)]);
    let growth = lichen.upper_share(if draw.chance(0.4) { draw.between(0.03, 0.25) } else { 0.0 }, 0.1);
    let moss = draw.hsv([0.12, 0.27], [0.2, 0.6], [0.3, 0.6]);
    let (rough, f0, layer_tone) = (draw.between(0.35, 0.8), draw.between(0.025, 0.05), draw.between(0.0, 0.5));
    let water = Water::draw(draw, 0.3);
    paint(height, |t| {
        let tone = 0.6 + 0.09 * relief.data[t] + 0.3 * grit.data[t] + layer_tone * strata.data[t] + 0.15 * lichen.data[t];
        let stone = Coat::dielectric(ramp.at(tone), rough + 0.12 * grit.data[t] - 0.01 * relief.data[t], f0);
        let overgrown = stone.under(
            Coat::dielectric(scale(moss, 1.0 + 0.6 * grit.data[t]), 0.93, 0.025),
            growth.data[t] * (0.6 + 0.8 * grit.data[t] - 0.06 * relief.data[t]).clamp(0.0, 0.9),
        );
        water.over(overgrown, 0.3 * relief.data[t])
    })
}

/// Polished marble, onyx or granite-like stone: veins and bands below a glossy surface.
pub fn marble(draw: &mut Draw) -> MaterialMaps {
    let (wx, wy) = (draw.noise(300.0, 6), draw.noise(300.0, 6));
    let reach = draw.between(60.0, 220.0);
    let (apart, near) = (draw.between(200.0, 420.0), draw.between(70.0, 160.0));
    let veins = draw.ridged(Fbm::new(apart, 1)).warped(&wx, &wy, reach);
    let fine = draw.ridged(Fbm::new(near, 1)).warped(&wx, &wy, reach);
    let bands = draw.fbm(Fbm::stretched(600.0, 60.0, 5)).warped(&wx, &wy, reach);
    let (cloud, grain) = (draw.noise(160.0, 6), draw.fbm(Fbm::new(9.0, 3).gain(0.8)));
    let (ground, vein) = draw.pick(&[
        (srgb(232, 230, 226), srgb(120, 120, 124)),
        (srgb(226, 214, 194), srgb(150, 106, 66)),
        (srgb(28, 28, 30), srgb(206, 200, 190)),
        (srgb(22, 22, 22), srgb(120, 120, 120)),
        (srgb(46, 40, 36), srgb(130, 116, 100)),
        (srgb(36, 62, 52), srgb(170, 196, 176)),
        (srgb(112, 52, 44), srgb(214, 186, 170)),
        (srgb(196, 184, 170), srgb(92, 76, 66)),
        (srgb(60, 66, 78), srgb(190, 196, 204)),
    ]);
    let (ground, vein) = (draw.near(ground, 0.12), draw.near(vein, 0.15));
    let second = mix(ground, draw.near(vein, 0.4), draw.between(0.15, 0.5));
    let (banded, network, speckle) = (draw.between(0.0, 0.9), draw.between(0.2, 0.9), draw.between(0.02, 0.3));
    let (rough, etched) = (draw.scale_between(0.02, 0.25), draw.scale_between(0.003, 0.12));
    let (f0, hazy) = (draw.between(0.04, 0.06), draw.between(0.1, 0.5));
    let (thick, thin) = (draw.between(0.02, 0.1), draw.between(0.02, 0.08));
    let thick = veins.plus(0.12, &cloud).upper_share(thick, 0.06);
    let thin = fine.plus(0.12, &cloud).upper_share(thin, 0.06);
    // A slab from the saw is plane; an old floor is not.
    let worn = if draw.chance(0.6) { 0.0 } else { 1.0 };
    let height = cloud.clone().map(|v| 0.25 * worn * v).plus(-0.05 * worn, &thick).plus(0.015 * worn, &grain);
    paint(height, |t| {
        let (thick, thin) = (thick.data[t], network * thin.data[t]);
        let mut colour = mix(ground, second, smoothstep(-0.35, 0.45, cloud.data[t] + banded * 1.5 * bands.data[t]));
        colour = mix(colour, vein, (thick * 0.9 + 0.6 * thin).min(1.0));
        let tone = 1.0 + speckle * grain.data[t] + 0.1 * bands.data[t];
        Coat::dielectric(scale(colour, tone), rough * (1.0 + hazy * cloud.data[t]) + etched * (thick + thin), f0)
    })
}
