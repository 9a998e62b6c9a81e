//! TensorBoard: curves and pictures.
//!
//! They are a convenience, so a failure to write them ends this recorder with one warning and the run goes on.

use super::event_file::{self, EventFile};
use super::{Histogram, Kind, Quantity, Recorder, Row};
use image::RgbImage;
use protobuf::Message;
use std::io;
use std::path::{Path, PathBuf};
use tensorboard_rs::summary;

/// Writes scalars, images and histograms as TensorBoard events.
pub struct TensorBoard {
    folder: PathBuf,
    /// Begun with the first event.
    file: Option<EventFile>,
    failed: bool,
}

impl TensorBoard {
    /// A recorder that begins an event file of its own in the folder once there is something to write.
    pub fn new(folder: &Path) -> Self {
        Self { folder: folder.into(), file: None, failed: false }
    }

    fn add(&mut self, summary: &impl Message, step: u64) {
        self.attempt(|board| {
            let file = match board.file.take() {
                Some(file) => file,
                None => EventFile::create(&board.folder)?,
            };
            board.file.insert(file).add(summary, step)
        });
    }

    fn attempt(&mut self, write: impl FnOnce(&mut Self) -> io::Result<()>) {
        if self.failed {
            return;
        }
        if let Err(error) = write(self) {
            let folder = self.folder.display();
            eprintln!(
                "warning: TensorBoard events can't be written into {folder} any more ({error}); metrics.jsonl has all numbers"
            );
            self.failed = true;
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
        for (name, value) in row.values {
            self.add(&summary::scalar(&tag(row.stage, row.kind, name), *value as f32), row.step);
        }
        Ok(())
    }

    fn picture(&mut self, stage: &str, step: u64, name: &str, image: &RgbImage) -> io::Result<()> {
        // Row-major interleaved RGB under dims [3, WIDTH, HEIGHT]: the order in which the crate really reads them. (It writes the
        // summary's width and height fields exchanged; readers go by the PNG, as TensorBoard's EventAccumulator showed.)
        let dims = [3, image.width() as usize, image.height() as usize];
        self.add(&summary::image(&format!("{stage}/{name}"), image.as_raw(), &dims), step);
        Ok(())
    }

    fn histogram(&mut self, stage: &str, step: u64, of: Quantity, layer: &str, found: &Histogram) -> io::Result<()> {
        let Histogram { least, sum, sum_of_squares, ends, counts } = found;
        let largest = ends.last().copied().unwrap_or(*least);
        let tag = format!("{stage}-{}/{layer}", of.name());
        let number = counts.iter().sum();
        self.add(&summary::histogram_raw(&tag, *least, largest, number, *sum, *sum_of_squares, ends, counts), step);
        Ok(())
    }

    /// TensorBoard shows every value of a step that it finds, so those that will be repeated go.
    fn rewind(&mut self, stage: &str, step: u64) -> io::Result<()> {
        self.flush()?;
        self.attempt(|board| {
            if event_file::rewind(&board.folder, stage, step)? {
                // The open file may be one of those that were replaced.
                board.file = None;
            }
            Ok(())
        });
        Ok(())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.attempt(|board| board.file.as_mut().map_or(Ok(()), EventFile::flush));
        Ok(())
    }
}

#[cfg(test)]
mod tests;
