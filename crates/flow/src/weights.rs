//! The two flow nets on disk: `adjacent.safetensors`, `distant.safetensors` and `manifest.json` in one folder.

use std::{collections::BTreeMap, path::Path};

use burn::tensor::Device;
use ops::weights::{Description, load_net, save_net};
pub use ops::weights::{Manifest, NetRecord, Precision, WeightsError};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::pwc::{Pwc, PwcConfig};

/// Kind of the flow nets in a manifest.
pub const KIND: &str = "pwc";
/// Name of the net for neighbouring frames.
pub const ADJACENT: &str = "adjacent";
/// Name of the net from a key frame to the guidance image.
pub const DISTANT: &str = "distant";

/// Both flow nets of a scan.
#[derive(Clone, Debug)]
pub struct FlowNets {
    /// For neighbouring frames.
    pub adjacent: Pwc,
    /// For a roughly aligned key frame and the guidance image.
    pub distant: Pwc,
}

impl FlowNets {
    /// Reads both nets from a folder of weights.
    ///
    /// # Errors
    /// If a file is missing, broken or doesn't fit its architecture.
    pub fn load(folder: &Path, device: &Device) -> Result<Self, WeightsError> {
        Ok(Self { adjacent: load(folder, ADJACENT, device)?.0, distant: load(folder, DISTANT, device)?.0 })
    }
}

/// Reads one flow net from a folder of weights: [`ADJACENT`], [`DISTANT`] or, for a pre-trained one, any other name.
///
/// # Errors
/// As [`FlowNets::load`].
pub fn load(folder: &Path, net: &str, device: &Device) -> Result<(Pwc, NetRecord), WeightsError> {
    load_net(folder, net, KIND, |config: PwcConfig| {
        config.validate().map_err(|e| e.to_string())?;
        // Every weight is replaced by the file's.
        Ok(config.init(device, &mut ChaCha8Rng::seed_from_u64(0)))
    })
}

/// Writes one flow net into a folder of weights and its manifest. `training` says how it was trained, `metrics` what it
/// reached.
///
/// # Errors
/// If a file can't be written or a weight isn't finite in `precision`.
pub fn save(
    folder: &Path,
    net: &str,
    pwc: &Pwc,
    training: String,
    metrics: BTreeMap<String, f64>,
    precision: Precision,
) -> Result<(), WeightsError> {
    let description = Description { kind: KIND, architecture: pwc.config().clone(), training, metrics };
    save_net(folder, net, pwc, description, precision)
}
