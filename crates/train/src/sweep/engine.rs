//! Hands the runs to an existing engine: a job definition for HyperQueue, an array script for SLURM.
//!
//! A task is one run folder and the command of [`super::local::command`], which goes on where the folder stands. So an engine
//! may start a task again after it lost a worker, and a second submission repeats nothing that is finished.

use super::local::command;
use super::plan::{Run, levels};
use std::io;
use std::path::{Path, PathBuf};
use std::process::Command;

/// How often HyperQueue may lose a worker under the same task.
const CRASHES: u32 = 20;

/// A program, its arguments, and what it is for.
pub struct Submission {
    /// `hq` or `sbatch`.
    pub program: &'static str,
    /// Arguments; `{JOB}` stands for the number that the submission before gave back.
    pub arguments: Vec<String>,
}

impl Submission {
    /// As a person would type it.
    pub fn shell(&self) -> String {
        let words = self.arguments.iter().map(|word| quote(word)).collect::<Vec<_>>();
        format!("{} {}", self.program, words.join(" "))
    }
}

/// What the tasks of an engine share.
pub struct Tasks<'a> {
    /// The sweep's folder.
    pub out: &'a Path,
    /// The sweep's name.
    pub name: &'a str,
    /// All runs.
    pub runs: &'a [Run],
    /// Those that aren't finished, by index.
    pub due: &'a [usize],
    /// Where the nets run.
    pub device: &'a str,
    /// Cores of one task.
    pub cores: usize,
}

impl Tasks<'_> {
    /// Writes `hyperqueue.toml`: one task per run; a run that takes nets waits for those that train them.
    ///
    /// # Errors
    /// The system's refusal.
    pub fn hyperqueue(&self) -> io::Result<Vec<Submission>> {
        let logs = self.folder("logs")?;
        let tasks = self.due.iter().map(|&index| {
            let run = &self.runs[index];
            let (program, arguments) = command(self.out, run, self.runs, self.device)?;
            let words = std::iter::once(program.display().to_string()).chain(arguments).map(toml::Value::String);
            // A task that starts again on another worker writes a log of its own.
            let log = |ending: &str| {
                toml::Value::String(logs.join(format!("{}.%{{INSTANCE_ID}}.{ending}", run.name)).display().to_string())
            };
            let deps = run.takes.iter().filter(|owner| self.due.contains(owner));
            let cpus = self.cores;
            let threads = cpus.to_string();
            let mut task = toml::toml! {
                env = { RAYON_NUM_THREADS = threads }
                request = [{ resources = { cpus = (cpus as i64) } }]
                crash_limit = (i64::from(CRASHES))
            };
            task.insert("id".into(), toml::Value::Integer(index as i64));
            task.insert("command".into(), toml::Value::Array(words.collect()));
            task.insert("stdout".into(), log("out"));
            task.insert("stderr".into(), log("log"));
            task.insert("deps".into(), toml::Value::Array(deps.map(|&i| toml::Value::Integer(i as i64)).collect()));
            Ok(toml::Value::Table(task))
        });
        let mut job = toml::Table::new();
        job.insert("name".into(), toml::Value::String(self.name.into()));
        job.insert("task".into(), toml::Value::Array(tasks.collect::<io::Result<_>>()?));
        let text = format!(
            "# `train sweep` wrote this; submit it with: hq job submit-file hyperqueue.toml\n{}",
            toml::to_string(&job).map_err(io::Error::other)?
        );
        let path = self.write("hyperqueue.toml", &text)?;
        Ok(vec![Submission { program: "hq", arguments: vec!["job".into(), "submit-file".into(), path] }])
    }

    /// Writes `slurm.sh` and the lists of its tasks: an array for the runs that can start at once, another that waits for it
    /// for those that take their nets.
    ///
    /// # Errors
    /// The system's refusal.
    pub fn slurm(&self) -> io::Result<Vec<Submission>> {
        let logs = self.folder("logs")?;
        let script = self.write("slurm.sh", &slurm_script(self.name, &logs, self.cores))?;
        let mut submissions = Vec::new();
        for level in levels(self.runs) {
            let due: Vec<usize> = level.into_iter().filter(|index| self.due.contains(index)).collect();
            if due.is_empty() {
                continue;
            }
            let lines = due.iter().map(|&index| {
                let (program, arguments) = command(self.out, &self.runs[index], self.runs, self.device)?;
                let words: Vec<String> =
                    std::iter::once(program.display().to_string()).chain(arguments).map(|word| quote(&word)).collect();
                Ok(words.join(" ") + "\n")
            });
            let lines = lines.collect::<io::Result<String>>()?;
            let list = self.write(&format!("slurm-tasks-{}.txt", submissions.len() + 1), &lines)?;
            let mut arguments = vec!["--parsable".into(), format!("--array=1-{}", due.len())];
            if !submissions.is_empty() {
                // Not `afterok`: one failed run must not hold back those that don't need it.
                arguments.push("--dependency=afterany:{JOB}".into());
            }
            arguments.extend([script.clone(), list]);
            submissions.push(Submission { program: "sbatch", arguments });
        }
        Ok(submissions)
    }

    fn folder(&self, name: &str) -> io::Result<PathBuf> {
        let path = std::path::absolute(self.out.join(name))?;
        std::fs::create_dir_all(&path)?;
        Ok(path)
    }

    fn write(&self, name: &str, text: &str) -> io::Result<String> {
        let path = std::path::absolute(self.out.join(name))?;
        crate::atomic::write(&path, text.as_bytes())?;
        Ok(path.display().to_string())
    }
}

