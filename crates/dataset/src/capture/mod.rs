//! Frames a person brings: a phone video (through ffmpeg), a folder of pictures, or a `.npy` array.
//!
//! Frames are read one after the other and made small at once, so memory is bounded by the frames that are kept. A clip
//! with more frames than the cap is thinned evenly over its whole length.

mod collect;
mod error;
mod folder;
mod npy;
mod transfer;
mod video;

use std::io::Read;
use std::path::{Path, PathBuf};

use ops::planes::Planes;
use serde::{Deserialize, Serialize};

pub use error::CaptureError;
pub use video::{Tools, complaints};

use crate::image_io::Picture;
use collect::{Collector, Fit};

/// Smallest side of a frame after cropping.
pub const MIN_SIDE: usize = 64;

/// How frames are cut to the shape that the nets see.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Crop {
    /// The largest square at the centre.
    #[default]
    Square,
    /// Nothing is cut.
    None,
}

/// How a clip is read.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CaptureConfig {
    /// Frame side after cropping (the shorter side without cropping), by area mean in linear light; larger than the source
    /// or absent keeps the source's.
    pub resolution: Option<usize>,
    /// How frames are cut.
    pub crop: Crop,
    /// Most frames that are kept; longer clips are thinned to every second, fourth … frame.
    pub max_frames: usize,
    /// Most memory for kept frames, in MiB; lowers `max_frames` where needed.
    pub max_mib: usize,
}

impl Default for CaptureConfig {
    fn default() -> Self {
        Self { resolution: None, crop: Crop::Square, max_frames: 600, max_mib: 2048 }
    }
}

impl CaptureConfig {
    /// Checks every value.
    ///
    /// # Errors
    /// [`CaptureError::Config`] for the first value out of range.
    pub fn validate(&self) -> Result<(), CaptureError> {
        let fail = |key, found: usize, expected| Err(CaptureError::Config { key, found, expected });
        match self.resolution {
            Some(side) if side < MIN_SIDE => return fail("resolution", side, "at least 64 pixels"),
            _ => {}
        }
        if self.max_frames < 2 {
            return fail("max_frames", self.max_frames, "at least 2");
        }
        if self.max_mib == 0 {
            return fail("max_mib", 0, "at least 1");
        }
        Ok(())
    }
}

/// What kind of source a clip was read from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum ClipKind {
    /// A video file.
    Video,
    /// A folder of pictures.
    Folder,
    /// A `.npy` array.
    Npy,
}

/// The frames of a scan.
#[derive(Clone, Debug)]
pub struct Clip {
    /// Gamma-encoded RGB frames of one size.
    pub frames: Vec<Planes>,
    /// Position of each frame in the source, from 0.
    pub indices: Vec<usize>,
    /// Where they come from.
    pub source: PathBuf,
    /// What kind of source that is.
    pub kind: ClipKind,
    /// Mean frame rate of the source, where it states one.
    pub fps: Option<f64>,
    /// Field of view across a frame's width, in degrees, where the pictures' EXIF data tell the focal length.
    pub fov_deg: Option<f64>,
    /// What the reader should know: dropped black frames, thinning, decoder complaints.
    pub notes: Vec<String>,
}

/// Reads a clip: a folder of PNG, JPEG or EXR frames (in natural order), a `.npy` array `[frames, height, width, 3]`, or
/// anything else as a video.
///
/// # Errors
/// Every way a clip can be unusable has its own [`CaptureError`], which says what to do.
pub fn read(path: &Path, config: &CaptureConfig) -> Result<Clip, CaptureError> {
    read_with(path, config, &Tools::default())
}

/// [`read`] with other names or places of the ffmpeg programs.
///
/// # Errors
/// As [`read`].
pub fn read_with(path: &Path, config: &CaptureConfig, tools: &Tools) -> Result<Clip, CaptureError> {
    config.validate()?;
    let meta = std::fs::metadata(path).map_err(|source| match source.kind() {
        std::io::ErrorKind::NotFound => CaptureError::Missing { path: path.into() },
        _ => CaptureError::Read { path: path.into(), source },
    })?;
    let mut collector = Collector::new(path, config);
    let extension = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    let (kind, fps) = if meta.is_dir() {
        folder::read(path, &mut collector)?;
        (ClipKind::Folder, None)
    } else if meta.len() == 0 {
        return Err(CaptureError::Empty { path: path.into() });
    } else if extension == "npy" {
        npy::read(path, &mut collector)?;
        (ClipKind::Npy, None)
    } else if folder::is_frame(path) {
        return Err(CaptureError::OneFrame { path: path.into() });
    } else {
        let fps = video::read(path, tools, &mut collector)?;
        (ClipKind::Video, fps)
    };
    collector.finish(kind, fps)
}

/// As [`read`] for a NumPy array of `length` bytes that may lie anywhere; errors name `path`.
///
/// # Errors
/// As [`read`].
pub fn decode_npy(array: impl Read, length: u64, path: &Path, config: &CaptureConfig) -> Result<Clip, CaptureError> {
    config.validate()?;
    let mut collector = Collector::new(path, config);
    npy::decode(array, length, path, &mut collector)?;
    collector.finish(ClipKind::Npy, None)
}

/// Reads one photo (a guidance image) as a gamma-encoded RGB frame, cut and made small like the frames of a clip.
///
/// # Errors
/// [`CaptureError::Image`], [`CaptureError::TooSmall`].
pub fn read_photo(path: &Path, config: &CaptureConfig) -> Result<Planes, CaptureError> {
    config.validate()?;
    let frame = Picture::read(path)?.to_frame();
    Ok(Fit::new(path, config, frame.width, frame.height)?.planes(frame))
}

#[cfg(test)]
mod tests;
