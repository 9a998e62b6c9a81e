//! The configuration of a run: strict TOML files, layered, validated before any work.
//!
//! A config file holds only its differences: every key has a default, `extends = "other.toml"` names the file below it,
//! and `--set table.key=value` lies on top. Each layer is checked by itself, so an error points at the file, line and
//! column where the key was written.

pub(crate) mod diagnosis;
pub(crate) mod layers;
mod lookup;
mod optimisation;
pub mod reference;
mod tables;
mod validate;

pub use diagnosis::Diagnosis;
pub use lookup::{config_folders, find};
pub use optimisation::{Adam, Optimisation, Schedule, Teaching};
pub use tables::{
    ChairsStage, Checkpointing, Config, FlowInit, FlowSize, FlowTable, OnNan, PairStage, Report, ReportFlow, Run, SvbrdfStage,
};
pub use validate::Invalid;

use std::path::PathBuf;

/// Why a configuration can't be used.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// No file of that name.
    #[error("no config file `{name}`: looked for {}{}", list(.looked), suggest(.nearest))]
    NotFound {
        /// The name that was asked for.
        name: String,
        /// Every path that was tried.
        looked: Vec<PathBuf>,
        /// The existing config whose name is closest.
        nearest: Option<String>,
    },
    /// The file is there but can't be read.
    #[error("cannot read the config {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The operating system's reason.
        source: std::io::Error,
    },
    /// `extends` runs in a circle.
    #[error("`extends` runs in a circle: {}", chain.iter().map(|p| p.display().to_string()).collect::<Vec<_>>().join(" → "))]
    Circle {
        /// The files in the order they extend each other.
        chain: Vec<PathBuf>,
    },
    /// A syntax error, an unknown key or a value of the wrong type.
    #[error("{0}")]
    Text(Box<Diagnosis>),
    /// Values that the program can't work with.
    #[error("{}", .0.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n"))]
    Values(Vec<Diagnosis>),
    /// The layers fit one by one but not together.
    #[error("the config and its `extends`/`--set` layers don't fit together: {0}")]
    Merge(String),
}

impl Config {
    /// Loads the named config with everything it extends, lays the `--set` assignments on top and validates the result.
    ///
    /// # Errors
    /// A file that isn't there, an unknown key, a wrong type or an impossible value; see [`ConfigError`].
    pub fn load(name: &str, assignments: &[String]) -> Result<Self, ConfigError> {
        let path = find(name)?;
        let mut config = Self::from_file(&path, assignments)?;
        if config.run.name.is_empty() {
            config.run.name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        }
        Ok(config)
    }

    /// Reads a resolved config back from a run folder, with `--set` assignments on top.
    ///
    /// # Errors
    /// As [`Config::load`].
    pub fn from_file(path: &std::path::Path, assignments: &[String]) -> Result<Self, ConfigError> {
        let mut layers = layers::read(path)?;
        for assignment in assignments {
            layers.push(layers::from_assignment(assignment)?);
        }
        Self::from_layers(&layers)
    }

    /// Lays layers over each other and validates the result.
    pub(crate) fn from_layers(layers: &[layers::Layer]) -> Result<Self, ConfigError> {
        let config = layers::merge(layers)?;
        check(&config, layers)?;
        Ok(config)
    }

    /// The config as TOML, every key written out.
    pub fn to_toml(&self) -> String {
        toml::to_string_pretty(self).unwrap_or_else(|error| format!("# the config could not be written as TOML: {error}\n"))
    }
}

fn check(config: &Config, layers: &[layers::Layer]) -> Result<(), ConfigError> {
    let invalid = config.validate();
    if invalid.is_empty() {
        return Ok(());
    }
    Err(ConfigError::Values(invalid.iter().map(|problem| layers::locate(layers, problem)).collect()))
}

fn list(paths: &[PathBuf]) -> String {
    paths.iter().map(|path| path.display().to_string()).collect::<Vec<_>>().join(", ")
}

fn suggest(nearest: &Option<String>) -> String {
    nearest.as_ref().map(|name| format!("; did you mean `{name}`?")).unwrap_or_default()
}
