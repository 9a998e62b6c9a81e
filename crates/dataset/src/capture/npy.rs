//! Frames in NumPy's `.npy` format, read one frame at a time.

use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

use ops::planes::Planes;

use super::CaptureError;
use super::collect::{Collector, light_table};
use crate::image_io::MAX_SIDE;
use crate::npy::{Header, read_header};

/// An array of frames.
#[derive(Debug, PartialEq)]
struct Frames {
    /// Bytes per number: 1 (uint8) or 4 (float32).
    bytes: usize,
    /// Frames, rows, columns.
    shape: [usize; 3],
}

/// Float frames may leave \[0, 1\] by this much (resampling overshoot); further means another encoding.
const FLOAT_SLACK: f32 = 0.05;

pub(super) fn read(path: &Path, collector: &mut Collector) -> Result<(), CaptureError> {
    let io = |source| CaptureError::Read { path: path.into(), source };
    let file = File::open(path).map_err(io)?;
    let length = file.metadata().map_err(io)?.len();
    decode(BufReader::new(file), length, path, collector)
}

/// The same for an array of `length` bytes from anywhere.
pub(super) fn decode(mut reader: impl Read, length: u64, path: &Path, collector: &mut Collector) -> Result<(), CaptureError> {
    let io = |source| CaptureError::Read { path: path.into(), source };
    let fail = |reason| CaptureError::Npy { path: path.into(), reason };
    let header = read_header(&mut reader).map_err(fail)?;
    let Frames { bytes, shape: [frames, height, width] } = frames_of(&header).map_err(fail)?;
    let frame_bytes = height * width * 3 * bytes;
    let present = length.saturating_sub(header.data_start) / frame_bytes as u64;
    if present < frames as u64 {
        let reason = format!("{frames} frames are announced, {present} are there");
        return Err(CaptureError::Truncated { path: path.into(), reason });
    }
    let table = light_table(255);
    let mut buffer = vec![0u8; frame_bytes];
    for frame in 0..frames {
        reader.read_exact(&mut buffer).map_err(io)?;
        collector.push(width, height, |fit| {
            if bytes == 1 {
                return Ok(fit.integers(&buffer, width, &table, None));
            }
            float_frame(path, frame, &buffer, height, width).map(|planes| fit.planes(planes))
        })?;
    }
    Ok(())
}

fn float_frame(path: &Path, frame: usize, bytes: &[u8], height: usize, width: usize) -> Result<Planes, CaptureError> {
    let mut planes = Planes::new(3, height, width);
    let (mut low, mut high) = (f32::INFINITY, f32::NEG_INFINITY);
    for (i, number) in bytes.chunks_exact(4).enumerate() {
        let value = f32::from_le_bytes([number[0], number[1], number[2], number[3]]);
        if !value.is_finite() {
            return Err(CaptureError::NonFinite { path: path.into(), frame });
        }
        (low, high) = (low.min(value), high.max(value));
        planes.data[(i % 3) * height * width + i / 3] = value.clamp(0.0, 1.0);
    }
    if low < -FLOAT_SLACK || high > 1.0 + FLOAT_SLACK {
        return Err(CaptureError::Range { path: path.into(), frame, low, high });
    }
    Ok(planes)
}

/// What a header means for a reader of frames; an error says what was found.
fn frames_of(header: &Header) -> Result<Frames, String> {
    let bytes = match header.kind.as_str() {
        "<f4" => 4,
        _ if header.is_uint8() => 1,
        other => return Err(format!("numbers of type {other}")),
    };
    match header.shape[..] {
        [frames, height, width, 3] if frames > 0 && (1..=MAX_SIDE).contains(&height) && (1..=MAX_SIDE).contains(&width) => {
            Ok(Frames { bytes, shape: [frames, height, width] })
        }
        _ => Err(header.shape_text()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrays_of_frames_are_known_and_others_named() {
        let header = |kind: &str, shape: &[usize]| Header { kind: kind.into(), shape: shape.into(), data_start: 128 };
        let frames = frames_of(&header("<f4", &[5, 64, 80, 3]));
        assert_eq!(frames, Ok(Frames { bytes: 4, shape: [5, 64, 80] }));
        assert_eq!(frames_of(&header("|u1", &[5, 64, 80, 3])).unwrap().bytes, 1);
        let refused = |kind: &str, shape: &[usize]| frames_of(&header(kind, shape)).unwrap_err();
        assert!(refused("<f8", &[5, 64, 80, 3]).contains("<f8"));
        assert!(refused("<f4", &[5, 64, 80, 4]).contains("shape (5, 64, 80, 4)"));
        assert!(refused("<f4", &[64, 80, 3]).contains("shape (64, 80, 3)"));
        for shape in [[0, 64, 80, 3], [5, 0, 80, 3], [5, 64, 99_999, 3]] {
            assert!(refused("<f4", &shape).contains("shape"));
        }
    }
}
