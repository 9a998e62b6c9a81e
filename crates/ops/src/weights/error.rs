//! What can be wrong with weights on disk.

use std::{io, path::PathBuf};

use super::{MANIFEST_FORMAT, Precision};

/// What can be wrong with weights on disk.
#[derive(Debug, thiserror::Error)]
pub enum WeightsError {
    /// There is no such file.
    #[error("{} doesn't exist; give a folder of weights that holds it, or train the net", path.display())]
    Missing {
        /// The file.
        path: PathBuf,
    },
    /// The file can't be read.
    #[error("{} can't be read: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// The file can't be written.
    #[error("{} can't be written: {source}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// Not safetensors, or cut short.
    #[error("{} is not a complete safetensors file ({reason}); copy it again", path.display())]
    NotSafetensors {
        /// The file.
        path: PathBuf,
        /// What the reader met.
        reason: String,
    },
    /// The manifest isn't the JSON expected.
    #[error("{} is not a manifest of weights: {reason}", path.display())]
    BadManifest {
        /// The file.
        path: PathBuf,
        /// What the reader met.
        reason: String,
    },
    /// The manifest is of another version.
    #[error("{} is a manifest of format {found}, this program reads format {MANIFEST_FORMAT}", path.display())]
    Format {
        /// The file.
        path: PathBuf,
        /// Its version.
        found: u32,
    },
    /// The manifest lists no such net.
    #[error("{} lists no net `{net}` (it lists: {listed})", path.display())]
    NoNet {
        /// The manifest.
        path: PathBuf,
        /// The net looked for.
        net: String,
        /// The nets there are.
        listed: String,
    },
    /// The net is of another kind.
    #[error("net `{net}` in {} is a `{found}`, expected a `{expected}`", path.display())]
    Kind {
        /// The manifest.
        path: PathBuf,
        /// The net.
        net: String,
        /// The kind needed.
        expected: String,
        /// The kind recorded.
        found: String,
    },
    /// The architecture in the manifest can't be built.
    #[error("the architecture of net `{net}` in {} can't be built: {reason}", path.display())]
    Architecture {
        /// The manifest.
        path: PathBuf,
        /// The net.
        net: String,
        /// Why.
        reason: String,
    },
    /// The file isn't the one the manifest describes.
    #[error("{} has SHA-256 {found}, its manifest says {expected}; copy both again", path.display())]
    Checksum {
        /// The file.
        path: PathBuf,
        /// According to the manifest.
        expected: String,
        /// Of the file.
        found: String,
    },
    /// A file too small for the architecture in the manifest.
    #[error("{} can hold at most {held} weights, the architecture in its manifest has {needed}; copy both again", path.display())]
    TooFew {
        /// The file.
        path: PathBuf,
        /// Weights of the architecture.
        needed: usize,
        /// Weights that the file has room for.
        held: usize,
    },
    /// A parameter of the net isn't in the file.
    #[error("{} lacks `{tensor}` of shape {expected:?}; the weights belong to another architecture", path.display())]
    MissingTensor {
        /// The file.
        path: PathBuf,
        /// The parameter.
        tensor: String,
        /// Its shape.
        expected: Vec<usize>,
    },
    /// The file holds a tensor the net hasn't.
    #[error("{} holds `{tensor}` of shape {found:?}, which this architecture hasn't", path.display())]
    UnexpectedTensor {
        /// The file.
        path: PathBuf,
        /// The tensor.
        tensor: String,
        /// Its shape.
        found: Vec<usize>,
    },
    /// A tensor that another file of the same net holds too.
    #[error("{} holds `{tensor}`, which another file of the net holds too; copy the whole folder again", path.display())]
    Twice {
        /// The file.
        path: PathBuf,
        /// The tensor.
        tensor: String,
    },
    /// A tensor of another shape.
    #[error("`{tensor}` in {} has shape {found:?}, this architecture expects {expected:?}", path.display())]
    Shape {
        /// The file.
        path: PathBuf,
        /// The tensor.
        tensor: String,
        /// The net's shape.
        expected: Vec<usize>,
        /// The file's shape.
        found: Vec<usize>,
    },
    /// A tensor of a number type other than f16, bf16 and f32.
    #[error("`{tensor}` in {} is stored as {found}, expected F16, BF16 or F32", path.display())]
    NumberType {
        /// The file.
        path: PathBuf,
        /// The tensor.
        tensor: String,
        /// Its type.
        found: String,
    },
    /// A weight that is no number, or too large for the chosen precision.
    #[error("`{tensor}` of {} holds a value that is not finite in {precision}", path.display())]
    NotFinite {
        /// The file.
        path: PathBuf,
        /// The tensor.
        tensor: String,
        /// The number type.
        precision: Precision,
    },
}
