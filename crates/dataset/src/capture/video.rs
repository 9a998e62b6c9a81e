//! Videos, decoded by the ffmpeg programs on the PATH and read through a pipe, one frame at a time.

use std::ffi::OsString;
use std::io::{BufReader, ErrorKind, Read};
use std::path::Path;
use std::process::{Child, ChildStderr, Command, Stdio};
use std::thread::JoinHandle;

use super::CaptureError;
use super::collect::Collector;
use super::transfer::Transfer;
use crate::image_io::MAX_SIDE;

/// Names or paths of the programs.
#[derive(Clone, Debug)]
pub struct Tools {
    /// Decodes.
    pub ffmpeg: String,
    /// Describes.
    pub ffprobe: String,
}

impl Default for Tools {
    fn default() -> Self {
        Self { ffmpeg: "ffmpeg".into(), ffprobe: "ffprobe".into() }
    }
}

/// What ffprobe says of the first video stream.
struct Stream {
    fps: Option<f64>,
    transfer: Transfer,
    /// More than 8 bit per channel.
    deep: bool,
}

/// Reads all frames; returns the mean frame rate.
pub(super) fn read(path: &Path, tools: &Tools, collector: &mut Collector) -> Result<Option<f64>, CaptureError> {
    let stream = probe(path, tools)?;
    // Every stored frame once, whatever its time stamp; the option's name changed between versions.
    let mut complaint = decode(path, tools, &stream, &["-fps_mode", "passthrough"], collector)?;
    if complaint.contains("fps_mode") && collector.seen() == 0 {
        complaint = decode(path, tools, &stream, &["-vsync", "0"], collector)?;
    }
    if is_truncation(&complaint) {
        return Err(CaptureError::Truncated { path: path.into(), reason: last_line(&complaint) });
    }
    if collector.seen() == 0 {
        let reason = if complaint.is_empty() { "no frame came out".into() } else { last_line(&complaint) };
        return Err(CaptureError::NotAVideo { path: path.into(), reason });
    }
    if !complaint.is_empty() {
        collector.notes.push(format!("ffmpeg: {}", last_line(&complaint)));
    }
    Ok(stream.fps)
}

fn probe(path: &Path, tools: &Tools) -> Result<Stream, CaptureError> {
    let mut command = Command::new(&tools.ffprobe);
    command.args(["-v", "error", "-select_streams", "v:0", "-show_entries"]);
    command.args(["stream=avg_frame_rate,r_frame_rate,pix_fmt,color_transfer", "-of", "json"]);
    let output = command.arg(local(path)).stdin(Stdio::null()).output().map_err(|e| not_started(path, &tools.ffprobe, e))?;
    let complaint = String::from_utf8_lossy(&output.stderr).into_owned();
    if !output.status.success() {
        let reason = last_line(&complaint);
        return Err(if is_truncation(&complaint) && begins_like_a_video(path) {
            CaptureError::Truncated { path: path.into(), reason }
        } else {
            CaptureError::NotAVideo { path: path.into(), reason }
        });
    }
    let answer: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap_or_default();
    let stream = &answer["streams"][0];
    if !stream.is_object() {
        return Err(CaptureError::NoVideoStream { path: path.into() });
    }
    let text = |key: &str| stream[key].as_str().unwrap_or_default();
    let rate = |key: &str| {
        let (numerator, denominator) = text(key).split_once('/')?;
        let rate = numerator.parse::<f64>().ok()? / denominator.parse::<f64>().ok()?;
        (rate.is_finite() && rate > 0.0).then_some(rate)
    };
    let pixels = text("pix_fmt");
    let deep = ["10", "12", "14", "16"]
        .iter()
        .any(|bits| pixels.contains(&format!("p{bits}")) || pixels.contains(&format!("{bits}le")))
        || pixels.contains("48")
        || pixels.contains("64");
    Ok(Stream {
        fps: rate("avg_frame_rate").or_else(|| rate("r_frame_rate")),
        transfer: Transfer::from_name(text("color_transfer")),
        deep,
    })
}

/// Ends the decoder when reading stops early.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        // Both fail only when the process has ended already.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Decodes all frames into the collector; returns what ffmpeg complained of.
fn decode(
    path: &Path,
    tools: &Tools,
    stream: &Stream,
    timing: &[&str],
    collector: &mut Collector,
) -> Result<String, CaptureError> {
    let mut command = Command::new(&tools.ffmpeg);
    command.args(["-nostdin", "-hide_banner", "-v", "error", "-i"]).arg(local(path)).args(["-map", "0:v:0"]).args(timing);
    // PPM is raw RGB with the size before every frame, so rotated videos (ffmpeg turns them) need no arithmetic here.
    command.args(["-f", "image2pipe", "-c:v", "ppm", "-pix_fmt", if stream.deep { "rgb48be" } else { "rgb24" }, "-"]);
    let spawned = command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn();
    let mut running = Running(spawned.map_err(|e| not_started(path, &tools.ffmpeg, e))?);
    let complaint = complaints(running.0.stderr.take());
    let read = match running.0.stdout.take() {
        Some(stdout) => read_frames(path, BufReader::with_capacity(1 << 20, stdout), stream, collector),
        None => Ok(()),
    };
    if read.is_err() {
        drop(running);
        return read.map(|()| String::new());
    }
    let status = running.0.wait().map_err(|source| CaptureError::Read { path: path.into(), source })?;
    let complaint = complaint.join().unwrap_or_default();
    if !status.success() && collector.seen() > 0 && !is_truncation(&complaint) {
        let reason = last_line(&complaint);
        return Err(CaptureError::Broken { path: path.into(), frames: collector.seen(), reason });
    }
    Ok(complaint)
}

