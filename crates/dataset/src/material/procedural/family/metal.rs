//! Bare metals: brushed, hammered, patterned plate, polished, scratched.

use std::f32::consts::FRAC_1_SQRT_2;

use crate::material::maps::MaterialMaps;
use crate::material::procedural::colour::{Rgb, metal, mix, scale, srgb};
use crate::material::procedural::draw::Draw;
use crate::material::procedural::field::{Field, TILE, smoothstep};
use crate::material::procedural::noise::Fbm;
use crate::material::procedural::pattern::scatter::{Stamp, scatter};
use crate::material::procedural::surface::{Coat, paint};

/// One of the metals, slightly off its book value.
pub fn any_metal(draw: &mut Draw) -> Rgb {
    metal_of(draw, &metal::ALL)
}

/// One of some metals, clean or dulled by a film.
fn metal_of(draw: &mut Draw, metals: &[Rgb]) -> Rgb {
    let base = draw.pick(metals);
    let base = if draw.chance(0.65) { base } else { scale(base, draw.between(0.6, 1.0)) };
    draw.near(base, 0.05)
}

/// Thin straight scratches: 1 in their middle, 0 outside.
pub fn scratches(draw: &mut Draw, count: usize, length: [f32; 2], width: f32, angles: [f32; 2]) -> Field {
    let stamps: Vec<Stamp> = (0..count)
        .map(|_| {
            let at = [draw.between(0.0, TILE), draw.between(0.0, TILE)];
            let half = [0.5 * draw.scale_between(length[0], length[1]), draw.between(0.6, 1.0) * width];
            Stamp::turned(draw, at, angles, half, 0.0)
        })
        .collect();
    let hits = scatter(draw.size, 0.0, &stamps, |along, across, _| Some((1.0 - along * along) * (1.0 - across * across)));
    Field { size: draw.size, data: hits.iter().map(|h| h.height).collect() }
}

/// Metal brushed along x: long fine grooves.
pub fn brushed_metal(draw: &mut Draw) -> MaterialMaps {
    let f0 = any_metal(draw);
    let length = draw.scale_between(160.0, 700.0);
    let grooves = draw.fbm(Fbm::stretched(length, 5.0, 2).gain(0.9));
    let (bands, stain) = (draw.fbm(Fbm::stretched(length, 34.0, 3)), draw.noise(220.0, 5));
    let angles = [-0.06, 0.06];
    let count = draw.whole(0, 160);
    let strokes = scratches(draw, count, [60.0, 420.0], 1.4, angles);
    let (depth, rough) = (draw.scale_between(0.02, 0.5), draw.between(0.18, 0.5));
    // Fine brushing leaves its mark in the gloss alone.
    let depth = if draw.chance(0.3) { 0.0 } else { depth };
    let warp = if depth > 0.0 { 0.8 } else { 0.0 };
    let (uneven, dirt) = (draw.between(0.15, 0.45), draw.between(0.0, 0.25));
    let height = grooves.clone().map(|v| depth * v).plus(-1.2 * depth, &strokes).plus(warp, &stain);
    paint(height, |t| {
        let streak = 0.6 * grooves.data[t] + 0.4 * bands.data[t];
        let tone = (0.86 + uneven * streak - 0.2 * strokes.data[t]) * (1.0 - dirt * smoothstep(0.0, 0.6, stain.data[t]));
        Coat::metal(
            scale(f0, tone.clamp(0.2, 1.1)),
            rough + 0.25 * uneven * streak + 0.12 * strokes.data[t] + 0.1 * stain.data[t],
        )
    })
}

/// Hammered or peened metal: overlapping dents, darker patina between the ridges.
pub fn hammered_metal(draw: &mut Draw) -> MaterialMaps {
    let size = draw.size;
    let f0 = any_metal(draw);
    let cell = draw.scale_between(24.0, 80.0);
    let dents = draw.worley(cell);
    let (wx, wy) = (draw.noise(cell * 1.5, 2), draw.noise(cell * 1.5, 2));
    let (grit, stain) = (draw.fbm(Fbm::new(9.0, 2).gain(0.8)), draw.noise(140.0, 6));
    let depth = dents.unit_texels() * draw.between(0.1, 0.24);
    let raised = if draw.chance(0.3) { -1.0 } else { 1.0 };
    let mut texel = 0;
    let bowls = Field::from_fn(size, |x, y| {
        let sway = 0.12 * cell;
        let cell = dents.at(x + sway * wx.data[texel], y + sway * wy.data[texel]);
        texel += 1;
        cell.nearest * cell.nearest
    })
    .blur(1.2);
    let height = bowls.clone().map(|b| raised * depth * b).plus(0.12, &grit).plus(1.5, &stain);
    let (patina, rough) = (draw.between(0.0, 0.85), draw.between(0.12, 0.4));
    let tarnish = scale(draw.near(f0, 0.3), 0.35);
    let specks = draw.noise(16.0, 3).upper_share(draw.between(0.02, 0.12), 0.08);
    paint(height, |t| {
        let deep = if raised > 0.0 { smoothstep(0.45, 0.05, bowls.data[t]) } else { smoothstep(0.2, 0.6, bowls.data[t]) };
        let dark = patina * (deep * (0.6 + 0.8 * stain.data[t]) + 0.7 * specks.data[t]).clamp(0.0, 1.0);
        let tone = 0.95 + 0.12 * grit.data[t] + 0.1 * stain.data[t];
        Coat::metal(scale(mix(f0, tarnish, dark), tone), rough + 0.3 * dark + 0.06 * grit.data[t] + 0.12 * stain.data[t])
    })
}

