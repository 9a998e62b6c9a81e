//! Previews as PNG files, `previews/STAGE-STEP-NAME.png`.

use super::{Recorder, Row};
use image::RgbImage;
use std::io;
use std::path::PathBuf;

/// Writes pictures into a folder.
pub struct Previews {
    /// The folder.
    pub folder: PathBuf,
}

impl Recorder for Previews {
    fn row(&mut self, _row: &Row<'_>) -> io::Result<()> {
        Ok(())
    }

    fn picture(&mut self, stage: &str, step: u64, name: &str, image: &RgbImage) -> io::Result<()> {
        let mut bytes = io::Cursor::new(Vec::new());
        image.write_to(&mut bytes, image::ImageFormat::Png).map_err(io::Error::other)?;
        crate::atomic::write(&self.folder.join(format!("{stage}-{step:06}-{name}.png")), bytes.get_ref())
    }

    fn rewind(&mut self, _stage: &str, _step: u64) -> io::Result<()> {
        Ok(())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
