//! A folder of weights: the manifest up to the first zero byte, then the safetensors of every net.
#![no_main]

use std::fs;
use std::sync::LazyLock;

use burn::tensor::Device;
use fuzz::{show, split_at_zero};
use libfuzzer_sys::fuzz_target;
use tempfile::TempDir;

/// Written over by every input.
static FOLDER: LazyLock<TempDir> = LazyLock::new(|| tempfile::tempdir().expect("a folder for temporary files"));

fuzz_target!(|input: &[u8]| {
    let folder = FOLDER.path();
    let (manifest, tensors) = split_at_zero(input);
    let write = |name: &str, bytes: &[u8]| fs::write(folder.join(name), bytes).expect("the folder takes small files");
    write("manifest.json", manifest);
    for net in [flow::weights::ADJACENT, svbrdf::weights::NAME] {
        write(&format!("{net}.safetensors"), tensors);
    }
    let device = Device::flex();
    if let Err(error) = flow::weights::load(folder, flow::weights::ADJACENT, &device) {
        show(&error);
    }
    if let Err(error) = svbrdf::weights::load(folder, &device) {
        show(&error);
    }
});
