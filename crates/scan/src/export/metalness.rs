//! Diffuse and specular albedo as base colour and metalness, the workflow of most real-time renderers.

use ops::planes::Planes;
use render::svbrdf::SvbrdfImage;

/// Specular albedo that the metalness workflow gives every dielectric.
pub const DIELECTRIC: f32 = 0.04;

/// Base colour (3 planes, linear) and metalness (1 plane).
///
/// Per pixel the metalness solves, for the channels' means d and s, `d = base·(1 − m)`, `s = 0.04·(1 − m) + base·m`; the base
/// colour then follows per channel, from the diffuse part for dielectrics and the specular part for metals. Coloured or strong
/// specular albedo over a bright diffuse one can't be expressed: the conversion's error is measured by whoever writes it.
pub fn base_colour_and_metalness(maps: &SvbrdfImage) -> (Planes, Planes) {
    let (height, width) = (maps.height(), maps.width());
    let (mut base, mut metalness) = (Planes::new(3, height, width), Planes::new(1, height, width));
    for i in 0..height * width {
        let mean = |p: &Planes| (0..3).map(|c| p.plane(c)[i]).sum::<f32>() / 3.0;
        let m = solve(mean(&maps.diffuse), mean(&maps.specular));
        metalness.data[i] = m;
        for c in 0..3 {
            let (d, s) = (maps.diffuse.plane(c)[i], maps.specular.plane(c)[i]);
            let from_diffuse = d / (1.0 - m).max(1e-4);
            let from_specular = (s - DIELECTRIC * (1.0 - m)) / m.max(1e-4);
            base.plane_mut(c)[i] = (from_diffuse + (from_specular - from_diffuse) * m * m).clamp(0.0, 1.0);
        }
    }
    (base, metalness)
}

/// The maps that a base colour and a metalness stand for, with the normals and roughness of `maps`.
pub fn diffuse_and_specular(base: &Planes, metalness: &Planes, maps: &SvbrdfImage) -> SvbrdfImage {
    let mut out = maps.clone();
    for c in 0..3 {
        for (i, &m) in metalness.data.iter().enumerate() {
            let b = base.plane(c)[i];
            out.diffuse.plane_mut(c)[i] = b * (1.0 - m);
            out.specular.plane_mut(c)[i] = DIELECTRIC * (1.0 - m) + b * m;
        }
    }
    out
}

/// The root in [0, 1] of `0.04·m² + (d + s − 0.08)·m + 0.04 − s = 0`, which eliminating the base colour leaves.
fn solve(diffuse: f32, specular: f32) -> f32 {
    if specular <= DIELECTRIC {
        return 0.0;
    }
    let (a, b, c) = (DIELECTRIC, diffuse + specular - 2.0 * DIELECTRIC, DIELECTRIC - specular);
    let discriminant = (b * b - 4.0 * a * c).max(0.0);
    ((-b + discriminant.sqrt()) / (2.0 * a)).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use render::texel::Texel;

    use super::*;

    fn maps(diffuse: [f32; 3], specular: [f32; 3]) -> SvbrdfImage {
        SvbrdfImage::constant(2, 2, &Texel { normal: [0.0, 0.0, 1.0], diffuse, roughness: 0.4, specular })
    }

    #[test]
    fn pure_dielectrics_and_metals_survive_the_round_trip() {
        for (d, s) in [([0.5, 0.2, 0.1], [0.04; 3]), ([0.0; 3], [0.9, 0.6, 0.3])] {
            let original = maps(d, s);
            let (base, metalness) = base_colour_and_metalness(&original);
            let back = diffuse_and_specular(&base, &metalness, &original);
            for c in 0..3 {
                assert!((back.diffuse.at(c, 0, 0) - d[c]).abs() < 1e-3, "diffuse {d:?}");
                assert!((back.specular.at(c, 0, 0) - s[c]).abs() < 1e-3, "specular {s:?}");
            }
        }
    }

    #[test]
    fn what_it_makes_of_any_maps_is_in_range() {
        for (d, s) in [([1.0; 3], [1.0; 3]), ([0.0; 3], [0.0; 3]), ([0.3, 0.0, 0.9], [0.5, 0.1, 0.0])] {
            let (base, metalness) = base_colour_and_metalness(&maps(d, s));
            assert!(base.data.iter().chain(&metalness.data).all(|v| (0.0..=1.0).contains(v)));
        }
    }
}
