//! Weights on disk: one safetensors file per net and one `manifest.json` that says what the files are.
//!
//! A folder of weights holds `NAME.safetensors` for each net (`adjacent`, `distant`, `svbrdf`; several files where one would be too
//! large) and a [`Manifest`] with, for each, the architecture it fits, where it comes from and what it reached. Tensors carry the path of the parameter in the
//! module (`pyramid.levels.0.convs.1.weight`), so other programs can read them too.

mod error;
mod file;
mod manifest;
mod module;

pub use error::WeightsError;
pub use file::{Precision, StoredTensor, Tensors, load, read_tensors, save, write_tensors};
pub use manifest::{DataSource, Manifest, NetRecord, Port, Shard};
pub use module::{fill, tensors_of};

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

use burn::module::Module;
use file::{decode_file, read, sha256};
use half::f16;
use serde::{Serialize, de::DeserializeOwned};

/// Name of the manifest in a folder of weights.
pub const MANIFEST: &str = "manifest.json";
/// Version of the manifest this program writes and reads.
pub const MANIFEST_FORMAT: u32 = 1;

/// Nets with more weights than this beyond what their file can hold aren't built.
const MAX_MISSING: usize = 1 << 20;

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
    let architecture = serde_json::to_value(&description.architecture).map_err(|e| WeightsError::Architecture {
        path: folder.join(MANIFEST),
        net: net.into(),
        reason: e.to_string(),
    })?;
    let record = NetRecord {
        kind: description.kind.into(),
        architecture,
        precision,
        parameters: module.num_params(),
        sha256: None,
        shards: Vec::new(),
        inputs: Vec::new(),
        outputs: Vec::new(),
        training: description.training,
        data: Vec::new(),
        // JSON has no infinity: a figure that says "without bound" would make the manifest unreadable.
        metrics: description.metrics.into_iter().filter(|(_, value)| value.is_finite()).collect(),
    };
    add_net(folder, net, &tensors_of(module), record, u64::MAX)
}

/// Writes a net's tensors into a folder of weights, in files of up to `largest` bytes and the record's precision, and enters its
/// record in the manifest, which is made if need be. The record's files and their SHA-256 are filled in.
///
/// # Errors
/// As [`save_net`].
pub fn add_net(folder: &Path, net: &str, tensors: &Tensors, mut record: NetRecord, largest: u64) -> Result<(), WeightsError> {
    fs::create_dir_all(folder).map_err(|source| WeightsError::Write { path: folder.into(), source })?;
    let mut manifest = match Manifest::read(folder) {
        Ok(manifest) => manifest,
        Err(WeightsError::Missing { .. }) => Manifest::default(),
        Err(other) => return Err(other),
    };
    let mut shards = save_shards(folder, net, tensors, record.precision, largest)?;
    record.sha256 = if shards.len() == 1 { shards.pop().map(|whole| whole.sha256) } else { None };
    record.shards = shards;
    manifest.nets.insert(net.into(), record);
    manifest.write(folder)
}

/// Writes tensors as the file of a net or, if that would be larger than `largest` bytes, as several: each but the last as full
/// as the order of names allows, one tensor at least. Returns their names and SHA-256.
///
/// # Errors
/// If a file can't be written or a weight isn't finite in `precision`.
fn save_shards(
    folder: &Path,
    net: &str,
    tensors: &Tensors,
    precision: Precision,
    largest: u64,
) -> Result<Vec<Shard>, WeightsError> {
    let mut parts: Vec<(u64, Vec<_>)> = Vec::new();
    for tensor in tensors {
        let bytes = (tensor.1.values.len() * precision.bytes()) as u64;
        match parts.last_mut() {
            Some((full, part)) if *full + bytes <= largest => {
                *full += bytes;
                part.push(tensor);
            }
            _ => parts.push((bytes, vec![tensor])),
        }
    }
    let count = parts.len();
    let mut shards = Vec::with_capacity(count);
    for (index, (_, part)) in parts.into_iter().enumerate() {
        let file = match count {
            1 => format!("{net}.safetensors"),
            _ => format!("{net}-{:05}-of-{count:05}.safetensors", index + 1),
        };
        let sha256 = write_tensors(part.into_iter(), &folder.join(&file), precision)?;
        shards.push(Shard { file, sha256 });
    }
    Ok(shards)
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
    let (mut held, mut files) = (0, Vec::new());
    for (path, expected) in record.files(folder, net)? {
        let bytes = read(&path)?;
        if let Some(expected) = expected {
            let found = sha256(&bytes);
            if !expected.eq_ignore_ascii_case(&found) {
                return Err(WeightsError::Checksum { path, expected: expected.into(), found });
            }
        }
        held += bytes.len() / size_of::<f16>();
        files.push((path, bytes));
    }
    let path = files[0].0.clone();
    let bad = |reason: String| WeightsError::Architecture { path: folder.join(MANIFEST), net: net.into(), reason };
    let architecture = serde_json::from_value(record.architecture.clone()).map_err(|e| bad(e.to_string()))?;
    // Before room is made for them: a manifest can announce anything. Smaller gaps are told tensor by tensor.
    let needed = parameters(&architecture).map_err(bad)?;
    if needed > held + MAX_MISSING {
        return Err(WeightsError::TooFew { path, needed, held });
    }
    let mut tensors = Tensors::new();
    for (path, bytes) in files {
        for (tensor, stored) in decode_file(&bytes, &path)? {
            if tensors.contains_key(&tensor) {
                return Err(WeightsError::Twice { path, tensor });
            }
            tensors.insert(tensor, stored);
        }
    }
    let module = fill(build(architecture).map_err(bad)?, tensors, &path)?;
    Ok((module, record))
}

#[cfg(test)]
mod tests;
