//! Glazed and printed tiles, porcelain, terrazzo.

use crate::material::maps::MaterialMaps;
use crate::material::procedural::colour::{Ramp, Rgb, mix, scale, srgb};
use crate::material::procedural::draw::Draw;
use crate::material::procedural::field::{Field, TILE, lerp, smoothstep};
use crate::material::procedural::noise::{Fbm, hash, unit};
use crate::material::procedural::pattern::courses::{Courses, Slab};
use crate::material::procedural::surface::{Coat, paint};
use crate::material::procedural::worley::Worley;

/// Glazed tiles in grout: square, oblong or hexagonal.
pub fn ceramic_tiles(draw: &mut Draw) -> MaterialMaps {
    let seed = draw.seed();
    let style = draw.whole(0, 3);
    let pitch = draw.scale_between(48.0, 170.0);
    let count = (TILE / pitch).round() as usize;
    let courses = match style {
        0 => Courses::bond((count / 2).max(2), count / 2 * 2, 0.5, seed),
        _ => Courses::bond(count, count, 0.0, seed),
    };
    let comb = Worley::honeycomb(pitch, seed);
    let tile = |x: f32, y: f32| -> (u32, f32, [f32; 2]) {
        if style == 1 {
            let cell = comb.at(x, y);
            (cell.id, cell.border * comb.unit_texels(), cell.offset)
        } else {
            let slab = courses.at(x, y);
            (slab.id, slab.inside(4.0), [slab.at[0] / slab.half[0], slab.at[1] / slab.half[1]])
        }
    };
    let body = match draw.whole(0, 3) {
        0 => draw.grey([0.08, 0.97]),
        1 => draw.hsv([0.0, 1.0], [0.5, 0.95], [0.1, 0.7]),
        _ => draw.hsv([0.0, 1.0], [0.0, 0.6], [0.15, 0.9]),
    };
    let ramp = if draw.chance(0.4) {
        Ramp((0..4).map(|_| shaded(draw, body, 0.6)).collect())
    } else {
        let amount = draw.between(0.02, 0.15);
        Ramp((0..4).map(|_| shaded(draw, body, amount)).collect())
    };
    let glaze = Glaze {
        gap: draw.between(2.5, 6.0),
        bevel: draw.between(3.0, 9.0),
        rise: draw.between(2.0, 5.0),
        waves: draw.scale_between(0.03, 1.6),
        roughness: draw.scale_between(0.01, 0.3),
        mottle: draw.between(0.03, 0.3),
    };
    glaze.build(draw, tile, |id, _, n| ramp.at(unit(id, 4) + 0.4 * n))
}

/// The glaze of another tile: a tinted one may turn a little in hue, a grey one stays grey.
fn shaded(draw: &mut Draw, body: Rgb, amount: f32) -> Rgb {
    if body[0] == body[2] {
        scale(body, 1.0 + draw.between(-amount, amount)).map(|v| v.min(1.0))
    } else {
        draw.near(body, amount)
    }
}

/// Square tiles with a printed ornament, four-fold and mirrored.
pub fn printed_tiles(draw: &mut Draw) -> MaterialMaps {
    let count = draw.pick(&[4, 5, 6, 7, 8, 10]);
    let courses = Courses::bond(count, count, 0.0, draw.seed());
    let ground = draw.pick(&[
        srgb(236, 230, 214),
        srgb(226, 222, 212),
        srgb(214, 196, 160),
        srgb(60, 66, 78),
        srgb(40, 40, 44),
        srgb(196, 206, 204),
    ]);
    let inks: Vec<Rgb> = (0..3).map(|_| draw.hsv([0.0, 1.0], [0.3, 0.9], [0.15, 0.75])).collect();
    let ornament = Ornament::new(draw);
    let glaze = Glaze {
        gap: draw.between(1.5, 4.0),
        bevel: draw.between(2.0, 5.0),
        rise: draw.between(1.0, 3.0),
        waves: draw.between(0.3, 1.2),
        roughness: draw.between(0.08, 0.5),
        mottle: draw.between(0.05, 0.25),
    };
    let slab = |x: f32, y: f32| -> (u32, f32, [f32; 2]) {
        let Slab { id, at, half } = courses.at(x, y);
        (id, courses.at(x, y).inside(3.0), [at[0] / half[0], at[1] / half[1]])
    };
    glaze.build(draw, slab, |id, at, n| {
        let worn = smoothstep(0.45, 0.75, n + 0.2 * unit(id, 9));
        match ornament.ink(at) {
            Some(ink) => mix(inks[ink], ground, 0.7 * worn + 0.08),
            None => ground,
        }
    })
}

