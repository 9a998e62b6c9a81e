//! The SVBRDF net on disk: `svbrdf.safetensors` and `manifest.json` in a folder of weights.

use std::{collections::BTreeMap, path::Path};

use burn::tensor::Device;
use ops::weights::{Description, load_net, save_net};
pub use ops::weights::{Manifest, NetRecord, Precision, WeightsError};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::net::{SvbrdfNet, SvbrdfNetConfig};

/// Kind of the net in a manifest.
pub const KIND: &str = "svbrdf";
/// Name of the net.
pub const NAME: &str = "svbrdf";

/// Reads the net from a folder of weights.
///
/// # Errors
/// If a file is missing, broken or doesn't fit its architecture.
pub fn load(folder: &Path, device: &Device) -> Result<(SvbrdfNet, NetRecord), WeightsError> {
    let parameters = |config: &SvbrdfNetConfig| {
        config.validate().map_err(|e| e.to_string())?;
        Ok(config.parameters())
    };
    // Every weight is replaced by the file's.
    let build = |config: SvbrdfNetConfig| config.init(device, &mut ChaCha8Rng::seed_from_u64(0)).map_err(|e| e.to_string());
    load_net(folder, NAME, KIND, parameters, build)
}

/// Writes the net into a folder of weights and its manifest. `training` says how it was trained, `metrics` what it reached.
///
/// # Errors
/// If a file can't be written or a weight isn't finite in `precision`.
pub fn save(
    folder: &Path,
    net: &SvbrdfNet,
    training: String,
    metrics: BTreeMap<String, f64>,
    precision: Precision,
) -> Result<(), WeightsError> {
    let description = Description { kind: KIND, architecture: net.config().clone(), training, metrics };
    save_net(folder, NAME, net, description, precision)
}
