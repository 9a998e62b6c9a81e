//! Laws that a reflectance model obeys, and hand values of its terms.

use std::f64::consts::PI;

use render::brdf::{BrdfModel, DiffuseModel, SpecularModel, fresnel, masking, ndf};
use render::direction::unit;
use render::pixel::{lobe, shade};
use render::texel::Texel;

const UP: [f32; 3] = [0.0, 0.0, 1.0];

fn models() -> [BrdfModel; 4] {
    let model = |specular, diffuse| BrdfModel { specular, diffuse };
    [
        model(SpecularModel::Ggx, DiffuseModel::Lambert),
        model(SpecularModel::Ggx, DiffuseModel::Inria),
        model(SpecularModel::GgxClamped, DiffuseModel::Lambert),
        model(SpecularModel::GgxClamped, DiffuseModel::Inria),
    ]
}

fn at(polar: f64, azimuth: f64) -> [f32; 3] {
    [(polar.sin() * azimuth.cos()) as f32, (polar.sin() * azimuth.sin()) as f32, polar.cos() as f32]
}

fn texel(roughness: f32) -> Texel {
    Texel { normal: UP, diffuse: [0.5, 0.3, 0.1], roughness, specular: [0.04, 0.5, 0.9] }
}

#[test]
fn swapping_light_and_viewer_changes_nothing() {
    for model in models() {
        for i in 0..200 {
            let f = f64::from(i);
            let (a, b) = (at(1.5 * (f * 0.377).fract(), f), at(1.5 * (f * 0.613).fract(), 2.3 * f));
            let t = Texel { normal: unit([0.1, -0.15, 1.0]), ..texel(0.05 + 0.95 * (f * 0.271).fract() as f32) };
            let cosine = |w: [f32; 3]| render::direction::dot(t.normal, w);
            if cosine(a) < 0.02 || cosine(b) < 0.02 {
                continue;
            }
            let (there, back) = (shade(&t, a, b, model), shade(&t, b, a, model));
            for c in 0..3 {
                let (x, y) = (there[c] / cosine(a), back[c] / cosine(b));
                assert!((x - y).abs() <= 2e-4 * x.abs().max(1e-3), "{model:?} {a:?} {b:?}: {x} {y}");
            }
        }
    }
}

#[test]
fn nothing_is_negative_or_infinite() {
    for model in models() {
        for r in [0.0, 0.01, 0.05, 0.5, 1.0] {
            for tilt in [0.0, 0.8, 1.5, 0.49999 * PI, 0.50001 * PI, 2.2] {
                for azimuth in [0.0, 1.0, PI] {
                    let value = shade(&texel(r), at(tilt, 0.0), at(tilt, azimuth), model);
                    assert!(value.iter().all(|v| v.is_finite() && *v >= 0.0), "{model:?} r {r} tilt {tilt}: {value:?}");
                }
            }
        }
    }
    assert_eq!(shade(&texel(0.3), at(1.6, 0.0), UP, BrdfModel::default()), [0.0; 3], "light from below");
}

/// ∫ D(h) n·h dh over the hemisphere; the substitution tan² = alpha²·u/(1−u) puts the samples where the lobe is.
#[test]
fn the_normal_distribution_covers_the_surface_once() {
    for r in [0.05f32, 0.1, 0.3, 0.6, 1.0] {
        let alpha2 = r.powi(4);
        let steps = 20_000;
        let mut sum = 0.0;
        for i in 0..steps {
            let u = (f64::from(i) + 0.5) / f64::from(steps);
            let tan2 = f64::from(alpha2) * u / (1.0 - u);
            let cosine2 = 1.0 / (1.0 + tan2);
            let d = f64::from(ndf::ggx(alpha2, cosine2.sqrt() as f32, (1.0 - cosine2) as f32));
            // dω cosθ = π d(sin²θ); sin² = tan²/(1 + tan²).
            let dsin2_du = f64::from(alpha2) / ((1.0 - u) * (1.0 - u)) * cosine2 * cosine2;
            sum += PI * d * dsin2_du / f64::from(steps);
        }
        assert!((sum - 1.0).abs() < 2e-3, "r = {r}: {sum}");
    }
}

