use std::path::Path;

use burn::tensor::Device;
use dataset::image_io::Overwrite;
use dataset::material::library::{ProceduralConfig, SourceConfig};
use dataset::material::texture::Texture;
use flow::pwc::PwcConfig;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::conditions::{CONDITIONS, chosen};
use super::store::Common;
use super::summary::rows;
use super::*;

fn library() -> MaterialLibrary {
    let source = SourceConfig::Procedural(ProceduralConfig { size: 128, count: 40, ..ProceduralConfig::default() });
    MaterialLibrary::open(&[source], 3, 64 << 20).unwrap()
}

fn nets() -> FlowNets {
    let config = PwcConfig { channels: vec![4, 4, 4], estimator: vec![4], ..PwcConfig::slim() };
    let net = |seed| config.init(&Device::flex(), &mut ChaCha8Rng::seed_from_u64(seed));
    FlowNets { adjacent: net(1), distant: net(2) }
}

fn config() -> AlignmentConfig {
    let mut config = AlignmentConfig { sequences: 2, resolution: 64, ..AlignmentConfig::default() };
    config.videos.path.frames = 12;
    (config.align.size, config.align.refine_size) = (64, 64);
    config
}

fn store(folder: &Path, config: &AlignmentConfig, overwrite: Overwrite) -> Result<Store, EvaluateError> {
    Store::open(folder, &Common::new(config, "procedural", vec!["net".into()]), overwrite)
}

/// A case without its times.
fn timeless(case: &Case) -> Case {
    Case { seconds: Default::default(), ..case.clone() }
}

#[test]
fn every_condition_changes_something_that_can_be_set_and_validated() {
    let base = AlignmentConfig::default();
    for condition in CONDITIONS {
        let changed = condition.settings(&base).unwrap_or_else(|e| panic!("{}: {e}", condition.name));
        changed.validate().unwrap_or_else(|e| panic!("{}: {e}", condition.name));
        assert_eq!(changed == base, condition.name == "base", "{}", condition.name);
        assert_eq!(CONDITIONS.iter().filter(|c| c.name == condition.name || c.title == condition.title).count(), 1);
    }
    let names = |list: &str| chosen(list).unwrap().iter().map(|c| c.name).collect::<Vec<_>>();
    assert_eq!(names("roll, base"), ["base", "roll"]);
    assert_eq!(names("all").len(), CONDITIONS.len());
    assert!(names("ablation").contains(&"no-loops") && !names("ablation").contains(&"zigzag"));
    assert!(chosen("base,rol").unwrap_err().to_string().contains("`rol`"));
}

#[test]
fn a_stopped_evaluation_goes_on_and_ends_with_the_same_cases() {
    let (library, nets, config) = (library(), nets(), config());
    let conditions = chosen("base,no-adjust").unwrap();
    let measured = |folder: &Path, stop_after: usize| {
        let store = store(folder, &config, Overwrite::Refuse).unwrap();
        let mut heard = 0;
        let result = run(&library, &nets, (&config, &conditions), &store, |_| {
            heard += 1;
            heard < stop_after
        });
        (result, heard)
    };
    let (whole, parts) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let cases = measured(whole.path(), usize::MAX).0.unwrap();
    assert_eq!(cases.len(), 4);
    assert!(matches!(measured(parts.path(), 3), (Err(EvaluateError::Stopped), 3)));
    // A mark shows that what is there isn't measured again.
    let marked = parts.path().join("cases/base/0000.json");
    let text = std::fs::read_to_string(&marked).unwrap().replace(&cases[0].material, "marked");
    std::fs::write(&marked, text).unwrap();
    let again = measured(parts.path(), usize::MAX).0.unwrap();
    assert_eq!(again[0].material, "marked");
    for (a, b) in cases.iter().zip(&again).skip(1) {
        assert_eq!(timeless(a), timeless(b), "the same figures whatever was stopped");
    }
    std::fs::write(&marked, "{").unwrap();
    let error = measured(parts.path(), usize::MAX).0.unwrap_err().to_string();
    assert!(error.contains("0000.json") && error.contains("remove it"), "{error}");
}

