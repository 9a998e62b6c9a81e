//! TensorBoard event files through tensorboard-rs: the only file that knows that crate.
//!
//! The crate is unmaintained and panics where writing fails. Curves are a convenience, so a failure ends this recorder
//! with one warning and the run goes on.

use super::{Histogram, Kind, Quantity, Recorder, Row};
use image::RgbImage;
use std::io;
use std::mem::ManuallyDrop;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use tensorboard_rs::summary_writer::SummaryWriter;

/// Writes scalars, images and histograms as TensorBoard events.
pub struct TensorBoard {
    /// Dropped by hand: the writer's own drop panics once its thread is gone.
    writer: Option<ManuallyDrop<SummaryWriter>>,
}

impl TensorBoard {
    /// Starts an event file in a folder; without one (no permission, full disk) the recorder stays silent.
    pub fn new(folder: &Path) -> Self {
        let writer = catch_unwind(|| SummaryWriter::new(folder)).ok();
        Self { writer: writer.map(ManuallyDrop::new) }
    }

    fn attempt(&mut self, write: impl FnOnce(&mut SummaryWriter)) {
        let Some(mut writer) = self.writer.take() else { return };
        match catch_unwind(AssertUnwindSafe(|| write(&mut writer))) {
            Ok(()) => self.writer = Some(writer),
            Err(_) => eprintln!("warning: TensorBoard events can't be written any more; metrics.jsonl has all numbers"),
        }
    }
}

/// Training curves by stage and term, measurements beside them.
fn tag(stage: &str, kind: Kind, name: &str) -> String {
    match kind {
        Kind::Train => format!("{stage}/{name}"),
        Kind::Validate => format!("{stage}-held-out/{name}"),
    }
}

impl Recorder for TensorBoard {
    fn row(&mut self, row: &Row<'_>) -> io::Result<()> {
        self.attempt(|writer| {
            for (name, value) in row.values {
                writer.add_scalar(&tag(row.stage, row.kind, name), *value as f32, row.step as usize);
            }
        });
        Ok(())
    }

    fn picture(&mut self, stage: &str, step: u64, name: &str, image: &RgbImage) -> io::Result<()> {
        // Row-major interleaved RGB under dims [3, WIDTH, HEIGHT]: the order in which the crate really reads them. (It writes the
        // summary's width and height fields exchanged; readers go by the PNG, as TensorBoard's EventAccumulator showed.)
        let dims = [3, image.width() as usize, image.height() as usize];
        self.attempt(|writer| writer.add_image(&format!("{stage}/{name}"), image.as_raw(), &dims, step as usize));
        Ok(())
    }

    fn histogram(&mut self, stage: &str, step: u64, of: Quantity, layer: &str, found: &Histogram) -> io::Result<()> {
        let Histogram { least, sum, sum_of_squares, ends, counts } = found;
        let largest = ends.last().copied().unwrap_or(*least);
        let tag = format!("{stage}-{}/{layer}", of.name());
        let number = counts.iter().sum();
        self.attempt(|writer| {
            writer.add_histogram_raw(&tag, *least, largest, number, *sum, *sum_of_squares, ends, counts, step as usize);
        });
        Ok(())
    }

    fn rewind(&mut self, _stage: &str, _step: u64) -> io::Result<()> {
        // Event files only grow; TensorBoard shows the newer value of a step.
        Ok(())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.attempt(SummaryWriter::flush);
        Ok(())
    }
}

impl Drop for TensorBoard {
    fn drop(&mut self) {
        if let Some(writer) = self.writer.take() {
            let _ = catch_unwind(AssertUnwindSafe(|| drop(ManuallyDrop::into_inner(writer))));
        }
    }
}

#[cfg(test)]
mod tests;
