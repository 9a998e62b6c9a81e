//! `train export` and `train import` as a person runs them: what they leave, and what they refuse.

use super::{Home, bad_input::check};
use std::fs;
use std::sync::OnceLock;

/// A finished run, made once.
fn finished() -> &'static Home {
    static RUN: OnceLock<Home> = OnceLock::new();
    RUN.get_or_init(|| {
        let home = Home::new();
        let short = ["--set", "adjacent.steps=2", "--set", "svbrdf.steps=2"];
        let ended = home.run(&[&["--config", "tiny.toml", "--out", "run"], &short[..]].concat());
        assert_eq!(ended.code, Some(0), "{}", ended.stderr);
        home
    })
}

/// The finished run in a home of its own, to spoil.
fn copied() -> Home {
    let home = Home::new();
    fs::create_dir_all(home.path("run/weights")).unwrap();
    for file in ["config.toml", "run.json", "materials.json", "report.json"] {
        fs::copy(finished().path("run").join(file), home.path("run").join(file)).unwrap();
    }
    for file in fs::read_dir(finished().path("run/weights")).unwrap() {
        let file = file.unwrap();
        fs::copy(file.path(), home.path("run/weights").join(file.file_name())).unwrap();
    }
    home
}

const EXPORT: [&str; 5] = ["export", "--run", "run", "--out", "out"];

#[test]
fn an_export_is_made_once_and_replaced_on_demand() {
    let home = copied();
    let ended = home.run(&[&EXPORT[..], &["--dtype", "bf16"]].concat());
    assert_eq!(ended.code, Some(0), "{}", ended.stderr);
    assert!(ended.stdout.contains("as bf16") && ended.stdout.contains("px at most"), "{}", ended.stdout);
    let mut files: Vec<_> =
        fs::read_dir(home.path("out")).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    files.sort();
    let expected = ["README.md", "adjacent", "examples", "load.py", "manifest.json", "pwc.py", "svbrdf.py", "svbrdf"];
    let expected = expected.map(|f| if f.contains('.') { f.to_string() } else { format!("{f}.safetensors") });
    let mut expected = expected.to_vec();
    expected.sort();
    assert_eq!(files, expected);
    check(&home, &[("a second time", EXPORT.to_vec(), 2, vec!["out exists already", "--force"])]);
    let again = home.run(&[&EXPORT[..], &["--force"]].concat());
    assert_eq!(again.code, Some(0), "{}", again.stderr);
    assert!(again.stdout.contains("as f32; stored exactly"), "{}", again.stdout);
    let left = fs::read_dir(home.path("")).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap());
    assert!(left.into_iter().all(|name| !name.contains("partial")));
}

