//! The programs of the workspace, built once per test process and run as a person would.

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::OnceLock;

/// How a program ended.
#[derive(Debug)]
pub struct Ended {
    /// Its exit code; `None` when a signal ended it.
    pub code: Option<i32>,
    /// What it printed.
    pub stdout: String,
    /// What it complained of.
    pub stderr: String,
}

/// Runs `train`, `scan` or `evaluate` in a folder.
///
/// # Panics
/// If the program can't be built or started: then there is nothing to test.
pub fn run(program: &str, folder: &Path, arguments: &[impl AsRef<OsStr>]) -> Ended {
    ended(command(program).current_dir(folder).args(arguments))
}

/// Runs a prepared command.
///
/// # Panics
/// If it can't be started.
pub fn ended(command: &mut Command) -> Ended {
    let output = command.stdin(Stdio::null()).output().expect("a program that was just built can be started");
    Ended {
        code: output.status.code(),
        stdout: String::from_utf8_lossy(&output.stdout).into_owned(),
        stderr: String::from_utf8_lossy(&output.stderr).into_owned(),
    }
}

/// A command that starts one of the programs.
///
/// # Panics
/// As [`run`].
pub fn command(program: &str) -> Command {
    static BUILT: OnceLock<BTreeMap<String, PathBuf>> = OnceLock::new();
    let built = BUILT.get_or_init(build);
    Command::new(built.get(program).unwrap_or_else(|| panic!("cargo built no program `{program}`, only {built:?}")))
}

/// Whether a program of the system can be started.
pub fn available(program: &str) -> bool {
    Command::new(program).arg("-version").stdout(Stdio::null()).stderr(Stdio::null()).status().is_ok_and(|s| s.success())
}

/// Cargo hands the programs of a package only to tests of the same package, so this asks it to build them, in the profile
/// and target folder that the test itself was built in. Where they are fresh already this takes a moment.
fn build() -> BTreeMap<String, PathBuf> {
    let test = std::env::current_exe().expect("a running test has a path");
    // <target folder>/<profile>/deps/<test>
    let folder = |n: usize| test.ancestors().nth(n).expect("cargo puts tests three folders deep");
    let profile = match folder(2).file_name().and_then(OsStr::to_str) {
        Some("debug") | None => "dev",
        Some(name) => name,
    };
    let mut cargo = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    cargo.args(["build", "--message-format=json", "--profile", profile, "--target-dir"]).arg(folder(3));
    cargo.args(["-p", "train", "-p", "scan", "-p", "evaluate", "--bins"]).current_dir(env!("CARGO_MANIFEST_DIR"));
    let output = cargo.stdin(Stdio::null()).output().expect("cargo started this test, so it can be started again");
    assert!(output.status.success(), "the programs don't build:\n{}", String::from_utf8_lossy(&output.stderr));
    let messages = String::from_utf8_lossy(&output.stdout);
    let artifacts = messages.lines().filter_map(|line| serde_json::from_str::<serde_json::Value>(line).ok());
    artifacts.filter_map(|m| Some((m["target"]["name"].as_str()?.into(), m["executable"].as_str()?.into()))).collect()
}
