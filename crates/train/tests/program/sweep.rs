//! `train sweep`: runs that are shared, stopped, broken and resumed end in one table; engines get the same runs.

use super::{Ended, Home};
use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::OnceLock;

/// Two rows that share their flow net, and one that only measures.
const SWEEP: &str = r#"
base = "tiny.toml"
seeds = [3, 4]
figures = ["maps_l1_ratio", "diffuse_l1", "alignment_pixel_error", "adjacent_epe_ratio"]

[titles]
full = "everything"

[settings]
adjacent.steps = 4
svbrdf.steps = 6
checkpoint.every_steps = 2
svbrdf.net = { dropout = 0.0 }

[settings.report]
evaluate = true

[settings.report.synthetic]
textured = 2
low_texture = 1
resolution = 64
map_resolution = 16
pairs = 1
constant_videos = 2
align = { photometric = { iterations = 2 }, adjust = false, loops = false }

[variants.full]

[variants.bare]
svbrdf.loss.weights.top = 0.0

[variants.unregular]
report.synthetic.align.regularise = "none"

[published]
source = "nobody"
figures.full = { diffuse_l1 = 0.1 }
figures.bare = { diffuse_l1 = 0.2 }
"#;

fn home() -> Home {
    let home = Home::new();
    home.write("sweep.toml", SWEEP);
    home
}

fn read(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// The sweep that was left alone, made once.
fn undisturbed() -> &'static Home {
    static SWEEP: OnceLock<Home> = OnceLock::new();
    SWEEP.get_or_init(|| {
        let home = home();
        let ended = home.run(&["sweep", "sweep.toml", "--out", "out", "--jobs", "2"]);
        assert_eq!(ended.code, Some(0), "{}\n{}", ended.stderr, ended.stdout);
        home
    })
}

#[test]
fn a_sweep_ends_in_a_table_and_repeats_nothing() {
    let home = undisturbed();
    let out = home.path("out");
    let table = read(&out.join("table.md"));
    for part in
        ["| everything |", "| bare |", "| unregular |", "over 2 seeds", "of 6 pairs", "Against nobody", "Of 1 published"]
    {
        assert!(table.contains(part), "`{part}` is not in:\n{table}");
    }
    assert_eq!(read(&out.join("table.csv")).lines().count(), 1 + 3 * 4);
    assert!(read(&out.join("table.svg")).contains("everything"));
    let summary: serde_json::Value = serde_json::from_str(&read(&out.join("sweep.json"))).unwrap();
    assert_eq!(summary["runs"].as_array().unwrap().len(), 6);
    assert!(summary["runs"].as_array().unwrap().iter().all(|run| run["finished"] == true));

    // The flow net was trained once per seed, the SVBRDF net of the last row not at all.
    let weights = |run: &str, net: &str| std::fs::read(out.join(run).join(format!("weights/{net}.safetensors"))).unwrap();
    assert!(weights("bare-seed3", "adjacent") == weights("full-seed3", "adjacent"));
    assert!(weights("bare-seed3", "svbrdf") != weights("full-seed3", "svbrdf"));
    assert!(weights("unregular-seed4", "svbrdf") == weights("full-seed4", "svbrdf"));
    assert!(weights("full-seed4", "adjacent") != weights("full-seed3", "adjacent"));
    assert!(!read(&out.join("bare-seed3/metrics.jsonl")).contains("\"adjacent\""));
    assert_eq!(std::fs::read_dir(out.join("unregular-seed3/checkpoints")).unwrap().count(), 0);

    let again = home.run(&["sweep", "sweep.toml", "--out", "out"]);
    assert_eq!((again.code, again.stderr.contains("start")), (Some(0), false), "{}", again.stderr);
    assert_eq!(read(&out.join("table.md")), table);
    let listed = home.run(&["sweep", "sweep.toml", "--out", "out", "--dry-run"]);
    assert_eq!(listed.stdout.matches("finished").count(), 6, "{}", listed.stdout);
    assert!(listed.stdout.contains("unregular-seed3: trains nothing, nets of full-seed3"), "{}", listed.stdout);

    let other = home.run(&["sweep", "sweep.toml", "--out", "out", "--set", "svbrdf.steps=7"]);
    assert_eq!(other.code, Some(2));
    for part in ["full-seed3", "`svbrdf.steps` is 6 there and 7 here", "--force"] {
        assert!(other.stderr.contains(part), "{}", other.stderr);
    }
}

