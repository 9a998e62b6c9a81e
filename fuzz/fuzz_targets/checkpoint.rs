//! PyTorch checkpoints of both containers, as `train import` reads them.
#![no_main]

use std::fs;
use std::sync::LazyLock;

use flow::pwc::release::from_release;
use fuzz::show;
use libfuzzer_sys::fuzz_target;
use tempfile::TempDir;
use train::import::checkpoint;

/// Written over by every input.
static FOLDER: LazyLock<TempDir> = LazyLock::new(|| tempfile::tempdir().expect("a folder for temporary files"));

fuzz_target!(|input: &[u8]| {
    let path = FOLDER.path().join("given.pth");
    fs::write(&path, input).expect("the folder takes small files");
    match checkpoint::read(&path) {
        Ok(tensors) => {
            for tensor in tensors.values() {
                assert_eq!(tensor.shape.iter().product::<usize>(), tensor.values.len());
                assert!(tensor.values.iter().all(|v| v.is_finite()));
            }
            if let Err(error) = from_release(tensors) {
                show(&error);
            }
        }
        Err(error) => show(&error),
    }
});
