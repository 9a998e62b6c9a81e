//! `progress.json`: the stages of a run that are done, with what they reached.

use crate::pipeline::RunError;
use crate::run_folder::RunFolder;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

const FILE: &str = "progress.json";

/// A stage that is done.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FinishedStage {
    /// Its name.
    pub stage: String,
    /// Optimiser steps.
    pub steps: usize,
    /// Training time of the whole run up to its end, in seconds.
    pub seconds: f64,
    /// Share of the steps' time that went by waiting for data, since the last start.
    #[serde(default)]
    pub data_wait_share: f64,
    /// Measurements on held-out materials.
    pub measured: BTreeMap<String, f64>,
    /// Batches skipped because a loss was not finite on them.
    pub skipped: Vec<u64>,
}

/// All stages that are done.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Finished {
    /// In the order in which they ended.
    pub stages: Vec<FinishedStage>,
    /// The most memory that any process of this run held by the end of a stage, in MiB.
    pub peak_rss_mib: Option<f64>,
}

impl Finished {
    /// Reads the record of a run folder; empty for a new run.
    ///
    /// # Errors
    /// A file that isn't such a record.
    pub fn read(folder: &RunFolder) -> Result<Self, RunError> {
        Self::of_run(folder.path())
    }

    /// Reads the record of a run that another process may be writing.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub fn of_run(run: &Path) -> Result<Self, RunError> {
        let path = run.join(FILE);
        match std::fs::read_to_string(&path) {
            Ok(text) => serde_json::from_str(&text).map_err(|error| RunError::Finished { path, reason: error.to_string() }),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(Self::default()),
            Err(error) => Err(RunError::Finished { path, reason: error.to_string() }),
        }
    }

    /// Adds a stage and writes the record.
    ///
    /// # Errors
    /// The system's refusal.
    pub fn add(&mut self, folder: &RunFolder, stage: FinishedStage) -> Result<(), RunError> {
        self.stages.push(stage);
        self.peak_rss_mib = self.peak_rss_mib.into_iter().chain(ops::process::peak_rss_mib()).reduce(f64::max);
        folder.write(FILE, &crate::report::pretty(self)?)?;
        Ok(())
    }

    /// Whether a stage is done.
    pub fn has(&self, stage: &str) -> bool {
        self.stages.iter().any(|done| done.stage == stage)
    }

    /// A measurement of a finished stage.
    pub fn measured(&self, stage: &str, name: &str) -> Option<f64> {
        self.stages.iter().find(|done| done.stage == stage)?.measured.get(name).copied()
    }

    /// Training time of the run up to the end of the last finished stage.
    pub fn seconds(&self) -> f64 {
        self.stages.last().map_or(0.0, |stage| stage.seconds)
    }
}
