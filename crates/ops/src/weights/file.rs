//! One module, one safetensors file.

use std::{
    collections::BTreeMap,
    fs,
    io::{self, Write},
    path::{Path, PathBuf},
};

use burn::{
    module::{Module, ModuleMapper, ModuleVisitor, Param},
    tensor::{Bool, Int, Tensor, TensorData},
};
use half::f16;
use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::WeightsError;

/// Number type of stored weights.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Precision {
    /// Half precision: released weights.
    F16,
    /// Single precision: exact.
    #[default]
    F32,
}

impl std::fmt::Display for Precision {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::F16 => "f16",
            Self::F32 => "f32",
        })
    }
}

/// Writes all parameters of a module as safetensors, atomically, and returns the file's SHA-256.
///
/// # Errors
/// If the file can't be written or a weight isn't finite in `precision`.
pub fn save<M: Module>(module: &M, path: &Path, precision: Precision) -> Result<String, WeightsError> {
    let mut collector = Collector::default();
    module.visit(&mut collector);
    let mut encoded = Vec::with_capacity(collector.tensors.len());
    for (name, shape, values) in collector.tensors {
        let bytes = encode(&values, precision).ok_or_else(|| WeightsError::NotFinite {
            path: path.into(),
            tensor: name.clone(),
            precision,
        })?;
        encoded.push((name, shape, bytes));
    }
    let dtype = match precision {
        Precision::F16 => Dtype::F16,
        Precision::F32 => Dtype::F32,
    };
    let views = encoded.iter().map(|(name, shape, bytes)| {
        (name.as_str(), TensorView::new(dtype, shape.clone(), bytes).expect("as many bytes as the shape says"))
    });
    let file = safetensors::serialize(views, None).expect("the views were just made");
    write_atomically(path, &file)?;
    Ok(sha256(&file))
}

/// Fills a module with the weights of a file, whatever their precision. Parameters keep their identity.
///
/// # Errors
/// If the file is missing, broken, or holds other tensors than the module has.
pub fn load<M: Module>(module: M, path: &Path) -> Result<M, WeightsError> {
    let bytes = read(path)?;
    fill(module, &bytes, path)
}

pub(super) fn fill<M: Module>(module: M, bytes: &[u8], path: &Path) -> Result<M, WeightsError> {
    let file = SafeTensors::deserialize(bytes)
        .map_err(|e| WeightsError::NotSafetensors { path: path.into(), reason: e.to_string() })?;
    let mut shapes = Shapes::default();
    module.visit(&mut shapes);

    let mut values = BTreeMap::new();
    for (tensor, expected) in shapes.found {
        let Ok(view) = file.tensor(&tensor) else {
            return Err(WeightsError::MissingTensor { path: path.into(), tensor, expected });
        };
        if view.shape() != expected {
            return Err(WeightsError::Shape { path: path.into(), tensor, expected, found: view.shape().to_vec() });
        }
        values.insert(tensor.clone(), decode(&view, tensor, path)?);
    }
    if let Some((tensor, view)) = file.iter().find(|(name, _)| !values.contains_key(*name)) {
        let found = view.shape().to_vec();
        return Err(WeightsError::UnexpectedTensor { path: path.into(), tensor: tensor.into(), found });
    }
    Ok(module.map(&mut Filler { path: Vec::new(), values }))
}

fn encode(values: &[f32], precision: Precision) -> Option<Vec<u8>> {
    match precision {
        Precision::F32 => values.iter().all(|v| v.is_finite()).then(|| values.iter().flat_map(|v| v.to_le_bytes()).collect()),
        Precision::F16 => {
            let halves: Vec<f16> = values.iter().map(|&v| f16::from_f32(v)).collect();
            halves.iter().all(|v| v.is_finite()).then(|| halves.iter().flat_map(|v| v.to_le_bytes()).collect())
        }
    }
}

fn decode(view: &TensorView<'_>, tensor: String, path: &Path) -> Result<Vec<f32>, WeightsError> {
    let (precision, values): (_, Vec<f32>) = match view.dtype() {
        Dtype::F32 => {
            let (words, _) = view.data().as_chunks::<4>();
            (Precision::F32, words.iter().map(|&b| f32::from_le_bytes(b)).collect())
        }
        Dtype::F16 => {
            let (words, _) = view.data().as_chunks::<2>();
            (Precision::F16, words.iter().map(|&b| f16::from_le_bytes(b).to_f32()).collect())
        }
        other => return Err(WeightsError::NumberType { path: path.into(), tensor, found: format!("{other:?}") }),
    };
    if values.iter().all(|v| v.is_finite()) {
        Ok(values)
    } else {
        Err(WeightsError::NotFinite { path: path.into(), tensor, precision })
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
    write().map_err(|source| WeightsError::Write { path: path.into(), source })
}

pub(super) fn sha256(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|b| format!("{b:02x}")).collect()
}

/// Names, shapes and values of all parameters.
#[derive(Default)]
struct Collector {
    path: Vec<String>,
    tensors: Vec<(String, Vec<usize>, Vec<f32>)>,
}

impl ModuleVisitor for Collector {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        let tensor = param.val();
        self.tensors.push((self.path.join("."), tensor.dims().to_vec(), crate::planes::values(tensor)));
    }

    fn visit_int<const D: usize>(&mut self, _: &Param<Tensor<D, Int>>) {
        unreachable!("the nets have float parameters only: {}", self.path.join("."));
    }

    fn visit_bool<const D: usize>(&mut self, _: &Param<Tensor<D, Bool>>) {
        unreachable!("the nets have float parameters only: {}", self.path.join("."));
    }

    fn enter_module(&mut self, name: &str, _container: &str) {
        self.path.push(name.into());
    }

    fn exit_module(&mut self, _name: &str, _container: &str) {
        self.path.pop();
    }
}

/// Names and shapes of all parameters, without making lazy ones.
#[derive(Default)]
struct Shapes {
    path: Vec<String>,
    found: Vec<(String, Vec<usize>)>,
}

impl ModuleVisitor for Shapes {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        self.found.push((self.path.join("."), param.lazy_shape().dims::<D>().to_vec()));
    }

    fn enter_module(&mut self, name: &str, _container: &str) {
        self.path.push(name.into());
    }

    fn exit_module(&mut self, _name: &str, _container: &str) {
        self.path.pop();
    }
}

/// Puts values in the place of parameters; [`fill`] has checked that each has one of its shape.
struct Filler {
    path: Vec<String>,
    values: BTreeMap<String, Vec<f32>>,
}

impl ModuleMapper for Filler {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        let Some(values) = self.values.remove(&self.path.join(".")) else {
            return param;
        };
        let data = TensorData::new(values, param.lazy_shape().dims::<D>());
        let tensor = Tensor::from_data(data, &param.lazy_device());
        let id = param.id;
        param.transform_for_load(tensor, id)
    }

    fn enter_module(&mut self, name: &str, _container: &str) {
        self.path.push(name.into());
    }

    fn exit_module(&mut self, _name: &str, _container: &str) {
        self.path.pop();
    }
}
