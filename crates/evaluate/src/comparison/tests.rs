use super::*;
use dataset::material::texture::Texture;

fn run(variant: &str, seed: u64, values: &[f64]) -> Measured {
    let row = |(index, value): (usize, &f64)| Row {
        material: format!("m{index}"),
        texture: Texture::Rich,
        figures: Figures::from([("diffuse_l1".into(), *value)]),
    };
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    Measured {
        variant: variant.into(),
        seed,
        figures: Figures::from([("diffuse_l1".into(), mean), ("dssim".into(), 0.2)]),
        materials: values.iter().enumerate().map(row).collect(),
    }
}

fn question(published: &[(&str, f64)]) -> Question {
    let figures = |value: f64| Figures::from([("diffuse_l1".into(), value)]);
    let published = published.iter().map(|(name, value)| (name.to_string(), figures(*value))).collect();
    Question {
        variants: ["full", "worse", "absent"].map(|name| (name.to_string(), format!("the {name} one"))).into(),
        reference: "full".into(),
        figures: vec!["diffuse_l1".into(), "dssim".into()],
        published: Some(Published { source: "a paper".into(), figures: published }),
    }
}

fn comparison() -> Comparison {
    let mut runs = Vec::new();
    for seed in 1..=3 {
        let noise = seed as f64 * 1e-3;
        runs.push(run("full", seed, &[0.10 + noise, 0.20 + noise, 0.30]));
        runs.push(run("worse", seed, &[0.12 + noise, 0.23, 0.34 + 2.0 * noise]));
    }
    Comparison::new(question(&[("full", 0.1), ("worse", 0.2)]), &runs)
}

#[test]
fn means_are_over_seeds_and_pairs_over_materials_and_seeds() {
    let comparison = comparison();
    let cell = comparison.cells[1][0].as_ref().unwrap();
    assert!((cell.mean.value - (0.69 / 3.0 + 0.002)).abs() < 1e-12);
    let difference = cell.difference.unwrap();
    assert_eq!((difference.pairs, difference.p), (9, Some(2.0 / 512.0)));
    assert!((difference.mean.value - (0.09 / 3.0 + 0.002 / 3.0)).abs() < 1e-12 && difference.is_certain());
    assert!(comparison.cells[0][0].as_ref().unwrap().difference.is_none());
    assert!(comparison.cells[2][0].is_none());
    // Equal everywhere: no test, no difference.
    let equal = comparison.cells[1][1].as_ref().unwrap().difference.unwrap();
    assert_eq!((equal.mean.value, equal.p, equal.pairs), (0.0, None, 0));
}

#[test]
fn verdicts_compare_signs() {
    let comparison = comparison();
    assert_eq!(comparison.verdict(1, 0).map(|(_, verdict)| verdict), Some(Verdict::Confirmed));
    assert_eq!((comparison.verdict(1, 1), comparison.verdict(2, 0)), (None, None));
    let other = Comparison { question: question(&[("full", 0.2), ("worse", 0.1)]), ..comparison };
    assert_eq!(other.verdict(1, 0).map(|(_, verdict)| verdict), Some(Verdict::Contradicted));
}

#[test]
fn a_single_seed_is_never_certain() {
    let runs = [run("full", 1, &[0.1; 8]), run("worse", 1, &[0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9])];
    let comparison = Comparison::new(question(&[("full", 0.1), ("worse", 0.2)]), &runs);
    assert_eq!(comparison.verdict(1, 0).map(|(_, verdict)| verdict), Some(Verdict::SameSign));
    let text = markdown(&comparison);
    assert!(text.contains("| 0.1000 |") && !text.contains("**+"), "{text}");
}

#[test]
fn the_files_say_everything() {
    let comparison = comparison();
    let text = markdown(&comparison);
    for part in [
        "| the full one | 0.2013 ± 0.0017 |",
        "**+0.0307 ± 0.0008** (p = 0.004)",
        "✓",
        "| the absent one | – |",
        "Of 1 published differences 1 are confirmed",
    ] {
        assert!(text.contains(part), "`{part}` is not in:\n{text}");
    }
    let table = csv(&comparison);
    assert_eq!(table.lines().count(), 5, "{table}");
    assert!(table.lines().all(|line| line.matches(',').count() == 10), "{table}");
    let picture = svg(&comparison);
    assert_eq!((picture.matches("<svg").count(), picture.matches("the worse one").count()), (1, 1));
    assert!(!picture.contains("NaN") && !picture.contains("inf"), "{picture}");
}
