//! `--nets-of RUN`: nets that another run has trained in the very same way are taken over instead of trained again.

use crate::config::{Config, ConfigError};
use crate::fingerprint;
use crate::finished::Finished;
use crate::pipeline::{Part, RunError};
use crate::run_folder::{FolderError, RunFolder};
use ops::weights::{MANIFEST, Manifest, WeightsError, file_of};
use std::path::{Path, PathBuf};

/// Nets that can't be taken over.
#[derive(Debug, thiserror::Error)]
pub enum TakenError {
    /// The other run would give other nets.
    #[error(
        "--nets-of {}: nothing there was trained as this run would train it (the config's parts for flow nets and for the SVBRDF net both differ, or have no steps): give a run whose config differs in one of them or in `report` only",
        run.display()
    )]
    Different {
        /// The other run.
        run: PathBuf,
    },
    /// The other run isn't done with them.
    #[error("--nets-of {}: its stage {stage} is not finished: continue it first with `--resume {}`", run.display(), run.display())]
    Unfinished {
        /// The other run.
        run: PathBuf,
        /// The stage.
        stage: &'static str,
    },
    /// The other run's config.
    #[error(transparent)]
    Config(#[from] ConfigError),
}

/// Takes from a run every part that the config would train the same way, and that isn't finished here. Returns the stages.
///
/// # Errors
/// A run that has nothing to give or isn't finished with it, or files that can't be read or written.
pub fn take(folder: &RunFolder, config: &Config, run: &Path) -> Result<Vec<&'static str>, RunError> {
    let path = run.join("config.toml");
    if !path.is_file() {
        return Err(FolderError::Absent { path: run.into() }.into());
    }
    let theirs = Config::from_file(&path, &[]).map_err(TakenError::Config)?;
    let same = |part: &Part| fingerprint::of_part(config, *part) == fingerprint::of_part(&theirs, *part);
    let stages: Vec<_> = Part::ALL.into_iter().filter(same).flat_map(|part| part.trained(config)).collect();
    if stages.is_empty() {
        return Err(TakenError::Different { run: run.into() }.into());
    }
    let done = Finished::of_run(run)?;
    let mut finished = Finished::read(folder)?;
    for stage in &stages {
        let Some(record) = done.stages.iter().find(|record| record.stage == *stage) else {
            return Err(TakenError::Unfinished { run: run.into(), stage }.into());
        };
        if !finished.has(stage) {
            copy_net(&run.join("weights"), &folder.weights(), stage)?;
            finished.add(folder, record.clone())?;
        }
    }
    Ok(stages)
}

/// Copies a net with its entry in the manifest, which comes last.
fn copy_net(from: &Path, to: &Path, net: &str) -> Result<(), RunError> {
    let theirs = Manifest::read(from)?;
    let Some(record) = theirs.nets.get(net) else {
        let listed = theirs.nets.keys().map(String::as_str).collect::<Vec<_>>().join(", ");
        return Err(WeightsError::NoNet { path: from.join(MANIFEST), net: net.into(), listed }.into());
    };
    let mut ours = match Manifest::read(to) {
        Err(WeightsError::Missing { .. }) => Manifest::default(),
        manifest => manifest?,
    };
    let source = file_of(from, net);
    let bytes = std::fs::read(&source).map_err(|error| WeightsError::Read { path: source, source: error })?;
    crate::atomic::write(&file_of(to, net), &bytes)?;
    ours.nets.insert(net.into(), record.clone());
    crate::atomic::write(&to.join(MANIFEST), crate::report::pretty(&ours)?.as_bytes())?;
    Ok(())
}
