//! A run that is stopped, killed or damaged ends, after a resume, in the very numbers of a run that was left alone.

use super::{Ended, Home, metrics};
use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::OnceLock;

/// The run that was left alone, made once.
pub fn undisturbed() -> &'static (Home, Vec<String>) {
    static RUN: OnceLock<(Home, Vec<String>)> = OnceLock::new();
    RUN.get_or_init(|| {
        let home = Home::new();
        let ended = home.run(&["--config", "tiny.toml", "--out", "run"]);
        assert_eq!(ended.code, Some(0), "{}", ended.stderr);
        let numbers = metrics(&home.path("run"));
        (home, numbers)
    })
}

/// Starts a run and sends a signal as soon as it has reported a step of the stage.
fn signalled(home: &Home, arguments: &[&str], stage: &str, signal: &str) -> Ended {
    let mut child = home.command(arguments).stderr(Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(child.stderr.take().unwrap());
    let (mut line, mut stderr) = (String::new(), String::new());
    while !line.starts_with(stage) {
        line.clear();
        assert!(lines.read_line(&mut line).unwrap() > 0, "the run ended before {stage}: {stderr}");
        stderr.push_str(&line);
    }
    let sent = Command::new("sh").args(["-c", &format!("kill -{signal} {}", child.id())]).status().unwrap();
    assert!(sent.success());
    lines.read_to_string(&mut stderr).unwrap();
    Ended { code: child.wait().unwrap().code(), stdout: String::new(), stderr }
}

pub fn checkpoints(run: &Path) -> Vec<std::path::PathBuf> {
    let mut files: Vec<_> = std::fs::read_dir(run.join("checkpoints")).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.sort();
    files
}

#[test]
fn a_run_leaves_everything_a_person_or_a_program_reads() {
    let (home, numbers) = undisturbed();
    let run = home.path("run");
    for name in [
        "config.toml",
        "run.json",
        "materials.json",
        "report.json",
        "report.html",
        "status.json",
        "weights/manifest.json",
        "weights/adjacent.safetensors",
        "weights/svbrdf.safetensors",
        "previews/adjacent-000001-pair0.png",
        "previews/svbrdf-000001-maps0.png",
        "previews/svbrdf-000001-frames0.png",
    ] {
        assert!(run.join(name).is_file(), "{name}");
    }
    assert_eq!(std::fs::read_dir(run.join("tb")).unwrap().count(), 1);
    let read = |name: &str| -> serde_json::Value { serde_json::from_slice(&std::fs::read(run.join(name)).unwrap()).unwrap() };
    let report = read("report.json");
    for name in
        ["minutes", "peak_rss_mib", "adjacent_epe_ratio", "adjacent_homography_ratio", "maps_l1_ratio", "render_l1_ratio"]
    {
        assert!(report[name].as_f64().is_some_and(|value| value > 0.0), "{name}: {report}");
    }
    assert_eq!((&read("run.json")["seed"], &read("run.json")["device"]), (&3.into(), &"cpu".into()));
    let train_rows = numbers.iter().filter(|line| line.contains("\"kind\":\"train\"")).count();
    assert_eq!(train_rows, 48);
}

#[test]
fn the_resolved_config_of_a_run_repeats_it() {
    let home = Home::new();
    let written = undisturbed().0.path("run/config.toml");
    let ended = home.run(&["--config", written.to_str().unwrap(), "--out", "again"]);
    assert_eq!(ended.code, Some(0), "{}", ended.stderr);
    assert_eq!(metrics(&home.path("again")), undisturbed().1);
    let config = |path: &Path| std::fs::read_to_string(path).unwrap();
    assert_eq!(config(&home.path("again/config.toml")), config(&written));
}

#[test]
fn a_run_is_watched_from_outside() {
    let run = undisturbed().0.path("run");
    let watch = |more: &[&str]| undisturbed().0.run(&[&["watch", run.to_str().unwrap()], more].concat());
    let shown = watch(&[]);
    assert_eq!(shown.code, Some(0), "{}", shown.stderr);
    for part in ["finished", "svbrdf 24/24 (100 %)", "exemplars/s", "data ", "rendering ", "maps_l1_ratio (held-out)"] {
        assert!(shown.stdout.contains(part), "`{part}` is not in: {}", shown.stdout);
    }
    assert!(!shown.stdout.contains('\u{1b}'), "escapes outside a terminal");
    assert!(watch(&["--stage", "adjacent", "--once"]).stdout.contains("matching "));
    let wrong = watch(&["--stage", "distant"]);
    assert_eq!(wrong.code, Some(2));
    assert!(wrong.stderr.contains("no stage `distant`") && wrong.stderr.contains("adjacent, svbrdf"), "{}", wrong.stderr);
}

#[test]
fn another_number_of_workers_changes_no_bit() {
    let home = Home::new();
    let ended = home.run(&["--config", "tiny.toml", "--out", "run", "--set", "run.data_workers=4"]);
    assert_eq!(ended.code, Some(0), "{}", ended.stderr);
    assert_eq!(metrics(&home.path("run")), undisturbed().1);
}

#[test]
fn ctrl_c_leaves_a_checkpoint_and_the_resumed_run_equals_the_undisturbed_one() {
    let home = Home::new();
    let run = home.path("run");
    let first = signalled(&home, &["--config", "tiny.toml", "--out", "run"], "adjacent", "INT");
    assert_eq!(first.code, Some(130), "{}", first.stderr);
    assert!(first.stderr.contains("continue with `--resume run`"), "{}", first.stderr);
    assert!(!checkpoints(&run).is_empty());
    // A second stop, by SIGTERM and in the second stage, under another number of workers.
    let arguments = ["--resume", "run", "--set", "run.data_workers=3"];
    let second = signalled(&home, &arguments, "svbrdf", "TERM");
    assert_eq!(second.code, Some(130), "{}", second.stderr);
    let last = home.run(&["--resume", "run"]);
    assert_eq!(last.code, Some(0), "{}", last.stderr);
    assert_eq!(metrics(&run), undisturbed().1);
    let weights = |home: &Home| std::fs::read(home.path("run/weights/svbrdf.safetensors")).unwrap();
    assert!(weights(&home) == weights(&undisturbed().0), "the weights differ");
}

#[test]
fn kill_9_costs_steps_but_no_file() {
    let home = Home::new();
    let killed = signalled(&home, &["--config", "tiny.toml", "--out", "run"], "svbrdf", "KILL");
    assert_eq!(killed.code, None, "{}", killed.stderr);
    let last = home.run(&["--resume", "run"]);
    assert_eq!(last.code, Some(0), "{}", last.stderr);
    assert_eq!(metrics(&home.path("run")), undisturbed().1);
}

#[test]
fn a_damaged_checkpoint_is_refused_and_the_offered_one_continues() {
    let home = Home::new();
    let stopped = home.path("run");
    copy(&undisturbed().0.path("run"), &stopped);
    // As if the run had died right after the last checkpoint of its last stage.
    let progress: serde_json::Value = serde_json::from_slice(&std::fs::read(stopped.join("progress.json")).unwrap()).unwrap();
    let adjacent_only = serde_json::json!({ "stages": [progress["stages"][0]], "peak_rss_mib": null });
    std::fs::write(stopped.join("progress.json"), adjacent_only.to_string()).unwrap();
    let files = checkpoints(&stopped);
    let (newest, previous) = (&files[files.len() - 1], &files[files.len() - 2]);
    let bytes = std::fs::read(newest).unwrap();
    std::fs::write(newest, &bytes[..bytes.len() / 2]).unwrap();
    let refused = home.run(&["--resume", "run"]);
    assert_eq!(refused.code, Some(1), "{}", refused.stderr);
    let name = previous.file_name().unwrap().to_str().unwrap();
    for part in ["damaged or truncated", "is whole (step 20)", "--checkpoint", name] {
        assert!(refused.stderr.contains(part), "`{part}` is not in: {}", refused.stderr);
    }
    let offered = format!("run/checkpoints/{name}");
    let continued = home.run(&["--resume", "run", "--checkpoint", &offered]);
    assert_eq!(continued.code, Some(0), "{}", continued.stderr);
    assert_eq!(metrics(&stopped), undisturbed().1);
}

#[test]
fn a_resumed_run_keeps_to_its_config() {
    let home = Home::new();
    copy(&undisturbed().0.path("run"), &home.path("run"));
    for other in ["svbrdf.steps=99", "run.compute=f16"] {
        let ended = home.run(&["--resume", "run", "--set", other]);
        assert_eq!(ended.code, Some(2), "{other}: {}", ended.stderr);
        assert!(ended.stderr.contains("continues as it began"), "{other}: {}", ended.stderr);
    }
    assert_eq!(
        home.run(&[
            "--resume",
            "run",
            "--set",
            "checkpoint.every_steps=9",
            "--set",
            "run.on_nan=restore",
            "--set",
            "svbrdf.optimisation.histogram_every=5"
        ])
        .code,
        Some(0)
    );
}

pub fn copy(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap().flatten() {
        let target = to.join(entry.file_name());
        if entry.path().is_dir() {
            copy(&entry.path(), &target);
        } else {
            std::fs::copy(entry.path(), target).unwrap();
        }
    }
}
