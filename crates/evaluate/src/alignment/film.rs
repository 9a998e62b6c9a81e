//! Scans as a phone stores them: encoded to a video and decoded again by ffmpeg.

use std::borrow::Cow;
use std::ffi::OsStr;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::Mutex;

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
        if !(0.001..=24.0).contains(&self.bits_per_pixel) {
            let found = self.bits_per_pixel.to_string();
            return Err(EvaluateError::Config { name: "encoding.bits_per_pixel", found, expected: "0.001 to 24 bits" });
        }
        Ok(())
    }
}

/// A decoded scan on disk, read frame by frame.
pub struct Film {
    frames: Mutex<File>,
    count: usize,
    side: usize,
    /// Goes with everything in it.
    _folder: TempDir,
}

impl Film {
    /// Renders, encodes and decodes a scan.
    ///
    /// # Errors
    /// If ffmpeg isn't there or refuses, or the temporary folder can't be written to.
    pub fn shoot(sequence: &Sequence, side: usize, encoding: &Encoding) -> Result<Self, EvaluateError> {
        encoding.validate()?;
        let folder = tempfile::tempdir().map_err(|source| EvaluateError::Folder { folder: std::env::temp_dir(), source })?;
        let (video, raw) = (folder.path().join("scan.mp4"), folder.path().join("scan.rgb"));
        let size = format!("{side}x{side}");
        let bits = format!("{}", (encoding.bits_per_pixel * (side * side) as f64 * RATE).ceil());
        let rate = format!("{RATE}");
        let raw_video = ["-f", "rawvideo", "-pix_fmt", "rgb24"];
        let encode = [&raw_video[..], &["-s", &size, "-r", &rate, "-i", "-"]].concat();
        let to_video = ["-c:v", &encoding.codec, "-b:v", &bits, "-pix_fmt", "yuv420p"];
        ffmpeg(&encode, None, &to_video, &video, |pipe| {
            (0..sequence.len()).try_for_each(|frame| pipe.write_all(&bytes(&sequence.frame(frame, side))))
        })?;
        ffmpeg(&[], Some(&video), &raw_video, &raw, |_| Ok(()))?;
        let failed = |source| EvaluateError::Folder { folder: folder.path().into(), source };
        let frames = File::open(&raw).map_err(failed)?;
        let (found, expected) = (frames.metadata().map_err(failed)?.len(), (sequence.len() * side * side * 3) as u64);
        if found != expected {
            let reason = format!("{found} bytes came back where {expected} were expected: frames were lost or added");
            return Err(EvaluateError::Encoding { reason });
        }
        Ok(Self { frames: Mutex::new(frames), count: sequence.len(), side, _folder: folder })
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

/// Runs ffmpeg with one input, a file or what `feed` writes, and one output.
fn ffmpeg(
    before: &[&str],
    input: Option<&Path>,
    after: &[&str],
    output: &Path,
    feed: impl FnOnce(&mut dyn Write) -> std::io::Result<()>,
) -> Result<(), EvaluateError> {
    let fail = |reason: String| EvaluateError::Encoding { reason };
    let mut command = Command::new("ffmpeg");
    command.args(["-hide_banner", "-v", "error", "-y"]).args(before);
    if let Some(path) = input {
        command.args([OsStr::new("-i"), path.as_os_str()]);
    }
    command.args(after).arg(output).stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::piped());
    let mut running = command.spawn().map_err(|e| fail(format!("`ffmpeg` can't be started ({e}); is it on the PATH?")))?;
    let fed = running.stdin.take().map_or(Ok(()), |mut pipe| feed(&mut pipe));
    let ended = running.wait_with_output().map_err(|e| fail(e.to_string()))?;
    let complaint = String::from_utf8_lossy(&ended.stderr);
    match (ended.status.success(), fed) {
        (true, Ok(())) => Ok(()),
        // Why it ended says more than that its pipe broke.
        (_, fed) => Err(fail(match (complaint.trim(), fed) {
            ("", Err(e)) => e.to_string(),
            ("", Ok(())) => format!("ffmpeg ended with {}", ended.status),
            (text, _) => text.to_string(),
        })),
    }
}
