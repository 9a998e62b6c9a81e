//! The cases on disk: `settings.json` and `cases/CONDITION/NNNN.json`, each written in one step.

use std::path::{Path, PathBuf};

use dataset::image_io::{Overwrite, write_bytes};
use serde::{Deserialize, Serialize};

use crate::EvaluateError;

use super::AlignmentConfig;
use super::case::Case;
use super::conditions::Condition;

/// What all cases of a folder have in common. Which scans are measured isn't part of it: more can be added.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Common {
    /// The protocol's settings, as TOML.
    pub settings: String,
    /// Where the materials come from.
    pub materials: String,
    /// Checksums of the nets.
    pub nets: Vec<String>,
    /// [`flow::align::VERSION`]; 0 in folders from before there was one.
    #[serde(default)]
    pub aligner: u32,
}

impl Common {
    /// Of a protocol's settings and this program's aligner.
    pub fn new(config: &AlignmentConfig, materials: &str, nets: Vec<String>) -> Self {
        let config = AlignmentConfig { sequences: 0, scans: Vec::new(), ..config.clone() };
        let settings = toml::to_string(&config).expect("settings are plain values");
        Self { settings, materials: materials.into(), nets, aligner: flow::align::VERSION }
    }
}

/// A folder of cases.
#[derive(Debug)]
pub struct Store {
    folder: PathBuf,
}

impl Store {
    /// Opens a folder for cases with these settings, and makes it if it doesn't exist. Cases of other settings are removed if
    /// `overwrite` allows it.
    ///
    /// # Errors
    /// If the folder holds cases of other settings or another aligner that may not be removed, or can't be written to.
    pub fn open(folder: &Path, common: &Common, overwrite: Overwrite) -> Result<Self, EvaluateError> {
        let (path, store) = (folder.join("settings.json"), Self { folder: folder.into() });
        let found = if path.exists() { Some(json::<Common>(&path)?) } else { None };
        if found.as_ref() == Some(common) {
            return Ok(store);
        }
        if found.is_some() && overwrite == Overwrite::Refuse {
            return Err(EvaluateError::OtherSettings { folder: folder.into() });
        }
        let failed = |source| EvaluateError::Folder { folder: folder.into(), source };
        std::fs::create_dir_all(folder).map_err(failed)?;
        let cases = folder.join("cases");
        if cases.exists() {
            std::fs::remove_dir_all(&cases).map_err(failed)?;
        }
        write_bytes(&path, &pretty(common), Overwrite::Allow)?;
        Ok(store)
    }

    /// The case of a condition and a scan, if it was measured with the condition's present settings.
    ///
    /// # Errors
    /// If its file can't be read or isn't a case.
    pub fn read(&self, condition: &Condition, sequence: usize) -> Result<Option<Case>, EvaluateError> {
        let path = self.path(condition.name, sequence);
        let case = if path.exists() { Some(json::<Case>(&path)?) } else { None };
        Ok(case.filter(|case| case.settings == condition.settings))
    }

    /// Keeps a case and returns it as [`Store::read`] will: a number may lose its last bit on the way through text, and an
    /// evaluation that was stopped must not end with other figures.
    ///
    /// # Errors
    /// If its file can't be written.
    pub fn write(&self, case: &Case) -> Result<Case, EvaluateError> {
        let path = self.path(&case.condition, case.sequence);
        let folder = path.parent().unwrap_or(&self.folder);
        std::fs::create_dir_all(folder).map_err(|source| EvaluateError::Folder { folder: folder.into(), source })?;
        write_bytes(&path, &pretty(case), Overwrite::Allow)?;
        json(&path)
    }

    fn path(&self, condition: &str, sequence: usize) -> PathBuf {
        self.folder.join("cases").join(condition).join(format!("{sequence:04}.json"))
    }
}

fn pretty(value: &impl Serialize) -> Vec<u8> {
    serde_json::to_vec_pretty(value).expect("plain values")
}

fn json<T: serde::de::DeserializeOwned>(path: &Path) -> Result<T, EvaluateError> {
    let wrong = |message: String| EvaluateError::Case { path: path.into(), message };
    let text = std::fs::read(path).map_err(|e| wrong(e.to_string()))?;
    serde_json::from_slice(&text).map_err(|e| wrong(e.to_string()))
}
