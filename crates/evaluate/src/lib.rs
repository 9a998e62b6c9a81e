//! Floor 4: how good a method is, measured on materials it never saw (paper §8; spec 6).
//!
//! A *protocol* makes test scans, runs the method and its baselines on identical frames and fills a table. [`synthetic`] is the
//! protocol that every training run ends with, [`alignment`] measures the alignment alone, under many conditions,
//! [`localisation`] how frame 0 is found in a guidance photo, [`compare`] measures one scan on disk; [`table`] writes tables as JSON, CSV and Markdown, [`sheet`] draws contact sheets, [`plot`] curves.

pub mod adjacent;
pub mod alignment;
pub mod baseline;
pub mod compare;
pub mod comparison;
pub mod localisation;
pub mod materials;
pub mod output;
pub mod plot;
pub mod report;
pub mod sheet;
pub mod statistics;
pub mod synthetic;
pub mod table;

use std::path::PathBuf;

/// Anything that stops an evaluation.
#[derive(Debug, thiserror::Error)]
pub enum EvaluateError {
    /// The test materials.
    #[error(transparent)]
    Materials(#[from] dataset::material::library::LibraryError),
    /// The scans' settings.
    #[error("evaluate: videos: {0}")]
    Videos(dataset::sequence::SequenceConfigError),
    /// The alignment refused its input.
    #[error(transparent)]
    Align(#[from] flow::align::AlignError),
    /// The reconstruction refused its input.
    #[error(transparent)]
    Fusion(#[from] svbrdf::net::fusion::FusionError),
    /// The weights.
    #[error(transparent)]
    Weights(#[from] ops::weights::WeightsError),
    /// A picture couldn't be written.
    #[error(transparent)]
    Image(#[from] dataset::image_io::ImageError),
    /// Maps on disk.
    #[error(transparent)]
    Maps(#[from] scan::export::maps::ReadMapsError),
    /// Maps and truth of different sizes.
    #[error("the maps in {maps} and the truth in {truth} differ in size; scan with the truth's size as --resolution")]
    Sizes {
        /// Folder and size of the maps.
        maps: String,
        /// Folder and size of the truth.
        truth: String,
    },
    /// A setting of a condition.
    #[error(transparent)]
    Setting(#[from] scan::settings::SettingError),
    /// A condition that doesn't exist.
    #[error(
        "--conditions: there is no `{found}`; expected names or groups, separated by commas: base, scans, ablation, all, {}",
        alignment::conditions::CONDITIONS.map(|c| c.name).join(", ")
    )]
    Condition {
        /// What was given.
        found: String,
    },
    /// A folder whose cases were measured otherwise.
    #[error(
        "{} holds cases of other settings, materials, nets or another version of the aligner: give another --out, or --force to remove them",
        folder.display()
    )]
    OtherSettings {
        /// The folder.
        folder: PathBuf,
    },
    /// A folder that can't be written to.
    #[error("writing to {}: {source}", folder.display())]
    Folder {
        /// The folder.
        folder: PathBuf,
        /// Why not.
        source: std::io::Error,
    },
    /// A file among the cases that isn't one.
    #[error("{}: {message}; remove it to measure that scan again", path.display())]
    Case {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        message: String,
    },
    /// A scan that couldn't be made a video.
    #[error(
        "encoding a scan as a video: {reason}. It needs ffmpeg with the codec (Debian, Ubuntu: `apt install ffmpeg`); \
         --conditions chooses rows that need none"
    )]
    NoEncoder {
        /// What is missing.
        reason: String,
    },
    /// A scan that can't be encoded.
    #[error("encoding a scan as a video in {}: {reason}", folder.display())]
    Encoding {
        /// The folder of the video.
        folder: PathBuf,
        /// Why not.
        reason: String,
    },
    /// A protocol's setting that can't work.
    #[error("evaluate: {name} = {found}: {expected}")]
    Config {
        /// Its name.
        name: &'static str,
        /// Its value.
        found: String,
        /// What would do.
        expected: &'static str,
    },
    /// The person or the training run asked to stop.
    #[error("the evaluation was stopped before it was finished; no table was written")]
    Stopped,
}
