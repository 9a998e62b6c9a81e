//! Metals under rust or paint: layers that cover each other.

use crate::material::maps::MaterialMaps;
use crate::material::procedural::colour::{Ramp, metal, scale, srgb};
use crate::material::procedural::draw::Draw;
use crate::material::procedural::family::metal::scratches;
use crate::material::procedural::family::sheet::dyed;
use crate::material::procedural::field::{Field, lerp, smoothstep};
use crate::material::procedural::noise::Fbm;
use crate::material::procedural::surface::{Coat, paint};

/// Rust from bright orange bloom to dark scale, with the fine texture that all of it shares.
pub struct Rust {
    ramp: Ramp,
    bloom: Field,
    /// Its fine grain, zero mean.
    pub grit: Field,
}

impl Rust {
    /// Draws its colours and texture.
    pub fn draw(draw: &mut Draw) -> Self {
        let stops = [srgb(44, 28, 24), srgb(82, 42, 28), srgb(124, 62, 34), srgb(166, 92, 46), srgb(196, 134, 82)];
        let ramp = Ramp(stops.iter().map(|&c| draw.near(c, 0.15)).collect());
        Self { ramp, bloom: draw.noise(70.0, 6), grit: draw.fbm(Fbm::new(9.0, 3).gain(0.75)) }
    }

    /// Rust at a texel, brighter by `tone`.
    pub fn coat(&self, texel: usize, tone: f32) -> Coat {
        let tone = 0.42 + 0.38 * self.bloom.data[texel] + 0.35 * self.grit.data[texel] + tone;
        Coat::dielectric(self.ramp.at(tone), 0.86 + 0.12 * self.grit.data[texel] + 0.1 * self.bloom.data[texel], 0.035)
    }
}

/// Steel in all states of rusting, with streaks that run down.
pub fn rusted_metal(draw: &mut Draw) -> MaterialMaps {
    let rust = Rust::draw(draw);
    let (wx, wy) = (draw.noise(90.0, 4), draw.noise(90.0, 4));
    let streaks = draw.fbm(Fbm::stretched(26.0, 420.0, 4));
    let patches = draw.noise(190.0, 6).warped(&wx, &wy, 40.0).plus(draw.between(0.0, 0.8), &streaks).plus(0.25, &rust.grit);
    let cover = patches.upper_share(draw.between(0.35, 0.97), draw.between(0.08, 0.35));
    let pits = draw.fbm(Fbm::new(18.0, 3)).upper_share(draw.between(0.04, 0.16), 0.1);
    let crust = draw.scale_between(0.06, 2.2);
    let mut texel = 0;
    let height = Field::from_fn(draw.size, |_, _| {
        let t = texel;
        texel += 1;
        cover.data[t] * (crust * (0.6 + 0.6 * rust.bloom.data[t] + 0.5 * rust.grit.data[t]) - 0.5 * crust * pits.data[t])
            + 0.06 * crust * rust.grit.data[t]
    });
    let relief = height.relief(8.0);
    let steel = scale(metal::IRON, draw.between(0.45, 1.0));
    let rough = draw.between(0.25, 0.5);
    paint(height, |t| {
        let clean = Coat::metal(
            scale(steel, 0.85 + 0.35 * streaks.data[t] + 0.25 * rust.grit.data[t]),
            rough + 0.2 * wx.data[t] + 0.1 * rust.grit.data[t],
        );
        let tone = 0.15 * (relief.data[t]).clamp(-1.5, 1.5) - 0.3 * pits.data[t] + 0.35 * streaks.data[t];
        clean.under(rust.coat(t, tone), cover.data[t])
    })
}

