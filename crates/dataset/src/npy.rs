//! The header of NumPy's `.npy` format (versions 1 to 3), which says what the numbers after it are.

use std::io::Read;

/// Longest header that is read; NumPy itself stops at 10 000 bytes.
const MAX_HEADER_BYTES: usize = 1 << 16;

/// What the header of an array in C order says.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Header {
    /// Type of the numbers in NumPy's words, like `|u1` or `<f4`.
    pub kind: String,
    /// Size of every axis, the slowest first.
    pub shape: Vec<usize>,
    /// Where the numbers begin, in bytes from the start of the file.
    pub data_start: u64,
}

impl Header {
    /// Whether the numbers are unsigned bytes.
    pub(crate) fn is_uint8(&self) -> bool {
        ["|u1", "<u1", "=u1"].contains(&self.kind.as_str())
    }

    /// The shape as NumPy prints it.
    pub(crate) fn shape_text(&self) -> String {
        format!("shape ({})", self.shape.iter().map(ToString::to_string).collect::<Vec<_>>().join(", "))
    }
}

/// Reads the header; the reader then stands at the first number.
///
/// # Errors
/// A sentence that says what was found.
pub(crate) fn read_header(reader: &mut impl Read) -> Result<Header, String> {
    let mut start = [0u8; 8];
    reader.read_exact(&mut start).map_err(|_| "the file is shorter than a header".to_string())?;
    if &start[..6] != b"\x93NUMPY" {
        return Err("it doesn't begin like a NumPy array".into());
    }
    let size_bytes = match start[6] {
        1 => 2,
        2 | 3 => 4,
        other => return Err(format!("version {other} of the format")),
    };
    let mut size = [0u8; 4];
    reader.read_exact(&mut size[..size_bytes]).map_err(|_| "the header is cut off".to_string())?;
    let length = u32::from_le_bytes(size) as usize;
    if length > MAX_HEADER_BYTES {
        return Err(format!("a header of {length} bytes"));
    }
    let mut text = vec![0u8; length];
    reader.read_exact(&mut text).map_err(|_| "the header is cut off".to_string())?;
    let (kind, shape) = parse(&String::from_utf8_lossy(&text))?;
    Ok(Header { kind, shape, data_start: (start.len() + size_bytes + length) as u64 })
}

/// Parses a header like `{'descr': '|u1', 'fortran_order': False, 'shape': (141, 256, 256, 3), }`.
fn parse(text: &str) -> Result<(String, Vec<usize>), String> {
    let value = |key: &str| Some(text.split_once(&format!("'{key}':"))?.1.trim_start());
    let quoted = |v: &str| v.strip_prefix('\'').and_then(|v| v.split_once('\'')).map(|(v, _)| v.to_string());
    let kind = value("descr").and_then(quoted).ok_or("the header names no number type")?;
    if value("fortran_order").is_none_or(|v| !v.starts_with("False")) {
        return Err("Fortran order".into());
    }
    let list = value("shape").and_then(|v| v.strip_prefix('(')).and_then(|v| v.split_once(')'));
    let list = list.ok_or("the header has no shape")?.0;
    let shape: Result<Vec<usize>, _> = list.split(',').map(str::trim).filter(|n| !n.is_empty()).map(str::parse).collect();
    Ok((kind, shape.map_err(|_| format!("shape ({list})"))?))
}

/// The bytes of a file with a header of version 1, for tests.
#[cfg(test)]
pub(crate) fn file(kind: &str, shape: &str, data: &[u8]) -> Vec<u8> {
    let mut header = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': ({shape}), }}");
    while (header.len() + 11) % 64 != 0 {
        header.push(' ');
    }
    header.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.as_bytes());
    bytes.extend(data);
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn headers_are_read_and_others_named() {
        let text = "{'descr': '<f4', 'fortran_order': False, 'shape': (5, 64, 80, 3), }";
        assert_eq!(parse(text), Ok(("<f4".into(), vec![5, 64, 80, 3])));
        let wrong = |from: &str, to: &str| parse(&text.replace(from, to)).unwrap_err();
        assert!(wrong("False", "True").contains("Fortran"));
        assert!(wrong("descr", "dtype").contains("no number type"));
        assert!(wrong("shape", "size").contains("no shape"));
        assert!(wrong("64", "99999999999999999999999").contains("shape (5, 9999"));

        let bytes = file("|u1", "2, 3", &[7; 6]);
        let header = read_header(&mut bytes.as_slice()).unwrap();
        assert!(header.is_uint8() && header.shape_text() == "shape (2, 3)");
        assert_eq!(bytes.len() as u64 - header.data_start, 6);
        let refused = |bytes: &[u8]| read_header(&mut &*bytes).unwrap_err();
        assert!(refused(&bytes[..7]).contains("shorter than a header"));
        assert!(refused(&bytes[..50]).contains("cut off"));
        assert!(refused(b"\x93NUMPY\x09\x00aaaa").contains("version 9"));
        assert!(refused(b"\x93NUMPY\x02\x00\xff\xff\xff\xff").contains("a header of 4294967295 bytes"));
    }

    proptest! {
        #[test]
        fn headers_of_any_text_never_panic(text in "(\\{|\\}|'descr': |'shape': |'fortran_order': |False|'\\|u1'|\\(|\\)|,|[0-9]{1,25}|é|')*") {
            let _ = parse(&text);
        }

        #[test]
        fn files_of_any_bytes_never_panic(version in 0u8..4, bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            let _ = read_header(&mut [b"\x93NUMPY" as &[u8], &[version, 0], &bytes].concat().as_slice());
            let _ = read_header(&mut bytes.as_slice());
        }
    }
}
