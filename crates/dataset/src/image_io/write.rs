//! Writing: whole or not at all, and never over another file by accident.

use std::io::{Cursor, Write};
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

use exr::prelude::{AnyChannel, AnyChannels, Encoding, FlatSamples, Image, Layer, LayerAttributes, WritableImage};
use image::{ExtendedColorType, ImageEncoder, codecs::png::PngEncoder};
use ops::planes::Planes;

use super::ImageError;

/// What to do when the file exists.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Overwrite {
    /// Leave it and report.
    Refuse,
    /// Replace it (`--force`).
    Allow,
}

/// Writes bytes under a name in one step: a reader sees the old file or the new one, never a part.
///
/// # Errors
/// [`ImageError::Exists`] when the file exists and may not be replaced, [`ImageError::Write`] when the system refuses
/// (no such folder, no permission, disk full); nothing is left behind then.
pub fn write_bytes(path: &Path, bytes: &[u8], overwrite: Overwrite) -> Result<(), ImageError> {
    static COUNTER: AtomicU64 = AtomicU64::new(0);
    if overwrite == Overwrite::Refuse && path.exists() {
        return Err(ImageError::Exists { path: path.into() });
    }
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let number = COUNTER.fetch_add(1, Ordering::Relaxed);
    let temporary = path.with_file_name(format!(".{name}.{}-{number}.part", std::process::id()));
    let written = (|| {
        let mut file = std::fs::File::create(&temporary)?;
        file.write_all(bytes)?;
        file.sync_all()?;
        std::fs::rename(&temporary, path)
    })();
    written.map_err(|source| {
        // The name of the temporary file is ours alone; if it can't be removed either, the first error is the one to tell.
        let _ = std::fs::remove_file(&temporary);
        ImageError::Write { path: path.into(), source }
    })
}

/// Writes planes with values in \[0, 1\] as an 8-bit PNG (1 channel: grey, 3: RGB). Values are stored as they are.
///
/// # Errors
/// See [`write_bytes`]; [`ImageError::NonFinite`] and [`ImageError::WriteChannels`] for planes that no PNG can hold.
pub fn write_png8(path: &Path, planes: &Planes, overwrite: Overwrite) -> Result<(), ImageError> {
    let values = interleaved(path, planes)?;
    let bytes: Vec<u8> = values.iter().map(|v| (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u8).collect();
    let colour = if planes.channels == 3 { ExtendedColorType::Rgb8 } else { ExtendedColorType::L8 };
    write_png(path, planes, &bytes, colour, overwrite)
}

/// Writes planes with values in \[0, 1\] as a 16-bit PNG (1 channel: grey, 3: RGB). Values are stored as they are.
///
/// # Errors
/// See [`write_png8`].
pub fn write_png16(path: &Path, planes: &Planes, overwrite: Overwrite) -> Result<(), ImageError> {
    let values = interleaved(path, planes)?;
    // The encoder takes native byte order and stores big-endian.
    let bytes: Vec<u8> = values.iter().flat_map(|v| ((v.clamp(0.0, 1.0) * 65535.0 + 0.5) as u16).to_ne_bytes()).collect();
    let colour = if planes.channels == 3 { ExtendedColorType::Rgb16 } else { ExtendedColorType::L16 };
    write_png(path, planes, &bytes, colour, overwrite)
}

fn write_png(
    path: &Path,
    planes: &Planes,
    bytes: &[u8],
    colour: ExtendedColorType,
    overwrite: Overwrite,
) -> Result<(), ImageError> {
    let mut file = Vec::new();
    PngEncoder::new(&mut file)
        .write_image(bytes, planes.width as u32, planes.height as u32, colour)
        .map_err(|e| ImageError::Write { path: path.into(), source: std::io::Error::other(e) })?;
    write_bytes(path, &file, overwrite)
}

/// Writes planes as a 32-bit float EXR (1 channel: Y, 3: R, G, B), lossless. Values are linear by that format's definition.
///
/// # Errors
/// See [`write_png8`].
pub fn write_exr(path: &Path, planes: &Planes, overwrite: Overwrite) -> Result<(), ImageError> {
    interleaved(path, planes)?;
    let names: &[&str] = if planes.channels == 3 { &["R", "G", "B"] } else { &["Y"] };
    let list = names.iter().enumerate().map(|(c, name)| AnyChannel::new(*name, FlatSamples::F32(planes.plane(c).to_vec())));
    let channels = AnyChannels::sort(list.collect());
    let layer = Layer::new((planes.width, planes.height), LayerAttributes::default(), Encoding::SMALL_LOSSLESS, channels);
    let mut file = Cursor::new(Vec::new());
    Image::from_layer(layer)
        .write()
        .to_buffered(&mut file)
        .map_err(|e| ImageError::Write { path: path.into(), source: std::io::Error::other(e.to_string()) })?;
    write_bytes(path, &file.into_inner(), overwrite)
}

fn interleaved(path: &Path, planes: &Planes) -> Result<Vec<f32>, ImageError> {
    if planes.channels != 1 && planes.channels != 3 {
        return Err(ImageError::WriteChannels { path: path.into(), channels: planes.channels });
    }
    let area = planes.area();
    if let Some(i) = planes.data.iter().position(|v| !v.is_finite()) {
        let pixel = i % area;
        return Err(ImageError::NonFinite { path: path.into(), x: pixel % planes.width, y: pixel / planes.width });
    }
    Ok((0..area).flat_map(|i| (0..planes.channels).map(move |c| planes.data[c * area + i])).collect())
}