#[test]
fn a_folder_of_other_settings_is_refused_unless_forced() {
    let (folder, config) = (tempfile::tempdir().unwrap(), config());
    store(folder.path(), &config, Overwrite::Refuse).unwrap();
    let more = AlignmentConfig { sequences: 9, ..config.clone() };
    store(folder.path(), &more, Overwrite::Refuse).expect("more scans may be added");
    let single = AlignmentConfig { scans: vec![41, 3], ..config.clone() };
    store(folder.path(), &single, Overwrite::Refuse).expect("and single ones");
    assert_eq!((more.numbers().len(), single.numbers()), (9, vec![41, 3]));
    let path = folder.path().join("settings.json");
    let own = std::fs::read_to_string(&path).unwrap();
    let mut common: serde_json::Value = serde_json::from_str(&own).unwrap();
    common.as_object_mut().unwrap().remove("aligner").expect("the aligner's version is among what cases have in common");
    std::fs::write(&path, common.to_string()).unwrap();
    let error = store(folder.path(), &config, Overwrite::Refuse).unwrap_err().to_string();
    assert!(error.contains("aligner") && error.contains("--force"), "an earlier program's: {error}");
    std::fs::write(&path, own).unwrap();
    let case = folder.path().join("cases/base/0000.json");
    std::fs::create_dir_all(case.parent().unwrap()).unwrap();
    std::fs::write(&case, "").unwrap();
    let other = AlignmentConfig { seed: 1, ..config.clone() };
    let error = store(folder.path(), &other, Overwrite::Refuse).unwrap_err().to_string();
    assert!(error.contains("--force") && case.exists(), "{error}");
    store(folder.path(), &other, Overwrite::Allow).unwrap();
    assert!(!case.exists());
    assert!(store(folder.path(), &config, Overwrite::Refuse).is_err());
}

#[test]
fn frames_for_others_come_with_exact_homographies_and_only_where_there_are_any() {
    let (folder, library) = (tempfile::tempdir().unwrap(), library());
    let config = AlignmentConfig { sequences: 1, ..config() };
    export::frames(&library, &config, &chosen("base").unwrap(), folder.path()).unwrap();
    let scan = folder.path().join("frames/base/0000");
    let frame = dataset::image_io::Picture::read(&scan.join("frame-0010.png")).unwrap();
    let sequence = config.sequence(&library, 0).unwrap();
    assert_eq!((frame.height, frame.width), (64, 64));
    let truth: serde_json::Value = serde_json::from_slice(&std::fs::read(scan.join("truth.json")).unwrap()).unwrap();
    let last = &truth["key_frames"][1];
    assert_eq!(last["frame"], 10);
    let exact = sequence.homography(0, 10, 64).matrix;
    let found: Vec<f64> = last["homography"].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
    assert!((found[2] - exact[(0, 2)]).abs() < 1e-9 && (found[3] - exact[(1, 0)]).abs() < 1e-9, "row by row");
    let error = export::frames(&library, &config, &chosen("distortion").unwrap(), folder.path()).unwrap_err();
    assert!(error.to_string().contains("distortion"), "{error}");
}

fn case(condition: &str, sequence: usize, texture: Texture, figures: &[(&str, f64)]) -> Case {
    let key = |frame: usize, expected: f64, error: f64| case::KeyFrameRecord {
        frame,
        dropped: None,
        expected_px: Some(expected),
        zncc: 0.5,
        error_px: Some(error),
    };
    Case {
        condition: condition.into(),
        settings: vec![],
        sequence,
        material: format!("material {sequence}"),
        texture,
        figures: figures.iter().map(|(name, value)| (name.to_string(), *value)).collect(),
        key_frames: vec![key(5, 1.0, 2.0), key(10, 2.0, 7.0), key(15, 3.0, 4.0)],
        seconds: flow::align::Seconds { reading: 100.0, flows: 1.0, steps: 2.0, placing: 3.0 },
    }
}

#[test]
fn rows_hold_means_intervals_and_paired_tests_by_class() {
    let mut cases = Vec::new();
    for i in 0..6 {
        let error = 1.0 + i as f64;
        cases.push(case("base", i, Texture::Rich, &[("penalised_error", error), ("pixel_error", error)]));
        cases.push(case("zigzag", i, Texture::Rich, &[("penalised_error", error + 0.5)]));
    }
    cases.push(case("base", 6, Texture::Absent, &[("penalised_error", 20.0), ("refused", 1.0)]));
    let rows = rows(&cases);
    let names: Vec<(&str, &str, usize)> = rows.iter().map(|r| (r.condition, r.class, r.sequences)).collect();
    let expected = [
        ("base", "textured or low", 6),
        ("base", "textured", 6),
        ("base", "featureless", 1),
        ("zigzag", "textured or low", 6),
        ("zigzag", "textured", 6),
    ];
    assert_eq!(names, expected);
    let figures = &rows[1].figures;
    assert!((figures["pixel_error"] - 3.5).abs() < 1e-12 && figures["seconds"] == 6.0);
    // Student's t of 5 degrees of freedom: 2.5706·√(3.5/6).
    assert!((figures["pixel_error_interval"] - 2.5706 * (3.5f64 / 6.0).sqrt()).abs() < 1e-3);
    assert!((figures["spearman_expected"] - 0.5).abs() < 0.1);
    assert!(!figures.contains_key("penalised_error_p"), "the base isn't compared with itself");
    assert_eq!(rows[4].figures["penalised_error_p"], 2.0 / 64.0, "six differences of one sign");
    let text = table::markdown(&rows);
    assert!(text.contains("| as it is | 6 | – | 3.50 ± 1.96 |") && text.contains("**featureless**"), "{text}");
    let csv = table::csv(&rows);
    assert_eq!(csv.lines().count(), 6);
    assert!(csv.lines().all(|l| l.matches(',').count() == csv.lines().next().unwrap().matches(',').count()));
}

