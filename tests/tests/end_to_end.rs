//! From a clip on disk to a material on disk, through the real programs and with nets that know nothing: the alignment
//! doesn't need them, and every file must be there and hold what it says.

use std::path::Path;

use acceptance::{clip, nets, programs};
use dataset::image_io::{Picture, Samples};
use dataset::material::procedural::Family;
use dataset::sequence::Sequence;
use ops::homography::Homography;
use serde_json::Value;

const RESOLUTION: usize = 128;
const FRAMES: usize = 61;
const KEY_FRAMES: usize = 13;

/// Scans the clip in `folder` and returns the folder of the result.
fn scan(folder: &Path, clip: &str, out: &str, code: i32) -> std::path::PathBuf {
    let (resolution, key_frames) = (RESOLUTION.to_string(), KEY_FRAMES.to_string());
    let arguments = [clip, "--out", out, "--weights", "weights", "--resolution", &resolution, "--key-frames", &key_frames];
    let ended = programs::run("scan", folder, &arguments);
    assert_eq!(ended.code, Some(code), "{}{}", ended.stdout, ended.stderr);
    folder.join(out)
}

fn prepare(folder: &Path) -> Sequence {
    let video = clip::spiral(Family::Pavers).unwrap();
    std::fs::create_dir(folder.join("clip")).unwrap();
    clip::write(&video, FRAMES, RESOLUTION, &folder.join("clip")).unwrap();
    nets::write(&folder.join("weights")).unwrap();
    video
}

