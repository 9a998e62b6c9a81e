//! Loose ground: gravel, sand, leaf litter, grass.

use std::f32::consts::TAU;

use crate::material::maps::MaterialMaps;
use crate::material::procedural::colour::{Ramp, Rgb, mix, scale};
use crate::material::procedural::draw::Draw;
use crate::material::procedural::field::{Field, TILE, smoothstep};
use crate::material::procedural::noise::{Fbm, hash, unit};
use crate::material::procedural::pattern::scatter::{Hit, Stamp, scatter};
use crate::material::procedural::surface::{Coat, Water, paint};

/// Pebbles or crushed stone of several sizes.
pub fn gravel(draw: &mut Draw) -> MaterialMaps {
    let size = draw.size;
    let largest = draw.scale_between(34.0, 90.0);
    let layers = [1.0, 0.6, 0.36].map(|s| (draw.worley(largest * s), s * largest));
    let (wx, wy) = (draw.noise(34.0, 3), draw.noise(34.0, 3));
    let (grit, coarse) = (draw.fbm(Fbm::new(8.0, 2).gain(0.8)), draw.noise(150.0, 5));
    let (angular, share, wobble) = (draw.chance(0.5), draw.between(0.45, 0.8), draw.between(0.06, 0.16));
    let sunk = draw.between(0.35, 0.8);
    let mut stones: Vec<(u32, f32)> = Vec::with_capacity(size * size);
    let mut texel = 0;
    let height = Field::from_fn(size, |x, y| {
        let t = texel;
        texel += 1;
        let mut best = (0u32, 1.2 * grit.data[t] + 1.5 * coarse.data[t] - 2.0);
        for (k, (cells, width)) in layers.iter().enumerate() {
            let cell = cells.at(x + wobble * width * wx.data[t], y + wobble * width * wy.data[t]);
            if k < 2 && unit(cell.id, 1) > share {
                continue;
            }
            let inside = if angular { cell.border - 0.02 } else { cell.rounded(0.56) - 0.03 };
            let reach = (inside / 0.3).clamp(0.0, 1.0);
            let shape = if angular { smoothstep(0.0, 0.55, reach) } else { (1.0 - (1.0 - reach).powi(2)).max(0.0).sqrt() };
            let lean = (unit(cell.id, 2) - 0.5) * cell.offset[0] + (unit(cell.id, 3) - 0.5) * cell.offset[1];
            let top = sunk * width * ((0.16 + 0.12 * unit(cell.id, 4)) * shape + if angular { 0.22 } else { 0.1 } * lean)
                + 0.5 * grit.data[t];
            if reach > 0.02 && top > best.1 {
                best = (hash(cell.id, k as u32, 1).max(1), top);
            }
        }
        stones.push((best.0, best.1));
        best.1
    });
    let relief = height.relief(0.18 * largest);
    let base = draw.hsv([0.02, 0.14], [0.02, 0.35], [0.3, 0.8]);
    let variety = draw.between(0.3, 0.9);
    let ramp = Ramp((0..6).map(|_| draw.near(base, variety)).collect());
    let soil = scale(draw.near(base, 0.3), 0.4);
    let (rough, f0, speckle) = (draw.between(0.4, 0.85), draw.between(0.025, 0.05), draw.between(0.1, 0.6));
    let water = Water::draw(draw, 0.3);
    paint(height, |t| {
        let (id, _) = stones[t];
        let cavity = (1.0 + 0.08 * relief.data[t]).clamp(0.3, 1.25);
        let tone = cavity * (1.0 + speckle * grit.data[t] + 0.25 * wx.data[t] + 0.1 * coarse.data[t]);
        let colour = if id == 0 { soil } else { ramp.at(unit(id, 5)) };
        let roughness = if id == 0 { 0.95 } else { rough + 0.3 * (unit(id, 6) - 0.5) };
        water.over(Coat::dielectric(scale(colour, tone.max(0.1)), roughness + 0.1 * grit.data[t], f0), 0.3 * relief.data[t])
    })
}

