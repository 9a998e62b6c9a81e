//! Wood: sawn grain, planks, parquet, bark.

use crate::material::maps::MaterialMaps;
use crate::material::procedural::colour::{Ramp, Rgb, mix, scale, srgb};
use crate::material::procedural::draw::Draw;
use crate::material::procedural::field::{Field, TILE, lerp, smoothstep};
use crate::material::procedural::noise::{Fbm, unit};
use crate::material::procedural::pattern::courses::{Courses, Herringbone, Slab};
use crate::material::procedural::surface::{Coat, paint};
use crate::material::procedural::worley::Worley;

/// Grain along x: growth rings, fibres and pores, each periodic.
struct Grain {
    /// 0 in early wood to 1 in late wood.
    rings: Field,
    /// Fine streaks, zero mean.
    fibre: Field,
    /// 1 inside pores.
    pores: Field,
    /// 1 inside knots.
    knots: Field,
}

impl Grain {
    fn draw(draw: &mut Draw, knot_count: usize) -> Self {
        let size = draw.size;
        let count = draw.whole(14, 46) as f32;
        let (figure, ripple) = (draw.fbm(Fbm::stretched(700.0, 190.0, 3)), draw.fbm(Fbm::stretched(220.0, 30.0, 3)));
        let (sway, shiver) = (draw.between(1.0, 5.0) * count / 24.0, draw.between(0.15, 0.5));
        let eyes: Vec<[f32; 4]> = (0..knot_count)
            .map(|_| [draw.between(0.0, TILE), draw.between(0.0, TILE), draw.between(9.0, 24.0), draw.pick(&[-1.0, 1.0])])
            .collect();
        let mut knots = Field::constant(size, 0.0);
        let mut texel = 0;
        let rings = Field::from_fn(size, |x, y| {
            let mut phase = y / TILE * count + sway * figure.data[texel] + shiver * ripple.data[texel];
            for &[ex, ey, radius, side] in &eyes {
                let (dx, dy) = (around(x - ex), around(y - ey));
                // Fibres part around a knot and close again: the pull falls off faster across the grain than along it.
                let d2 = (dx / 3.2).powi(2) + dy * dy;
                phase += side * 3.0 * (-d2 / (2.2 * radius * radius)).exp();
                let inside = ((dx / 1.25).powi(2) + dy * dy).sqrt() / radius;
                knots.data[texel] = f32::max(knots.data[texel], smoothstep(1.0, 0.75, inside));
            }
            texel += 1;
            let t = phase - phase.floor();
            smoothstep(0.15, 0.92, t) * (1.0 - smoothstep(0.93, 1.0, t))
        });
        let fibre = draw.fbm(Fbm::stretched(230.0, 7.0, 3).gain(0.8));
        let pores = draw.fbm(Fbm::stretched(44.0, 4.0, 1)).upper_share(draw.between(0.02, 0.1), 0.1);
        Self { rings, fibre, pores, knots }
    }
}

/// The shorter way around the tile.
fn around(d: f32) -> f32 {
    d - TILE * (d / TILE).round()
}

/// Early wood, late wood and pore colours of a species.
fn species(draw: &mut Draw) -> [Rgb; 3] {
    let (light, dark) = draw.pick(&[
        (srgb(214, 178, 128), srgb(172, 122, 72)),
        (srgb(226, 198, 156), srgb(196, 152, 102)),
        (srgb(178, 130, 84), srgb(128, 84, 50)),
        (srgb(150, 92, 58), srgb(98, 54, 34)),
        (srgb(108, 74, 52), srgb(62, 42, 32)),
        (srgb(168, 86, 52), srgb(116, 48, 30)),
        (srgb(164, 152, 136), srgb(112, 102, 92)),
        (srgb(86, 60, 44), srgb(44, 32, 26)),
        (srgb(196, 124, 54), srgb(150, 84, 34)),
        (srgb(160, 94, 40), srgb(108, 58, 24)),
        (srgb(96, 62, 30), srgb(58, 36, 20)),
    ]);
    let (light, dark) = (draw.near(light, 0.15), draw.near(dark, 0.15));
    [light, dark, scale(dark, 0.4)]
}

/// How the wood is finished.
struct Finish {
    roughness: f32,
    f0: f32,
    /// Depth of rings and fibres: brushed or weathered wood is deeper.
    relief: f32,
    contrast: f32,
}

