use std::fs;

use exr::prelude::{
    AnyChannel, AnyChannels, Blocks, Compression, Encoding, FlatSamples, Image, Layer, LayerAttributes, LineOrder, Vec2,
    WritableImage,
};
use proptest::prelude::*;

use super::*;
use crate::damage::Damage;

fn ramp(channels: usize, height: usize, width: usize) -> Planes {
    let count = channels * height * width;
    Planes::from_vec(channels, height, width, (0..count).map(|i| i as f32 / (count - 1) as f32).collect())
}

fn jpeg(width: u32, height: u32) -> Vec<u8> {
    let mut bytes = Vec::new();
    let image = image::RgbImage::from_fn(width, height, |x, y| image::Rgb([(x * 9) as u8, (y * 7) as u8, 80]));
    image.write_to(&mut std::io::Cursor::new(&mut bytes), image::ImageFormat::Jpeg).unwrap();
    bytes
}

#[test]
fn every_format_comes_back_as_it_was_written() {
    let folder = tempfile::tempdir().unwrap();
    for channels in [1, 3] {
        let planes = ramp(channels, 5, 7);
        let path = folder.path().join("a");
        for (half_step, write) in [
            (0.5 / 255.0, write_png8 as fn(&Path, &Planes, Overwrite) -> Result<(), ImageError>),
            (0.5 / 65535.0, write_png16),
            (0.0, write_exr),
        ] {
            write(&path, &planes, Overwrite::Allow).unwrap();
            let back = Picture::read(&path).unwrap();
            assert_eq!((back.channels, back.height, back.width), (channels, 5, 7));
            let worst = back.to_planes().data.iter().zip(&planes.data).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            assert!(worst <= half_step + 1e-7, "{worst}");
        }
    }
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "no temporary file is left");
}

#[test]
fn nothing_is_overwritten_unasked_and_failures_leave_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("map.png");
    fs::write(&path, "precious").unwrap();
    assert!(matches!(write_png8(&path, &ramp(3, 2, 2), Overwrite::Refuse), Err(ImageError::Exists { .. })));
    assert_eq!(fs::read(&path).unwrap(), b"precious");
    let nan = Planes::constant(2, 2, &[f32::NAN]);
    assert!(matches!(write_exr(&path, &nan, Overwrite::Allow), Err(ImageError::NonFinite { x: 0, y: 0, .. })));
    assert!(matches!(write_png16(&path, &ramp(2, 2, 2), Overwrite::Allow), Err(ImageError::WriteChannels { channels: 2, .. })));
    assert_eq!(fs::read(&path).unwrap(), b"precious");
    let nowhere = folder.path().join("no/such/folder.png");
    assert!(matches!(write_png8(&nowhere, &ramp(3, 2, 2), Overwrite::Refuse), Err(ImageError::Write { .. })));
}

#[test]
fn each_kind_of_bad_file_has_its_own_error() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bad.png");
    let read = |bytes: &[u8]| {
        fs::write(&path, bytes).unwrap();
        Picture::read(&path).unwrap_err()
    };
    assert!(matches!(Picture::read(&folder.path().join("gone.png")), Err(ImageError::Missing { .. })));
    assert!(matches!(Picture::read(folder.path()), Err(ImageError::Read { .. })));
    assert!(matches!(read(b""), ImageError::Empty { .. }));
    let text = read(b"hello there");
    assert!(text.to_string().contains("hello th") && matches!(text, ImageError::Format { .. }), "{text}");
    let jpeg = jpeg(64, 48);
    assert!(matches!(read(&jpeg[..jpeg.len() / 2]), ImageError::Truncated { format: "JPEG", .. }));
    let write = |write: fn(&Path, &Planes, Overwrite) -> Result<(), ImageError>| {
        write(&path, &ramp(3, 40, 40), Overwrite::Allow).unwrap();
        fs::read(&path).unwrap()
    };
    let png = write(write_png16);
    assert!(
        matches!(read(&png[..png.len() / 2]), ImageError::Truncated { format: "PNG", .. }),
        "{}",
        read(&png[..png.len() / 2])
    );
    let floats = write(write_exr);
    assert!(matches!(read(&floats[..floats.len() / 2]), ImageError::Truncated { .. } | ImageError::Decode { .. }));
    let mut flipped = png.clone();
    flipped[60] ^= 0x55;
    assert!(matches!(read(&flipped), ImageError::Decode { .. }));
}

#[test]
fn huge_images_are_refused_by_their_header() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("huge.png");
    write_png8(&path, &Planes::constant(1, 16_400, &[0.5]), Overwrite::Refuse).unwrap();
    assert!(matches!(Picture::read(&path), Err(ImageError::TooLarge { width: 16_400, height: 1, .. })));
}

#[test]
fn small_files_that_announce_large_pictures_are_refused_before_room_is_made() {
    let path = Path::new("bomb");
    let mut photo = jpeg(16, 16);
    let frame = photo.windows(2).position(|marker| marker == [0xff, 0xc0]).unwrap();
    photo[frame + 5..frame + 9].copy_from_slice(&[0x10, 0, 0x10, 0]);
    assert!(matches!(Picture::decode(&photo, path), Err(ImageError::Truncated { format: "JPEG", .. })));

    let corner = |image: &mut [u8], side: i32| {
        let name = b"dataWindow\0box2i\0";
        let value = image.windows(name.len()).position(|part| part == name).unwrap() + name.len() + 4;
        image[value + 8..value + 16].copy_from_slice(&[side.to_le_bytes(), side.to_le_bytes()].concat());
    };
    let mut tile = exr(&["R", "G", "B"], 8, Compression::ZIP1, Blocks::Tiles(Vec2(4096, 4096)));
    corner(&mut tile, 4095);
    assert!(matches!(Picture::decode(&tile, path), Err(ImageError::Truncated { format: "EXR", .. })));
    let names: Vec<String> = (0..100).map(|i| format!("light {i}")).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let mut tile = exr(&names, 8, Compression::ZIP1, Blocks::Tiles(Vec2(16_384, 16_384)));
    corner(&mut tile, 16_383);
    assert!(matches!(Picture::decode(&tile, path), Err(ImageError::Decode { format: "EXR", .. })));
}

