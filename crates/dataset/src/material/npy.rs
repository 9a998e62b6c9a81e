//! NumPy arrays of uint8, H×W×12: normal, diffuse, roughness and specular with three numbers each, the layout in which the
//! authors of the paper kept their materials.

use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

use super::error::MaterialError;
use super::four_maps::{AlbedoEncoding, FourMaps, Strides};
use super::stored::{MAX_STORED_SIDE, Material, MaterialInfo};
use crate::image_io::Samples;
use crate::npy::{Header, read_header};

/// Extension of the arrays.
pub const EXTENSION: &str = "npy";
/// Numbers of a texel: four maps of three.
const CHANNELS: usize = 12;

/// Reads an array. `roughness_squared`: the roughness is the square of the stored one (the authors square that of their
/// 4096² arrays and not that of their 1024² ones). While it is read, the file's bytes (201 MB at 4096²) stand beside the
/// material's.
///
/// # Errors
/// [`MaterialError::Read`] when the system refuses, [`MaterialError::Npy`] for a truncated file or an array of another kind.
pub fn load(
    path: &Path,
    albedo: AlbedoEncoding,
    roughness_squared: bool,
    info: MaterialInfo,
) -> Result<Material, MaterialError> {
    let read = |source| MaterialError::Read { path: path.into(), source };
    let file = File::open(path).map_err(read)?;
    let length = file.metadata().map_err(read)?.len();
    decode(BufReader::new(file), length, path, albedo, roughness_squared, info)
}

/// As [`load`] for an array of `length` bytes from anywhere; errors name `path`.
///
/// # Errors
/// As [`load`].
pub fn decode(
    mut reader: impl Read,
    length: u64,
    path: &Path,
    albedo: AlbedoEncoding,
    roughness_squared: bool,
    info: MaterialInfo,
) -> Result<Material, MaterialError> {
    let read = |source| MaterialError::Read { path: path.into(), source };
    let fail = |found| MaterialError::Npy { path: path.into(), found };
    let header = read_header(&mut reader).map_err(fail)?;
    let [height, width] = size(&header).map_err(fail)?;
    let bytes = height * width * CHANNELS;
    // Before room is made for them: a header can announce anything.
    let present = length.saturating_sub(header.data_start);
    if present < bytes as u64 {
        return Err(fail(format!("{bytes} bytes are announced, {present} are there: the file is truncated")));
    }
    let mut data = vec![0; bytes];
    reader.read_exact(&mut data).map_err(read)?;
    let strides = Strides { column: CHANNELS, row: width * CHANNELS, map: CHANNELS / 4 };
    FourMaps { samples: Samples::Eight(data), width, height, strides, albedo, roughness_squared }.build(info)
}

/// Rows and columns; an error says what was found.
fn size(header: &Header) -> Result<[usize; 2], String> {
    if !header.is_uint8() {
        return Err(format!("numbers of type {}", header.kind));
    }
    match header.shape[..] {
        [height, width, CHANNELS] if height.max(width) > MAX_STORED_SIDE => {
            Err(format!("{}, more than {MAX_STORED_SIDE} texels a side: make it smaller", header.shape_text()))
        }
        [height, width, CHANNELS] if height > 0 && width > 0 => Ok([height, width]),
        _ => Err(header.shape_text()),
    }
}
