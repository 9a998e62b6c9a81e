//! The run folders of a sweep: made ready before anything runs, so that one command (`train --resume RUN`) starts, continues
//! and finishes any of them, here or on another machine.

use super::plan::Run;
use crate::cli::{Failure, check_start, describe_run};
use crate::config::Config;
use crate::fingerprint;
use crate::pipeline;
use crate::run_folder::RunFolder;
use std::path::Path;

/// How far a run is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum State {
    /// There is no folder yet.
    New,
    /// Its folder is ready; it may have checkpoints.
    Begun,
    /// Its report is written.
    Finished,
}

/// Looks at a run's folder.
///
/// # Errors
/// A folder that isn't a run's, or is that of a run with another config.
pub fn state(path: &Path, run: &Run) -> Result<State, Failure> {
    let empty = std::fs::read_dir(path).map_or(!path.exists(), |mut entries| entries.next().is_none());
    if empty {
        return Ok(State::New);
    }
    let config = path.join("config.toml");
    if !config.is_file() || !path.join("run.json").is_file() {
        let text = format!(
            "{} is in the way: expected nothing there, or a run folder with config.toml and run.json; move it away or give another --out",
            path.display()
        );
        return Err(Failure::Usage(text));
    }
    let before = Config::from_file(&config, &[])?;
    if fingerprint::of_run(&before) != fingerprint::of_run(&run.config) || before.report != run.config.report {
        let text = format!(
            "{} holds a run with another config: {}; give another --out, or --force to make such runs anew",
            path.display(),
            differences(&before, &run.config)
        );
        return Err(Failure::Usage(text));
    }
    Ok(if path.join("report.json").is_file() { State::Finished } else { State::Begun })
}

/// Makes a run's folder ready. It appears whole or not at all.
///
/// # Errors
/// Materials that can't be used, missing starting weights, or files that can't be written.
pub fn prepare(path: &Path, run: &Run, device: &str, force: bool) -> Result<(), Failure> {
    check_start(&run.config)?;
    let materials = pipeline::open_library(&run.config).map_err(|error| Failure::Usage(error.to_string()))?;
    RunFolder::create(path, force, |folder| describe_run(folder, &run.config, device, &materials)).map(drop)
}

/// The first keys whose values differ, "there" first.
fn differences(there: &Config, here: &Config) -> String {
    /// More would not be read.
    const SHOWN: usize = 3;
    let table = |config: &Config| toml::Table::try_from(config).unwrap_or_default();
    let (mut there, mut here) = (table(there), table(here));
    for config in [&mut there, &mut here] {
        // Nothing in them but the seed decides the results.
        config.remove("run");
        config.remove("checkpoint");
    }
    let mut found = Vec::new();
    compare("", &toml::Value::Table(there), &toml::Value::Table(here), &mut found);
    match found.len() {
        0 => "its seed differs".into(),
        count if count > SHOWN => format!("{} and {} more", found[..SHOWN].join(", "), count - SHOWN),
        _ => found.join(", "),
    }
}

fn compare(key: &str, there: &toml::Value, here: &toml::Value, found: &mut Vec<String>) {
    if let (toml::Value::Table(there), toml::Value::Table(here)) = (there, here) {
        let absent = toml::Value::String("absent".into());
        let names: std::collections::BTreeSet<&String> = there.keys().chain(here.keys()).collect();
        for name in names {
            let inner = if key.is_empty() { name.clone() } else { format!("{key}.{name}") };
            compare(&inner, there.get(name).unwrap_or(&absent), here.get(name).unwrap_or(&absent), found);
        }
    } else if there != here {
        found.push(format!("`{key}` is {there} there and {here} here"));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(set: &[&str]) -> Run {
        let set: Vec<String> = set.iter().map(ToString::to_string).collect();
        let config = Config::load("smoke", &set).unwrap();
        Run { name: "a".into(), row: "a".into(), seed: config.run.seed, config, takes: vec![] }
    }

    #[test]
    fn a_prepared_run_is_begun_and_another_config_is_refused_with_the_keys() {
        let home = tempfile::tempdir().unwrap();
        let (path, first) = (home.path().join("a"), run(&[]));
        assert_eq!(state(&path, &first).unwrap(), State::New);
        prepare(&path, &first, "cpu", false).unwrap();
        assert_eq!(state(&path, &first).unwrap(), State::Begun);
        assert_eq!(std::fs::read_dir(home.path()).unwrap().count(), 1);
        // Neither the number of workers nor checkpoints decide anything.
        assert_eq!(state(&path, &run(&["run.data_workers=3", "checkpoint.every_steps=7"])).unwrap(), State::Begun);
        let other = run(&["svbrdf.steps=21", "report.synthetic.pairs=3"]);
        let text = state(&path, &other).unwrap_err().to_string();
        for part in ["`svbrdf.steps` is 20 there and 21 here", "`report.synthetic.pairs` is 2 there and 3 here", "--force"] {
            assert!(text.contains(part), "{text}");
        }
        assert!(state(&path, &run(&["run.seed=5"])).unwrap_err().to_string().contains("seed"));
        prepare(&path, &other, "cpu", true).unwrap();
        assert_eq!(state(&path, &other).unwrap(), State::Begun);
        std::fs::write(path.join("report.json"), "{}").unwrap();
        assert_eq!(state(&path, &other).unwrap(), State::Finished);
    }

    #[test]
    fn a_folder_of_something_else_is_left_alone() {
        let home = tempfile::tempdir().unwrap();
        std::fs::write(home.path().join("notes.txt"), "mine").unwrap();
        assert!(state(home.path(), &run(&[])).unwrap_err().to_string().contains("in the way"));
    }
}
