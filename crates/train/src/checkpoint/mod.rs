//! Checkpoints: everything a stage needs to go on bit for bit, in one safetensors file.
//!
//! Names inside: `weights/…`, `average/…` (moving average), `first/…` and `second/…` (Adam's moments), each followed by the
//! parameter's path. The header's metadata carry the [`State`] as JSON and the SHA-256 of all values, so a truncated,
//! damaged or foreign file is told apart from a good one before anything is used.

mod store;

pub use store::Store;

use crate::optimiser::{LossScale, NamedTensors, from_vec, to_vec};
use burn::tensor::Device;
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};

/// Changes with the layout of the file.
const FORMAT: &str = "deep-reflectance-checkpoint-1";

/// A measurement on held-out materials.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Measured {
    /// Optimiser steps done by then.
    pub step: u64,
    /// The stage's most telling figure, the smaller the better.
    pub figure: f64,
}

/// Where a stage stands. Random streams are functions of seed, stage and step, so these numbers are all there is.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct State {
    /// Stage of the run.
    pub stage: String,
    /// Optimiser steps done.
    pub step: u64,
    /// Index of the next batch.
    pub cursor: u64,
    /// Steps that Adam has seen.
    pub adam_time: u64,
    /// Factor on the loss, where convolutions compute in half precision.
    #[serde(default)]
    pub loss_scale: LossScale,
    /// Batches that are left out because a loss was not finite on them.
    pub skipped: Vec<u64>,
    /// The latest measurements on held-out materials.
    pub measured: Vec<(String, f64)>,
    /// The best measurements whose checkpoints are kept, best first.
    #[serde(default)]
    pub best: Vec<Measured>,
    /// Training time of the whole run so far, in seconds.
    pub seconds: f64,
    /// Digest of the part of the config that decides the results.
    pub fingerprint: String,
}

/// A stage's whole state.
#[derive(Clone, Default)]
pub struct Checkpoint {
    /// Where it stands.
    pub state: State,
    /// The net's parameters.
    pub weights: NamedTensors,
    /// Their moving average; empty when none is kept.
    pub average: NamedTensors,
    /// Adam's first moments.
    pub first: NamedTensors,
    /// Adam's second moments.
    pub second: NamedTensors,
}

/// A checkpoint that can't be used.
#[derive(Debug, thiserror::Error)]
pub enum CheckpointError {
    /// The file can't be read or written.
    #[error("cannot access the checkpoint {}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// The file isn't whole.
    #[error("the checkpoint {} is damaged or truncated: {reason}", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What doesn't fit.
        reason: String,
    },
    /// The file is of another version of the program.
    #[error(
        "the checkpoint {} is of another version of this program: its format is `{found}`, expected `{FORMAT}`: continue with the version that wrote it (run.json names its revision), or start a new run",
        path.display()
    )]
    Version {
        /// The file.
        path: PathBuf,
        /// The format that it names.
        found: String,
    },
    /// The file is whole but belongs to something else.
    #[error("the checkpoint {} does not belong to this run: {reason}", path.display())]
    Foreign {
        /// The file.
        path: PathBuf,
        /// What doesn't fit.
        reason: String,
    },
    /// The checkpoint to go on from is unusable; another one may do.
    #[error("{refused}{}", offer(.run, .usable))]
    Refused {
        /// Why it is refused.
        refused: Box<CheckpointError>,
        /// The run folder.
        run: PathBuf,
        /// The newest usable one of the stage, with its step.
        usable: Option<(PathBuf, u64)>,
    },
}

fn offer(run: &Path, usable: &Option<(PathBuf, u64)>) -> String {
    match usable {
        Some((path, step)) => {
            let (run, path) = (run.display(), path.display());
            format!("\n  = another is whole (step {step}): continue from there with `--resume {run} --checkpoint {path}`")
        }
        None => "\n  = there is no other usable checkpoint of this stage: move the file away to start the stage anew".into(),
    }
}

