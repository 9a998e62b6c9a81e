//! Woven cloth, denim, knitwear, carpet.

use std::f32::consts::TAU;

use crate::material::maps::MaterialMaps;
use crate::material::procedural::colour::{Rgb, mix, scale};
use crate::material::procedural::draw::Draw;
use crate::material::procedural::field::{Field, TILE, lerp};
use crate::material::procedural::noise::{Fbm, hash, unit};
use crate::material::procedural::pattern::weave::{Draft, Knit, Weave};
use crate::material::procedural::surface::{Coat, paint};

/// Coarse cloth: plain, basket, twill or satin; plain-coloured, striped or checked.
pub fn woven_cloth(draw: &mut Draw) -> MaterialMaps {
    let draft = draw.pick(&[Draft::Plain, Draft::Plain, Draft::Basket(2), Draft::Twill { over: 2, under: 2 }, Draft::Satin]);
    let pitch = draw.scale_between(8.0, 26.0);
    let weave = Weave::new(pitch, pitch * draw.between(0.8, 1.3), draft, [draw.between(0.85, 1.0), draw.between(0.85, 1.0)]);
    let ground = draw.hsv([0.0, 1.0], [0.0, 0.75], [0.1, 0.85]);
    let other = if draw.chance(0.5) { draw.near(ground, 0.3) } else { draw.hsv([0.0, 1.0], [0.05, 0.6], [0.2, 0.9]) };
    let stripes = draw.pick(&[0, 1, 2, 2]);
    let sets = [0, 1].map(|_| Stripes::draw(draw, ground, other));
    let cloth = Cloth {
        depth: pitch * draw.between(0.06, 0.16),
        ply: pitch * draw.between(0.25, 0.6),
        twist: draw.pick(&[-1.0, 1.0]),
        fuzz: draw.between(0.1, 0.4),
        roughness: draw.between(0.5, 0.95),
        f0: draw.between(0.025, 0.05),
    };
    cloth.build(draw, weave, |warp, index| match (stripes, warp) {
        (0, true) => ground,
        (0, false) => other,
        (1, false) => ground,
        (_, warp) => sets[usize::from(!warp)].colour(index, weave.threads()[usize::from(!warp)]),
    })
}

/// Denim: dyed warp over white weft in a fine twill, faded in places.
pub fn denim(draw: &mut Draw) -> MaterialMaps {
    let pitch = draw.scale_between(4.5, 9.0);
    let draft = draw.pick(&[Draft::Twill { over: 3, under: 1 }, Draft::Twill { over: 2, under: 1 }]);
    let weave = Weave::new(pitch, pitch, draft, [1.0, 0.85]);
    let dye = match draw.whole(0, 3) {
        0 => draw.hsv([0.0, 1.0], [0.1, 0.6], [0.15, 0.6]),
        1 => draw.hsv([0.58, 0.66], [0.1, 0.3], [0.15, 0.35]),
        _ => draw.hsv([0.56, 0.64], [0.45, 0.8], [0.25, 0.65]),
    };
    let white = draw.hsv([0.08, 0.15], [0.0, 0.12], [0.55, 0.85]);
    let white = mix(white, dye, draw.between(0.1, 0.6));
    let cloth = Cloth {
        depth: pitch * draw.between(0.08, 0.2),
        ply: pitch * 0.5,
        twist: 1.0,
        fuzz: draw.between(0.3, 0.6),
        roughness: draw.between(0.75, 0.92),
        f0: draw.between(0.03, 0.045),
    };
    let fade = draw.between(0.05, 0.3);
    cloth.build(
        draw,
        weave,
        |warp, index| {
            if warp { mix(dye, white, fade * unit(hash(7, index as u32, 1), 1).powi(2)) } else { white }
        },
    )
}

/// A sequence of coloured stripes over the threads of one direction.
struct Stripes {
    colours: [Rgb; 3],
    bands: usize,
    seed: u32,
}

impl Stripes {
    fn draw(draw: &mut Draw, ground: Rgb, other: Rgb) -> Self {
        let accent = draw.hsv([0.0, 1.0], [0.2, 0.9], [0.1, 0.95]);
        Self { colours: [ground, other, accent], bands: draw.whole(6, 28), seed: draw.seed() }
    }

    fn colour(&self, thread: usize, threads: usize) -> Rgb {
        let band = thread * self.bands / threads;
        let pick = unit(hash(self.seed, band as u32, 0), 0);
        self.colours[if pick < 0.5 {
            0
        } else if pick < 0.82 {
            1
        } else {
            2
        }]
    }
}

/// The yarn of a woven cloth. Lengths in reference texels.
struct Cloth {
    depth: f32,
    /// Distance of the twisted strands along the thread.
    ply: f32,
    twist: f32,
    /// Irregularity of colour and height.
    fuzz: f32,
    roughness: f32,
    f0: f32,
}

