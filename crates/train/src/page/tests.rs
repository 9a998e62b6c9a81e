use super::*;
use crate::recorder::{Kind, Metrics, Previews, Recorder, Row};
use serde_json::json;
use std::collections::BTreeMap;

#[test]
fn moments_are_dates() {
    assert_eq!(utc(0), "1970-01-01 00:00 UTC");
    assert_eq!(utc(951_782_400), "2000-02-29 00:00 UTC");
    assert_eq!(utc(1_795_490_138), "2026-11-24 03:15 UTC");
}

#[test]
fn a_page_shows_every_term_the_first_and_last_pictures_and_the_config() {
    let home = tempfile::tempdir().unwrap();
    let mut metrics = Metrics::open(&home.path().join("metrics.jsonl")).unwrap();
    std::fs::create_dir(home.path().join("previews")).unwrap();
    let mut previews = Previews { folder: home.path().join("previews") };
    for step in 1..=5 {
        let values = ["loss", "matching", "gradient_norm"].map(|name| (name.to_string(), 1.0 / step as f64));
        metrics.row(&Row { stage: "adjacent", step, kind: Kind::Train, values: &values }).unwrap();
        previews.picture("adjacent", step, "pair0", &image::RgbImage::from_pixel(8, 4, image::Rgb([step as u8; 3]))).unwrap();
    }
    let measured = [("epe_ratio".to_string(), 0.5)];
    metrics.row(&Row { stage: "adjacent", step: 5, kind: Kind::Validate, values: &measured }).unwrap();
    metrics.flush().unwrap();
    let mut config = Config::default();
    config.run.name = "my <run>".into();
    let stage = FinishedStage {
        stage: "adjacent".into(),
        steps: 5,
        seconds: 90.0,
        data_wait_share: 0.25,
        measured: BTreeMap::new(),
        skipped: vec![],
    };
    let finished = Finished { stages: vec![stage], ..Finished::default() };
    let Value::Object(report) =
        json!({ "minutes": 2.0, "adjacent_epe_ratio": 0.4, "maps_l1_ratio_textured": 0.9, "materials": 1.0 })
    else {
        unreachable!()
    };
    let page = html(home.path(), &config, &finished, &report).unwrap();
    for part in [
        "<h1>my &lt;run&gt;</h1>",
        ">matching</text>",
        "<dt>epe_ratio</dt><dd>0.5000</dd>",
        "adjacent, pair0, step 1:",
        "adjacent, pair0, step 5:",
        "25.0 %",
        "1 min 30 s",
        "seed = 1",
        "≤ 0.45",
        "class=\"number met\">0.400",
        "<code>materials</code></td><td class=\"number\">1</td>",
        // Eight pixels, three times as large.
        "width=\"24\" height=\"12\"",
    ] {
        assert!(page.contains(part), "`{part}` is not in the page");
    }
    assert!(!page.contains("step 3:"));
    assert!(page.contains("<th class=\"number\">textured</th>") && !page.contains(">featureless</th>"));
    let outside = page.replace("http://www.w3.org/2000/svg", "");
    assert!(!outside.contains("http"), "the page leads out");
}

#[test]
fn a_folder_without_files_is_a_page_too() {
    let home = tempfile::tempdir().unwrap();
    let page = html(home.path(), &Config::default(), &Finished::default(), &Map::new()).unwrap();
    assert!(page.contains("unknown") && !page.contains("<img"));
}
