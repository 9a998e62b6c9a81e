//! One safetensors file.

use std::{
    collections::BTreeMap,
    fs,
    io::{self, Write},
    path::{Path, PathBuf},
};

use burn::module::Module;
use half::{bf16, f16};
use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::{WeightsError, fill, tensors_of};

/// Number type of stored weights.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Precision {
    /// Half precision, 11 significant bits up to 65504: released weights.
    F16,
    /// Half the bits too: 8 significant ones over the range of single precision.
    Bf16,
    /// Single precision: exact.
    #[default]
    F32,
}

impl Precision {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::F32, Self::F16, Self::Bf16];

    /// What manifests and the command line call it.
    pub fn name(self) -> &'static str {
        match self {
            Self::F16 => "f16",
            Self::Bf16 => "bf16",
            Self::F32 => "f32",
        }
    }

    fn dtype(self) -> Dtype {
        match self {
            Self::F16 => Dtype::F16,
            Self::Bf16 => Dtype::BF16,
            Self::F32 => Dtype::F32,
        }
    }

    /// Bytes of a number.
    pub(super) fn bytes(self) -> usize {
        match self {
            Self::F16 | Self::Bf16 => 2,
            Self::F32 => 4,
        }
    }
}

impl std::fmt::Display for Precision {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

/// A tensor of a file, in single precision.
#[derive(Clone, Debug, PartialEq)]
pub struct StoredTensor {
    /// Its shape.
    pub shape: Vec<usize>,
    /// Its values, last axis fastest.
    pub values: Vec<f32>,
}

/// Tensors by name.
pub type Tensors = BTreeMap<String, StoredTensor>;

/// Writes all parameters of a module as safetensors, atomically, and returns the file's SHA-256.
///
/// # Errors
/// If the file can't be written or a weight isn't finite in `precision`.
pub fn save<M: Module>(module: &M, path: &Path, precision: Precision) -> Result<String, WeightsError> {
    write_tensors(tensors_of(module).iter(), path, precision)
}

/// Fills a module with the weights of a file, whatever their precision. Parameters keep their identity.
///
/// # Errors
/// If the file is missing, broken, or holds other tensors than the module has.
pub fn load<M: Module>(module: M, path: &Path) -> Result<M, WeightsError> {
    fill(module, read_tensors(path)?, path)
}

/// Writes tensors as safetensors, atomically, and returns the file's SHA-256.
///
/// # Errors
/// As [`save`].
pub fn write_tensors<'a>(
    tensors: impl Iterator<Item = (&'a String, &'a StoredTensor)>,
    path: &Path,
    precision: Precision,
) -> Result<String, WeightsError> {
    let mut encoded = Vec::new();
    for (name, stored) in tensors {
        let bytes = encode(&stored.values, precision).ok_or_else(|| WeightsError::NotFinite {
            path: path.into(),
            tensor: name.clone(),
            precision,
        })?;
        encoded.push((name, stored.shape.clone(), bytes));
    }
    let views = encoded.iter().map(|(name, shape, bytes)| {
        (name.as_str(), TensorView::new(precision.dtype(), shape.clone(), bytes).expect("as many bytes as the shape says"))
    });
    let file = safetensors::serialize(views, None).expect("the views were just made");
    write_atomically(path, &file)?;
    Ok(sha256(&file))
}

/// All tensors of a safetensors file, whatever their precision.
///
/// # Errors
/// If the file is missing or broken, or holds something else than finite floats.
pub fn read_tensors(path: &Path) -> Result<Tensors, WeightsError> {
    decode_file(&read(path)?, path)
}

pub(super) fn decode_file(bytes: &[u8], path: &Path) -> Result<Tensors, WeightsError> {
    let file = SafeTensors::deserialize(bytes)
        .map_err(|e| WeightsError::NotSafetensors { path: path.into(), reason: e.to_string() })?;
    let stored = |(name, view): (&str, TensorView<'_>)| {
        let shape = view.shape().to_vec();
        Ok((name.to_string(), StoredTensor { shape, values: decode(&view, name, path)? }))
    };
    file.iter().map(stored).collect()
}

/// Values as bytes; `None` when one isn't finite in `precision`.
fn encode(values: &[f32], precision: Precision) -> Option<Vec<u8>> {
    fn bytes<const N: usize>(values: &[f32], word: impl Fn(f32) -> ([u8; N], bool)) -> Option<Vec<u8>> {
        let mut bytes = Vec::with_capacity(values.len() * N);
        for &value in values {
            let (word, finite) = word(value);
            finite.then(|| bytes.extend(word))?;
        }
        Some(bytes)
    }
    match precision {
        Precision::F32 => bytes(values, |v| (v.to_le_bytes(), v.is_finite())),
        Precision::F16 => bytes(values, |v| (f16::from_f32(v).to_le_bytes(), f16::from_f32(v).is_finite())),
        Precision::Bf16 => bytes(values, |v| (bf16::from_f32(v).to_le_bytes(), bf16::from_f32(v).is_finite())),
    }
}

fn decode(view: &TensorView<'_>, tensor: &str, path: &Path) -> Result<Vec<f32>, WeightsError> {
    let halves = || view.data().as_chunks::<2>().0.iter();
    let (precision, values): (_, Vec<f32>) = match view.dtype() {
        Dtype::F32 => (Precision::F32, view.data().as_chunks::<4>().0.iter().map(|&b| f32::from_le_bytes(b)).collect()),
        Dtype::F16 => (Precision::F16, halves().map(|&b| f16::from_le_bytes(b).to_f32()).collect()),
        Dtype::BF16 => (Precision::Bf16, halves().map(|&b| bf16::from_le_bytes(b).to_f32()).collect()),
        other => {
            return Err(WeightsError::NumberType { path: path.into(), tensor: tensor.into(), found: format!("{other:?}") });
        }
    };
    if values.iter().all(|v| v.is_finite()) {
        Ok(values)
    } else {
        Err(WeightsError::NotFinite { path: path.into(), tensor: tensor.into(), precision })
    }
}

pub(super) fn read(path: &Path) -> Result<Vec<u8>, WeightsError> {
    fs::read(path).map_err(|source| match source.kind() {
        io::ErrorKind::NotFound | io::ErrorKind::NotADirectory => WeightsError::Missing { path: path.into() },
        _ => WeightsError::Read { path: path.into(), source },
    })
}

/// Writes beside the target and renames, so that a stop leaves the old file or the new one.
pub(super) fn write_atomically(path: &Path, bytes: &[u8]) -> Result<(), WeightsError> {
    let mut scratch = path.as_os_str().to_owned();
    scratch.push(".partial");
    let scratch = PathBuf::from(scratch);
    let write = || {
        let mut file = fs::File::create(&scratch)?;
        file.write_all(bytes)?;
        file.sync_all()?;
        fs::rename(&scratch, path)
    };
    write().map_err(|source| {
        // On a full disk the half file is what must go first.
        let _ = fs::remove_file(&scratch);
        WeightsError::Write { path: path.into(), source }
    })
}

pub(super) fn sha256(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|b| format!("{b:02x}")).collect()
}