fn json(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

#[test]
fn a_folder_of_frames_becomes_a_material() {
    let folder = tempfile::tempdir().unwrap();
    let video = prepare(folder.path());
    let out = scan(folder.path(), "clip", "first", 0);
    check_maps(&out);
    check_alignment(&out, &video);
    // The same clip gives the same material, to the last byte.
    let again = scan(folder.path(), "clip", "again", 0);
    for name in ["Diffuse.exr", "NormalGL.png", "alignment.json"] {
        assert_eq!(std::fs::read(out.join(name)).unwrap(), std::fs::read(again.join(name)).unwrap(), "{name}");
    }
}

/// Every map is there twice, at the clip's size and within its range, and `material.json` lists it.
fn check_maps(out: &Path) {
    let material = json(&out.join("material.json"));
    assert_eq!((&material["width"], &material["height"]), (&RESOLUTION.into(), &RESOLUTION.into()));
    let maps = material["maps"].as_array().unwrap();
    let mut names: Vec<&str> = maps.iter().map(|m| m["name"].as_str().unwrap()).collect();
    names.sort_unstable();
    let expected = ["BaseColor", "Coverage", "Diffuse", "Metalness", "NormalDX", "NormalGL", "Roughness", "Specular"];
    assert_eq!(names, expected);
    for map in maps {
        let [png, exr] = ["png", "exr"].map(|key| Picture::read(&out.join(map[key].as_str().unwrap())).unwrap());
        assert!(matches!(png.samples, Samples::Sixteen(_)), "{map}");
        let Samples::Linear(values) = &exr.samples else { panic!("{map} isn't stored as floats") };
        assert!([&png, &exr].iter().all(|p| (p.width, p.height) == (RESOLUTION, RESOLUTION)), "{map}");
        let low = if map["name"].as_str().unwrap().starts_with("Normal") { -1.0 } else { 0.0 };
        assert!(values.iter().all(|v| (low..=1.0).contains(v)), "{map}");
    }
    let [gl, dx] = ["NormalGL", "NormalDX"].map(|n| Picture::read(&out.join(format!("{n}.exr"))).unwrap().to_planes());
    assert!(gl.plane(1).iter().zip(dx.plane(1)).all(|(g, d)| *g == -*d) && gl.plane(0) == dx.plane(0));
    let sheet = Picture::read(&out.join("contact-sheet.png")).unwrap();
    assert!(sheet.width >= RESOLUTION && sheet.height >= RESOLUTION);
}

/// The homographies are those of the cameras the clip was rendered with.
fn check_alignment(out: &Path, video: &Sequence) {
    let alignment = json(&out.join("alignment.json"));
    let keys = alignment["key_frames"].as_array().unwrap();
    assert_eq!(keys.len(), KEY_FRAMES - 1);
    let mut errors = Vec::new();
    for (k, key) in keys.iter().enumerate() {
        let index = key["index"].as_u64().unwrap() as usize;
        assert_eq!(index, (k + 1) * (FRAMES - 1) / (KEY_FRAMES - 1));
        let picture = out.join(format!("keyframes/frame-{index:05}.png"));
        assert_eq!(picture.is_file(), key["status"] == "aligned", "{key}");
        if key["status"] == "aligned" {
            let rows = |r: usize, c: usize| key["homography"][r][c].as_f64().unwrap();
            let found = Homography::new(nalgebra::Matrix3::from_fn(rows));
            errors.push(mean_distance(&found, &video.homography(0, index, RESOLUTION)));
        } else {
            assert!(key["reason"].as_str().is_some_and(|reason| !reason.is_empty()), "{key}");
        }
    }
    assert!(errors.len() * 2 > keys.len(), "{} of {} key frames", errors.len(), keys.len());
    errors.sort_by(f64::total_cmp);
    let median = errors[errors.len() / 2] * 1024.0 / RESOLUTION as f64;
    assert!(median <= 20.0, "median error {median:.1} px at 1024, of {errors:?}");
}

/// Mean distance, in pixels, between where two homographies send a grid of guidance pixels.
fn mean_distance(found: &Homography, exact: &Homography) -> f64 {
    let grid = (0..64).map(|i| [i % 8, i / 8].map(|n| f64::from(n) / 7.0 * (RESOLUTION - 1) as f64));
    let distance = |[x, y]: [f64; 2]| {
        let (a, b) = (found.apply(x, y).unwrap(), exact.apply(x, y).unwrap());
        (a.0 - b.0).hypot(a.1 - b.1)
    };
    grid.map(distance).sum::<f64>() / 64.0
}

#[test]
fn a_video_becomes_a_material() {
    if !programs::available("ffmpeg") {
        println!("left out: there is no ffmpeg here");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    prepare(folder.path());
    let mut ffmpeg = std::process::Command::new("ffmpeg");
    ffmpeg.args(["-v", "error", "-framerate", "30", "-i", "clip/frame-%04d.png", "-pix_fmt", "yuv420p", "clip.mp4"]);
    let encoded = programs::ended(ffmpeg.current_dir(folder.path()));
    assert_eq!(encoded.code, Some(0), "{}", encoded.stderr);
    check_maps(&scan(folder.path(), "clip.mp4", "out", 0));
}

#[test]
fn force_replaces_an_output_and_a_dry_run_writes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    prepare(folder.path());
    let out = folder.path().join("out");
    let run = |more: &[&str]| {
        let fixed = ["clip", "--out", "out", "--weights", "weights", "--resolution", "64", "--key-frames", "5"];
        programs::run("scan", folder.path(), &[&fixed[..], more].concat())
    };
    let dry = run(&["--dry-run"]);
    assert_eq!(dry.code, Some(0), "{}", dry.stderr);
    assert!(dry.stdout.contains("resolution = 64") && dry.stdout.contains("key_frames = 5") && !out.exists());
    std::fs::create_dir(&out).unwrap();
    std::fs::write(out.join("old.txt"), "").unwrap();
    assert_eq!(run(&[]).code, Some(2));
    assert!(out.join("old.txt").is_file());
    let forced = run(&["--force"]);
    assert!(matches!(forced.code, Some(0 | 4)), "{}", forced.stderr);
    assert!(out.join("material.json").is_file() && !out.join("old.txt").exists());
}