/// Starts a sweep and stops it as soon as it says something.
fn stopped(home: &Home, arguments: &[&str], said: &str) -> Ended {
    let mut child = home.command(arguments).stderr(Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(child.stderr.take().unwrap());
    let mut stderr = String::new();
    while !stderr.contains(said) {
        assert!(lines.read_line(&mut stderr).unwrap() > 0, "the sweep ended before `{said}`: {stderr}");
    }
    assert!(Command::new("sh").args(["-c", &format!("kill -INT {}", child.id())]).status().unwrap().success());
    lines.read_to_string(&mut stderr).unwrap();
    Ended { code: child.wait().unwrap().code(), stdout: String::new(), stderr }
}

#[test]
fn a_stopped_sweep_goes_on_and_ends_in_the_same_table() {
    let home = home();
    let first = stopped(&home, &["sweep", "sweep.toml", "--out", "out"], "start bare-seed3");
    assert_eq!(first.code, Some(130), "{}", first.stderr);
    assert!(first.stderr.contains("of 6 runs left; the same command goes on"), "{}", first.stderr);
    let report = home.path("out/full-seed3/report.json");
    let written = std::fs::metadata(&report).unwrap().modified().unwrap();
    let half = home.run(&["sweep", "sweep.toml", "--out", "out", "--table"]);
    assert!(half.stdout.contains("of 6 runs are not in these tables: they are not finished"), "{}", half.stdout);

    let second = home.run(&["sweep", "sweep.toml", "--out", "out"]);
    assert_eq!(second.code, Some(0), "{}", second.stderr);
    assert!(!second.stderr.contains("start full-seed3") && second.stderr.contains("start bare-seed3"), "{}", second.stderr);
    assert_eq!(std::fs::metadata(&report).unwrap().modified().unwrap(), written);
    assert_eq!(read(&home.path("out/table.csv")), read(&undisturbed().path("out/table.csv")));
}

#[test]
fn a_run_that_fails_is_named_and_does_not_end_the_others() {
    let home = home();
    // What `full-seed3` shares can't be used, and neither can what waits for it.
    assert_eq!(stopped(&home, &["sweep", "sweep.toml", "--out", "out"], "start full-seed3").code, Some(130));
    home.write("out/full-seed3/progress.json", "{ broken");
    let ended = home.run(&["sweep", "sweep.toml", "--out", "out"]);
    assert_eq!(ended.code, Some(1), "{}", ended.stderr);
    for part in ["FAILED full-seed3: exit code 1", "progress.json", "FAILED bare-seed3: not run: it takes nets of full-seed3"] {
        assert!(ended.stderr.contains(part), "`{part}` is not in:\n{}", ended.stderr);
    }
    for part in ["3 of 6 runs are not in these tables, 3 of them failed", "- full-seed3: exit code 1", "over 1 seed:"] {
        assert!(ended.stdout.contains(part), "`{part}` is not in:\n{}", ended.stdout);
    }
}

#[test]
fn wrong_nets_are_not_taken() {
    let home = undisturbed();
    let take = |from: &str, set: &str| {
        let arguments = ["--config", "tiny.toml", "--out", "taker", "--force", "--nets-of", from, "--set", set];
        home.run(&arguments)
    };
    let ended = take("out/full-seed3", "svbrdf.steps=5");
    assert_eq!(ended.code, Some(2), "{}", ended.stderr);
    assert!(ended.stderr.contains("nothing there was trained as this run would train it"), "{}", ended.stderr);
    let ended = take("out/none", "svbrdf.steps=5");
    assert!(ended.code == Some(2) && ended.stderr.contains("out/none"), "{}", ended.stderr);
    let ended = home.run(&[
        "--config",
        "tiny.toml",
        "--out",
        "other",
        "--set",
        "report.evaluate=true",
        "--set",
        "report.flow_nets=nowhere",
    ]);
    assert_eq!(ended.code, Some(2), "{}", ended.stderr);
    assert!(ended.stderr.contains("`report.flow_nets` is \"nowhere\"") && !home.path("other").exists(), "{}", ended.stderr);
}

/// Puts a shell script in the place of an engine's program; it notes its arguments.
#[cfg(unix)]
fn stub(home: &Home, program: &str, answer: &str) {
    use std::os::unix::fs::PermissionsExt;
    std::fs::create_dir_all(home.path("stubs")).unwrap();
    let path = home.path("stubs").join(program);
    std::fs::write(&path, format!("#!/bin/sh\necho \"$@\" >> {}\n{answer}\n", home.path("called").display())).unwrap();
    std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).unwrap();
}