/// Sand or earth: grains, ripples, small stones.
pub fn sand(draw: &mut Draw) -> MaterialMaps {
    let size = draw.size;
    let (wx, wy) = (draw.noise(220.0, 4), draw.noise(220.0, 4));
    let waves = draw.whole(8, 26) as f32;
    let tilt = draw.whole(0, 3) as f32;
    let ripple = if draw.chance(0.6) { draw.between(1.0, 4.0) } else { 0.0 };
    let (grains, coarse, dunes) =
        (draw.fbm(Fbm::new(6.0, 2).gain(0.9)), draw.fbm(Fbm::new(40.0, 5).gain(0.6)), draw.noise(280.0, 4));
    let count = draw.whole(0, 260);
    let pebbles: Vec<Stamp> = (0..count)
        .map(|_| {
            let radius = draw.scale_between(2.5, 11.0);
            let half = [radius * draw.between(1.0, 1.6), radius];
            Stamp::random(draw, half, -0.4 * radius)
        })
        .collect();
    let hits =
        scatter(size, 0.0, &pebbles, |a, b, id| Some((1.0 - a * a - b * b).max(0.0).sqrt() * (3.0 + 4.0 * unit(id, 1)) - 1.0));
    // Fine and level, or coarse and freshly dug.
    let (bumps, grain_height) = if draw.chance(0.65) {
        (draw.between(0.6, 3.5), draw.between(0.15, 0.9))
    } else {
        (draw.between(3.0, 9.0), draw.between(1.2, 2.6))
    };
    let mut texel = 0;
    let height = Field::from_fn(size, |x, y| {
        let t = texel;
        texel += 1;
        let phase = (y * waves + x * tilt) / TILE + 1.4 * wx.data[t];
        let wave = (TAU * phase).sin();
        ripple * (wave - 0.25 * wave * wave) * (1.0 + wy.data[t])
            + bumps * coarse.data[t]
            + 4.0 * dunes.data[t]
            + grain_height * grains.data[t]
            + hits[t].height.max(0.0)
    });
    let relief = height.relief(10.0);
    let base = draw.hsv([0.05, 0.13], [0.12, 0.6], [0.28, 0.8]);
    let dark = scale(draw.near(base, 0.2), draw.between(0.25, 0.6));
    let stone = draw.hsv([0.03, 0.14], [0.02, 0.3], [0.25, 0.75]);
    let (speckle, damp) = (draw.between(0.4, 1.0), draw.between(0.0, 0.5));
    let (rough, f0) = (draw.between(0.5, 0.95), draw.between(0.02, 0.04));
    paint(height, |t| {
        let wet = damp * smoothstep(0.0, 0.7, dunes.data[t]);
        let tone = 0.6 + speckle * grains.data[t] + 0.08 * relief.data[t] + 0.5 * coarse.data[t];
        let colour = scale(mix(dark, base, tone.clamp(0.0, 1.0)), 1.0 - 0.55 * wet);
        let sand = Coat::dielectric(colour, rough - 0.35 * wet + 0.1 * grains.data[t], f0);
        let pebble = Coat::dielectric(scale(stone, 0.6 + 0.8 * unit(hits[t].id, 2) + 0.3 * grains.data[t]), 0.6, 0.04);
        sand.under(pebble, if hits[t].id == 0 { 0.0 } else { smoothstep(0.0, 0.8, hits[t].height) })
    })
}

/// Leaf litter: dry leaves over and under each other.
pub fn leaves(draw: &mut Draw) -> MaterialMaps {
    let size = draw.size;
    let length = draw.scale_between(40.0, 90.0);
    let slender = draw.between(0.32, 0.6);
    let count = (3.4 * TILE * TILE / (length * length * slender)) as usize;
    let stamps: Vec<Stamp> = (0..count)
        .map(|k| {
            let half = 0.5 * length * draw.between(0.7, 1.3);
            let width = half * slender * draw.between(0.75, 1.25);
            Stamp::random(draw, [half, width], 9.0 * k as f32 / count as f32)
        })
        .collect();
    // Fresh and flat to dry and curled up.
    let crisp = draw.scale_between(0.5, 3.0);
    let lobes = draw.pick(&[0.0, 0.0, 3.0, 5.0]);
    let outline = move |a: f32, b: f32, id: u32| -> Option<f32> {
        let taper = (1.0 - a * a).max(0.0) * (1.0 - 0.25 * a);
        let lobe = if lobes > 0.0 { 0.82 + 0.18 * (TAU * 0.5 * lobes * (a + 0.15)).cos() } else { 1.0 };
        let side = b.abs() / (taper * lobe).max(1e-3);
        let curl = (unit(id, 3) - 0.3) * 9.0 * crisp;
        let rib = 0.9 * smoothstep(0.1, 0.0, b.abs());
        (side < 1.0).then(|| {
            curl * (b * b + 0.4 * a * a)
                + rib * (1.0 - a.abs())
                + crisp * ((unit(id, 4) - 0.5) * 5.0 * a + (unit(id, 5) - 0.5) * 4.0 * b)
        })
    };
    let hits = scatter(size, -4.0, &stamps, outline);
    let (grit, coarse) = (draw.fbm(Fbm::new(9.0, 3).gain(0.75)), draw.noise(60.0, 4));
    let height = Field { size, data: hits.iter().zip(&grit.data).map(|(h, g)| h.height + 0.7 * g).collect() }.blur(1.0);
    let relief = height.relief(8.0);
    let hue = draw.pick(&[[0.04, 0.12], [0.02, 0.1], [0.07, 0.16], [0.15, 0.27]]);
    let tints: Vec<Rgb> = (0..7).map(|_| draw.hsv(hue, [0.15, 0.8], [0.15, 0.65])).collect();
    let soil = draw.hsv([0.05, 0.1], [0.2, 0.5], [0.1, 0.25]);
    let (rough, f0) = (draw.between(0.4, 0.8), draw.between(0.03, 0.05));
    let water = Water::draw(draw, 0.35);
    paint(height, |t| {
        let Hit { id, at: [a, b], .. } = hits[t];
        let shade = (1.0 + 0.13 * relief.data[t]).clamp(0.25, 1.3);
        if id == 0 {
            return Coat::dielectric(scale(soil, shade * (1.0 + 0.6 * grit.data[t])), 0.95, 0.02);
        }
        let tint = tints[(unit(id, 1) * tints.len() as f32) as usize];
        let vein = (7.0 * (a - 0.9 * b.abs())).fract().abs();
        let veins = smoothstep(0.06, 0.01, b.abs()).max(0.5 * smoothstep(0.18, 0.02, vein.min(1.0 - vein)));
        let spots = smoothstep(0.25, 0.6, coarse.data[t] + 0.4 * grit.data[t]);
        let tone = shade * (0.75 + 0.5 * unit(id, 2) + 0.3 * grit.data[t]) * (1.0 - 0.5 * spots);
        let colour = mix(tint, mix(tint, [0.6, 0.5, 0.35], 0.5), veins);
        let leaf = Coat::dielectric(scale(colour, tone), rough + 0.15 * (unit(id, 6) - 0.5) + 0.1 * grit.data[t], f0);
        water.over(leaf, 0.3 * relief.data[t])
    })
}

