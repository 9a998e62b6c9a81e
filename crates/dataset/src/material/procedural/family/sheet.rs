//! Manufactured metal: plain and dyed sheet, corrugated sheet, chainmail.

use std::f32::consts::TAU;

use crate::material::maps::MaterialMaps;
use crate::material::procedural::colour::{Rgb, metal, mix, scale};
use crate::material::procedural::draw::Draw;
use crate::material::procedural::family::coated_metal::Rust;
use crate::material::procedural::family::metal::any_metal;
use crate::material::procedural::field::{Field, TILE, smoothstep};
use crate::material::procedural::noise::{Fbm, hash, unit};
use crate::material::procedural::pattern::scatter::{Stamp, scatter};
use crate::material::procedural::surface::{Coat, paint};

/// Plain rolled sheet: bare, blackened or dyed by anodising; mostly flat, at times finely blasted. Low texture.
pub fn sheet_metal(draw: &mut Draw) -> MaterialMaps {
    let f0 = match draw.whole(0, 9) {
        0..=2 => any_metal(draw),
        3 | 4 => blackened(draw),
        _ => dyed(draw),
    };
    let (rolled, cloud) = (draw.fbm(Fbm::stretched(600.0, 24.0, 4)), draw.noise(260.0, 5));
    let (uneven, dull) = (draw.scale_between(0.004, 0.06), draw.scale_between(0.004, 0.1));
    let rough = draw.scale_between(0.015, 0.7);
    let blasted = draw.chance(0.3).then(|| (draw.scale_between(0.03, 0.3), draw.fbm(Fbm::new(6.0, 2).gain(0.8))));
    let height = match blasted {
        Some((depth, grain)) => grain.map(|v| depth * v),
        None => Field::constant(draw.size, 0.0),
    };
    paint(height, |t| {
        let streak = 0.6 * rolled.data[t] + 0.4 * cloud.data[t];
        Coat::metal(scale(f0, 1.0 + uneven * (streak - 0.7)), rough * (1.0 + dull * (2.0 * cloud.data[t] + rolled.data[t])))
    })
}

/// Blued, browned or oxidised to a dark grey.
fn blackened(draw: &mut Draw) -> Rgb {
    let base = any_metal(draw);
    let grey = scale([base.iter().sum::<f32>() / 3.0; 3], draw.scale_between(0.06, 0.4));
    let tint = draw.hsv([0.0, 1.0], [0.0, 0.3], [0.9, 1.0]);
    std::array::from_fn(|c| (grey[c] * tint[c]).max(0.02))
}

/// Metal seen through a dye: what the dye swallows leaves the reflection of the clear layer on top.
pub fn dyed(draw: &mut Draw) -> Rgb {
    const CLEAR_LAYER: f32 = 0.02;
    // The deepest dyes let nothing of the complementary colour through.
    let depth = draw.between(0.75, 1.2).min(1.0);
    let hue = if draw.chance(0.5) { draw.between(0.02, 0.14) } else { draw.between(0.0, 1.0) };
    let through = draw.hsv([hue, hue], [depth, depth], [0.55, 0.95]);
    through.map(|v| v.max(CLEAR_LAYER))
}

