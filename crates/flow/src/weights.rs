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
    let parameters = |config: &PwcConfig| {
        config.validate().map_err(|e| e.to_string())?;
        Ok(config.parameters())
    };
    // Every weight is replaced by the file's.
    let build = |config: PwcConfig| Ok(config.init(device, &mut ChaCha8Rng::seed_from_u64(0)));
    load_net(folder, net, KIND, parameters, build)
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

#[cfg(test)]
mod tests {
    use super::*;
    use burn::tensor::Tensor;
    use ops::planes::values;

    fn tiny(seed: u64) -> Pwc {
        let config = PwcConfig { channels: vec![4, 4, 4], estimator: vec![4], ..PwcConfig::slim() };
        config.init(&Device::flex(), &mut ChaCha8Rng::seed_from_u64(seed))
    }

    fn flow(net: &Pwc) -> Vec<f32> {
        let ramp: Tensor<4> = Tensor::<1, burn::tensor::Int>::arange(0..3 * 256, &Device::flex())
            .float()
            .reshape([1, 3, 16, 16])
            .div_scalar(768.0);
        values(net.flow(ramp.clone(), ramp.flip([2])))
    }

    #[test]
    fn both_nets_come_back_from_a_folder() {
        let folder = tempfile::tempdir().unwrap();
        let (adjacent, distant) = (tiny(1), tiny(2));
        for (name, net) in [(ADJACENT, &adjacent), (DISTANT, &distant)] {
            let metrics = BTreeMap::from([("epe_ratio".to_string(), 0.4)]);
            save(folder.path(), name, net, "a test".into(), metrics, Precision::F32).unwrap();
        }
        let nets = FlowNets::load(folder.path(), &Device::flex()).unwrap();
        assert_eq!((flow(&nets.adjacent), flow(&nets.distant)), (flow(&adjacent), flow(&distant)));
        assert_eq!(nets.adjacent.config(), adjacent.config());
    }

    #[test]
    fn a_missing_net_and_an_impossible_architecture_are_named() {
        let folder = tempfile::tempdir().unwrap();
        save(folder.path(), ADJACENT, &tiny(1), String::new(), BTreeMap::new(), Precision::F16).unwrap();
        let error = FlowNets::load(folder.path(), &Device::flex()).unwrap_err().to_string();
        assert!(error.contains("distant") && error.contains("adjacent"), "{error}");

        let path = folder.path().join(ops::weights::MANIFEST);
        let text = std::fs::read_to_string(&path).unwrap();
        let mut json: serde_json::Value = serde_json::from_str(&text).unwrap();
        json["nets"][ADJACENT]["architecture"]["radius"] = 90.into();
        std::fs::write(&path, json.to_string()).unwrap();
        let error = load(folder.path(), ADJACENT, &Device::flex()).unwrap_err().to_string();
        assert!(error.contains("radius") && error.contains("90"), "{error}");
    }
}
