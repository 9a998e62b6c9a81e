//! Kills, full disks and exchanged files: the short form of `tests/endurance/kills.py`.

use super::stop_and_resume::{checkpoints, copy, undisturbed};
use super::{Ended, Home, metrics};
use std::collections::BTreeMap;
use std::path::Path;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};
use train::recorder::read_scalars;

/// A run that has been slowed by a loaded machine may take this long to reach any moment.
const PATIENCE: Duration = Duration::from_secs(120);

fn start(home: &Home) -> Child {
    let known = home.path("run/config.toml").exists();
    let arguments: &[&str] = if known { &["--resume", "run"] } else { &["--config", "tiny.toml", "--out", "run"] };
    home.command(arguments).stderr(Stdio::piped()).spawn().unwrap()
}

/// Waits for a moment of a run, or its end.
fn wait_for(child: &mut Child, moment: impl Fn() -> bool) {
    let began = Instant::now();
    while !moment() && child.try_wait().unwrap().is_none() {
        assert!(began.elapsed() < PATIENCE, "the moment doesn't come");
        std::thread::sleep(Duration::from_micros(200));
    }
}

fn names(folder: &Path) -> Vec<String> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    entries.flatten().filter_map(|entry| entry.file_name().into_string().ok()).collect()
}

/// Scalars of the event files by tag and step.
fn events(run: &Path) -> BTreeMap<(String, u64), Vec<u32>> {
    let mut found: BTreeMap<_, Vec<u32>> = BTreeMap::new();
    for (step, tag, value) in read_scalars(&run.join("tb")).unwrap() {
        found.entry((tag, step)).or_default().push(value.to_bits());
    }
    found
}

#[track_caller]
fn assert_equals_the_undisturbed_run(run: &Path) {
    let (home, numbers) = undisturbed();
    assert_eq!(&metrics(run), numbers);
    for net in ["adjacent", "svbrdf"] {
        let weights = |run: &Path| std::fs::read(run.join(format!("weights/{net}.safetensors"))).unwrap();
        assert!(weights(run) == weights(&home.path("run")), "the weights of {net} differ");
    }
    let events = events(run);
    assert!(events.values().all(|values| values.len() == 1), "a step is in the events twice");
    assert_eq!(events, self::events(&home.path("run")));
}

#[test]
fn a_run_killed_at_many_moments_ends_as_if_it_had_not_been() {
    let home = Home::new();
    let run = home.path("run");
    let written = |name: &'static str| move |run: &Path| run.join("checkpoints").join(name).exists();
    let writing = |run: &Path| names(&run.join("checkpoints")).iter().any(|name| name.starts_with(".writing-"));
    let moments: [&dyn Fn(&Path) -> bool; 6] = [
        &|run| run.with_file_name(".preparing-run").exists(),
        &|run| run.join("run.json").exists(),
        &written("adjacent-00000005.safetensors"),
        &writing,
        &|run| run.join("weights/adjacent.safetensors").exists(),
        &written("svbrdf-00000010.safetensors"),
    ];
    for moment in moments {
        let mut child = start(&home);
        wait_for(&mut child, || moment(&run));
        child.kill().unwrap();
        child.wait().unwrap();
    }
    let ended = home.run(if run.join("config.toml").exists() {
        &["--resume", "run"]
    } else {
        &["--config", "tiny.toml", "--out", "run"]
    });
    assert_eq!(ended.code, Some(0), "{}", ended.stderr);
    assert_equals_the_undisturbed_run(&run);
    assert!(!writing(&run), "half-written files are left");
}