/// A drawing in the unit square [−1, 1]², the same in all eight mirror images.
struct Ornament {
    petals: f32,
    rings: [f32; 3],
    star: f32,
    corner: f32,
    band: f32,
    lattice: f32,
}

impl Ornament {
    fn new(draw: &mut Draw) -> Self {
        Self {
            petals: draw.pick(&[4.0, 8.0, 8.0, 12.0, 16.0]),
            rings: [draw.between(0.12, 0.3), draw.between(0.4, 0.6), draw.between(0.7, 0.95)],
            star: draw.between(0.15, 0.5),
            corner: draw.between(0.35, 0.75),
            band: draw.between(0.03, 0.09),
            lattice: draw.pick(&[0.0, 3.0, 4.0, 6.0]),
        }
    }

    /// Which ink covers a position, if any.
    fn ink(&self, at: [f32; 2]) -> Option<usize> {
        let (x, y) = (at[0].abs(), at[1].abs());
        let r = (x * x + y * y).sqrt();
        let wave = (self.petals * at[1].atan2(at[0])).cos();
        let flower = self.rings[1] * (1.0 - self.star + self.star * wave);
        let corner = ((1.0 - x).powi(2) + (1.0 - y).powi(2)).sqrt();
        let corner_wave = self.corner * (0.85 + 0.15 * (self.petals * (1.0 - y).atan2(1.0 - x)).cos());
        if x.max(y) > 1.0 - self.band {
            Some(0)
        } else if r < self.rings[0] {
            Some(2)
        } else if (r - flower).abs() < self.band * 0.8 || (r - self.rings[2]).abs() < self.band * 0.7 {
            Some(0)
        } else if r < flower {
            Some(1)
        } else if (corner - corner_wave).abs() < self.band {
            Some(0)
        } else if corner < 0.6 * corner_wave {
            Some(2)
        } else if self.lattice > 0.0 && r > self.rings[2] && corner > corner_wave {
            let across = (self.lattice * (x + y)).fract() - 0.5;
            let along = (self.lattice * (x - y + 2.0)).fract() - 0.5;
            (across.abs() < 0.12 || along.abs() < 0.12).then_some(1)
        } else {
            None
        }
    }
}

/// The body of glazed tiles. Lengths in reference texels.
struct Glaze {
    gap: f32,
    bevel: f32,
    rise: f32,
    /// Amplitude of the unevenness that makes highlights wander.
    waves: f32,
    roughness: f32,
    /// Strength of colour variation within a tile.
    mottle: f32,
}

impl Glaze {
    fn build(
        &self,
        draw: &mut Draw,
        tile: impl Fn(f32, f32) -> (u32, f32, [f32; 2]),
        colour: impl Fn(u32, [f32; 2], f32) -> Rgb,
    ) -> MaterialMaps {
        let size = draw.size;
        let (coarse, grit) = (draw.noise(150.0, 6), draw.fbm(Fbm::new(8.0, 2).gain(0.8)));
        let swell = draw.noise(130.0, 2);
        let specks = draw.noise(12.0, 2).upper_share(draw.between(0.0, 0.03), 0.06);
        let (mut faces, mut colours) = (Vec::with_capacity(size * size), Vec::with_capacity(size * size));
        let mut texel = 0;
        let height = Field::from_fn(size, |x, y| {
            let (id, inside, at) = tile(x, y);
            let face = smoothstep(0.0, 1.0, (inside - 0.5 * self.gap) / self.bevel);
            let lean = (unit(id, 1) - 0.5) * at[0] + (unit(id, 2) - 0.5) * at[1];
            let top = self.rise + 0.6 * lean + self.waves * swell.data[texel];
            faces.push(smoothstep(0.0, 1.5, inside - 0.5 * self.gap));
            colours.push(colour(id, at, self.mottle * 2.0 * coarse.data[texel]));
            let bed = 0.9 * grit.data[texel];
            texel += 1;
            lerp(bed, top, face)
        });
        let relief = height.relief(8.0);
        let grout = if draw.chance(0.5) { draw.grey([0.1, 0.85]) } else { draw.hsv([0.05, 0.15], [0.0, 0.2], [0.15, 0.8]) };
        let (worn, f0) = (draw.between(0.0, 0.25), draw.between(0.035, 0.06));
        paint(height, |t| {
            let tone = 1.0 + self.mottle * (coarse.data[t] + 0.5 * grit.data[t]);
            let face = mix(scale(colours[t], tone), [0.025; 3], 0.8 * specks.data[t]);
            let glaze = Coat::dielectric(face, self.roughness + worn * (0.4 + coarse.data[t]).max(0.0) * 0.6, f0);
            let dirt = 1.0 + 0.4 * coarse.data[t] + 0.4 * grit.data[t] + (0.15 * relief.data[t]).clamp(-0.5, 0.1);
            let joint = Coat::dielectric(scale(grout, dirt), 0.85 + 0.1 * grit.data[t], 0.03);
            joint.under(glaze, faces[t])
        })
    }
}