/// Polished or satin metal: low texture, a few smudges and hairlines.
pub fn polished_metal(draw: &mut Draw) -> MaterialMaps {
    // Bright metals are what is polished and plated.
    const BRIGHT: [Rgb; 6] = [metal::SILVER, metal::ALUMINIUM, metal::CHROMIUM, metal::GOLD, metal::COPPER, metal::BRASS];
    let f0 = if draw.chance(0.7) { metal_of(draw, &BRIGHT) } else { any_metal(draw) };
    let (smudge, fine, swell) = (draw.noise(170.0, 5), draw.noise(24.0, 3), draw.noise(400.0, 2));
    let count = draw.whole(0, 40);
    let hairlines = scratches(draw, count, [40.0, 300.0], 0.9, [0.0, 6.3]);
    let rough = if draw.chance(0.35) { draw.scale_between(0.01, 0.03) } else { draw.scale_between(0.03, 0.4) };
    let (dull, film) = (draw.scale_between(0.004, 0.14), draw.scale_between(0.004, 0.06));
    let warp = if draw.chance(0.5) { 0.0 } else { draw.between(0.2, 1.2) };
    let (ripple, cut) = if warp > 0.0 { (0.03, -0.12) } else { (0.0, 0.0) };
    let height = swell.map(|v| warp * v).plus(ripple, &fine).plus(cut, &hairlines);
    paint(height, |t| {
        let smudged = smoothstep(-0.1, 0.6, smudge.data[t]);
        Coat::metal(
            scale(f0, 1.0 - film * smudged),
            rough * (1.0 + 0.1 * fine.data[t]) + dull * smudged + 0.06 * hairlines.data[t],
        )
    })
}

/// Chequer plate: raised lozenges at right angles, worn bright on top, dirt around them; bare or painted.
pub fn diamond_plate(draw: &mut Draw) -> MaterialMaps {
    let size = draw.size;
    let count = draw.whole(7, 16) as f32;
    let pitch = TILE / count;
    let (long, wide, rise) =
        (draw.between(0.36, 0.46) * pitch, draw.between(0.11, 0.17) * pitch, draw.between(0.05, 0.09) * pitch);
    let bars = draw.pick(&[1, 1, 2, 3]);
    let (grit, stain) = (draw.fbm(Fbm::new(9.0, 3).gain(0.75)), draw.noise(150.0, 6));
    let mut texel = 0;
    let studs = Field::from_fn(size, |x, y| {
        let (i, j) = ((x / pitch).floor(), (y / pitch).floor());
        let mut best = 0.0f32;
        // A lozenge is longer than its cell, so the four nearest cells may reach here.
        for (ci, cj) in [(i, j), (i + 1.0, j), (i, j + 1.0), (i + 1.0, j + 1.0)] {
            let (dx, dy) = (x - ci * pitch, y - cj * pitch);
            let sign = if (ci + cj).rem_euclid(2.0) < 0.5 { 1.0 } else { -1.0 };
            let (along, across) = ((dx + sign * dy) * FRAC_1_SQRT_2, (dy - sign * dx) * FRAC_1_SQRT_2);
            for bar in 0..bars {
                let shift = (bar as f32 - 0.5 * (bars - 1) as f32) * 2.3 * wide / bars as f32;
                let (a, b) = (along / long, (across - shift) / wide * if bars > 1 { 1.15 } else { 1.0 } * bars as f32);
                best = best.max(1.0 - a * a - b.abs().powf(1.5));
            }
        }
        texel += 1;
        smoothstep(0.0, 0.55, best + 0.1 * grit.data[texel - 1])
    });
    let height = studs.clone().map(|s| rise * s).plus(0.25, &grit).plus(1.0, &stain);
    let relief = height.relief(8.0);
    let bare = any_metal(draw);
    let paint_colour = draw.chance(0.45).then(|| draw.hsv([0.0, 1.0], [0.1, 0.9], [0.08, 0.6]));
    let (rough, dirt, wear) = (draw.between(0.2, 0.45), draw.between(0.2, 0.8), draw.between(0.3, 0.9));
    let speckle = draw.between(0.05, 0.3);
    paint(height, |t| {
        let tone = 0.85 + speckle * (grit.data[t] + 0.8 * stain.data[t]);
        let bright = Coat::metal(scale(bare, tone), rough + 0.18 * grit.data[t] + 0.15 * stain.data[t]);
        let top = studs.data[t] * smoothstep(0.2, 0.8, studs.data[t] * wear + 0.6 * grit.data[t] + 0.4 * stain.data[t] + 0.25);
        let base = match paint_colour {
            Some(colour) => Coat::dielectric(scale(colour, tone + 0.1), 0.4 + 0.2 * grit.data[t], 0.045).under(bright, top),
            None => bright,
        };
        let crevice = (0.5 * (-relief.data[t]).clamp(0.0, 1.5)
            + 0.8 * smoothstep(0.15, 0.6, stain.data[t]) * (1.0 - studs.data[t]))
            * dirt;
        base.under(Coat::dielectric(srgb(58, 48, 38), 0.9, 0.03), crevice.clamp(0.0, 0.9))
    })
}
