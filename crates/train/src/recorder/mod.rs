//! Where the numbers and pictures of a run go.

mod event_file;
mod histogram;
mod metrics;
mod previews;
mod status;
mod tensorboard;

pub use event_file::read_scalars;
pub use histogram::{Histogram, Quantity};
pub use metrics::{Metrics, read_steps};
pub use previews::Previews;
pub use status::{Status, StatusFile, StoredStatus};
pub use tensorboard::TensorBoard;

use image::RgbImage;
use std::io;

/// What a row of numbers is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Losses of one optimiser step.
    Train,
    /// Measurements on held-out materials.
    Validate,
}

impl Kind {
    /// The word in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Train => "train",
            Self::Validate => "validate",
        }
    }
}

/// One row of numbers.
pub struct Row<'a> {
    /// Stage of the run.
    pub stage: &'a str,
    /// Optimiser steps so far.
    pub step: u64,
    /// What it is about.
    pub kind: Kind,
    /// Names and values.
    pub values: &'a [(String, f64)],
}

/// Takes in what a run reports.
pub trait Recorder {
    /// A row of numbers.
    ///
    /// # Errors
    /// The system's refusal to write.
    fn row(&mut self, row: &Row<'_>) -> io::Result<()>;

    /// A picture.
    ///
    /// # Errors
    /// The system's refusal to write.
    fn picture(&mut self, stage: &str, step: u64, name: &str, image: &RgbImage) -> io::Result<()>;

    /// How the values of one layer are spread; recorders without a place for it pass it over.
    ///
    /// # Errors
    /// The system's refusal to write.
    fn histogram(&mut self, _stage: &str, _step: u64, _of: Quantity, _layer: &str, _found: &Histogram) -> io::Result<()> {
        Ok(())
    }

    /// How the run is getting on, after every step; recorders that keep nothing of it pass it over.
    ///
    /// # Errors
    /// The system's refusal to write.
    fn status(&mut self, _status: &Status<'_>) -> io::Result<()> {
        Ok(())
    }

    /// Forgets what a stage reported after a step: the run goes on from there.
    ///
    /// # Errors
    /// The system's refusal to write.
    fn rewind(&mut self, stage: &str, step: u64) -> io::Result<()>;

    /// Brings everything to the disk.
    ///
    /// # Errors
    /// The system's refusal to write.
    fn flush(&mut self) -> io::Result<()>;
}

impl Recorder for Vec<Box<dyn Recorder>> {
    fn row(&mut self, row: &Row<'_>) -> io::Result<()> {
        self.iter_mut().try_for_each(|recorder| recorder.row(row))
    }

    fn picture(&mut self, stage: &str, step: u64, name: &str, image: &RgbImage) -> io::Result<()> {
        self.iter_mut().try_for_each(|recorder| recorder.picture(stage, step, name, image))
    }

    fn histogram(&mut self, stage: &str, step: u64, of: Quantity, layer: &str, found: &Histogram) -> io::Result<()> {
        self.iter_mut().try_for_each(|recorder| recorder.histogram(stage, step, of, layer, found))
    }

    fn status(&mut self, status: &Status<'_>) -> io::Result<()> {
        self.iter_mut().try_for_each(|recorder| recorder.status(status))
    }

    fn rewind(&mut self, stage: &str, step: u64) -> io::Result<()> {
        self.iter_mut().try_for_each(|recorder| recorder.rewind(stage, step))
    }

    fn flush(&mut self) -> io::Result<()> {
        self.iter_mut().try_for_each(|recorder| recorder.flush())
    }
}