/// A white furnace: a lossless surface under uniform light reflects at most what arrives; rough GGX loses the light that
/// bounces more than once.
#[test]
fn a_mirror_of_microfacets_reflects_at_most_everything() {
    let white = |r| Texel { normal: UP, diffuse: [0.0; 3], roughness: r, specular: [1.0; 3] };
    for r in [0.2f32, 0.4, 0.7, 1.0] {
        for tilt in [0.0, 0.6, 1.2] {
            let wo = at(tilt, 0.0);
            let (rings, spokes) = (400, 256);
            let mut albedo = 0.0;
            for i in 0..rings {
                for j in 0..spokes {
                    let polar = (f64::from(i) + 0.5) / f64::from(rings) * PI / 2.0;
                    let wi = at(polar, (f64::from(j) + 0.5) / f64::from(spokes) * 2.0 * PI);
                    let solid = polar.sin() * (PI / 2.0 / f64::from(rings)) * (2.0 * PI / f64::from(spokes));
                    albedo += f64::from(shade(&white(r), wi, wo, BrdfModel::default())[0]) * solid;
                }
            }
            assert!(albedo <= 1.002 && albedo > 0.3, "r {r}, tilt {tilt}: {albedo}");
            if r <= 0.4 && tilt <= 0.6 {
                assert!(albedo > 0.95, "a smooth mirror loses little: r {r}, tilt {tilt}: {albedo}");
            }
        }
    }
}

#[test]
fn terms_have_their_hand_values() {
    // r = 0.1: alpha = 0.01; exact peak 1/(π alpha²) = 3183, the authors' clamp gives (0.01/0.001)²/π = 31.8.
    assert!((ndf::ggx(1e-4, 1.0, 0.0) - 3183.1).abs() < 0.1);
    assert!((ndf::ggx_clamped(0.01, 1.0) - 31.830_99).abs() < 1e-4);
    // Above r = 0.178 the clamp doesn't touch the peak.
    let alpha = 0.2f32 * 0.2;
    assert!((ndf::ggx_clamped(alpha, 1.0) / ndf::ggx(alpha * alpha, 1.0, 0.0) - 1.0).abs() < 1e-3);
    assert_eq!(fresnel::schlick_weight(1.0), 0.0);
    assert_eq!(fresnel::schlick_weight(0.0), 1.0);
    assert!((fresnel::schlick_weight(0.5) - 1.0 / 32.0).abs() < 1e-7);
    assert!((fresnel::gaussian_weight(0.5) - 2f32.powf((-5.55473 * 0.5 - 6.98316) * 0.5)).abs() < 1e-7);
    assert_eq!(fresnel::reflectance(0.04, 0.0), 0.04);
    // G1 = 2c·factor: 1 at normal incidence, 2c/(c + √(alpha² + (1 − alpha²)c²)) at 60°.
    assert!((2.0 * masking::smith_factor(0.25, 1.0) - 1.0).abs() < 1e-7);
    assert!((masking::smith_factor(0.25, 0.5) - 1.0 / (0.5 + 0.4375f32.sqrt())).abs() < 1e-6);
    assert!((masking::clamped_factor(0.5, 0.5) - 1.0 / (0.5 * 0.75 + 0.25)).abs() < 1e-6);
    assert!((masking::clamped_factor(0.0, 0.0) - 1000.0).abs() < 1e-2);
    // Head-on: ρd/π + ρs·D/4.
    let value = shade(&texel(0.5), UP, UP, BrdfModel::default());
    let d = 1.0 / (std::f32::consts::PI * 0.0625);
    assert!((value[1] - (0.3 / std::f32::consts::PI + 0.5 * d / 4.0)).abs() < 1e-5);
    let inria = BrdfModel { diffuse: DiffuseModel::Inria, ..BrdfModel::default() };
    assert!((value[1] - shade(&texel(0.5), UP, UP, inria)[1] - 0.15 / std::f32::consts::PI).abs() < 1e-5);
    assert_eq!(lobe(&texel(0.5), UP, at(2.0, 0.0), at(1.0, 0.0), SpecularModel::Ggx), 0.0, "no lobe for a viewer below");
}

/// Mitsuba 3 computes the same lobes, in 20 parameter sets at 200 pairs of directions each; goldens/mitsuba_values.py made
/// the file.
#[test]
fn values_agree_with_an_independent_renderer() {
    let numbers = |row: &str| row.split(',').map(|field| field.parse::<f64>().expect("a number")).collect::<Vec<_>>();
    let mut compared = [0; 20];
    let mut texel = Texel::matte([0.0; 3]);
    for row in include_str!("goldens/mitsuba.csv").lines() {
        if let Some(set) = row.strip_prefix('#') {
            let v: Vec<f32> = numbers(set).iter().map(|&v| v as f32).collect();
            // With a specular albedo of 1 the Fresnel term is 1 from everywhere, as in the script.
            texel = Texel { normal: UP, roughness: v[1], diffuse: [v[2], v[3], v[4]], specular: [1.0; 3] };
            continue;
        }
        let v = numbers(row);
        let (wo, wi) = (at(v[1] * 1e-3, v[2] * 1e-3), at(v[3] * 1e-3, v[4] * 1e-3));
        let ours = shade(&texel, wi, wo, BrdfModel::default());
        for (ours, theirs) in ours.into_iter().zip(&v[5..]) {
            assert!((f64::from(ours) - theirs).abs() <= 1e-4 * theirs, "{row}: {ours}");
        }
        compared[v[0] as usize] += 1;
    }
    assert_eq!(compared, [200; 20]);
}