fn has_libx264() -> bool {
    let listed = std::process::Command::new("ffmpeg").args(["-hide_banner", "-encoders"]).output();
    listed.is_ok_and(|l| String::from_utf8_lossy(&l.stdout).contains(" libx264 "))
}

#[test]
fn a_scan_comes_back_from_the_encoder_frame_by_frame() {
    let sequence = config().sequence(&library(), 0).unwrap();
    let plenty = Encoding { codec: "libx264".into(), bits_per_pixel: 8.0 };
    if !has_libx264() {
        let message = plenty.probe().unwrap_err().to_string();
        assert!(message.contains("ffmpeg") && message.contains("--conditions"), "{message}");
        eprintln!("no ffmpeg with libx264 here: nothing else of encoded scans was tested");
        return;
    }
    plenty.probe().unwrap();
    let film = film::Film::shoot(&sequence, 64, &plenty).unwrap();
    assert_eq!(flow::align::Footage::count(&film), sequence.len());
    let error = |a: &ops::planes::Planes, b: &ops::planes::Planes| {
        a.data.iter().zip(&b.data).map(|(a, b)| (a - b).abs()).sum::<f32>() / a.data.len() as f32
    };
    let frame = |index: usize| flow::align::Footage::frame(&film, index).into_owned();
    for index in [0, 5, sequence.len() - 1] {
        let (own, other) = (sequence.frame(index, 64), sequence.frame((index + 6) % sequence.len(), 64));
        assert!(error(&frame(index), &own) < 0.5 * error(&frame(index), &other), "frame {index}");
    }
    let config = AlignmentConfig { sequences: 1, encoding: plenty, ..config() };
    let folder = tempfile::tempdir().unwrap();
    export::frames(&library(), &config, &chosen("base").unwrap(), folder.path()).unwrap();
    let picture = dataset::image_io::Picture::read(&folder.path().join("frames/base/0000/frame-0005.png")).unwrap();
    assert!(error(&picture.to_planes(), &frame(5)) < 1e-6, "other programs get the frames that the aligner gets");
}

#[test]
fn an_encoder_that_is_missing_is_said_before_anything_is_measured() {
    let folder = tempfile::tempdir().unwrap();
    let config = config();
    let missing = Condition { settings: &["encoding.codec=no-such-codec"], ..chosen("h264").unwrap()[0] };
    let conditions = [chosen("base").unwrap()[0], missing];
    let store = store(folder.path(), &config, Overwrite::Refuse).unwrap();
    let mut measured = 0;
    let result = run(&library(), &nets(), (&config, &conditions), &store, |_| {
        measured += 1;
        true
    });
    assert!(matches!(result, Err(EvaluateError::NoEncoder { .. })) && measured == 0, "{result:?}");
}

#[test]
fn what_cannot_be_encoded_is_named() {
    let encoding = |codec: &str, bits_per_pixel| Encoding { codec: codec.into(), bits_per_pixel };
    let refused = |resolution, encoding| {
        let config = AlignmentConfig { resolution, encoding, ..AlignmentConfig::default() };
        config.validate().unwrap_err().to_string()
    };
    assert!(refused(64, encoding("libx264", 0.0)).contains("encoding.bits_per_pixel = 0: "));
    assert!(refused(64, encoding(" ", 1.0)).contains("encoding.codec = \" \": "));
    assert!(refused(65, encoding("libx264", 1.0)).contains("resolution = 65: an even number"));
    AlignmentConfig { resolution: 65, ..AlignmentConfig::default() }.validate().unwrap();
}

#[cfg(unix)]
#[test]
fn a_talkative_encoder_ends_and_says_why() {
    let shell = |script: &str| {
        let mut command = std::process::Command::new("sh");
        command.args(["-c", script]);
        film::run(command, Path::new("the-folder"), |pipe| pipe.write_all(&[0; 1 << 20]))
    };
    // More than a pipe holds, on both sides.
    shell("head -c 300000 /dev/zero >&2; cat > /dev/null").unwrap();
    let full = shell("cat > /dev/null; echo No space left on device >&2; exit 1").unwrap_err().to_string();
    assert!(full.contains("the-folder: No space left") && !full.contains("apt"), "{full}");
    let absent = film::run(std::process::Command::new("no-such-program"), Path::new("the-folder"), |_| Ok(())).unwrap_err();
    assert!(absent.to_string().contains("apt install ffmpeg"), "{absent}");
}
