//! The real program, driven from outside: bad input, stops, kills and resumes.

mod bad_input;
mod exports;
mod kills;
mod stop_and_resume;
mod sweep;

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// A whole run of seconds: small materials, small nets, two stages.
const TINY: &str = r#"
[run]
seed = 3

[[materials]]
type = "procedural"
size = 64
count = 16

[flow]
init = "none"
architecture = { channels = [4, 8], convs_per_level = 1, estimator = [8], radius = 2, context = [] }

[adjacent]
steps = 24
batch = 1
pairs = { resolution = 48, crop = 32 }
mixed_videos = 2
validation_pairs = 1
optimisation = { validate_every = 10, preview_every = 20 }

[svbrdf]
steps = 24
net = { width = 4, levels = 3, dropout = 0.5, output = { start = "medians", gain = 0.02 } }
exemplars = { resolution = 32, key_frames = [1, 2], mixed_videos = 2 }
median_exemplars = 2
validation_exemplars = 1
optimisation = { learning_rate = 1e-3, warm_up = 4, validate_every = 10, preview_every = 20 }

[report]
evaluate = false

[checkpoint]
every_steps = 5
"#;

/// A folder with the tiny config in it.
struct Home {
    folder: tempfile::TempDir,
}

impl Home {
    fn new() -> Self {
        let home = Self { folder: tempfile::tempdir().unwrap() };
        home.write("tiny.toml", TINY);
        home
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn write(&self, name: &str, text: &str) {
        std::fs::write(self.path(name), text).unwrap();
    }

    fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_train"));
        command.current_dir(self.folder.path()).args(arguments);
        command
    }

    fn run(&self, arguments: &[&str]) -> Ended {
        Ended::new(self.command(arguments).output().unwrap())
    }
}

/// What a finished process said.
struct Ended {
    code: Option<i32>,
    stdout: String,
    stderr: String,
}

impl Ended {
    fn new(output: Output) -> Self {
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        Self { code: output.status.code(), stdout: text(&output.stdout), stderr: text(&output.stderr) }
    }
}

/// Every number of the metrics as text, by line: equal text is equal bits, since numbers are written in full.
fn metrics(run: &Path) -> Vec<String> {
    std::fs::read_to_string(run.join("metrics.jsonl")).unwrap().lines().map(str::to_string).collect()
}
