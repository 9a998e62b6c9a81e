//! One case of bad input, and what must come of it.

use std::collections::BTreeSet;
use std::path::Path;

use acceptance::{nets, programs};

/// What a case needs from the machine; without it the case is left out with a line that says so.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Needs {
    Nothing,
    /// ffmpeg to be there.
    Ffmpeg,
    /// No program on the PATH at all.
    EmptyPath,
    /// A user who can't write everywhere.
    Permissions,
}

/// A mistake that a person makes.
pub struct Case {
    pub name: &'static str,
    pub needs: Needs,
    /// Makes the input in an empty folder.
    pub input: fn(&Place),
    /// The command line, run in that folder; `WEIGHTS` is a folder of good weights, `…` stands for
    /// `--out out --weights WEIGHTS`.
    pub arguments: &'static str,
    pub code: i32,
    /// Parts of the message.
    pub says: &'static [&'static str],
}

/// Where a case plays.
pub struct Place<'a> {
    pub folder: &'a Path,
    pub weights: &'a Path,
}

/// A case that needs nothing from the machine.
pub const fn case(
    name: &'static str,
    input: fn(&Place),
    arguments: &'static str,
    code: i32,
    says: &'static [&'static str],
) -> Case {
    Case { name, needs: Needs::Nothing, input, arguments, code, says }
}

/// An empty folder as input.
pub fn nothing(_: &Place) {}

/// Runs all cases of a program and fails with everything that went wrong.
pub fn check(program: &str, cases: &[Case]) {
    let weights = tempfile::tempdir().unwrap();
    nets::write(weights.path()).unwrap();
    let wrong: Vec<String> = cases.iter().filter_map(|case| case.failure(program, weights.path())).collect();
    assert!(wrong.is_empty(), "{} of {} cases:\n\n{}", wrong.len(), cases.len(), wrong.join("\n\n"));
}

impl Case {
    /// What went wrong.
    fn failure(&self, program: &str, weights: &Path) -> Option<String> {
        let folder = tempfile::tempdir().unwrap();
        let place = Place { folder: folder.path(), weights };
        if let Some(reason) = self.left_out(&place) {
            println!("left out: {program}, {}: {reason}", self.name);
            return None;
        }
        (self.input)(&place);
        let before = names(folder.path());
        let line = self.arguments.replace('…', "--out out --weights WEIGHTS");
        let weights = weights.to_str().unwrap();
        let arguments = line.split_whitespace().map(|a| if a == "WEIGHTS" { weights } else { a });
        let mut command = programs::command(program);
        command.current_dir(folder.path()).args(arguments);
        if self.needs == Needs::EmptyPath {
            command.env("PATH", "");
        }
        let ended = programs::ended(&mut command);
        let mut wrong = Vec::new();
        if ended.code != Some(self.code) {
            wrong.push(format!("exit code {:?}, expected {}", ended.code, self.code));
        }
        wrong.extend(self.says.iter().filter(|s| !ended.stderr.contains(**s)).map(|s| format!("doesn't say {s:?}")));
        if ended.stderr.contains("panicked") || ended.stderr.contains("RUST_BACKTRACE") {
            wrong.push("panicked".into());
        }
        let left: Vec<String> = names(folder.path()).difference(&before).cloned().collect();
        if !left.is_empty() {
            wrong.push(format!("left behind: {left:?}"));
        }
        let heading = format!("{program}, {} ({line}): {}", self.name, wrong.join("; "));
        (!wrong.is_empty()).then(|| format!("{heading}\n{}", ended.stderr))
    }

    fn left_out(&self, place: &Place) -> Option<&'static str> {
        match self.needs {
            Needs::Nothing | Needs::EmptyPath => None,
            Needs::Ffmpeg if programs::available("ffmpeg") && programs::available("ffprobe") => None,
            Needs::Ffmpeg => Some("there is no ffmpeg here"),
            Needs::Permissions if place.can_write_everywhere() => Some("this user may write everywhere"),
            Needs::Permissions => None,
        }
    }
}

/// Everything below a folder.
fn names(folder: &Path) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        found.insert(path.display().to_string());
        if path.is_dir() {
            found.extend(names(&path));
        }
    }
    found
}