/// What a program complains of, read beside its frames: a talkative one would block on a full pipe. A bounded part, 64 KiB, is
/// enough for messages.
pub fn complaints(stderr: Option<ChildStderr>) -> JoinHandle<String> {
    std::thread::spawn(move || {
        let mut text = Vec::new();
        if let Some(mut stderr) = stderr {
            let _ = stderr.by_ref().take(1 << 16).read_to_end(&mut text);
            let _ = std::io::copy(&mut stderr, &mut std::io::sink());
        }
        String::from_utf8_lossy(&text).into_owned()
    })
}

fn read_frames(path: &Path, mut pipe: impl Read, stream: &Stream, collector: &mut Collector) -> Result<(), CaptureError> {
    let io = |source| CaptureError::Read { path: path.into(), source };
    let max = if stream.deep { 65_535 } else { 255 };
    let table = stream.transfer.table(max);
    let primaries = stream.transfer.primaries();
    let mut bytes = Vec::new();
    while let Some([width, height, found_max]) = read_ppm_header(&mut pipe).map_err(io)? {
        if found_max != max || width > MAX_SIDE || height > MAX_SIDE {
            let reason = format!("frames of {width}×{height} with values up to {found_max}");
            return Err(CaptureError::Broken { path: path.into(), frames: collector.seen(), reason });
        }
        bytes.resize(width * height * 3 * if stream.deep { 2 } else { 1 }, 0);
        pipe.read_exact(&mut bytes).map_err(|e| match e.kind() {
            ErrorKind::UnexpectedEof => {
                CaptureError::Broken { path: path.into(), frames: collector.seen(), reason: "a frame is cut off".into() }
            }
            _ => io(e),
        })?;
        collector.push(width, height, |fit| {
            if !stream.deep {
                return Ok(fit.integers(&bytes, width, &table, primaries));
            }
            let words: Vec<u16> = bytes.chunks_exact(2).map(|b| u16::from_be_bytes([b[0], b[1]])).collect();
            Ok(fit.integers(&words, width, &table, primaries))
        })?;
    }
    Ok(())
}

/// Columns, rows and largest value of the next PPM image; `None` at the end of the pipe.
fn read_ppm_header(pipe: &mut impl Read) -> std::io::Result<Option<[usize; 3]>> {
    let invalid = || std::io::Error::new(ErrorKind::InvalidData, "ffmpeg's frames don't begin like PPM images");
    let mut byte = [0u8];
    if pipe.read(&mut byte)? == 0 {
        return Ok(None);
    }
    let mut header = vec![byte[0]];
    // "P6", columns, rows and largest value, each followed by one white space.
    while header.iter().filter(|b| b.is_ascii_whitespace()).count() < 4 {
        if header.len() > 64 {
            return Err(invalid());
        }
        pipe.read_exact(&mut byte)?;
        header.push(byte[0]);
    }
    let text = String::from_utf8_lossy(&header);
    let mut words = text.split_ascii_whitespace();
    if words.next() != Some("P6") {
        return Err(invalid());
    }
    let mut number = || words.next().and_then(|w| w.parse().ok()).ok_or_else(invalid);
    Ok(Some([number()?, number()?, number()?]))
}

/// A path that ffmpeg can't take for an option or a network address.
fn local(path: &Path) -> OsString {
    let mut name = OsString::from("file:");
    name.push(path);
    name
}

fn not_started(path: &Path, program: &str, source: std::io::Error) -> CaptureError {
    match source.kind() {
        ErrorKind::NotFound => CaptureError::NoFfmpeg { path: path.into(), program: program.into() },
        _ => CaptureError::Read { path: program.into(), source },
    }
}

/// Whether ffmpeg's messages say that the end of the file is missing.
fn is_truncation(complaint: &str) -> bool {
    ["moov atom not found", "partial file", "Truncat", "truncated", "stream ends prematurely"]
        .iter()
        .any(|sign| complaint.contains(sign))
}

/// Whether a file has a container's beginning. ffprobe goes by the name and calls any text file named `.mp4` a cut video.
fn begins_like_a_video(path: &Path) -> bool {
    let mut start = [0u8; 8];
    let read = std::fs::File::open(path).and_then(|mut file| file.read_exact(&mut start));
    let boxes: [&[u8]; 6] = [b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip"];
    read.is_ok() && (boxes.contains(&&start[4..]) || start.starts_with(b"\x1a\x45\xdf\xa3") || start.starts_with(b"RIFF"))
}

fn last_line(text: &str) -> String {
    text.lines().map(str::trim).rfind(|l| !l.is_empty()).unwrap_or("no reason given").to_string()
}
