//! Frames in NumPy's `.npy` format, read one frame at a time.

use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

use ops::planes::Planes;

use super::CaptureError;
use super::collect::{Collector, light_table};
use crate::image_io::MAX_SIDE;

/// What the header of an array says.
#[derive(Debug, PartialEq)]
struct Header {
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
    let mut reader = BufReader::new(file);
    let (header, offset) = read_header(&mut reader).map_err(|reason| CaptureError::Npy { path: path.into(), reason })?;
    let [frames, height, width] = header.shape;
    let frame_bytes = height * width * 3 * header.bytes;
    let present = (length - offset.min(length)) / frame_bytes as u64;
    if present < frames as u64 {
        let reason = format!("{frames} frames are announced, {present} are there");
        return Err(CaptureError::Truncated { path: path.into(), reason });
    }
    let table = light_table(255);
    let mut buffer = vec![0u8; frame_bytes];
    for frame in 0..frames {
        reader.read_exact(&mut buffer).map_err(io)?;
        collector.push(width, height, |fit| {
            if header.bytes == 1 {
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

/// The header and where the data begins; an error says what was found.
fn read_header(reader: &mut impl Read) -> Result<(Header, u64), String> {
    let mut start = [0u8; 8];
    reader.read_exact(&mut start).map_err(|_| "the file is shorter than a header".to_string())?;
    if &start[..6] != b"\x93NUMPY" {
        return Err("it doesn't begin like a NumPy array".into());
    }
    let mut size = [0u8; 4];
    let size_bytes = if start[6] == 1 { 2 } else { 4 };
    reader.read_exact(&mut size[..size_bytes]).map_err(|_| "the header is cut off".to_string())?;
    let length = u32::from_le_bytes(size) as u64;
    if length > 1 << 16 {
        return Err(format!("a header of {length} bytes"));
    }
    let mut text = vec![0u8; length as usize];
    reader.read_exact(&mut text).map_err(|_| "the header is cut off".to_string())?;
    Ok((parse_header(&String::from_utf8_lossy(&text))?, 8 + size_bytes as u64 + length))
}

/// Parses a header like `{'descr': '|u1', 'fortran_order': False, 'shape': (141, 256, 256, 3), }`.
fn parse_header(text: &str) -> Result<Header, String> {
    let value = |key: &str| {
        let after = text.split_once(&format!("'{key}':"))?.1.trim_start();
        Some(after)
    };
    let quoted = |v: &str| v.strip_prefix('\'').and_then(|v| v.split_once('\'')).map(|(v, _)| v.to_string());
    let kind = value("descr").and_then(quoted).ok_or("the header names no number type")?;
    let bytes = match kind.as_str() {
        "|u1" | "<u1" | "=u1" => 1,
        "<f4" => 4,
        other => return Err(format!("numbers of type {other}")),
    };
    if value("fortran_order").is_none_or(|v| !v.starts_with("False")) {
        return Err("Fortran order".into());
    }
    let list = value("shape").and_then(|v| v.strip_prefix('(')).and_then(|v| v.split_once(')'));
    let list = list.ok_or("the header has no shape")?.0;
    let shape: Result<Vec<usize>, _> = list.split(',').map(str::trim).filter(|n| !n.is_empty()).map(str::parse).collect();
    match shape.as_deref() {
        Ok(&[frames, height, width, 3]) if height <= MAX_SIDE && width <= MAX_SIDE && height * width > 0 => {
            Ok(Header { bytes, shape: [frames, height, width] })
        }
        _ => Err(format!("shape ({list})")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn headers_are_read_and_others_named() {
        let header = "{'descr': '<f4', 'fortran_order': False, 'shape': (5, 64, 80, 3), }";
        assert_eq!(parse_header(header), Ok(Header { bytes: 4, shape: [5, 64, 80] }));
        let wrong = |from: &str, to: &str| parse_header(&header.replace(from, to)).unwrap_err();
        assert!(wrong("<f4", "<f8").contains("<f8"));
        assert!(wrong("False", "True").contains("Fortran"));
        assert!(wrong(", 3)", ", 4)").contains("5, 64, 80, 4"));
        assert!(wrong("(5, ", "(").contains("64, 80, 3"));
        assert!(wrong("64", "99999999999999999999999").contains("shape"));
    }

    proptest! {
        #[test]
        fn headers_of_any_text_never_panic(text in "(\\{|\\}|'descr': |'shape': |'fortran_order': |False|'\\|u1'|\\(|\\)|,|[0-9]{1,25}|é|')*") {
            let _ = parse_header(&text);
        }

        #[test]
        fn files_of_any_bytes_never_panic(version in 0u8..4, bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            let _ = read_header(&mut [b"\x93NUMPY" as &[u8], &[version, 0], &bytes].concat().as_slice());
            let _ = read_header(&mut bytes.as_slice());
        }
    }
}
