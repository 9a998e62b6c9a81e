//! Moulded plastic.

use crate::material::maps::MaterialMaps;
use crate::material::procedural::draw::Draw;
use crate::material::procedural::field::Field;
use crate::material::procedural::noise::Fbm;
use crate::material::procedural::surface::{Coat, paint};

/// Moulded plastic, laminate or rubber: one colour right through, one roughness, flat or with the fine grain of its mould. Low
/// texture.
pub fn plastic(draw: &mut Draw) -> MaterialMaps {
    let colour = match draw.whole(0, 4) {
        0 => draw.grey([0.03, 0.25]),
        1 => draw.grey([0.95, 0.995]),
        2 => draw.grey([0.1, 0.9]),
        _ => draw.hsv([0.0, 1.0], [0.5, 1.0], [0.15, 0.9]),
    };
    let (rough, f0) = (draw.scale_between(0.03, 0.98), draw.between(0.037, 0.05));
    let height = if draw.chance(0.55) {
        Field::constant(draw.size, 0.0)
    } else {
        let (grain, depth) = (draw.scale_between(5.0, 12.0), draw.scale_between(0.03, 0.4));
        draw.fbm(Fbm::new(grain, 2).gain(0.7)).map(|v| depth * v)
    };
    paint(height, |_| Coat::dielectric(colour, rough, f0))
}