#[test]
fn a_second_process_is_refused_and_a_kill_leaves_no_lock() {
    let home = Home::new();
    let mut first = start(&home);
    wait_for(&mut first, || home.path("run/run.json").exists());
    for arguments in [&["--resume", "run"][..], &["--config", "tiny.toml", "--out", "run", "--force"]] {
        let second = home.run(arguments);
        // On a slow day the first may be done by now; then it was not the lock that refused.
        if first.try_wait().unwrap().is_none() {
            assert_eq!(second.code, Some(1), "{}", second.stderr);
            assert!(second.stderr.contains("in use by another process"), "{}", second.stderr);
        }
    }
    first.kill().unwrap();
    first.wait().unwrap();
    let last = home.run(&["--resume", "run"]);
    assert_eq!(last.code, Some(0), "{}", last.stderr);
    assert_equals_the_undisturbed_run(&home.path("run"));
}

/// A limit on the size of files, as a quota sets it, stands for a full disk: it needs no disk of one's own. The checkpoints of the
/// first stage are below it, those of the second above.
#[cfg(unix)]
#[test]
fn a_checkpoint_that_cannot_be_written_ends_the_run_with_what_to_do() {
    let home = Home::new();
    let limited = "trap '' XFSZ; ulimit -f 120; exec \"$0\" --config tiny.toml --out run";
    let mut shell = std::process::Command::new("sh");
    shell.current_dir(home.path("")).args(["-c", limited, env!("CARGO_BIN_EXE_train")]);
    let ended = Ended::new(shell.output().unwrap());
    assert_eq!(ended.code, Some(1), "{}", ended.stderr);
    for part in ["cannot access the checkpoint run/checkpoints/svbrdf-00000005", "too large", "`--resume run` goes on"] {
        assert!(ended.stderr.contains(part), "`{part}` is not in: {}", ended.stderr);
    }
    assert!(!ended.stderr.contains("panicked"), "{}", ended.stderr);
    assert!(names(&home.path("run/checkpoints")).iter().all(|name| name.starts_with("adjacent-")));
    let last = home.run(&["--resume", "run"]);
    assert_eq!(last.code, Some(0), "{}", last.stderr);
    assert_eq!(metrics(&home.path("run")), undisturbed().1);
}

/// The undisturbed run as it was before its last stage ended.
fn before_the_end() -> Home {
    let home = Home::new();
    copy(&undisturbed().0.path("run"), &home.path("run"));
    let progress: serde_json::Value = serde_json::from_slice(&std::fs::read(home.path("run/progress.json")).unwrap()).unwrap();
    let adjacent_only = serde_json::json!({ "stages": [progress["stages"][0]], "peak_rss_mib": null });
    home.write("run/progress.json", &adjacent_only.to_string());
    home
}

#[test]
fn checkpoints_that_are_not_the_runs_own_are_refused_and_a_good_one_is_offered() {
    let other = Home::new();
    let ended =
        other.run(&["--config", "tiny.toml", "--out", "run", "--set", "svbrdf.net.width=8", "--set", "adjacent.steps=2"]);
    assert_eq!(ended.code, Some(0), "{}", ended.stderr);
    let newest = |home: &Home| checkpoints(&home.path("run")).pop().unwrap();
    let foreign = std::fs::read(newest(&other)).unwrap();
    let own = std::fs::read(newest(undisturbed_home())).unwrap();
    let older = std::fs::read(newest(undisturbed_home()).with_file_name("svbrdf-00000020.safetensors")).unwrap();
    // Headers differ in length, as the seconds in them do; the numbers behind them don't.
    let numbers = |file: &[u8]| 8 + u64::from_le_bytes(file[..8].try_into().unwrap()) as usize;
    let half = (own.len() - numbers(&own)) / 2;
    let mixed = [&own[..numbers(&own) + half], &older[numbers(&older) + half..]].concat();
    let flow = std::fs::read(newest(undisturbed_home()).with_file_name("adjacent-00000024.safetensors")).unwrap();
    let cases = [
        ("of another architecture", foreign, "another configuration or seed"),
        ("of another step", older, "of step 20 and its name says 24"),
        ("of another stage", flow, "it is of the stage `adjacent`, the run stands in `svbrdf`"),
        ("of two halves", mixed, "put together from several files"),
        ("empty", Vec::new(), "damaged or truncated"),
    ];
    for (what, bytes, reason) in cases {
        let home = before_the_end();
        std::fs::write(newest(&home), bytes).unwrap();
        let refused = home.run(&["--resume", "run"]);
        assert_eq!(refused.code, Some(1), "{what}: {}", refused.stderr);
        let offered = "--resume run --checkpoint run/checkpoints/svbrdf-00000020.safetensors";
        for part in [reason, "step 20", offered] {
            assert!(refused.stderr.contains(part), "{what}: `{part}` is not in: {}", refused.stderr);
        }
        // A bad one that a person names is refused the same way, and nothing is moved.
        let chosen = home.run(&["--resume", "run", "--checkpoint", "run/checkpoints/svbrdf-00000024.safetensors"]);
        if what != "of another step" {
            assert_eq!(chosen.code, Some(1), "{what}: {}", chosen.stderr);
            assert!(chosen.stderr.contains(offered), "{what}: {}", chosen.stderr);
            let arguments: Vec<&str> = offered.split(' ').collect();
            let continued = home.run(&arguments);
            assert_eq!(continued.code, Some(0), "{what}: {}", continued.stderr);
            assert_eq!(metrics(&home.path("run")), undisturbed().1);
        }
    }
}

