//! `manifest.json`: what the files of a folder of weights are.

use std::{
    collections::BTreeMap,
    ffi::OsStr,
    path::{Path, PathBuf},
};

use serde::{Deserialize, Serialize};

use super::{MANIFEST, MANIFEST_FORMAT, Precision, WeightsError, file::read, file::write_atomically, file_of};

/// What a folder of weights holds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// [`MANIFEST_FORMAT`].
    pub format: u32,
    /// One record per net, by name.
    pub nets: BTreeMap<String, NetRecord>,
    /// What the nets reached together.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub evaluation: BTreeMap<String, f64>,
}

impl Default for Manifest {
    /// One without nets.
    fn default() -> Self {
        Self { format: MANIFEST_FORMAT, nets: BTreeMap::new(), evaluation: BTreeMap::new() }
    }
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
    /// The files that hold the net together, where one would be too large.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub shards: Vec<Shard>,
    /// What the net takes, in order; where the manifest is for other programs.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub inputs: Vec<Port>,
    /// What it gives, in order.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub outputs: Vec<Port>,
    /// How it was trained: command, data, steps.
    pub training: String,
    /// What it learned from.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub data: Vec<DataSource>,
    /// What it reached, by name.
    #[serde(default)]
    pub metrics: BTreeMap<String, f64>,
}

/// One of several files of a net.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Shard {
    /// Its name in the folder.
    pub file: String,
    /// Its SHA-256, in hexadecimal.
    pub sha256: String,
}

/// An input or output of a net.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Port {
    /// What it is called.
    pub name: String,
    /// Its axes, for example `N × 3 × H × W`.
    pub shape: String,
    /// Its numbers: units, range, encoding.
    pub meaning: String,
}

/// Materials or weights of one origin that a net learned from.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DataSource {
    /// Where they come from.
    pub source: String,
    /// Their licence.
    pub licence: String,
    /// How many there are.
    pub count: usize,
    /// What they are called, where a licence may ask for it.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub names: Vec<String>,
}

impl NetRecord {
    /// The files of the net, each with its SHA-256 where the manifest has it.
    pub(super) fn files(&self, folder: &Path, net: &str) -> Result<Vec<(PathBuf, Option<&str>)>, WeightsError> {
        if self.shards.is_empty() {
            return Ok(vec![(file_of(folder, net), self.sha256.as_deref())]);
        }
        let file = |shard: &'_ Shard| {
            // A manifest from somewhere else doesn't lead out of its folder.
            let plain = Path::new(&shard.file).file_name() == Some(OsStr::new(&shard.file));
            plain.then(|| folder.join(&shard.file)).ok_or_else(|| WeightsError::BadManifest {
                path: folder.join(MANIFEST),
                reason: format!("net `{net}` has the file `{}`, expected the name of one in this folder", shard.file),
            })
        };
        self.shards.iter().map(|shard| Ok((file(shard)?, Some(shard.sha256.as_str())))).collect()
    }
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

    /// Writes the manifest into a folder, atomically.
    ///
    /// # Errors
    /// If it can't be written.
    pub fn write(&self, folder: &Path) -> Result<(), WeightsError> {
        let mut text = serde_json::to_vec_pretty(self).expect("a manifest of strings and numbers is JSON");
        text.push(b'\n');
        write_atomically(&folder.join(MANIFEST), &text)
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
