//! Scans as a phone stores them: encoded to a video and decoded again by ffmpeg.

use std::borrow::Cow;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::Mutex;

use dataset::capture::complaints;
use dataset::sequence::Sequence;
use flow::align::Footage;
use ops::planes::Planes;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use tempfile::TempDir;

use crate::EvaluateError;

/// No encoder.
const NONE: &str = "none";
/// Frames per second of a phone.
const RATE: f64 = 30.0;

/// The encoder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Encoding {
    /// ffmpeg's name of it, such as `libx264`; `none` aligns the frames as they come from the sensor.
    pub codec: String,
    /// Mean bits per pixel. Phones write 1920 × 1080 pixels 30 times a second at 17 Mbit/s: 0.27.
    pub bits_per_pixel: f64,
}

impl Default for Encoding {
    fn default() -> Self {
        Self { codec: NONE.into(), bits_per_pixel: 0.27 }
    }
}

impl Encoding {
    /// Whether there is an encoder.
    pub fn encodes(&self) -> bool {
        self.codec != NONE
    }

    /// Checks the values before any work.
    ///
    /// # Errors
    /// Names the first value that can't work.
    pub fn validate(&self) -> Result<(), EvaluateError> {
        if self.codec.trim().is_empty() {
            let expected = "ffmpeg's name of an encoder, such as libx264, or none";
            return Err(EvaluateError::Config { name: "encoding.codec", found: format!("{:?}", self.codec), expected });
        }
        if !(0.001..=24.0).contains(&self.bits_per_pixel) {
            let found = self.bits_per_pixel.to_string();
            return Err(EvaluateError::Config { name: "encoding.bits_per_pixel", found, expected: "0.001 to 24 bits" });
        }
        Ok(())
    }

    /// Encodes a grey frame, if there is an encoder, to see whether it can be run.
    ///
    /// # Errors
    /// [`EvaluateError::NoEncoder`] if ffmpeg or its encoder isn't there, others if it refuses.
    pub fn probe(&self) -> Result<(), EvaluateError> {
        const SIDE: usize = 64;
        if !self.encodes() {
            return Ok(());
        }
        let folder = temporary()?;
        self.encode(&folder.path().join("grey.mp4"), SIDE, |pipe| pipe.write_all(&[128; 3 * SIDE * SIDE]))
    }

    /// Encodes the frames that `feed` writes, as interleaved 8-bit RGB.
    fn encode(
        &self,
        video: &Path,
        side: usize,
        feed: impl FnOnce(&mut dyn Write) -> std::io::Result<()>,
    ) -> Result<(), EvaluateError> {
        let size = format!("{side}x{side}");
        let bits = format!("{}", (self.bits_per_pixel * (side * side) as f64 * RATE).ceil());
        let mut command = ffmpeg();
        command.args(["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", &size, "-r", &format!("{RATE}"), "-i", "-"]);
        command.args(["-c:v", &self.codec, "-b:v", &bits, "-pix_fmt", "yuv420p"]).arg(video).stdout(Stdio::null());
        run(command, video.parent().unwrap_or(video), feed)
    }
}

fn temporary() -> Result<TempDir, EvaluateError> {
    tempfile::tempdir().map_err(|source| EvaluateError::Folder { folder: std::env::temp_dir(), source })
}

/// A decoded scan on disk, read frame by frame: 3 bytes per pixel, 443 MB for 141 frames of 1024², among the temporary files.
/// It has no name there, so that it goes with the program however that ends.
pub struct Film {
    frames: Mutex<File>,
    count: usize,
    side: usize,
}