fn undisturbed_home() -> &'static Home {
    &undisturbed().0
}

#[test]
fn numbers_that_go_bad_stop_the_run_with_step_term_and_dump() {
    let home = Home::new();
    // Finite one by one, infinite in their sum.
    let bad = [
        "--config",
        "tiny.toml",
        "--out",
        "run",
        "--set",
        "adjacent.steps=0",
        "--set",
        "svbrdf.loss.weights={maps=3e38, rendering=3e38, top=3e38}",
    ];
    let stopped = home.run(&bad);
    assert_eq!(stopped.code, Some(1), "{}", stopped.stderr);
    let dump = "run/failures/svbrdf-00000000-0.safetensors";
    for part in ["svbrdf, step 0: the term `loss` is inf", dump, "learning rate", "on_nan", "`--resume run` goes on"] {
        assert!(stopped.stderr.contains(part), "`{part}` is not in: {}", stopped.stderr);
    }
    for name in [dump, "run/failures/svbrdf-00000000-0.png", "run/failures/svbrdf-00000000-0.json"] {
        assert!(home.path(name).is_file(), "{name}");
    }
    // Going back doesn't help where every batch is bad, and that ends too.
    let restored = home.run(&["--resume", "run", "--set", "run.on_nan=restore"]);
    assert_eq!(restored.code, Some(1), "{}", restored.stderr);
    assert_eq!(restored.stderr.matches("skipping batch").count(), 5, "{}", restored.stderr);
    assert!(restored.stderr.contains("gone back 5 times already"), "{}", restored.stderr);
    assert!(home.path("run/failures/svbrdf-00000000-5.safetensors").is_file());
}

#[test]
fn a_resumed_run_stays_on_its_device() {
    let home = Home::new();
    copy(&undisturbed_home().path("run"), &home.path("run"));
    let text = std::fs::read_to_string(home.path("run/run.json")).unwrap();
    home.write("run/run.json", &text.replace("\"device\": \"cpu\"", "\"device\": \"tpu\""));
    let refused = home.run(&["--resume", "run"]);
    assert_eq!(refused.code, Some(2), "{}", refused.stderr);
    assert!(refused.stderr.contains("unknown device `tpu`"), "{}", refused.stderr);
    let moved = home.run(&["--resume", "run", "--device", "cpu"]);
    assert_eq!(moved.code, Some(0), "{}", moved.stderr);
    assert!(moved.stderr.contains("began on tpu and goes on on cpu"), "{}", moved.stderr);
}
