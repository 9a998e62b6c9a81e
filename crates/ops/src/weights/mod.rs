//! Weights on disk: one safetensors file per net and one `manifest.json` that says what the files are.
//!
//! A folder of weights holds `NAME.safetensors` for each net (`adjacent`, `distant`, `svbrdf`) and a [`Manifest`] with, for
//! each, the architecture it fits, where it comes from and what it reached. Tensors carry the path of the parameter in the
//! module (`pyramid.levels.0.convs.1.weight`), so other programs can read them too.

mod error;
mod file;

pub use error::WeightsError;
pub use file::{Precision, load, save};

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

use burn::module::Module;
use file::{fill, read, sha256, write_atomically};
use half::f16;
use serde::{Deserialize, Serialize, de::DeserializeOwned};

/// Name of the manifest in a folder of weights.
pub const MANIFEST: &str = "manifest.json";
/// Version of the manifest this program writes and reads.
pub const MANIFEST_FORMAT: u32 = 1;

/// Nets with more weights than this beyond what their file can hold aren't built.
const MAX_MISSING: usize = 1 << 20;

/// What a folder of weights holds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// [`MANIFEST_FORMAT`].
    pub format: u32,
    /// One record per net, by name.
    pub nets: BTreeMap<String, NetRecord>,
}

/// One net of a folder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NetRecord {
    /// What sort of net reads it, for example `pwc`.
    pub kind: String,
    /// The config the net is built from.
    pub architecture: serde_json::Value,
    /// Number type of the file.
    pub precision: Precision,
    /// How many weights.
    pub parameters: usize,
    /// SHA-256 of the file, in hexadecimal; checked when present.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sha256: Option<String>,
    /// How it was trained: command, data, steps.
    pub training: String,
    /// What it reached, by name.
    #[serde(default)]
    pub metrics: BTreeMap<String, f64>,
}

/// What [`save_net`] can't know from the net itself.
#[derive(Clone, Debug)]
pub struct Description<A> {
    /// What sort of net reads it, for example `pwc`.
    pub kind: &'static str,
    /// The config the net is built from.
    pub architecture: A,
    /// How it was trained: command, data, steps.
    pub training: String,
    /// What it reached, by name.
    pub metrics: BTreeMap<String, f64>,
}

impl Manifest {
    /// Reads the manifest of a folder.
    ///
    /// # Errors
    /// If there is none, or it isn't one.
    pub fn read(folder: &Path) -> Result<Self, WeightsError> {
        let path = folder.join(MANIFEST);
        let text = read(&path)?;
        let bad = |reason: String| WeightsError::BadManifest { path: path.clone(), reason };
        #[derive(Deserialize)]
        struct Version {
            format: u32,
        }
        let Version { format } = serde_json::from_slice(&text).map_err(|e| bad(e.to_string()))?;
        if format != MANIFEST_FORMAT {
            return Err(WeightsError::Format { path, found: format });
        }
        serde_json::from_slice(&text).map_err(|e| bad(e.to_string()))
    }

    /// The record of a net.
    ///
    /// # Errors
    /// If the net isn't listed or is of another kind.
    pub fn net(&self, folder: &Path, net: &str, kind: &str) -> Result<&NetRecord, WeightsError> {
        let path = folder.join(MANIFEST);
        let Some(record) = self.nets.get(net) else {
            let listed = self.nets.keys().map(String::as_str).collect::<Vec<_>>().join(", ");
            return Err(WeightsError::NoNet { path, net: net.into(), listed });
        };
        if record.kind != kind {
            let found = record.kind.clone();
            return Err(WeightsError::Kind { path, net: net.into(), expected: kind.into(), found });
        }
        Ok(record)
    }
}

/// Where a net's weights lie in a folder.
pub fn file_of(folder: &Path, net: &str) -> PathBuf {
    folder.join(format!("{net}.safetensors"))
}

/// Writes a net into a folder of weights and enters it in the manifest, which is made if need be.
///
/// # Errors
/// If a file can't be written, a weight isn't finite in `precision`, or the folder holds a manifest that can't be read.
pub fn save_net<M: Module, A: Serialize>(
    folder: &Path,
    net: &str,
    module: &M,
    description: Description<A>,
    precision: Precision,
) -> Result<(), WeightsError> {
    let manifest_path = folder.join(MANIFEST);
    fs::create_dir_all(folder).map_err(|source| WeightsError::Write { path: folder.into(), source })?;
    let mut manifest = match Manifest::read(folder) {
        Ok(manifest) => manifest,
        Err(WeightsError::Missing { .. }) => Manifest { format: MANIFEST_FORMAT, nets: BTreeMap::new() },
        Err(other) => return Err(other),
    };
    let architecture = serde_json::to_value(&description.architecture).map_err(|e| WeightsError::Architecture {
        path: manifest_path.clone(),
        net: net.into(),
        reason: e.to_string(),
    })?;
    let sha256 = save(module, &file_of(folder, net), precision)?;
    let record = NetRecord {
        kind: description.kind.into(),
        architecture,
        precision,
        parameters: module.num_params(),
        sha256: Some(sha256),
        training: description.training,
        metrics: description.metrics,
    };
    manifest.nets.insert(net.into(), record);
    let mut text = serde_json::to_vec_pretty(&manifest).expect("a manifest of strings and numbers is JSON");
    text.push(b'\n');
    write_atomically(&manifest_path, &text)
}

/// Reads a net from a folder of weights: builds it from the architecture in the manifest and fills it.
///
/// `parameters` says how many weights the net of a config has and `build` makes it; both may say why it can't be built.
///
/// # Errors
/// If a file is missing, broken, of another kind or doesn't fit.
pub fn load_net<M: Module, A: DeserializeOwned>(
    folder: &Path,
    net: &str,
    kind: &str,
    parameters: impl FnOnce(&A) -> Result<usize, String>,
    build: impl FnOnce(A) -> Result<M, String>,
) -> Result<(M, NetRecord), WeightsError> {
    let manifest = Manifest::read(folder)?;
    let record = manifest.net(folder, net, kind)?.clone();
    let path = file_of(folder, net);
    let bytes = read(&path)?;
    if let Some(expected) = &record.sha256 {
        let found = sha256(&bytes);
        if !expected.eq_ignore_ascii_case(&found) {
            return Err(WeightsError::Checksum { path, expected: expected.clone(), found });
        }
    }
    let bad = |reason: String| WeightsError::Architecture { path: folder.join(MANIFEST), net: net.into(), reason };
    let architecture = serde_json::from_value(record.architecture.clone()).map_err(|e| bad(e.to_string()))?;
    // Before room is made for them: a manifest can announce anything. Smaller gaps are told tensor by tensor.
    let (needed, held) = (parameters(&architecture).map_err(bad)?, bytes.len() / size_of::<f16>());
    if needed > held + MAX_MISSING {
        return Err(WeightsError::TooFew { path, needed, held });
    }
    let module = fill(build(architecture).map_err(bad)?, &bytes, &path)?;
    Ok((module, record))
}

#[cfg(test)]
mod tests;