/// Paint over primer over metal, chipped and scratched, with rust where it was open for long.
pub fn chipped_paint(draw: &mut Draw) -> MaterialMaps {
    let size = draw.size;
    let rust = Rust::draw(draw);
    let (wx, wy) = (draw.noise(40.0, 4), draw.noise(40.0, 4));
    let damage = draw.noise(150.0, 6).warped(&wx, &wy, 16.0).plus(0.3, &draw.noise(14.0, 2));
    let (count, run) = (draw.whole(6, 60), draw.between(0.5, 1.0));
    let cuts = scratches(draw, count, [30.0, 260.0], 2.2, [0.0, 6.3]);
    let open = damage.plus(0.5 * run, &cuts);
    let share = draw.between(0.08, 0.45);
    let bare = open.upper_share(share, 0.02);
    let primer = open.upper_share(share + draw.between(0.02, 0.12), 0.02);
    // Chips that reach the metal are rusty in their middle, bright at their rim.
    let old = open.upper_share(share * draw.between(0.1, 0.9), 0.1);
    let (peel, fade) = (draw.noise(9.0, 1), draw.noise(260.0, 5));
    let thick = draw.between(0.8, 2.2);
    let mut texel = 0;
    let height = Field::from_fn(size, |_, _| {
        let t = texel;
        texel += 1;
        let film = thick * (0.4 * (1.0 - bare.data[t]) + 0.6 * (1.0 - primer.data[t]));
        let skin = 0.06 * peel.data[t] * (1.0 - primer.data[t]);
        film + skin + old.data[t] * (0.8 * rust.bloom.data[t] + 0.7 * rust.grit.data[t] + 0.3) + 0.5 * fade.data[t]
            - 0.5 * cuts.data[t]
    });
    let colour = draw.hsv([0.0, 1.0], [0.15, 0.95], [0.12, 0.8]);
    let (under, steel) = (draw.hsv([0.0, 0.12], [0.1, 0.6], [0.3, 0.7]), scale(metal::IRON, draw.between(0.6, 1.0)));
    let (gloss, f0) = (draw.between(0.1, 0.55), draw.between(0.04, 0.06));
    let grime = draw.between(0.05, 0.35);
    paint(height, |t| {
        let metal_coat =
            Coat::metal(scale(steel, 0.9 + 0.3 * rust.grit.data[t]), 0.32 + 0.15 * rust.grit.data[t] + 0.2 * fade.data[t]);
        let open = metal_coat.under(rust.coat(t, 0.1), old.data[t]);
        let tone = 1.0 + 0.25 * fade.data[t] - grime * smoothstep(0.0, 0.5, rust.bloom.data[t]) + 0.06 * rust.grit.data[t];
        let top = Coat::dielectric(scale(colour, tone), gloss + 0.2 * fade.data[t] + 0.05 * rust.grit.data[t], f0);
        let layer = Coat::dielectric(scale(under, 1.0 + 0.4 * rust.grit.data[t]), 0.75, 0.04);
        open.under(layer, 1.0 - bare.data[t]).under(top, 1.0 - primer.data[t])
    })
}

/// Intact lacquer or powder coating: even colour, orange peel, hardly any texture.
pub fn lacquered_metal(draw: &mut Draw) -> MaterialMaps {
    let colour = match draw.whole(0, 3) {
        0 => draw.grey([0.03, 0.98]),
        1 => draw.hsv([0.0, 1.0], [0.0, 0.6], [0.05, 0.95]),
        _ => draw.hsv([0.0, 1.0], [0.6, 1.0], [0.05, 0.9]),
    };
    let bump = draw.between(6.0, 14.0);
    let (peel, swell, dust) = (draw.noise(bump, 2), draw.noise(330.0, 2), draw.noise(7.0, 1));
    let (orange_peel, swollen) = (draw.scale_between(0.01, 0.35), draw.scale_between(0.05, 0.8));
    let (gloss, f0) = (draw.scale_between(0.03, 0.5), draw.between(0.04, 0.06));
    let specks = dust.upper_share(draw.between(0.0, 0.004), 0.05);
    let (film, hazy) = (draw.noise(200.0, 5), draw.scale_between(0.02, 0.5));
    let count = draw.whole(0, 12);
    let hairlines = scratches(draw, count, [40.0, 260.0], 1.0, [0.0, 6.3]);
    let height = peel.clone().map(|v| orange_peel * v).plus(swollen, &swell).plus(-0.2, &hairlines);
    // A transparent lacquer, as on bicycles, shows the metal below.
    let candy = draw.chance(0.3).then(|| dyed(draw));
    paint(height, |t| {
        let tone = 1.0 + 0.05 * swell.data[t] + lerp(0.0, 0.5, specks.data[t]);
        let roughness = gloss * (1.0 + hazy * film.data[t]) + 0.15 * hairlines.data[t];
        match candy {
            Some(f0) => Coat::metal(f0, roughness),
            None => Coat::dielectric(scale(colour, tone), roughness, f0),
        }
    })
}