/// Grass or moss: thin blades in tufts over soil.
pub fn grass(draw: &mut Draw) -> MaterialMaps {
    let size = draw.size;
    let length = draw.scale_between(26.0, 70.0);
    let width = draw.between(1.6, 3.2);
    let density = draw.noise(180.0, 4);
    let count = (5.0 * TILE * TILE / (length * width)) as usize / 4;
    let bare = draw.between(-0.9, -0.2);
    let stamps: Vec<Stamp> = (0..count)
        .filter_map(|k| {
            let half = [0.5 * length * draw.between(0.6, 1.2), width * draw.between(0.7, 1.2)];
            let stamp = Stamp::random(draw, half, 10.0 * (k as f32 / count as f32));
            (density.sample(stamp.at[0], stamp.at[1]) > bare).then_some(stamp)
        })
        .collect();
    let blade = |a: f32, b: f32, id: u32| -> Option<f32> {
        let bow = b + (unit(id, 1) - 0.5) * 0.9 * (1.0 - a * a) - 0.1;
        let half_width = 0.55 * (1.0 - a.abs().powi(3));
        (bow.abs() < half_width)
            .then(|| 2.5 * (1.0 - a * a) + 1.2 * (1.0 - (bow / half_width).powi(2)) + 3.0 * (unit(id, 2) - 0.5) * a)
    };
    let hits = scatter(size, -3.0, &stamps, blade);
    let grit = draw.fbm(Fbm::new(10.0, 3).gain(0.7));
    let height = Field {
        size,
        data: hits
            .iter()
            .zip(&grit.data)
            .map(|(h, g)| if h.id == 0 { h.height + 2.0 * g } else { h.height + 0.3 * g })
            .collect(),
    };
    // Grown upright or trodden down.
    let upright = draw.between(0.12, 0.5);
    let height = height.blur(1.2).map(|h| upright * h);
    let relief = height.relief(9.0);
    let green = draw.hsv([0.19, 0.29], [0.35, 0.75], [0.2, 0.5]);
    let dry = draw.hsv([0.1, 0.17], [0.25, 0.5], [0.4, 0.7]);
    let (withered, soil) = (draw.between(0.03, 0.5), draw.hsv([0.05, 0.1], [0.2, 0.5], [0.15, 0.35]));
    let (rough, f0) = (draw.between(0.4, 0.75), draw.between(0.03, 0.05));
    paint(height, |t| {
        let Hit { id, at: [a, _], .. } = hits[t];
        let shade = (0.95 + 0.12 / upright * relief.data[t]).clamp(0.2, 1.35);
        if id == 0 {
            return Coat::dielectric(scale(soil, shade * (1.0 + 0.8 * grit.data[t])), 0.95, 0.02);
        }
        let old = smoothstep(1.0 - withered, 1.0 - 0.5 * withered, unit(id, 3) + 0.3 * density.data[t]);
        let tint = scale(mix(green, dry, old), 0.55 + 0.7 * unit(id, 4) + 0.25 * a);
        Coat::dielectric(scale(tint, shade), rough + 0.2 * (unit(id, 5) - 0.5), f0)
    })
}