impl Finish {
    fn draw(draw: &mut Draw) -> Self {
        match draw.whole(0, 2) {
            0 => Self {
                roughness: draw.between(0.1, 0.32),
                f0: draw.between(0.04, 0.055),
                // Varnish fills the grain.
                relief: if draw.chance(0.5) { 0.0 } else { draw.between(0.05, 0.25) },
                contrast: draw.between(0.25, 0.9),
            },
            1 => Self {
                roughness: draw.between(0.28, 0.55),
                f0: 0.04,
                relief: draw.between(0.2, 0.8),
                contrast: draw.between(0.35, 1.0),
            },
            _ => Self {
                roughness: draw.between(0.65, 0.88),
                f0: draw.between(0.02, 0.035),
                relief: draw.between(1.0, 2.6),
                contrast: draw.between(0.7, 1.1),
            },
        }
    }

    fn coat(&self, wood: [Rgb; 3], rings: f32, fibre: f32, pores: f32, knots: f32) -> Coat {
        let early_late = (0.5 + self.contrast * (rings - 0.45) + 0.35 * fibre).clamp(0.0, 1.0);
        let mut colour = scale(mix(wood[0], wood[1], early_late), 1.0 + 0.3 * fibre);
        colour = mix(colour, wood[2], 0.65 * pores);
        colour = mix(colour, mix(scale(wood[1], 0.45), wood[2], rings), 0.8 * knots);
        Coat::dielectric(colour, self.roughness - 0.06 * rings + 0.12 * pores + 0.08 * fibre, self.f0)
    }

    fn height(&self, rings: f32, fibre: f32, pores: f32) -> f32 {
        self.relief * (0.9 * rings + 0.7 * fibre - 1.1 * pores)
    }
}

/// A plain sawn board or veneer with rings, pores and knots.
pub fn wood_grain(draw: &mut Draw) -> MaterialMaps {
    let knots = draw.pick(&[0, 0, 2, 4, 7]);
    let grain = Grain::draw(draw, knots);
    let (wood, finish) = (species(draw), Finish::draw(draw));
    let stain = draw.noise(300.0, 4);
    let swell = 0.6 * finish.relief.min(1.0);
    let mut texel = 0;
    let height = Field::from_fn(draw.size, |_, _| {
        let t = texel;
        texel += 1;
        finish.height(grain.rings.data[t], grain.fibre.data[t], grain.pores.data[t]) + swell * stain.data[t]
    });
    paint(height, |t| {
        let mut coat = finish.coat(wood, grain.rings.data[t], grain.fibre.data[t], grain.pores.data[t], grain.knots.data[t]);
        coat.diffuse = scale(coat.diffuse, 1.0 + 0.2 * stain.data[t]);
        coat.roughness += 0.05 * stain.data[t];
        coat
    })
}

/// Floor or wall boards with gaps, boards of different tone.
pub fn wood_planks(draw: &mut Draw) -> MaterialMaps {
    let rows = draw.whole(5, 12);
    let courses = Courses::random(draw.whole(1, 2), rows, draw);
    let gap = draw.between(1.5, 5.0);
    let boards = Boards {
        gap,
        bevel: draw.between(1.0, 4.0),
        rise: draw.between(2.0, 4.0),
        tone: draw.between(0.15, 0.5),
        knots: draw.pick(&[0, 3, 6]),
    };
    boards.build(draw, |x, y| courses.at(x, y))
}

/// Parquet blocks in a herringbone, straight or diagonal.
pub fn parquet(draw: &mut Draw) -> MaterialMaps {
    let pattern = Herringbone::new(draw.between(36.0, 70.0), draw.pick(&[3, 4, 5, 6]), draw.chance(0.6), draw.seed());
    // Sanded flush and filled, or laid with open joints.
    let rise = if draw.chance(0.5) { draw.between(0.05, 0.4) } else { draw.between(1.0, 4.0) };
    let boards =
        Boards { gap: draw.between(0.8, 2.0), bevel: draw.between(1.0, 2.0), rise, tone: draw.between(0.15, 0.45), knots: 0 };
    boards.build(draw, |x, y| pattern.at(x, y))
}

/// How boards are laid. Lengths in reference texels.
struct Boards {
    gap: f32,
    bevel: f32,
    /// Height over the gap.
    rise: f32,
    /// Variation of tone between boards.
    tone: f32,
    knots: usize,
}