/// Smooth glazed porcelain: almost no texture but the highlight, at times a few specks.
pub fn porcelain(draw: &mut Draw) -> MaterialMaps {
    let body = draw.pick(&[
        srgb(247, 246, 242),
        srgb(240, 236, 226),
        srgb(186, 206, 194),
        srgb(34, 48, 98),
        srgb(96, 44, 36),
        srgb(24, 24, 24),
    ]);
    let body = if draw.chance(0.65) { draw.grey([0.972, 0.998]) } else { draw.near(body, 0.08) };
    let (swell, fine) = (draw.noise(220.0, 3), draw.noise(40.0, 3));
    // Slip-cast ware is wavy, pressed and ground ware is plane.
    let waves = if draw.chance(0.5) { 0.0 } else { draw.between(0.2, 1.4) };
    let height = swell.clone().map(|v| waves * v).plus(0.04 * waves, &fine);
    let specks = draw.noise(10.0, 1).upper_share(if draw.chance(0.5) { draw.between(0.0, 0.004) } else { 0.0 }, 0.04);
    let (rough, pool) = (draw.scale_between(0.01, 0.16), draw.scale_between(0.001, 0.05));
    let f0 = draw.between(0.038, 0.048);
    paint(height, |t| {
        let tint = scale(body, 1.0 - pool * swell.data[t]);
        let colour = mix(tint, [0.04; 3], 0.6 * specks.data[t]);
        Coat::dielectric(colour, rough * (1.0 + 0.15 * fine.data[t]), f0)
    })
}

/// Polished stone chips in a cement or resin binder.
pub fn terrazzo(draw: &mut Draw) -> MaterialMaps {
    let size = draw.size;
    let binder = draw.hsv([0.0, 1.0], [0.0, 0.3], [0.08, 0.85]);
    let chips: Vec<Rgb> = (0..draw.whole(2, 5)).map(|_| draw.hsv([0.0, 0.6], [0.0, 0.4], [0.1, 0.9])).collect();
    let (wx, wy) = (draw.noise(24.0, 3), draw.noise(24.0, 3));
    let (grit, coarse) = (draw.fbm(Fbm::new(8.0, 2).gain(0.8)), draw.noise(200.0, 5));
    let largest = draw.scale_between(26.0, 80.0);
    let layers = [1.0, 0.55, 0.28].map(|s| (draw.worley(largest * s), draw.between(0.3, 0.75), draw.between(0.05, 0.2)));
    // Ground plane, or old enough for the binder to lie lower.
    let worn = if draw.chance(0.5) { 0.0 } else { 1.0 };
    let mut texel = 0;
    let mut hits: Vec<(u32, f32)> = Vec::with_capacity(size * size);
    let height = Field::from_fn(size, |x, y| {
        let mut found = (0, 0.0);
        for (k, (cells, share, gap)) in layers.iter().enumerate() {
            let reach = 0.14 * cells.unit_texels();
            let cell = cells.at(x + reach * wx.data[texel], y + reach * wy.data[texel]);
            let cover = smoothstep(0.0, 1.2, (cell.border - gap) * cells.unit_texels());
            // A smaller chip fits only where no larger one lies.
            if unit(cell.id, 1) < *share {
                found = (hash(cell.id, k as u32, 3), cover);
                break;
            }
        }
        hits.push(found);
        texel += 1;
        worn * (0.25 * found.1 + 0.04 * grit.data[texel - 1] + 0.3 * coarse.data[texel - 1])
    });
    let (rough, dull, f0) = (draw.scale_between(0.03, 0.4), draw.scale_between(0.004, 0.2), draw.between(0.035, 0.055));
    paint(height, |t| {
        let (id, cover) = hits[t];
        let chip = chips[(unit(id, 2) * chips.len() as f32) as usize];
        let chip = scale(chip, 0.7 + 0.6 * unit(id, 3) + 0.3 * wx.data[t] + 0.2 * grit.data[t]);
        let ground = scale(binder, 1.0 + 0.25 * grit.data[t] + 0.12 * coarse.data[t]);
        let roughness = rough * (1.0 + 0.3 * coarse.data[t]) + dull * (1.0 - cover);
        Coat::dielectric(mix(ground, chip, cover), roughness, f0)
    })
}
