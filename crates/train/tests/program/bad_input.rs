//! Bad input ends with the right exit code and a message that says what to do.

use super::{Home, TINY};

/// What is wrong, the arguments, the exit code, and what the message must contain.
pub type Case<'a> = (&'a str, Vec<&'a str>, i32, Vec<&'a str>);

pub fn check(home: &Home, cases: &[Case<'_>]) {
    for (wrong, arguments, code, parts) in cases {
        let ended = home.run(arguments);
        assert_eq!(ended.code, Some(*code), "{wrong}: {}", ended.stderr);
        for part in parts {
            assert!(ended.stderr.contains(part), "{wrong}: `{part}` is not in:\n{}", ended.stderr);
        }
        assert!(!ended.stderr.contains("panicked"), "{wrong}: {}", ended.stderr);
    }
}

#[test]
fn wrong_arguments() {
    let home = Home::new();
    check(
        &home,
        &[
            ("no config", vec![], 2, vec!["--config"]),
            ("no such config", vec!["--config", "spirel.toml"], 2, vec!["spirel.toml", "did you mean `spiral.toml`?"]),
            ("no such argument", vec!["--config", "tiny.toml", "--fast"], 2, vec!["--fast"]),
            ("config and resume", vec!["--config", "tiny.toml", "--resume", "x"], 2, vec!["cannot be used with"]),
            ("nothing to resume", vec!["--resume", "runs/none"], 2, vec!["runs/none", "config.toml"]),
            ("unknown device", vec!["--config", "tiny.toml", "--device", "tpu"], 2, vec!["`tpu`", "cpu, vulkan"]),
            (
                "two CPUs",
                vec!["--config", "tiny.toml", "--device", "cpu,cpu"],
                2,
                vec!["`--device cpu,cpu`", "all cores by itself"],
            ),
            ("two kinds", vec!["--config", "tiny.toml", "--device", "cuda:0,vulkan:0"], 2, vec!["several kinds"]),
            (
                "a batch for two cards",
                vec!["--config", "tiny.toml", "--device", "cuda:0,cuda:1"],
                2,
                vec!["a step of adjacent has 1", "`adjacent.optimisation.accumulate` to 2 or more"],
            ),
            ("assignment without =", vec!["--config", "tiny.toml", "--set", "run.seed"], 2, vec!["--set table.key=value"]),
            (
                "unknown key set",
                vec!["--config", "tiny.toml", "--set", "run.sed=4"],
                2,
                vec!["--set:1:5", "unknown key `sed`", "did you mean `seed`?", "^^^"],
            ),
            ("wrong type set", vec!["--config", "tiny.toml", "--set", "run.seed=fast"], 2, vec!["--set:1:10", "invalid type"]),
            (
                "impossible value set",
                vec!["--config", "tiny.toml", "--set", "adjacent.batch=0"],
                2,
                vec!["`adjacent.batch` is 0", "expected 1 to 1024"],
            ),
        ],
    );
    assert!(!home.path("runs").exists(), "bad usage left a run folder");
}

#[cfg(not(feature = "cuda"))]
#[test]
fn a_device_that_is_not_built_in_says_how_to_get_it() {
    let case = ("no cuda", vec!["--config", "tiny.toml", "--device", "cuda"], 2, vec!["--features cuda", "--device cpu"]);
    check(&Home::new(), &[case]);
}

#[test]
fn wrong_files() {
    let home = Home::new();
    home.write("syntax.toml", "[run]\nseed = = 4\n");
    home.write("key.toml", &format!("{TINY}\n[distant]\nstepz = 4\n"));
    home.write("table.toml", "[svbrfd]\nsteps = 1\n");
    home.write("type.toml", "[run]\n\nseed = \"one\"\n");
    home.write("choice.toml", "[run]\non_nan = \"resture\"\n");
    home.write("value.toml", "extends = \"tiny.toml\"\n[checkpoint]\nkeep_last = 1\n");
    home.write("empty.toml", "");
    home.write("above.toml", "extends = \"value.toml\"\n[run]\nseed = 2\n");
    home.write("align.toml", "extends = \"tiny.toml\"\n[report.synthetic.align]\nkey_frame_step = 0\n");
    home.write("circle.toml", "extends = \"circle.toml\"\n");
    home.write("orphan.toml", "extends = \"nowhere.toml\"\n");
    home.write("folder.toml", "extends = \"tiny.toml\"\n[[materials]]\ntype = \"pbr\"\npath = \"no/such/folder\"\n");
    home.write("family.toml", "extends = \"tiny.toml\"\n[[materials]]\ntype = \"procedural\"\nfamilies = [\"brix\"]\n");
    home.write("init.toml", "extends = \"tiny.toml\"\n[flow]\ninit = \"absent.safetensors\"\n");
    home.write("crop.toml", "extends = \"tiny.toml\"\n[adjacent]\npairs = { resolution = 48, crop = 64 }\n");
    let config = |name| vec!["--config", name];
    check(
        &home,
        &[
            ("syntax", config("syntax.toml"), 2, vec!["syntax.toml:2:8", "seed = = 4", "^"]),
            ("unknown key", config("key.toml"), 2, vec!["key.toml:", "unknown key `stepz`", "did you mean `steps`?", "^^^^^"]),
            ("unknown table", config("table.toml"), 2, vec!["table.toml:1:2", "did you mean `svbrdf`?"]),
            ("wrong type", config("type.toml"), 2, vec!["type.toml:3:8", "invalid type: string \"one\""]),
            ("unknown choice", config("choice.toml"), 2, vec!["choice.toml:2:", "did you mean `restore`?"]),
            ("impossible value", config("value.toml"), 2, vec!["value.toml:3:13", "`checkpoint.keep_last` is 1", "at least 2"]),
            ("impossible value below", config("above.toml"), 2, vec!["value.toml:3:13", "keep_last = 1", "            ^"]),
            (
                "impossible alignment",
                config("align.toml"),
                2,
                vec!["align.toml:3:18", "align.key_frame_step = 0", "(paper: 5)"],
            ),
            ("nothing to do", config("empty.toml"), 2, vec!["steps in at least one of the stages"]),
            ("extends itself", config("circle.toml"), 2, vec!["runs in a circle"]),
            ("extends nothing", config("orphan.toml"), 2, vec!["nowhere.toml"]),
            ("no material folder", config("folder.toml"), 2, vec!["folder.toml", "no/such/folder"]),
            ("unknown family", config("family.toml"), 2, vec!["`brix`", "bricks"]),
            ("no starting weights", config("init.toml"), 2, vec!["absent.safetensors", "not there"]),
            ("crop larger than frame", config("crop.toml"), 2, vec!["crop.toml:3", "64", "48"]),
        ],
    );
    assert!(!home.path("runs").exists(), "a bad config left a run folder");
}

#[test]
fn folders_that_are_not_to_be_touched() {
    let home = Home::new();
    std::fs::create_dir_all(home.path("full")).unwrap();
    home.write("full/precious.txt", "mine");
    home.write("file", "mine");
    let out = |folder| vec!["--config", "tiny.toml", "--out", folder];
    let force = |folder| vec!["--config", "tiny.toml", "--force", "--out", folder];
    check(
        &home,
        &[
            ("existing folder", out("full"), 2, vec!["not empty", "--resume full", "--out", "--force"]),
            ("existing file", out("file"), 2, vec!["file", "--out"]),
            ("force on a foreign folder", force("full"), 2, vec!["not a run folder"]),
            ("force on a file", force("file"), 2, vec!["not a run folder"]),
            ("below a file", out("file/run"), 1, vec!["cannot write", "file/run"]),
        ],
    );
    assert_eq!(std::fs::read_to_string(home.path("full/precious.txt")).unwrap(), "mine");
    assert_eq!(std::fs::read_dir(home.path("full")).unwrap().count(), 1);
}

#[test]
fn a_dry_run_prints_a_config_that_loads_to_itself_and_writes_nothing() {
    let home = Home::new();
    let first = home.run(&["--config", "tiny.toml", "--set", "svbrdf.steps=7", "--dry-run"]);
    assert_eq!(first.code, Some(0), "{}", first.stderr);
    assert!(first.stdout.contains("name = \"tiny\"") && first.stdout.contains("steps = 7"), "{}", first.stdout);
    home.write("resolved.toml", &first.stdout);
    let second = home.run(&["--config", "resolved.toml", "--dry-run"]);
    assert_eq!(first.stdout, second.stdout);
    assert!(!home.path("runs").exists());
}
