//! Copies the nets of a run into a folder of released weights, in half precision.
//!
//! `cargo run -p scan --example release_weights -- runs/spiral/weights weights`

use std::path::Path;

use anyhow::{Context, bail};
use burn::tensor::Device;
use ops::weights::{Manifest, Precision};

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [from, to] = &arguments[..] else { bail!("usage: release_weights RUN/weights TARGET") };
    let (from, to, device) = (Path::new(from), Path::new(to), Device::flex());
    for (name, record) in Manifest::read(from)?.nets {
        let (training, metrics) = (record.training.clone(), record.metrics.clone());
        match record.kind.as_str() {
            flow::weights::KIND => {
                let (net, _) = flow::weights::load(from, &name, &device)?;
                flow::weights::save(to, &name, &net, training, metrics, Precision::F16)?;
            }
            svbrdf::weights::KIND => {
                let (net, _) = svbrdf::weights::load(from, &device)?;
                svbrdf::weights::save(to, &net, training, metrics, Precision::F16)?;
            }
            other => bail!("{}: net {name} is of unknown kind {other}", from.display()),
        }
        let size = std::fs::metadata(ops::weights::file_of(to, &name)).context("reading the new file's size")?.len();
        println!("{name}: {} weights, {} KiB", record.parameters, size / 1024);
    }
    Ok(())
}
