//! Reading: the bytes of a PNG, JPEG, EXR or HDR file to a [`Picture`].

use std::io::Cursor;
use std::panic::AssertUnwindSafe;
use std::path::Path;

use exr::meta::header::Header;
use exr::prelude::{FlatSamples, MetaData, ReadChannels, ReadLayers, read as read_exr};
use image::codecs::hdr::HdrDecoder;
use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader, Limits};

use super::{ImageError, MAX_SIDE, Picture, Samples};

/// Most memory a decoder may ask for: an RGB image of 16 bit at the largest size, and its rows in flight.
const MAX_DECODER_BYTES: u64 = (MAX_SIDE * MAX_SIDE * 4 * 2 + (64 << 20)) as u64;

/// Most bytes of pixels that a byte of an EXR file can stand for: DEFLATE reaches 1032, and PXR24 drops a byte of four before
/// it.
const MAX_EXR_RATIO: u64 = 1400;

/// Most pixels that a byte of an HDR file can stand for: a run of 255 takes four.
const MAX_HDR_RATIO: u64 = 64;

const PNG_START: &[u8] = b"\x89PNG\r\n\x1a\n";
const JPEG_START: &[u8] = b"\xff\xd8\xff";
const HDR_START: &[u8] = b"#?R";
const EXR_START: &[u8] = b"\x76\x2f\x31\x01";

pub(super) fn read(path: &Path) -> Result<Picture, ImageError> {
    let bytes = std::fs::read(path).map_err(|source| match source.kind() {
        std::io::ErrorKind::NotFound => ImageError::Missing { path: path.into() },
        _ => ImageError::Read { path: path.into(), source },
    })?;
    decode(&bytes, path)
}

pub(super) fn decode(bytes: &[u8], path: &Path) -> Result<Picture, ImageError> {
    if bytes.is_empty() {
        return Err(ImageError::Empty { path: path.into() });
    }
    if bytes.starts_with(EXR_START) {
        return guarded(path, "EXR", || decode_exr(path, bytes));
    }
    if bytes.starts_with(PNG_START) {
        return guarded(path, "PNG", || decode_integers(path, bytes, ImageFormat::Png, "PNG"));
    }
    if bytes.starts_with(JPEG_START) {
        if !has_jpeg_end(bytes) {
            return Err(ImageError::Truncated { path: path.into(), format: "JPEG" });
        }
        return guarded(path, "JPEG", || decode_integers(path, bytes, ImageFormat::Jpeg, "JPEG"));
    }
    if bytes.starts_with(HDR_START) {
        return guarded(path, "HDR", || decode_hdr(path, bytes));
    }
    let start = bytes[..bytes.len().min(8)].escape_ascii().to_string();
    Err(ImageError::Format { path: path.into(), start })
}

fn failed(path: &Path, format: &'static str, error: &image::ImageError) -> ImageError {
    let reason = error.to_string();
    if ["unexpected end", "UnexpectedEof", "failed to fill"].iter().any(|end| reason.contains(end)) {
        ImageError::Truncated { path: path.into(), format }
    } else {
        ImageError::Decode { path: path.into(), format, reason }
    }
}

fn decode_hdr(path: &Path, bytes: &[u8]) -> Result<Picture, ImageError> {
    let fail = |error: image::ImageError| failed(path, "HDR", &error);
    let decoder = HdrDecoder::new(Cursor::new(bytes)).map_err(fail)?;
    let (width, height) = decoder.dimensions();
    let (width, height) = (width as usize, height as usize);
    check_size(path, width, height)?;
    let pixels = (width * height) as u64;
    if pixels > MAX_HDR_RATIO * bytes.len() as u64 {
        return Err(ImageError::Truncated { path: path.into(), format: "HDR" });
    }
    if pixels * 12 > MAX_DECODER_BYTES {
        let reason = format!("its pixels take {} MiB; export it smaller", (pixels * 12) >> 20);
        return Err(ImageError::Decode { path: path.into(), format: "HDR", reason });
    }
    let values = DynamicImage::from_decoder(decoder).map_err(fail)?.into_rgb32f().into_raw();
    Ok(Picture { width, height, channels: 3, samples: Samples::Linear(values) })
}

/// The decoders are other people's and panic on some broken files: for a person, files like any other broken one.
fn guarded(
    path: &Path,
    format: &'static str,
    decode: impl FnOnce() -> Result<Picture, ImageError>,
) -> Result<Picture, ImageError> {
    // Nothing outlives a decoder that gave up half-way, so nothing half-done is seen.
    std::panic::catch_unwind(AssertUnwindSafe(decode)).unwrap_or_else(|_| {
        let reason = "the decoder gave up, as its parts contradict each other; export it again".into();
        Err(ImageError::Decode { path: path.into(), format, reason })
    })
}

