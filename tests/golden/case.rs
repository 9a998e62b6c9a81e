//! What the PyTorch twins wrote (see `generate/README.md`), and how far a result is from it.
//!
//! Shared by the tests of several crates through `#[path]`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use burn::tensor::{Device, Tensor, TensorData};
use safetensors::{Dtype, SafeTensors, tensor::TensorView};

/// Largest relative error of a comparison.
pub const TOLERANCE: f64 = 1e-4;

/// A path under `tests/golden`.
pub fn golden(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/golden").join(path)
}

/// The tensors of one file.
pub struct Case(BTreeMap<String, (Vec<usize>, Vec<f32>)>);

impl Case {
    /// Reads a file under `tests/golden`.
    pub fn read(path: &str) -> Self {
        let bytes = std::fs::read(golden(path)).unwrap_or_else(|e| panic!("{path}: {e}"));
        let file = SafeTensors::deserialize(&bytes).unwrap();
        Self(file.iter().map(|(name, view)| (name.into(), (view.shape().to_vec(), numbers(&view)))).collect())
    }

    fn array(&self, name: &str) -> &(Vec<usize>, Vec<f32>) {
        self.0.get(name).unwrap_or_else(|| panic!("no `{name}` in the fixture"))
    }

    /// The values of a tensor.
    pub fn values(&self, name: &str) -> &[f32] {
        &self.array(name).1
    }

    /// A tensor on a device.
    pub fn tensor<const D: usize>(&self, name: &str, device: &Device) -> Tensor<D> {
        let (shape, values) = self.array(name);
        let shape: [usize; D] = shape.as_slice().try_into().unwrap();
        Tensor::from_data(TensorData::new(values.clone(), shape), device)
    }
}

/// 8-bit values are pictures and masks: pictures stand for [0, 1] in steps of 1/255, masks hold 0 and 1 only.
fn numbers(view: &TensorView<'_>) -> Vec<f32> {
    match view.dtype() {
        Dtype::F32 => view.data().as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect(),
        Dtype::U8 if view.data().iter().all(|b| *b <= 1) => view.data().iter().map(|b| f32::from(*b)).collect(),
        Dtype::U8 => view.data().iter().map(|b| f32::from(*b) / 255.0).collect(),
        other => panic!("{other:?} in a fixture"),
    }
}

/// ‖found − expected‖ / ‖expected‖: no error where both vanish, an infinite one where only the expected does.
pub fn relative_norm(found: &[f32], expected: &[f32]) -> f64 {
    let norm = |values: Vec<f64>| values.into_iter().map(|v| v * v).sum::<f64>().sqrt();
    relative(found, expected, norm)
}

/// The largest difference over the largest expected magnitude.
pub fn relative_largest(found: &[f32], expected: &[f32]) -> f64 {
    relative(found, expected, |values| values.into_iter().fold(0.0, |largest, v| v.abs().max(largest)))
}

fn relative(found: &[f32], expected: &[f32], size: impl Fn(Vec<f64>) -> f64) -> f64 {
    assert_eq!(found.len(), expected.len());
    // Maxima would pass over NaN.
    assert!(found.iter().all(|v| v.is_finite()), "a result isn't finite");
    let error = size(found.iter().zip(expected).map(|(f, e)| f64::from(*f) - f64::from(*e)).collect());
    if error == 0.0 { 0.0 } else { error / size(expected.iter().map(|e| f64::from(*e)).collect()) }
}

/// The largest relative error of single numbers.
#[allow(dead_code, reason = "the optimiser's test has no use for it")]
pub fn worst_term(found: &[f32], expected: &[f32]) -> f64 {
    assert_eq!(found.len(), expected.len());
    found.iter().zip(expected).map(|(f, e)| relative_norm(&[*f], &[*e])).fold(0.0, f64::max)
}