impl Film {
    /// Renders, encodes and decodes a scan.
    ///
    /// # Errors
    /// If ffmpeg isn't there or refuses, or the temporary folder can't be written to.
    pub fn shoot(sequence: &Sequence, side: usize, encoding: &Encoding) -> Result<Self, EvaluateError> {
        encoding.validate()?;
        let folder = temporary()?;
        let video = folder.path().join("scan.mp4");
        encoding.encode(&video, side, |pipe| {
            (0..sequence.len()).try_for_each(|frame| pipe.write_all(&bytes(&sequence.frame(frame, side))))
        })?;
        let failed = |source| EvaluateError::Folder { folder: std::env::temp_dir(), source };
        let raw = tempfile::tempfile().map_err(failed)?;
        let mut command = ffmpeg();
        command.arg("-i").arg(&video).args(["-f", "rawvideo", "-pix_fmt", "rgb24", "-"]);
        command.stdout(raw.try_clone().map_err(failed)?);
        run(command, folder.path(), |_| Ok(()))?;
        let (found, expected) = (raw.metadata().map_err(failed)?.len(), (sequence.len() * side * side * 3) as u64);
        if found != expected {
            let reason = format!("{found} bytes came back where {expected} were expected: frames were lost or added");
            return Err(EvaluateError::Encoding { folder: folder.path().into(), reason });
        }
        Ok(Self { frames: Mutex::new(raw), count: sequence.len(), side })
    }
}

impl Footage for Film {
    fn count(&self) -> usize {
        self.count
    }

    /// # Panics
    /// If the temporary file has become unreadable since it was written.
    fn frame(&self, index: usize) -> Cow<'_, Planes> {
        let area = self.side * self.side;
        let mut interleaved = vec![0u8; 3 * area];
        {
            let mut file = self.frames.lock().unwrap_or_else(|e| e.into_inner());
            let start = SeekFrom::Start((index * interleaved.len()) as u64);
            let read = file.seek(start).and_then(|_| file.read_exact(&mut interleaved));
            read.expect("a temporary file that was whole a moment ago");
        }
        let value = |i: usize| f32::from(interleaved[(i % area) * 3 + i / area]) / 255.0;
        Cow::Owned(Planes::from_vec(3, self.side, self.side, (0..3 * area).map(value).collect()))
    }
}

/// A frame as interleaved 8-bit RGB.
fn bytes(frame: &Planes) -> Vec<u8> {
    let area = frame.area();
    (0..3 * area).map(|i| (frame.data[(i % 3) * area + i / 3].clamp(0.0, 1.0) * 255.0).round() as u8).collect()
}

fn ffmpeg() -> Command {
    let mut command = Command::new("ffmpeg");
    command.args(["-hide_banner", "-v", "error", "-y"]);
    command
}

/// Runs ffmpeg on what `feed` writes; `folder` is where it writes to.
pub(super) fn run(
    mut command: Command,
    folder: &Path,
    feed: impl FnOnce(&mut dyn Write) -> std::io::Result<()>,
) -> Result<(), EvaluateError> {
    let fail = |reason: String| EvaluateError::Encoding { folder: folder.into(), reason };
    let spawned = command.stdin(Stdio::piped()).stderr(Stdio::piped()).spawn();
    let mut running = spawned.map_err(|e| EvaluateError::NoEncoder { reason: format!("`ffmpeg` can't be started: {e}") })?;
    let complaint = complaints(running.stderr.take());
    // Ends the pipe, too.
    let fed = running.stdin.take().map_or(Ok(()), |mut pipe| feed(&mut pipe));
    let status = running.wait().map_err(|e| fail(e.to_string()))?;
    let complaint = complaint.join().unwrap_or_default().trim().to_string();
    match (status.success(), fed) {
        (true, Ok(())) => Ok(()),
        _ if complaint.contains("Unknown encoder") => Err(EvaluateError::NoEncoder { reason: complaint }),
        // Why it ended says more than that its pipe broke.
        _ if !complaint.is_empty() => Err(fail(complaint)),
        (_, Err(e)) => Err(fail(e.to_string())),
        (_, Ok(())) => Err(fail(format!("ffmpeg ended with {status}"))),
    }
}