impl Boards {
    fn build(&self, draw: &mut Draw, slab: impl Fn(f32, f32) -> Slab) -> MaterialMaps {
        let size = draw.size;
        let grain = Grain::draw(draw, self.knots);
        let (wood, finish) = (species(draw), Finish::draw(draw));
        let (edge, stain) = (draw.noise(40.0, 3), draw.noise(240.0, 5));
        let wobble = finish.relief.min(1.5) * 1.2;
        let mut boards: Vec<(u32, f32, Coat)> = Vec::with_capacity(size * size);
        let mut texel = 0;
        let height = Field::from_fn(size, |x, y| {
            let s = slab(x, y);
            let inside = s.inside(1.5) - 0.5 * self.gap + wobble * edge.data[texel];
            texel += 1;
            // Every board is cut from another place of the same log.
            let (gx, gy) = (s.at[0] + TILE * unit(s.id, 1), s.at[1] + TILE * unit(s.id, 2));
            let [rings, fibre, pores, knots] =
                [&grain.rings, &grain.fibre, &grain.pores, &grain.knots].map(|f| f.sample(gx, gy));
            boards.push((s.id, inside, finish.coat(wood, rings, fibre, pores, knots)));
            let lean = (unit(s.id, 3) - 0.5) * s.at[1] / s.half[1] * 0.8 + unit(s.id, 4) * 0.6;
            let top = self.rise * (1.0 + 0.25 * lean) + finish.height(rings, fibre, pores);
            lerp(0.0, top, smoothstep(-1.0, self.bevel, inside))
        });
        let worn = draw.between(0.0, 0.3);
        paint(height, |t| {
            let (id, inside, mut coat) = boards[t];
            let tone = 1.0 + self.tone * 2.0 * (unit(id, 5) - 0.5) + 0.25 * stain.data[t];
            let warmth = 1.0 + 0.12 * (unit(id, 6) - 0.5);
            coat.diffuse = [coat.diffuse[0] * tone * warmth, coat.diffuse[1] * tone, coat.diffuse[2] * tone / warmth];
            coat.roughness += worn * stain.data[t] + 0.08 * (unit(id, 7) - 0.5);
            let crack = Coat::dielectric(scale(wood[2], 0.35), 0.9, 0.02);
            let shade = 1.0 - 0.35 * smoothstep(self.bevel + 4.0, 0.0, inside);
            coat.diffuse = scale(coat.diffuse, shade);
            crack.under(coat, smoothstep(-0.8, 0.8, inside))
        })
    }
}

/// Tree bark: ridged plates with deep furrows along y, some with moss.
pub fn bark(draw: &mut Draw) -> MaterialMaps {
    let size = draw.size;
    let width = draw.scale_between(36.0, 90.0);
    let (wx, wy) = (draw.fbm(Fbm::stretched(90.0, 160.0, 4)), draw.fbm(Fbm::stretched(60.0, 120.0, 4)));
    let stretch = draw.between(1.5, 2.3);
    let plates = Worley::new(width * stretch, [1.0 / stretch, stretch], 0.9, draw.seed());
    let ridges = draw.ridged(Fbm::stretched(width * 0.7, width * 4.0, 3));
    let (sway, rim) = (draw.between(0.5, 1.1) * width, draw.between(0.25, 0.5));
    let fibre = draw.fbm(Fbm::stretched(10.0, 60.0, 3).gain(0.7));
    let flakes = draw.fbm(Fbm::stretched(30.0, 44.0, 3));
    let depth = draw.between(4.0, 13.0);
    let mut texel = 0;
    let height = Field::from_fn(size, |x, y| {
        let t = texel;
        texel += 1;
        let cell = plates.at(x + sway * wx.data[t], y + 1.5 * sway * wy.data[t]);
        let plate = smoothstep(0.0, rim, cell.border) * (0.7 + 0.5 * unit(cell.id, 1)) - 0.25 * ridges.data[t];
        let steps = flakes.data[t] * 4.0;
        let steps = (steps.floor() + smoothstep(0.3, 0.7, steps - steps.floor())) * 0.25;
        depth * plate + 1.5 * fibre.data[t] + depth * 0.25 * steps
    });
    let relief = height.relief(16.0);
    let base = draw.hsv([0.04, 0.11], [0.1, 0.5], [0.3, 0.65]);
    let deep = scale(draw.near(base, 0.2), 0.2);
    let pale = mix(base, draw.hsv([0.06, 0.14], [0.05, 0.25], [0.6, 0.8]), 0.6);
    let ramp = Ramp(vec![deep, scale(base, 0.6), base, pale]);
    let moss = draw.hsv([0.18, 0.27], [0.4, 0.7], [0.25, 0.5]);
    let share = if draw.chance(0.45) { draw.between(0.05, 0.35) } else { 0.0 };
    let growth = draw.noise(160.0, 6).upper_share(share, 0.12);
    let (rough, f0) = (draw.between(0.45, 0.85), draw.between(0.02, 0.04));
    paint(height, |t| {
        let tone = 0.5 + 0.07 * relief.data[t] + 0.35 * fibre.data[t] + 0.2 * flakes.data[t];
        let green = growth.data[t] * smoothstep(-3.0, 1.0, relief.data[t]);
        let bark = Coat::dielectric(ramp.at(tone), rough + 0.12 * fibre.data[t] - 0.015 * relief.data[t], f0);
        bark.under(Coat::dielectric(scale(moss, 1.0 + 0.8 * fibre.data[t]), 0.95, 0.02), green * share.min(1.0).powf(0.2))
    })
}