/// Corrugated sheet, the waves along y: galvanised or painted, with streaks and rust that run down.
pub fn corrugated_sheet(draw: &mut Draw) -> MaterialMaps {
    let size = draw.size;
    let waves = draw.whole(8, 26) as f32;
    let depth = TILE / waves * draw.between(0.04, 0.17);
    // 0 is a sine; towards 1 crests and troughs flatten to a trapezium.
    let flat = if draw.chance(0.4) { draw.between(0.5, 0.85) } else { 0.0 };
    let rust = Rust::draw(draw);
    let (streaks, stain) = (draw.fbm(Fbm::stretched(22.0, 400.0, 4)), draw.noise(200.0, 6));
    let share = if draw.chance(0.6) { draw.between(0.02, 0.4) } else { 0.0 };
    let rusty = stain.clone().plus(0.9, &streaks).plus(0.25, &rust.grit).upper_share(share, 0.12);
    let spangle_size = draw.between(14.0, 34.0);
    let spangles = draw.worley(spangle_size);
    let mut tones = Vec::with_capacity(size * size);
    let mut texel = 0;
    let height = Field::from_fn(size, |x, y| {
        let t = texel;
        texel += 1;
        tones.push(unit(spangles.at(x, y).id, 1) - 0.5);
        let wave = (TAU * x / TILE * waves).sin();
        let wave = if flat > 0.0 { (wave / (1.0 - flat)).clamp(-1.0, 1.0) } else { wave };
        depth * wave + 0.15 * rust.grit.data[t] * rusty.data[t] + 2.0 * stain.data[t]
    });
    let zinc = scale(metal::ZINC, draw.between(0.45, 0.9));
    let zinc = mix(zinc, [0.45; 3], 0.6);
    let colour = draw.chance(0.6).then(|| draw.hsv([0.0, 1.0], [0.15, 0.9], [0.12, 0.8]));
    let (rough, dirt, spangle) = (draw.between(0.2, 0.55), draw.between(0.1, 0.6), draw.between(0.1, 0.5));
    paint(height, |t| {
        let tone = 1.0 - dirt * smoothstep(0.0, 0.7, stain.data[t] + 0.8 * streaks.data[t]) + 0.12 * rust.grit.data[t];
        let base = match colour {
            Some(colour) => Coat::dielectric(scale(colour, tone), rough + 0.15 * stain.data[t], 0.045),
            None => Coat::metal(
                scale(zinc, tone.max(0.3) * (1.0 + spangle * tones[t])),
                rough + 0.12 * stain.data[t] + 0.15 * tones[t],
            ),
        };
        base.under(rust.coat(t, 0.1 * streaks.data[t]), rusty.data[t])
    })
}

/// Chainmail: rows of rings that lean to either side in turn, each through its neighbours, over a dark ground.
pub fn chainmail(draw: &mut Draw) -> MaterialMaps {
    let size = draw.size;
    let columns = draw.whole(14, 40);
    let pitch = TILE / columns as f32;
    let rows = 2 * (TILE / (pitch * draw.between(0.85, 1.05))).round() as usize;
    let (radius, wire) = (pitch * draw.between(0.56, 0.66), draw.between(0.13, 0.2));
    let (lean, seed) = (draw.between(0.22, 0.4), draw.seed());
    let (sway, grit, stain) = (draw.noise(200.0, 3), draw.fbm(Fbm::new(8.0, 2).gain(0.8)), draw.noise(160.0, 5));
    let rings: Vec<Stamp> = (0..rows * columns)
        .map(|k| {
            let (row, column) = (k / columns, k % columns);
            let at = [(column as f32 + 0.5 * (row % 2) as f32) * pitch, (row as f32 + 0.5) * TILE / rows as f32];
            let at = [at[0] + 0.8 * sway.sample(at[0], at[1]), at[1] + 0.8 * sway.sample(at[1], at[0])];
            // The lowest bit tells which way the ring leans.
            let id = hash(seed, row as u32, column as u32) << 2 | 2 | (row % 2) as u32;
            Stamp { at, turn: [1.0, 0.0], half: [radius, radius], base: 0.0, id }
        })
        .collect();
    let hits = scatter(size, -radius, &rings, |a, b, id| {
        let across = ((a * a + b * b).sqrt() - 1.0 + wire) / wire;
        let side = if id & 1 == 0 { lean } else { -lean };
        (across.abs() < 1.0).then(|| radius * (wire * (1.0 - across * across).sqrt() + side * a))
    });
    let flat = draw.between(0.25, 0.5);
    let height = Field { size, data: hits.iter().map(|h| flat * h.height.max(-0.45 * radius)).collect() }.blur(0.6);
    let f0 = any_metal(draw);
    let (rough, tarnish, spread) = (draw.between(0.15, 0.45), draw.between(0.1, 0.7), draw.between(0.05, 0.3));
    let ground = Coat::dielectric(draw.hsv([0.0, 1.0], [0.0, 0.3], [0.01, 0.12]), 0.9, 0.02);
    paint(height, |t| {
        let hit = hits[t];
        if hit.id == 0 {
            return ground;
        }
        let dark = tarnish * smoothstep(0.1, -0.3, hit.height / radius + 0.3 * stain.data[t]);
        let tone = (1.0 - spread * unit(hit.id, 1) + 0.1 * grit.data[t]) * (1.0 - 0.7 * dark);
        Coat::metal(scale(f0, tone), rough + 0.25 * dark + 0.06 * grit.data[t])
    })
}
