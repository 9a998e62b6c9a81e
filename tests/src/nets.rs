//! Small nets with random weights, written by the library's own code: enough to run every path of the programs.

use std::collections::BTreeMap;
use std::path::Path;

use burn::tensor::Device;
use flow::pwc::PwcConfig;
use flow::weights::{ADJACENT, DISTANT};
use ops::weights::{Precision, WeightsError};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use svbrdf::net::SvbrdfNetConfig;

/// Writes a whole folder of weights, as a training run leaves it.
///
/// # Errors
/// If a file can't be written.
///
/// # Panics
/// If the nets' limits on widths and levels exclude what is built here.
pub fn write(folder: &Path) -> Result<(), WeightsError> {
    let (device, rng) = (Device::flex(), &mut ChaCha8Rng::seed_from_u64(11));
    let training = || "not at all: random weights of the acceptance tests".to_string();
    let pwc = PwcConfig {
        channels: vec![4, 4, 8],
        convs_per_level: 1,
        estimator: vec![8],
        radius: 1,
        context: Vec::new(),
        ..PwcConfig::slim()
    };
    for name in [ADJACENT, DISTANT] {
        let net = pwc.init(&device, rng);
        flow::weights::save(folder, name, &net, training(), BTreeMap::new(), Precision::F32)?;
    }
    let config = SvbrdfNetConfig { width: 4, levels: 3, dropout: 0.0, ..SvbrdfNetConfig::default() };
    let net = config.init(&device, rng).expect("a narrow, shallow net is a valid one");
    svbrdf::weights::save(folder, &net, training(), BTreeMap::new(), Precision::F32)
}
