//! What can be wrong with an image file.

use std::path::PathBuf;

/// A file that can't be read or written, and what to do.
#[derive(Debug, thiserror::Error)]
pub enum ImageError {
    /// Nothing there.
    #[error("{path}: no such file")]
    Missing {
        /// The file.
        path: PathBuf,
    },
    /// Zero bytes.
    #[error("{path}: the file is empty; copy or export it again")]
    Empty {
        /// The file.
        path: PathBuf,
    },
    /// The system refused.
    #[error("{path}: can't be read: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// Another kind of file.
    #[error("{path}: not a PNG, JPEG, EXR or HDR image (its first bytes are {start}); convert it to one of these")]
    Format {
        /// The file.
        path: PathBuf,
        /// Its first bytes, printable ones as text.
        start: String,
    },
    /// The end is missing.
    #[error("{path}: the {format} file is truncated; copy or export it again")]
    Truncated {
        /// The file.
        path: PathBuf,
        /// PNG, JPEG, EXR or HDR.
        format: &'static str,
    },
    /// The decoder gave up.
    #[error("{path}: broken {format} file: {reason}")]
    Decode {
        /// The file.
        path: PathBuf,
        /// PNG, JPEG, EXR or HDR.
        format: &'static str,
        /// The decoder's words.
        reason: String,
    },
    /// More pixels than any material or frame needs.
    #[error("{path}: {width}×{height} pixels; at most {max}×{max} are read, make it smaller", max = super::MAX_SIDE)]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// Channels that are neither grey nor red, green, blue.
    #[error("{path}: EXR channels {found}; expected R, G and B, or a single one")]
    Channels {
        /// The file.
        path: PathBuf,
        /// Their names.
        found: String,
    },
    /// NaN or infinity.
    #[error("{path}: NaN or infinite value at column {x}, row {y}; export it again without such values")]
    NonFinite {
        /// The file.
        path: PathBuf,
        /// Column.
        x: usize,
        /// Row.
        y: usize,
    },
    /// Would overwrite.
    #[error("{path} exists already; name another place or allow overwriting (--force)")]
    Exists {
        /// The file.
        path: PathBuf,
    },
    /// Couldn't be written; nothing was left behind.
    #[error("{path}: can't be written: {source}")]
    Write {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// Planes that no image format holds.
    #[error("{path}: {channels} channels; PNG and EXR files are written with 1 or 3")]
    WriteChannels {
        /// The file.
        path: PathBuf,
        /// How many there are.
        channels: usize,
    },
}