/// Bytes that are no checkpoint of this version.
pub(crate) enum Unreadable {
    /// Another version of the program wrote them; the format that they name.
    Version(String),
    /// They aren't whole; what doesn't fit.
    Damaged(String),
}

impl<E: std::fmt::Display> From<E> for Unreadable {
    fn from(reason: E) -> Self {
        Self::Damaged(reason.to_string())
    }
}

impl Checkpoint {
    fn groups(&self) -> [(&'static str, &NamedTensors); 4] {
        [("weights", &self.weights), ("average", &self.average), ("first", &self.first), ("second", &self.second)]
    }

    /// The file's bytes.
    ///
    /// # Errors
    /// Only a fault of the program: names or sizes that safetensors refuses.
    pub fn to_bytes(&self) -> Result<Vec<u8>, safetensors::SafeTensorError> {
        let mut values: BTreeMap<String, Vec<u8>> = BTreeMap::new();
        for (group, tensors) in self.groups() {
            for (name, tensor) in tensors {
                let bytes = to_vec(tensor).iter().flat_map(|value| value.to_le_bytes()).collect();
                values.insert(format!("{group}/{name}"), bytes);
            }
        }
        let views = values
            .iter()
            .map(|(name, bytes)| TensorView::new(Dtype::F32, vec![bytes.len() / 4], bytes).map(|view| (name.as_str(), view)))
            .collect::<Result<Vec<_>, _>>()?;
        let state = serde_json::to_string(&self.state).unwrap_or_default();
        let digest = digest(&state, values.iter().map(|(name, bytes)| (name.as_str(), bytes.as_slice())));
        let metadata = HashMap::from([("format".into(), FORMAT.into()), ("state".into(), state), ("sha256".into(), digest)]);
        safetensors::serialize(views, Some(metadata))
    }

    /// Reads a file's bytes back onto a device.
    pub(crate) fn from_bytes(bytes: &[u8], device: &Device) -> Result<Self, Unreadable> {
        let (_, header) = SafeTensors::read_metadata(bytes)?;
        let metadata = header.metadata().clone().unwrap_or_default();
        let field = |name: &str| metadata.get(name).cloned().ok_or_else(|| format!("its header has no `{name}`"));
        let format = field("format")?;
        if format != FORMAT {
            return Err(Unreadable::Version(format));
        }
        let state_text = field("state")?;
        let tensors = SafeTensors::deserialize(bytes)?;
        let views: BTreeMap<String, TensorView<'_>> = tensors.tensors().into_iter().collect();
        if digest(&state_text, views.iter().map(|(name, view)| (name.as_str(), view.data()))) != field("sha256")? {
            return Err(
                "its values don't add up to the stored SHA-256: it was damaged, or put together from several files".into()
            );
        }
        let state = serde_json::from_str(&state_text).map_err(|error| format!("its state can't be read: {error}"))?;
        let mut checkpoint = Self { state, ..Self::default() };
        for (name, view) in views {
            let (group, parameter) = name.split_once('/').unwrap_or(("", &name));
            let group = match group {
                "weights" => &mut checkpoint.weights,
                "average" => &mut checkpoint.average,
                "first" => &mut checkpoint.first,
                "second" => &mut checkpoint.second,
                _ => return Err(format!("it holds an unknown tensor `{name}`").into()),
            };
            let values = view.data().chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
            group.insert(parameter.to_string(), from_vec(values, device));
        }
        Ok(checkpoint)
    }
}

fn digest<'a>(state: &str, values: impl Iterator<Item = (&'a str, &'a [u8])>) -> String {
    let mut hash = Sha256::new();
    hash.update(state);
    for (name, bytes) in values {
        hash.update((name.len() as u64).to_le_bytes());
        hash.update(name);
        hash.update((bytes.len() as u64).to_le_bytes());
        hash.update(bytes);
    }
    hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}