#[test]
fn exports_that_cannot_be_made() {
    let home = copied();
    fs::create_dir_all(home.path("mine")).unwrap();
    home.write("mine/precious.txt", "mine");
    home.write("file", "mine");
    let export = |run, out| vec!["export", "--run", run, "--out", out];
    let with = |more: &[&'static str]| [&EXPORT[..], more].concat();
    check(
        &home,
        &[
            ("no run", export("runs/none", "out"), 2, vec!["no run in runs/none", "config.toml"]),
            ("a file for a run", export("file", "out"), 2, vec!["no run in file"]),
            ("weights for a run", export("run/weights", "out"), 2, vec!["no run in run/weights"]),
            ("no arguments", vec!["export"], 2, vec!["--run", "--out"]),
            ("wrong dtype", with(&["--dtype", "int8"]), 2, vec!["int8", "f32, f16, bf16"]),
            ("no size", with(&["--max-file", "0"]), 2, vec!["--max-file", "1.."]),
            ("training beside", vec!["--config", "tiny.toml", "export", "--run", "run", "--out", "out"], 2, vec!["export"]),
            ("a folder of one's own", with(&["--force", "--out", "mine"]), 2, vec!["--out"]),
            (
                "force on a foreign folder",
                [&export("run", "mine")[..], &["--force"]].concat(),
                2,
                vec!["mine is not an export"],
            ),
            ("force on a file", [&export("run", "file")[..], &["--force"]].concat(), 2, vec!["file is not an export"]),
            (
                "force on the run's weights",
                [&export("run", "run/weights")[..], &["--force"]].concat(),
                2,
                vec!["not an export"],
            ),
            ("below a file", export("run", "file/out"), 1, vec!["can't write", "file/"]),
        ],
    );
    assert!(!home.path("out").exists());
    assert_eq!(fs::read_to_string(home.path("mine/precious.txt")).unwrap(), "mine");
}

#[test]
fn runs_whose_weights_are_not_whole() {
    let case = |spoil: &dyn Fn(&Home), part: &str| {
        let home = copied();
        spoil(&home);
        check(&home, &[(part, EXPORT.to_vec(), 1, vec![part])]);
        assert!(!home.path("out").exists(), "{part}");
    };
    let (adjacent, svbrdf) = ("run/weights/adjacent.safetensors", "run/weights/svbrdf.safetensors");
    let whole = fs::read(finished().path(adjacent)).unwrap();
    case(&|h| fs::remove_dir_all(h.path("run/weights")).unwrap(), "no weights of adjacent, svbrdf yet");
    case(&|h| fs::remove_dir_all(h.path("run/weights")).unwrap(), "--resume run");
    case(&|h| fs::remove_file(h.path(svbrdf)).unwrap(), "svbrdf.safetensors doesn't exist");
    case(&|h| fs::write(h.path(adjacent), &whole[..whole.len() / 2]).unwrap(), "SHA-256");
    case(&|h| fs::rename(h.path(svbrdf), h.path(adjacent)).unwrap(), "SHA-256");
    case(&|h| h.write("run/weights/manifest.json", "{"), "not a manifest");
    case(&|h| h.write("run/materials.json", "[1]"), "materials.json can't be read");
    case(&|h| h.write("run/run.json", ""), "run.json can't be read");
    let swapped = |h: &Home| {
        let text = fs::read_to_string(h.path("run/weights/manifest.json")).unwrap();
        let text = text
            .replace("\"adjacent\"", "\"x\"")
            .replace("\"svbrdf\": {", "\"adjacent\": {")
            .replace("\"x\": {", "\"svbrdf\": {");
        h.write("run/weights/manifest.json", &text);
    };
    case(&swapped, "unknown kind `svbrdf`");
    // What the manifest doesn't check, the file does.
    let unsigned = |h: &Home| {
        let text = fs::read_to_string(h.path("run/weights/manifest.json")).unwrap();
        let lines: Vec<_> = text.lines().filter(|line| !line.contains("sha256")).collect();
        h.write("run/weights/manifest.json", &lines.join("\n"));
        fs::write(h.path(adjacent), &whole[..whole.len() / 2]).unwrap();
    };
    case(&unsigned, "not a complete safetensors file");
    case(
        &|h| {
            unsigned(h);
            fs::copy(h.path(svbrdf), h.path(adjacent)).unwrap();
        },
        "lacks `estimators",
    );
}

#[test]
fn an_imported_net_can_be_trained_on() {
    let home = Home::new();
    let checkpoint = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/golden/flow/release/pwc_net.pth.tar");
    let import = ["import", checkpoint, "--out", "weights"];
    let ended = home.run(&import);
    assert_eq!(ended.code, Some(0), "{}", ended.stderr);
    assert!(ended.stderr.contains("CC BY-NC-SA 4.0"), "{}", ended.stderr);
    // What it printed is what a config needs.
    let (_, flow) = ended.stdout.split_once("[flow]").unwrap();
    let config = super::TINY
        .replace("init = \"none\"", "")
        .replace("architecture = { channels = [4, 8], convs_per_level = 1, estimator = [8], radius = 2, context = [] }", "");
    home.write("on.toml", &config.replace("[flow]", &format!("[flow]{flow}")));
    let short = ["--set", "adjacent.steps=1", "--set", "svbrdf.steps=0", "--set", "adjacent.pairs={resolution=64, crop=64}"];
    let trained = home.run(&[&["--config", "on.toml", "--out", "run"], &short[..]].concat());
    assert_eq!(trained.code, Some(0), "{}", trained.stderr);
    // The export of that run knows where the net comes from.
    let exported = home.run(&EXPORT);
    assert_eq!(exported.code, Some(0), "{}", exported.stderr);
    assert!(fs::read_to_string(home.path("out/README.md")).unwrap().contains("the checkpoint pwc_net.pth.tar | not stated"));

    home.write("empty.pth", "");
    check(
        &home,
        &[
            ("a second time", import.to_vec(), 2, vec!["weights holds a net `chairs` already", "--force"]),
            ("no file", vec!["import", "none.pth", "--out", "weights", "--net", "a"], 1, vec!["none.pth can't be read"]),
            ("a folder", vec!["import", "weights", "--out", "weights", "--net", "a"], 1, vec!["weights can't be read"]),
            (
                "an empty file",
                vec!["import", "empty.pth", "--out", "weights", "--net", "a"],
                1,
                vec!["not a checkpoint", "torch.save"],
            ),
            (
                "another net's name",
                vec!["import", checkpoint, "--out", "weights", "--net", "svbrdf"],
                2,
                vec!["`svbrdf`", "chairs"],
            ),
            ("no folder", vec!["import", checkpoint], 2, vec!["--out"]),
        ],
    );
}
