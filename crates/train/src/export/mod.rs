//! `train export`: the nets of a finished run as a folder that other programs read, with everything they need to know.
//!
//! The folder is a folder of weights ([`ops::weights`]), so `scan`, `evaluate` and `flow.init` take it too. Beside the weights lie a
//! model card (`README.md`), the nets in PyTorch with a loader (`python/` of the repository), and examples of inputs and outputs
//! by which any program can tell that it computes the same.

mod card;
mod examples;
mod net;
mod rounding;
mod run;

pub use rounding::Rounding;

use std::{
    fs,
    path::{Path, PathBuf},
};

use burn::tensor::Device;
use examples::Examples;
use net::Net;
use ops::weights::{MANIFEST, Manifest, NetRecord, Precision, StoredTensor, Tensors, WeightsError, add_net, write_tensors};
use run::FinishedRun;
use scan::output::{OutputError, Staging, check};

/// What PyTorch needs, as it lies in the repository.
const PYTHON: [(&str, &str); 3] = [
    ("load.py", include_str!("../../../../python/load.py")),
    ("pwc.py", include_str!("../../../../python/pwc.py")),
    ("svbrdf.py", include_str!("../../../../python/svbrdf.py")),
];
const CARD: &str = "README.md";
const EXAMPLES: &str = "examples.safetensors";

/// What to export, and how.
#[derive(Clone, Debug)]
pub struct Request {
    /// Run folder.
    pub run: PathBuf,
    /// Where to; it must not exist yet.
    pub out: PathBuf,
    /// Number type of the weights.
    pub precision: Precision,
    /// Nets whose weights take more bytes are cut into several files.
    pub largest_file: u64,
    /// Replace an earlier export.
    pub force: bool,
}

/// A net of an export.
#[derive(Clone, Debug)]
pub struct Exported {
    /// Its name.
    pub net: String,
    /// Its record in the manifest.
    pub record: NetRecord,
    /// What rounding the weights changes.
    pub rounding: Rounding,
}

/// An export that can't be made.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// No run.
    #[error("there is no run in {}: expected a folder with config.toml and run.json, as `train --config …` leaves it below runs/", path.display())]
    NoRun {
        /// The folder.
        path: PathBuf,
    },
    /// A run whose stages aren't all done.
    #[error("the run in {} isn't finished: it has no weights of {} yet; finish it with `train --resume {}`", path.display(), nets.join(", "), path.display())]
    Unfinished {
        /// The run.
        path: PathBuf,
        /// What is missing.
        nets: Vec<String>,
    },
    /// A record of the run that can't be read.
    #[error("{} can't be read: {reason}", path.display())]
    Record {
        /// The file.
        path: PathBuf,
        /// Why.
        reason: String,
    },
    /// A net of a kind that this program doesn't know.
    #[error("net `{net}` in {} is of the unknown kind `{kind}`", path.display())]
    Kind {
        /// The manifest.
        path: PathBuf,
        /// The net.
        net: String,
        /// Its kind.
        kind: String,
    },
    /// `--force` on something that isn't an export.
    #[error("{} is not an export (it lacks manifest.json, load.py or README.md), so `--force` does not replace it: choose another with `--out`", path.display())]
    Foreign {
        /// The folder.
        path: PathBuf,
    },
    /// The weights.
    #[error(transparent)]
    Weights(#[from] WeightsError),
    /// The folder.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// The examples.
    #[error("the example scan can't be made: {0}")]
    Example(String),
}

impl ExportError {
    /// Whether the command was wrong rather than what it met.
    pub fn is_usage(&self) -> bool {
        matches!(self, Self::NoRun { .. } | Self::Foreign { .. } | Self::Output(OutputError::Exists { .. }))
    }
}

/// Exports a run: everything or nothing.
///
/// # Errors
/// See [`ExportError`].
pub fn export(request: &Request) -> Result<Vec<Exported>, ExportError> {
    let Request { run, out, precision, largest_file, force } = request;
    check(out, *force)?;
    if out.exists() && !is_export(out) {
        return Err(ExportError::Foreign { path: out.clone() });
    }
    let run = FinishedRun::read(run)?;
    let (device, examples) = (Device::flex(), Examples::new()?);
    let staging = Staging::new(out)?;
    let folder = staging.folder();
    let (mut exported, mut cases) = (Vec::new(), Tensors::new());
    for (name, record) in &run.manifest.nets {
        let before = Net::load(&run.weights, name, record, &device)?;
        let ports = before.ports();
        let record = NetRecord {
            precision: *precision,
            inputs: ports.inputs,
            outputs: ports.outputs,
            data: run.data(name, record),
            ..record.clone()
        };
        add_net(folder, name, &before.tensors(), record.clone(), *largest_file)?;
        // From the disk: what is measured is what others will read.
        let after = Net::load(folder, name, &record, &device)?;
        let example = examples.of(name, &record.kind, &device);
        let (exact, rounded) = (before.run(&example), after.run(&example));
        let rounding = Rounding::between(&before.tensors(), &after.tensors(), &exact, &rounded);
        for (index, (input, tensor)) in example.into_iter().enumerate() {
            cases.insert(format!("{name}.input.{index}.{input}"), stored(tensor));
        }
        cases.insert(format!("{name}.output"), stored(rounded));
        exported.push(Exported { net: name.clone(), record, rounding });
    }
    let mut manifest = Manifest::read(folder)?;
    for net in &mut exported {
        let record = manifest.nets.get_mut(&net.net).expect("it was added above");
        record.metrics.extend(net.rounding.figures(&record.kind, *precision));
        net.record = record.clone();
    }
    manifest.evaluation = run.evaluation;
    manifest.write(folder)?;
    write_tensors(cases.iter(), &folder.join(EXAMPLES), Precision::F32)?;
    let texts = PYTHON.into_iter().map(|(name, text)| (name, text.to_string()));
    for (name, text) in texts.chain([(CARD, card::text(&run.facts, &manifest, &exported))]) {
        let path = folder.join(name);
        fs::write(&path, text).map_err(|source| OutputError::Write { path, source })?;
    }
    staging.finish()?;
    Ok(exported)
}

fn is_export(folder: &Path) -> bool {
    [MANIFEST, CARD, PYTHON[0].0].iter().all(|name| folder.join(name).is_file())
}

fn stored(tensor: burn::tensor::Tensor<4>) -> StoredTensor {
    StoredTensor { shape: tensor.dims().to_vec(), values: ops::planes::values(tensor) }
}
