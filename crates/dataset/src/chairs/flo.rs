//! The `.flo` flow file of Middlebury and FlyingChairs: "PIEH", width, height, then (x, y) per pixel, little-endian.

use std::path::{Path, PathBuf};

use ops::planes::Planes;

use crate::image_io::{ImageError, Overwrite, write_bytes};

/// The float 202021.25, whose bytes read "PIEH".
const MAGIC: [u8; 4] = *b"PIEH";
const HEADER_BYTES: usize = 12;
const MAX_SIDE: i32 = 1 << 15;

/// A flow file that can't be read or written.
#[derive(Debug, thiserror::Error)]
pub enum FloError {
    /// The file can't be read.
    #[error("{path}: {source}; check that the file exists and may be read", path = path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// The content isn't a flow file.
    #[error("{path}: {found}; expected a .flo file (\"PIEH\", width, height, then 8 bytes per pixel)", path = path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// What was found.
        found: String,
    },
    /// Couldn't be written, or exists already.
    #[error(transparent)]
    Write(#[from] ImageError),
    /// Only two planes make a flow.
    #[error("{path}: a flow has 2 planes, this image has {channels}", path = path.display())]
    NotAFlow {
        /// The file.
        path: PathBuf,
        /// Planes found.
        channels: usize,
    },
}

/// Reads a flow file into two planes (x, y) in pixels: `position in the second image = pixel of the first + flow`.
///
/// Values beyond 1e9 (the format's mark for "unknown") and values that aren't finite become NaN, which every consumer
/// treats as invalid.
///
/// # Errors
/// [`FloError`] names the file and what is wrong with it.
pub fn read(path: &Path) -> Result<Planes, FloError> {
    let bytes = std::fs::read(path).map_err(|source| FloError::Io { path: path.to_owned(), source })?;
    parse(&bytes).map_err(|found| FloError::Malformed { path: path.to_owned(), found })
}

/// Parses the bytes of a flow file.
///
/// # Errors
/// A sentence that says what was found instead.
pub fn parse(bytes: &[u8]) -> Result<Planes, String> {
    if bytes.len() < HEADER_BYTES {
        return Err(format!("the file has {} bytes and ends within the header", bytes.len()));
    }
    if bytes[..4] != MAGIC {
        return Err(format!("the file begins with {:?}", String::from_utf8_lossy(&bytes[..4])));
    }
    let side = |at: usize| i32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]);
    let (width, height) = (side(4), side(8));
    if !(1..=MAX_SIDE).contains(&width) || !(1..=MAX_SIDE).contains(&height) {
        return Err(format!("the header says {width}×{height} pixels"));
    }
    let (width, height) = (width as usize, height as usize);
    let body = &bytes[HEADER_BYTES..];
    if body.len() != width * height * 8 {
        return Err(format!(
            "the header says {width}×{height} pixels, which take {} bytes, but {} follow",
            width * height * 8,
            body.len()
        ));
    }
    let mut flow = Planes::new(2, height, width);
    for (i, pixel) in body.chunks_exact(8).enumerate() {
        for c in 0..2 {
            let value = f32::from_le_bytes([pixel[4 * c], pixel[4 * c + 1], pixel[4 * c + 2], pixel[4 * c + 3]]);
            flow.data[c * width * height + i] = if value.abs() < 1e9 { value } else { f32::NAN };
        }
    }
    Ok(flow)
}

/// Writes two planes (x, y) as a flow file; NaN is written as the format's mark for "unknown".
///
/// # Errors
/// [`FloError::NotAFlow`] for anything but two planes, [`FloError::Write`] as [`write_bytes`].
pub fn write(path: &Path, flow: &Planes, overwrite: Overwrite) -> Result<(), FloError> {
    if flow.channels != 2 {
        return Err(FloError::NotAFlow { path: path.to_owned(), channels: flow.channels });
    }
    let mut bytes = Vec::with_capacity(HEADER_BYTES + 4 * flow.data.len());
    bytes.extend_from_slice(&MAGIC);
    bytes.extend_from_slice(&(flow.width as i32).to_le_bytes());
    bytes.extend_from_slice(&(flow.height as i32).to_le_bytes());
    for (x, y) in flow.plane(0).iter().zip(flow.plane(1)) {
        for value in [x, y] {
            bytes.extend_from_slice(&(if value.is_finite() { *value } else { 1e10 }).to_le_bytes());
        }
    }
    Ok(write_bytes(path, &bytes, overwrite)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::damage::Damage;
    use proptest::prelude::*;

    fn small() -> Planes {
        Planes::from_vec(2, 2, 3, (0..12).map(|i| i as f32 * 0.75 - 3.0).collect())
    }

    fn bytes_of(flow: &Planes) -> Vec<u8> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.flo");
        write(&path, flow, Overwrite::Refuse).unwrap();
        std::fs::read(path).unwrap()
    }

    #[test]
    fn a_flow_comes_back_and_its_bytes_are_those_of_the_format() {
        let bytes = bytes_of(&small());
        assert_eq!(f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]), 202_021.25);
        assert_eq!(bytes[4..12], [3, 0, 0, 0, 2, 0, 0, 0]);
        assert_eq!(bytes[12..16], (-3.0f32).to_le_bytes());
        assert_eq!(bytes[16..20], 1.5f32.to_le_bytes(), "x and y alternate");
        assert_eq!(parse(&bytes).unwrap(), small());
    }

    #[test]
    fn unknown_pixels_survive_as_nan() {
        let mut flow = small();
        flow.data[4] = f32::NAN;
        assert!(parse(&bytes_of(&flow)).unwrap().data[4].is_nan());
    }

    #[test]
    fn malformed_files_are_named() {
        let good = bytes_of(&small());
        let refused = |bytes: &[u8]| parse(bytes).unwrap_err();
        assert!(refused(&good[..7]).contains("ends within the header"));
        assert!(refused(&good[..good.len() - 1]).contains("47 follow"));
        assert!(refused(b"P6\n3 2 255 and more bytes").contains("P6"));
        let mut negative = good.clone();
        negative[7] = 0xff;
        assert!(refused(&negative).contains("the header says -"));
        let missing = read(Path::new("no/such/file.flo")).unwrap_err().to_string();
        assert!(missing.contains("file.flo") && missing.contains("check that the file exists"));
        let three = write(Path::new("x.flo"), &Planes::new(3, 1, 1), Overwrite::Refuse).unwrap_err();
        assert!(three.to_string().contains("has 3"));
    }

    proptest! {
        #[test]
        fn any_bytes_are_read_or_refused(mut bytes in proptest::collection::vec(any::<u8>(), 0..64), whole: bool) {
            if whole && bytes.len() >= 4 {
                bytes[..4].copy_from_slice(b"PIEH");
            }
            if let Ok(flow) = parse(&bytes) {
                prop_assert_eq!(flow.data.len() * 4 + 12, bytes.len());
            }
        }

        #[test]
        fn damaged_files_are_read_or_refused(damage in Damage::any()) {
            let bytes = damage.done_to(&bytes_of(&small()));
            if let Ok(flow) = parse(&bytes) {
                prop_assert!(flow.channels == 2 && flow.data.iter().all(|v| v.is_nan() || v.abs() < 1e9));
            }
        }
    }
}