fn decode_integers(path: &Path, bytes: &[u8], format: ImageFormat, name: &'static str) -> Result<Picture, ImageError> {
    let fail = |error: image::ImageError| failed(path, name, &error);
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    let mut limits = Limits::default();
    limits.max_alloc = Some(MAX_DECODER_BYTES);
    reader.limits(limits);
    let mut decoder = reader.into_decoder().map_err(fail)?;
    let (width, height) = decoder.dimensions();
    check_size(path, width as usize, height as usize)?;
    // A block of 8 × 8 pixels takes a bit at least. The decoder would make room for all and fill missing ones with grey.
    if format == ImageFormat::Jpeg && (bytes.len() as u64) * 8 < u64::from(width.div_ceil(8)) * u64::from(height.div_ceil(8)) {
        return Err(ImageError::Truncated { path: path.into(), format: name });
    }
    let orientation = decoder.orientation().map_err(fail)?;
    let mut image = DynamicImage::from_decoder(decoder).map_err(fail)?;
    image.apply_orientation(orientation);
    let (width, height) = (image.width() as usize, image.height() as usize);
    let grey = !image.color().has_color();
    let sixteen = image.color().bytes_per_pixel() / image.color().channel_count() == 2;
    let samples = match (sixteen, grey) {
        (false, true) => Samples::Eight(image.into_luma8().into_raw()),
        (false, false) => Samples::Eight(image.into_rgb8().into_raw()),
        (true, true) => Samples::Sixteen(image.into_luma16().into_raw()),
        (true, false) => Samples::Sixteen(image.into_rgb16().into_raw()),
    };
    Ok(Picture { width, height, channels: if grey { 1 } else { 3 }, samples })
}

fn decode_exr(path: &Path, bytes: &[u8]) -> Result<Picture, ImageError> {
    let fail = |error: exr::error::Error| match &error {
        exr::error::Error::Io(e) if e.kind() == std::io::ErrorKind::UnexpectedEof => {
            ImageError::Truncated { path: path.into(), format: "EXR" }
        }
        _ => ImageError::Decode { path: path.into(), format: "EXR", reason: error.to_string() },
    };
    let meta = MetaData::read_from_buffered(Cursor::new(bytes), false).map_err(fail)?;
    for header in &meta.headers {
        check_size(path, header.layer_size.x(), header.layer_size.y())?;
        check_room(path, bytes.len(), header)?;
    }
    let reader = read_exr().no_deep_data().largest_resolution_level().all_channels().first_valid_layer().all_attributes();
    let image = reader.from_buffered(Cursor::new(bytes)).map_err(fail)?;
    let (width, height) = (image.layer_data.size.x(), image.layer_data.size.y());
    check_size(path, width, height)?;
    let channels = &image.layer_data.channel_data.list;
    // Layers prefix their channels: "diffuse.R".
    let short = |name: &str| name.rsplit('.').next().unwrap_or(name).to_uppercase();
    let find = |wanted: &str| channels.iter().find(|c| short(&c.name.to_string()) == wanted && c.sampling.area() == 1);
    let colours: Vec<&FlatSamples> = match [find("R"), find("G"), find("B")] {
        [Some(r), Some(g), Some(b)] => vec![&r.sample_data, &g.sample_data, &b.sample_data],
        _ => channels
            .iter()
            .filter(|c| short(&c.name.to_string()) != "A" && c.sampling.area() == 1)
            .map(|c| &c.sample_data)
            .collect(),
    };
    if colours.len() != 3 && colours.len() != 1 || colours.iter().any(|c| c.len() != width * height) {
        let found = channels.iter().map(|c| c.name.to_string()).collect::<Vec<_>>().join(", ");
        return Err(ImageError::Channels { path: path.into(), found });
    }
    let mut values = vec![0.0; width * height * colours.len()];
    for (c, plane) in colours.iter().enumerate() {
        for (i, value) in plane.values_as_f32().enumerate() {
            if !value.is_finite() {
                return Err(ImageError::NonFinite { path: path.into(), x: i % width, y: i / width });
            }
            values[i * colours.len() + c] = value;
        }
    }
    Ok(Picture { width, height, channels: colours.len(), samples: Samples::Linear(values) })
}

fn check_size(path: &Path, width: usize, height: usize) -> Result<(), ImageError> {
    if width > MAX_SIDE || height > MAX_SIDE {
        return Err(ImageError::TooLarge { path: path.into(), width, height });
    }
    if width == 0 || height == 0 {
        return Err(ImageError::Empty { path: path.into() });
    }
    Ok(())
}

/// Whether the pixels of an EXR's layer can lie in the file and fit in memory, before room is made for them.
fn check_room(path: &Path, file_bytes: usize, header: &Header) -> Result<(), ImageError> {
    let room = (header.layer_size.area() as u64).saturating_mul(header.channels.bytes_per_pixel as u64);
    if room > MAX_DECODER_BYTES {
        let channels = header.channels.list.len();
        let reason = format!("its {channels} channels take {} MiB; export fewer channels or fewer pixels", room >> 20);
        return Err(ImageError::Decode { path: path.into(), format: "EXR", reason });
    }
    if room > (file_bytes as u64).saturating_mul(MAX_EXR_RATIO) {
        return Err(ImageError::Truncated { path: path.into(), format: "EXR" });
    }
    Ok(())
}

/// Whether a JPEG's picture data ends as it must. The decoder fills a missing end with grey and says nothing.
fn has_jpeg_end(bytes: &[u8]) -> bool {
    // Walk the segments up to the first scan: a thumbnail inside a segment has an end marker of its own.
    let mut at = 2;
    while at + 4 <= bytes.len() && bytes[at] == 0xff && bytes[at + 1] != 0xda {
        at += 2 + usize::from(u16::from_be_bytes([bytes[at + 2], bytes[at + 3]]));
    }
    bytes.get(at..).is_some_and(|scan| scan.windows(2).any(|pair| pair == [0xff, 0xd9]))
}
