//! Losses that are not numbers: found at once, with what led to them on the disk.

use std::io;
use std::path::{Path, PathBuf};

/// The first term of a step that isn't finite.
#[derive(Debug, Clone, PartialEq)]
pub struct NonFinite {
    /// Loss term, or `gradient_norm`.
    pub term: String,
    /// NaN or an infinity.
    pub value: f64,
}

/// Looks for a value that isn't finite.
pub fn check(values: &[(String, f64)]) -> Result<(), NonFinite> {
    match values.iter().find(|(_, value)| !value.is_finite()) {
        Some((term, value)) => Err(NonFinite { term: term.clone(), value: *value }),
        None => Ok(()),
    }
}

/// An array of an exemplar, for the dump.
#[derive(Debug, Clone, PartialEq)]
pub struct Array {
    /// What it is.
    pub name: String,
    /// Its shape.
    pub shape: Vec<usize>,
    /// Its values, last axis fastest.
    pub values: Vec<f32>,
}

/// Writes the batch on which a loss was not finite as `STAGE-STEP.safetensors` and returns the path.
///
/// # Errors
/// The system's refusal.
pub fn dump(folder: &Path, stage: &str, step: u64, arrays: &[Array]) -> io::Result<PathBuf> {
    use safetensors::tensor::{Dtype, TensorView};
    std::fs::create_dir_all(folder)?;
    let bytes: Vec<Vec<u8>> =
        arrays.iter().map(|array| array.values.iter().flat_map(|value| value.to_le_bytes()).collect()).collect();
    let views = arrays
        .iter()
        .zip(&bytes)
        .map(|(array, bytes)| TensorView::new(Dtype::F32, array.shape.clone(), bytes).map(|view| (array.name.as_str(), view)))
        .collect::<Result<Vec<_>, _>>()
        .map_err(io::Error::other)?;
    let path = folder.join(format!("{stage}-{step:08}.safetensors"));
    crate::atomic::write(&path, &safetensors::serialize(views, None).map_err(io::Error::other)?)?;
    Ok(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_bad_term_is_named() {
        let row =
            |values: [f64; 3]| ["total", "maps", "renderings"].map(String::from).into_iter().zip(values).collect::<Vec<_>>();
        assert_eq!(check(&row([1.0, 0.0, -3.0])), Ok(()));
        assert_eq!(check(&row([1.0, f64::INFINITY, f64::NAN])).unwrap_err().term, "maps");
    }

    #[test]
    fn the_dump_reads_back() {
        let home = tempfile::tempdir().unwrap();
        let array = Array { name: "frames".into(), shape: vec![1, 2], values: vec![f32::NAN, 2.0] };
        let path = dump(&home.path().join("failures"), "svbrdf", 7, &[array]).unwrap();
        let bytes = std::fs::read(path).unwrap();
        let tensors = safetensors::SafeTensors::deserialize(&bytes).unwrap();
        assert_eq!(tensors.tensor("frames").unwrap().shape(), [1, 2]);
        assert_eq!(tensors.tensor("frames").unwrap().data()[4..], 2.0_f32.to_le_bytes());
    }
}