#[cfg(unix)]
fn with_stubs(home: &Home, arguments: &[&str]) -> Ended {
    let path = format!("{}:{}", home.path("stubs").display(), std::env::var("PATH").unwrap());
    Ended::new(home.command(arguments).env("PATH", path).output().unwrap())
}

/// A stub stands for `sbatch`; its arrays are then run as SLURM would, by bash with SLURM_ARRAY_TASK_ID.
#[cfg(unix)]
#[test]
fn a_slurm_array_runs_every_folder_once() {
    let home = home();
    stub(&home, "sbatch", "wc -l < called | tr -d ' '");
    let arguments = ["sweep", "sweep.toml", "--out", "out dir", "--engine", "slurm", "--cores", "1"];
    let ended = with_stubs(&home, &arguments);
    assert_eq!((ended.code, ended.stdout.as_str()), (Some(0), "1\n2\n"), "{}", ended.stderr);
    let called = read(&home.path("called"));
    let calls: Vec<&str> = called.lines().collect();
    assert!(calls[0].starts_with("--parsable --array=1-2 ") && calls[0].ends_with("slurm-tasks-1.txt"), "{called}");
    assert!(calls[1].starts_with("--parsable --array=1-4 --dependency=afterany:1 "), "{called}");
    let script = read(&home.path("out dir/slurm.sh"));
    assert!(script.contains("#SBATCH --cpus-per-task=1") && script.contains("#SBATCH --requeue"), "{script}");
    let task = |list: &str, number: &str| {
        let mut bash = Command::new("bash");
        bash.args(["slurm.sh", list]).current_dir(home.path("out dir")).env("SLURM_ARRAY_TASK_ID", number);
        Ended::new(bash.output().unwrap())
    };
    for (list, numbers) in [("slurm-tasks-1.txt", 1..=2), ("slurm-tasks-2.txt", 1..=4)] {
        for number in numbers {
            let ended = task(list, &number.to_string());
            assert_eq!(ended.code, Some(0), "{}", ended.stderr);
        }
    }
    assert_eq!(task("slurm-tasks-2.txt", "5").code, Some(2));
    let again = with_stubs(&home, &arguments);
    assert!(again.code == Some(0) && again.stderr.contains("all 6 runs are finished"), "{}", again.stderr);
    assert_eq!(home.run(&["sweep", "sweep.toml", "--out", "out dir", "--table"]).code, Some(0));
    assert_eq!(read(&home.path("out dir/table.csv")), read(&undisturbed().path("out/table.csv")));
}

/// A stub stands for `hq`; `tests/engines/lost_worker.py` runs the job definition under the real server and workers.
#[cfg(unix)]
#[test]
fn a_hyperqueue_job_has_one_task_per_run_that_is_not_finished() {
    let home = home();
    let arguments = ["sweep", "sweep.toml", "--out", "out", "--engine", "hyperqueue", "--cores", "2"];
    let absent = Ended::new(home.command(&arguments).env("PATH", "/nowhere").output().unwrap());
    assert_eq!(absent.code, Some(1));
    assert!(
        absent.stderr.contains("`hq` can't be started") && absent.stderr.contains("hq job submit-file"),
        "{}",
        absent.stderr
    );
    stub(&home, "hq", "echo 'Job submitted successfully, job ID: 1'");
    let ended = with_stubs(&home, &arguments);
    assert_eq!(ended.code, Some(0), "{}", ended.stderr);
    assert!(read(&home.path("called")).starts_with("job submit-file /"));
    let job: toml::Table = read(&home.path("out/hyperqueue.toml")).parse().unwrap();
    let tasks = job["task"].as_array().unwrap();
    assert_eq!((job["name"].as_str(), tasks.len()), (Some("sweep"), 6));
    assert_eq!(tasks[2]["deps"].as_array().unwrap().len(), 1);
    assert_eq!(tasks[2]["request"][0]["resources"]["cpus"].as_integer(), Some(2));
    let words: Vec<&str> = tasks[2]["command"].as_array().unwrap().iter().filter_map(|word| word.as_str()).collect();
    assert_eq!((words[1], words[3]), ("--resume", "--nets-of"));
    assert!(words[2].ends_with("/out/unregular-seed3") && words[4].ends_with("/out/full-seed3"), "{words:?}");
    // Tasks are commands that run by themselves, in any folder.
    let alone = Command::new(words[0]).args(&words[1..]).current_dir("/").output().unwrap();
    let stderr = String::from_utf8_lossy(&alone.stderr);
    assert!(alone.status.code() == Some(1) && stderr.contains("adjacent is not finished"), "{stderr}");
}