impl Cloth {
    fn build(&self, draw: &mut Draw, weave: Weave, colour: impl Fn(bool, usize) -> Rgb) -> MaterialMaps {
        let size = draw.size;
        let seed = draw.seed();
        let (wx, wy) = (draw.noise(110.0, 3), draw.noise(110.0, 3));
        let (lint, worn, folds) = (draw.fbm(Fbm::new(5.0, 1)), draw.noise(140.0, 5), draw.noise(380.0, 2));
        let turns = (TILE / self.ply).round();
        let mut texel = 0;
        let mut colours: Vec<(Rgb, f32)> = Vec::with_capacity(size * size);
        let height = Field::from_fn(size, |x, y| {
            let thread = weave.at(x + 2.5 * wx.data[texel], y + 2.5 * wy.data[texel]);
            let id = hash(seed, thread.index as u32, u32::from(thread.warp));
            let phase = thread.along / TILE * turns + 0.45 * self.twist * thread.across + unit(id, 1);
            let strand = (TAU * phase).sin();
            // Slubs: a thread is thicker and darker here than there.
            let slub = unit(id, 2) - 0.5
                + (TAU * (thread.along / TILE * (2.0 + (unit(id, 3) * 9.0).floor()) + unit(id, 4))).sin() * 0.3;
            let tone = 1.0 + self.fuzz * (0.6 * slub + 0.45 * strand * 0.5 + 0.7 * lint.data[texel] + 0.5 * worn.data[texel]);
            let shade = (0.62 + 0.4 * thread.height).clamp(0.2, 1.0);
            colours.push((scale(colour(thread.warp, thread.index), tone.max(0.2) * shade), thread.height));
            let out = self.depth * (thread.height + 0.1 * strand + 0.12 * self.fuzz * slub)
                + 0.35 * lint.data[texel]
                + 2.0 * folds.data[texel];
            texel += 1;
            out
        });
        paint(height, |t| {
            let (colour, top) = colours[t];
            Coat::dielectric(colour, self.roughness - 0.08 * top + 0.1 * lint.data[t], self.f0)
        })
    }
}

/// A plain knit of thick yarn, with stripes at times.
pub fn knit(draw: &mut Draw) -> MaterialMaps {
    let size = draw.size;
    let width = draw.scale_between(18.0, 52.0);
    let knit = Knit::new(width, width * draw.between(0.6, 0.85), draw.between(0.6, 0.95));
    let yarns: Vec<Rgb> = (0..3).map(|_| draw.hsv([0.0, 1.0], [0.05, 0.8], [0.15, 0.9])).collect();
    let (striped, seed) = (draw.chance(0.35), draw.seed());
    let (wx, wy) = (draw.noise(120.0, 3), draw.noise(120.0, 3));
    let (lint, worn) = (draw.fbm(Fbm::new(5.0, 1)), draw.noise(180.0, 4));
    let (ply, fuzz, depth) = (draw.between(1.2, 2.6), draw.between(0.2, 0.5), width * draw.between(0.06, 0.16));
    let mut yarn: Vec<(Rgb, f32)> = Vec::with_capacity(size * size);
    let mut texel = 0;
    let height = Field::from_fn(size, |x, y| {
        let stitch = knit.at(x + 0.12 * width * wx.data[texel], y + 0.12 * width * wy.data[texel]);
        let id = hash(seed, stitch.index[0] as u32, stitch.index[1] as u32);
        let strand = (TAU * (ply * stitch.along + 0.6 * stitch.across)).sin();
        let row = hash(seed, stitch.index[1] as u32 / 3, 77);
        let base = yarns[if striped { (unit(row, 1) * 3.0) as usize } else { 0 }];
        let tone = 1.0 + fuzz * (unit(id, 1) - 0.5 + 0.35 * strand + 0.8 * lint.data[texel] + 0.5 * worn.data[texel]);
        yarn.push((scale(base, tone * (0.3 + 0.7 * stitch.height)), stitch.height));
        texel += 1;
        depth * (stitch.height + 0.09 * strand * stitch.height) + 0.5 * lint.data[texel - 1]
    });
    let (rough, f0) = (draw.between(0.75, 0.98), draw.between(0.02, 0.04));
    paint(height, |t| Coat::dielectric(yarn[t].0, rough + 0.1 * lint.data[t] - 0.05 * yarn[t].1, f0))
}

/// Loop or cut pile: tufts of mixed yarn.
pub fn carpet(draw: &mut Draw) -> MaterialMaps {
    let size = draw.size;
    let cell = draw.scale_between(8.0, 20.0);
    let tufts = draw.worley(cell);
    let ground = draw.hsv([0.0, 1.0], [0.03, 0.6], [0.15, 0.75]);
    let yarns: Vec<Rgb> =
        (0..4).map(|k| if k < 3 { draw.near(ground, 0.35) } else { draw.hsv([0.0, 1.0], [0.05, 0.4], [0.2, 0.9]) }).collect();
    let accent = draw.between(0.0, 0.25);
    let (wx, wy) = (draw.noise(cell * 0.8, 2), draw.noise(cell * 0.8, 2));
    let (lint, trodden) = (draw.fbm(Fbm::new(4.5, 1)), draw.noise(260.0, 4));
    let depth = cell * draw.between(0.12, 0.36);
    let mut tuft: Vec<(u32, f32)> = Vec::with_capacity(size * size);
    let mut texel = 0;
    let height = Field::from_fn(size, |x, y| {
        let cell_at = tufts.at(x + 0.3 * cell * wx.data[texel], y + 0.3 * cell * wy.data[texel]);
        let dome = (1.0 - 1.3 * cell_at.nearest * cell_at.nearest).max(0.0).sqrt();
        tuft.push((cell_at.id, dome));
        texel += 1;
        depth * dome * (0.7 + 0.6 * unit(cell_at.id, 1)) + 0.9 * lint.data[texel - 1] + 4.0 * trodden.data[texel - 1]
    });
    let (rough, f0) = (draw.between(0.75, 1.05), draw.between(0.02, 0.035));
    paint(height, |t| {
        let (id, dome) = tuft[t];
        let index = if unit(id, 2) < accent { 3 } else { (unit(id, 3) * 3.0) as usize };
        let tone = (0.35 + 0.65 * dome) * (1.0 + 0.6 * lint.data[t] + 0.3 * trodden.data[t] + 0.4 * (unit(id, 4) - 0.5));
        Coat::dielectric(scale(yarns[index], tone.max(0.1)), lerp(rough, rough - 0.1, dome), f0)
    })
}
