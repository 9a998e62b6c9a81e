use dataset::material::library::{ProceduralConfig, SourceConfig};
use dataset::material::texture::Texture;

use super::*;

#[test]
fn frames_are_found_in_photos_of_their_own_surface_only() {
    let source = SourceConfig::Procedural(ProceduralConfig { size: 256, count: 40, ..ProceduralConfig::default() });
    let library = MaterialLibrary::open(&[source], 3, 64 << 20).unwrap();
    let config =
        LocalisationConfig { cases: 3, resolution: 128, cover: 2.5, scales: vec![2.0], ..LocalisationConfig::default() };
    let cases = run(&library, &config, |_| ()).unwrap();
    assert_eq!(cases.len(), 6, "one photo of something else per scan");
    assert!(cases.iter().filter(|c| c.foreign).all(|c| c.error_px.is_none()), "{cases:?}");
    assert!(cases.iter().any(|c| !c.foreign && c.outcome == Outcome::Found), "{cases:?}");
    let again = run(&library, &LocalisationConfig { cases: 1, first: 2, ..config }, |_| ()).unwrap();
    assert_eq!((again[0].error_px, &again[0].answer), (cases[4].error_px, &cases[4].answer), "a case doesn't depend on others");
}

#[test]
fn shares_are_counted_by_scale_and_light() {
    let case = |scale: f64, outcome, foreign, error_px| Case {
        scan: 0,
        material: "m".into(),
        texture: Texture::Rich,
        foreign,
        scale,
        light: Light::Flash,
        outcome,
        error_px,
        answer: String::new(),
        seconds: 2.0,
    };
    let cases = [
        case(1.0, Outcome::Found, false, Some(1.0)),
        case(1.0, Outcome::Refused, false, None),
        case(2.0, Outcome::Repeats, false, None),
        case(5.0, Outcome::Found, false, Some(3.0)),
        case(5.0, Outcome::Wrong, false, Some(90.0)),
        case(1.0, Outcome::Refused, true, None),
    ];
    let text = markdown(&cases);
    assert!(text.contains("| all, textured or low texture | 5 | 0.400 | 0.200 | 0.200 | 0.200 | 2.00 | 2.0 |"), "{text}");
    assert!(text.contains("| … scale 5 | 2 | 0.500 | 0.000 | 0.000 | 0.500 | 3.00 | 2.0 |"), "{text}");
    assert!(text.contains("| of another material | 1 | 0.000 | 1.000 | 0.000 | 0.000 | – | 2.0 |"), "{text}");
}

#[test]
fn impossible_values_are_named() {
    let endless = LocaliseConfig { scale: [0.0, 12.5], ..LocaliseConfig::default() };
    for (config, name) in [
        (LocalisationConfig { cases: 0, ..LocalisationConfig::default() }, "cases"),
        (LocalisationConfig { scales: vec![], ..LocalisationConfig::default() }, "scales"),
        (LocalisationConfig { cover: 0.5, ..LocalisationConfig::default() }, "cover"),
        (LocalisationConfig { tilt_deg: 80.0, ..LocalisationConfig::default() }, "tilt_deg"),
        (LocalisationConfig { localise: endless, ..LocalisationConfig::default() }, "localise.scale = [0, 12.5]: "),
    ] {
        assert!(config.validate().unwrap_err().to_string().contains(name));
    }
}