fn slurm_script(name: &str, logs: &Path, cores: usize) -> String {
    // `#SBATCH` lines end at the line's end and know no variables; quotes are for folders with spaces.
    format!(
        r#"#!/bin/bash
#SBATCH --job-name={name}
#SBATCH --cpus-per-task={cores}
#SBATCH --output="{logs}/slurm-%A_%a.log"
#SBATCH --requeue
#SBATCH --signal=B:TERM@120
# `train sweep` wrote this. Each line of the list is the command of one run; SLURM_ARRAY_TASK_ID picks one. Add what your
# cluster needs (account, partition, time) here or on the command line: sbatch --array=1-N slurm.sh LIST
set -u
line=$(sed -n "${{SLURM_ARRAY_TASK_ID}}p" "$1")
if [ -z "$line" ]; then
    echo "error: $1 has no line ${{SLURM_ARRAY_TASK_ID}}" >&2
    exit 2
fi
export RAYON_NUM_THREADS="${{SLURM_CPUS_PER_TASK:-{cores}}}"
eval "exec_run() {{ exec $line; }}"
exec_run &
run=$!
# Two minutes before the time is over SLURM signals this shell; the run then writes a checkpoint. 130: submit the sweep again.
trap 'kill -TERM "$run"' TERM INT
wait "$run"
code=$?
if [ "$code" -gt 128 ] && kill -0 "$run" 2>/dev/null; then
    wait "$run"
    code=$?
fi
exit "$code"
"#,
        logs = logs.display()
    )
}

/// A word for a shell.
fn quote(word: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./=:,%+@".contains(c);
    if !word.is_empty() && word.chars().all(plain) { word.into() } else { format!("'{}'", word.replace('\'', r"'\''")) }
}

/// Submits one after the other; returns what the engine said.
///
/// # Errors
/// The program isn't there, or refuses; the message says how to submit by hand.
pub fn submit(submissions: &[Submission]) -> Result<Vec<String>, String> {
    let mut said: Vec<String> = Vec::new();
    for submission in submissions {
        let job = said.last().map_or("", |text| text.split(';').next().unwrap_or_default());
        let arguments = submission.arguments.iter().map(|word| word.replace("{JOB}", job));
        let program = submission.program;
        let by_hand = || {
            let lines = submissions.iter().map(Submission::shell).collect::<Vec<_>>().join("\n  ");
            format!("everything is written; submit it where {program} works:\n  {lines}")
        };
        let output = Command::new(program)
            .args(arguments)
            .output()
            .map_err(|error| format!("`{program}` can't be started ({error}): {}", by_hand()))?;
        if !output.status.success() {
            let reason = String::from_utf8_lossy(&output.stderr).trim().to_string();
            return Err(format!("`{program}` refuses ({reason}): {}", by_hand()));
        }
        said.push(String::from_utf8_lossy(&output.stdout).trim().to_string());
    }
    Ok(said)
}