/// What even pictures compress to is enough: no such file is taken for a truncated one.
#[test]
fn even_pictures_are_read_however_small_their_files_are() {
    let lossless = [Compression::RLE, Compression::ZIP1, Compression::ZIP16, Compression::PIZ, Compression::PXR24];
    for compression in lossless.into_iter().chain([Compression::B44, Compression::B44A]) {
        for blocks in [Blocks::ScanLines, Blocks::Tiles(Vec2(1024, 1024))] {
            let file = exr(&["Y"], 1024, compression, blocks);
            let picture = Picture::decode(&file, Path::new("even"));
            assert!(picture.is_ok(), "{compression:?} {blocks:?}, {} bytes: {picture:?}", file.len());
        }
    }
    let grey = image::GrayImage::from_pixel(1024, 1024, image::Luma([128]));
    let mut photo = Vec::new();
    grey.write_to(&mut std::io::Cursor::new(&mut photo), image::ImageFormat::Jpeg).unwrap();
    assert!(Picture::decode(&photo, Path::new("even")).is_ok());
}

/// A square EXR of zeros.
fn exr(channels: &[&str], side: usize, compression: Compression, blocks: Blocks) -> Vec<u8> {
    let list = channels.iter().map(|name| AnyChannel::new(*name, FlatSamples::F32(vec![0.0; side * side]))).collect();
    let encoding = Encoding { compression, blocks, line_order: LineOrder::Increasing };
    let layer = Layer::new((side, side), LayerAttributes::default(), encoding, AnyChannels::sort(list));
    let mut file = std::io::Cursor::new(Vec::new());
    Image::from_layer(layer).write().to_buffered(&mut file).unwrap();
    file.into_inner()
}

/// Found by the fuzz target: red is sampled more finely than brightness, and the decoder's own check gives way.
#[test]
fn a_decoder_that_panics_tells_of_a_broken_file() {
    let photo = include_bytes!("fixtures/decoder_panics.jpg");
    let error = Picture::decode(photo, Path::new("photo.jpg")).unwrap_err();
    assert!(matches!(error, ImageError::Decode { format: "JPEG", .. }), "{error}");
}

#[test]
fn nan_in_an_exr_is_named_by_its_place() {
    use exr::prelude::*;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("nan.exr");
    write_rgb_file(&path, 4, 3, |x, y| if (x, y) == (2, 1) { (f32::NAN, 0.0, 0.0) } else { (0.5, 0.5, 0.5) }).unwrap();
    assert!(matches!(Picture::read(&path), Err(ImageError::NonFinite { x: 2, y: 1, .. })));
}

#[test]
fn frames_are_encoded_and_have_three_channels() {
    let grey = Picture { width: 1, height: 1, channels: 1, samples: Samples::Linear(vec![0.18]) };
    let frame = grey.to_frame();
    assert_eq!(frame.channels, 3);
    assert!((frame.data[2] - 0.458_66).abs() < 1e-4);
    let stored = Picture { width: 1, height: 1, channels: 3, samples: Samples::Eight(vec![51, 102, 255]) };
    assert_eq!(stored.to_frame().data, [0.2, 0.4, 1.0]);
}

#[test]
fn resizing_keeps_encoding_and_mean() {
    let picture =
        Picture { width: 4, height: 2, channels: 1, samples: Samples::Sixteen(vec![0, 100, 200, 300, 400, 500, 600, 700]) };
    assert_eq!(picture.resized(2, 1).samples, Samples::Sixteen(vec![250, 450]));
    assert_eq!(picture.resized(4, 2), picture);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]

    /// Whatever a file holds, reading it ends in a picture or an error.
    #[test]
    fn damaged_files_never_panic(kind in 0..4usize, damage in Damage::any()) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        match kind {
            0 => write_png8(&path, &ramp(3, 9, 11), Overwrite::Allow).unwrap(),
            1 => write_png16(&path, &ramp(1, 9, 11), Overwrite::Allow).unwrap(),
            2 => write_exr(&path, &ramp(3, 9, 11), Overwrite::Allow).unwrap(),
            _ => fs::write(&path, jpeg(11, 9)).unwrap(),
        }
        fs::write(&path, damage.done_to(&fs::read(&path).unwrap())).unwrap();
        if let Ok(picture) = Picture::read(&path) {
            prop_assert!(picture.to_planes().data.iter().all(|v| v.is_finite()));
        }
    }

    #[test]
    fn arbitrary_bytes_never_panic(start in 0..4usize, bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        let magic: &[u8] = [b"\x89PNG\r\n\x1a\n" as &[u8], b"\xff\xd8\xff", b"\x76\x2f\x31\x01\x02\x00\x00\x00", b""][start];
        fs::write(&path, [magic, &bytes].concat()).unwrap();
        let _ = Picture::read(&path);
    }
}
