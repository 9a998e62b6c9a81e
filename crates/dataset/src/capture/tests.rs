use std::fs;
use std::process::Command;

use super::*;
use crate::image_io::{ImageError, Overwrite, write_exr, write_png8};

/// Left part red, right part green, upper half bright, and one step brighter with each frame.
fn frame(index: usize, height: usize, width: usize) -> Planes {
    let mut planes = Planes::new(3, height, width);
    for y in 0..height {
        for x in 0..width {
            let bright = if y < height / 2 { 0.8 } else { 0.4 } + 0.01 * index as f32;
            planes.set(usize::from(x >= width / 2), y, x, bright);
        }
    }
    planes
}

fn write_frames(folder: &Path, count: usize, height: usize, width: usize) {
    for i in 0..count {
        write_png8(&folder.join(format!("frame{i}.png")), &frame(i, height, width), Overwrite::Allow).unwrap();
    }
}

fn config(resolution: Option<usize>) -> CaptureConfig {
    CaptureConfig { resolution, ..CaptureConfig::default() }
}

fn npy(path: &Path, kind: &str, shape: &str, data: &[u8]) {
    fs::write(path, crate::npy::file(kind, shape, data)).unwrap();
}

/// ffmpeg's arguments split at spaces; `None` (and a line in the log) where ffmpeg isn't installed.
fn ffmpeg(folder: &Path, arguments: &str) -> Option<PathBuf> {
    let words: Vec<&str> = arguments.split(' ').collect();
    let made = Command::new("ffmpeg").current_dir(folder).args(["-nostdin", "-v", "error", "-y"]).args(&words).status();
    match made {
        Ok(status) => {
            assert!(status.success(), "ffmpeg {arguments}");
            Some(folder.join(words[words.len() - 1]))
        }
        Err(_) => {
            eprintln!("skipped: ffmpeg isn't installed");
            None
        }
    }
}

#[test]
fn folders_are_read_in_natural_order_cut_and_made_small() {
    let folder = tempfile::tempdir().unwrap();
    write_frames(folder.path(), 12, 80, 120);
    fs::write(folder.path().join("notes.txt"), "not a frame").unwrap();
    let clip = read(folder.path(), &config(None)).unwrap();
    assert_eq!((clip.frames.len(), clip.kind, clip.fps), (12, ClipKind::Folder, None));
    assert_eq!((clip.frames[0].height, clip.frames[0].width), (80, 80));
    // The centre of the frame is still where red turns green.
    assert!(clip.frames[3].at(0, 0, 39) > 0.8 && clip.frames[3].at(0, 0, 40) == 0.0 && clip.frames[3].at(1, 0, 40) > 0.8);
    let brightness: Vec<f32> = clip.frames.iter().map(|f| f.at(0, 0, 0)).collect();
    assert!(brightness.is_sorted(), "{brightness:?}");

    let small = read(folder.path(), &CaptureConfig { crop: Crop::None, ..config(Some(64)) }).unwrap();
    assert_eq!((small.frames[0].height, small.frames[0].width), (64, 96));
    assert!((small.frames[0].at(0, 5, 5) - 0.8).abs() < 0.01);
    // Light is averaged: half 0.8 and half 0.4 is brighter than the mean of the encoded values.
    let one = Fit::new(Path::new(""), &config(Some(64)), 128, 128).unwrap();
    let stripes = Planes::from_vec(3, 128, 128, (0..3 * 128 * 128).map(|i| [0.8, 0.4][i % 2]).collect());
    assert!((one.planes(stripes).at(0, 9, 9) - 0.6385).abs() < 1e-3);
}

#[test]
fn arrays_of_both_types_are_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("clip.npy");
    let interleaved = |i: usize| {
        let f = frame(i, 64, 70);
        (0..64 * 70 * 3).map(move |k| f.plane(k % 3)[k / 3]).collect::<Vec<f32>>()
    };
    let floats: Vec<f32> = (0..3).flat_map(interleaved).collect();
    npy(&path, "<f4", "3, 64, 70, 3", &floats.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<_>>());
    let clip = read(&path, &config(None)).unwrap();
    assert_eq!((clip.frames.len(), clip.kind), (3, ClipKind::Npy));
    assert_eq!(clip.frames[2], frame(2, 64, 70).crop(0, 3, 64, 64));
    npy(&path, "|u1", "3, 64, 70, 3", &floats.iter().map(|v| (v * 255.0 + 0.5) as u8).collect::<Vec<_>>());
    let bytes = read(&path, &config(None)).unwrap();
    let worst = bytes.frames[2].data.iter().zip(&clip.frames[2].data).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(worst < 0.003, "{worst}");
}

#[test]
fn long_clips_are_thinned_evenly_within_the_budget() {
    let folder = tempfile::tempdir().unwrap();
    write_frames(folder.path(), 15, 64, 64);
    let capped = CaptureConfig { max_frames: 6, ..CaptureConfig::default() };
    let clip = read(folder.path(), &capped).unwrap();
    assert_eq!(clip.indices, [0, 4, 8, 12]);
    assert!(clip.notes[0].contains("15 frames") && clip.notes[0].contains("every 4."));
    assert_eq!(clip.frames.len(), 4);
    // 64 × 64 × 3 floats are 48 KiB, so a MiB holds 21.
    assert_eq!(read(folder.path(), &CaptureConfig { max_mib: 1, ..CaptureConfig::default() }).unwrap().frames.len(), 15);
    for i in 0..2 {
        write_png8(&folder.path().join(format!("x{i}.png")), &frame(0, 400, 400), Overwrite::Allow).unwrap();
    }
    for i in 0..15 {
        fs::remove_file(folder.path().join(format!("frame{i}.png"))).unwrap();
    }
    let tight = CaptureConfig { max_mib: 2, ..CaptureConfig::default() };
    assert!(matches!(read(folder.path(), &tight), Err(CaptureError::Memory { max_mib: 2, .. })));
}

#[test]
fn every_bad_folder_has_its_own_error() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let read_it = || read(folder.path(), &config(None)).unwrap_err();
    assert!(matches!(read(&at("gone"), &config(None)), Err(CaptureError::Missing { .. })));
    assert!(matches!(read_it(), CaptureError::NoFrames { .. }));
    write_frames(folder.path(), 1, 64, 64);
    assert!(matches!(read_it(), CaptureError::OneFrame { .. }));
    assert!(matches!(read(&at("frame0.png"), &config(None)), Err(CaptureError::OneFrame { .. })));
    write_png8(&at("frame1.png"), &frame(0, 80, 64), Overwrite::Allow).unwrap();
    let sizes = read_it();
    assert!(matches!(sizes, CaptureError::Sizes { frame: 1, found: [64, 80], expected: [64, 64], .. }));
    assert!(sizes.to_string().contains("frame1.png"), "{sizes}");
    for i in 0..2 {
        write_png8(&at(&format!("frame{i}.png")), &frame(0, 40, 64), Overwrite::Allow).unwrap();
    }
    assert!(matches!(read_it(), CaptureError::TooSmall { width: 64, height: 40, .. }));
    for i in 0..4 {
        write_png8(&at(&format!("frame{i}.png")), &Planes::constant(64, 64, &[0.004; 3]), Overwrite::Allow).unwrap();
    }
    assert!(matches!(read_it(), CaptureError::Black { black: 4, frames: 4, .. }));
    for i in 1..4 {
        write_png8(&at(&format!("frame{i}.png")), &frame(i, 64, 64), Overwrite::Allow).unwrap();
    }
    let clip = read(folder.path(), &config(None)).unwrap();
    assert_eq!(clip.indices, [1, 2, 3]);
    assert!(clip.notes[0].contains("black"), "{:?}", clip.notes);
    // Three dark frames of ten are no dark clip, thinned or not.
    for i in 0..10 {
        let dark = Planes::constant(64, 64, &[0.004; 3]);
        let planes = if i < 3 { dark } else { frame(i, 64, 64) };
        write_png8(&at(&format!("frame{i}.png")), &planes, Overwrite::Allow).unwrap();
    }
    let thinned = read(folder.path(), &CaptureConfig { max_frames: 4, ..config(None) }).unwrap();
    assert_eq!(thinned.indices, [4, 6, 8]);
    fs::write(at("frame2.png"), b"").unwrap();
    assert!(matches!(read_it(), CaptureError::Image(ImageError::Empty { .. })));
    fs::write(at("frame2.png"), b"text").unwrap();
    assert!(matches!(read_it(), CaptureError::Image(ImageError::Format { .. })));
}

#[test]
fn every_bad_array_has_its_own_error() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("clip.npy");
    let read_it = || read(&path, &config(None)).unwrap_err();
    fs::write(&path, b"").unwrap();
    assert!(matches!(read_it(), CaptureError::Empty { .. }));
    fs::write(&path, b"PK\x03\x04 a zip file").unwrap();
    assert!(matches!(read_it(), CaptureError::Npy { .. }));
    npy(&path, "|u1", "2, 64, 64, 4", &[9; 64 * 64 * 8]);
    assert!(read_it().to_string().contains("shape (2, 64, 64, 4)"));
    npy(&path, "|u1", "2, 64, 64, 3", &[9; 64 * 64 * 4]);
    assert!(matches!(read_it(), CaptureError::Truncated { .. }));
    npy(&path, "|u1", "18446744073709551615, 16384, 16384, 3", &[9; 64]);
    assert!(matches!(read_it(), CaptureError::Truncated { .. } | CaptureError::Npy { .. }));
    npy(&path, "|u1", "1, 64, 64, 3", &[99; 64 * 64 * 3]);
    assert!(matches!(read_it(), CaptureError::OneFrame { .. }));
    let floats = |value: f32| (0..2 * 64 * 64 * 3).flat_map(|_| value.to_le_bytes()).collect::<Vec<_>>();
    npy(&path, "<f4", "2, 64, 64, 3", &floats(f32::NAN));
    assert!(matches!(read_it(), CaptureError::NonFinite { frame: 0, .. }));
    npy(&path, "<f4", "2, 64, 64, 3", &floats(128.0));
    assert!(matches!(read_it(), CaptureError::Range { high: 128.0, .. }));
}

#[test]
fn videos_keep_every_frame_in_order_at_any_time_stamps() {
    let folder = tempfile::tempdir().unwrap();
    write_frames(folder.path(), 10, 64, 96);
    // Time stamps that grow quadratically; a constant-rate reader would repeat frames.
    let make = "-framerate 30 -i frame%d.png -vf setpts=N*N/30/TB -c:v ffv1 -pix_fmt bgr0 clip.mkv";
    let Some(video) = ffmpeg(folder.path(), make) else { return };
    let clip = read(&video, &config(None)).unwrap();
    assert_eq!((clip.frames.len(), clip.kind), (10, ClipKind::Video));
    assert!(clip.fps.is_some_and(|f| f > 0.5 && f <= 1000.0), "{:?}", clip.fps);
    for (i, found) in clip.frames.iter().enumerate() {
        let expected = frame(i, 64, 96).crop(0, 16, 64, 64);
        let worst = found.data.iter().zip(&expected.data).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(worst < 0.003, "frame {i}: {worst}");
    }
}

/// Writes a rotation by a quarter turn into the track header, as phones do.
fn turn_track(video: &Path) {
    let mut bytes = fs::read(video).unwrap();
    let header = bytes.windows(4).position(|w| w == b"tkhd").unwrap();
    let matrix: [i32; 9] = [0, 0x1_0000, 0, -0x1_0000, 0, 0, 0, 0, 0x4000_0000];
    for (i, value) in matrix.iter().enumerate() {
        bytes[header + 44 + 4 * i..][..4].copy_from_slice(&value.to_be_bytes());
    }
    fs::write(video, bytes).unwrap();
}

#[test]
fn phone_videos_are_turned_upright() {
    let folder = tempfile::tempdir().unwrap();
    write_frames(folder.path(), 4, 64, 96);
    let make = "-framerate 30 -i frame%d.png -c:v mpeg4 -q:v 1 -pix_fmt yuv420p clip.mp4";
    let Some(video) = ffmpeg(folder.path(), make) else { return };
    let whole = CaptureConfig { crop: Crop::None, ..CaptureConfig::default() };
    let upright = read(&video, &whole).unwrap();
    assert_eq!((upright.frames[0].height, upright.frames[0].width), (64, 96));
    turn_track(&video);
    let turned = read(&video, &whole).unwrap();
    assert_eq!((turned.frames[0].height, turned.frames[0].width), (96, 64));
    // A quarter turn clockwise: what was on the left (red) is on top.
    let frame = &turned.frames[0];
    assert!(frame.at(0, 10, 32) > 0.3 && frame.at(1, 10, 32) < 0.2 && frame.at(1, 85, 32) > 0.3, "red isn't on top");
}

#[test]
fn ten_bit_videos_are_read_at_their_depth() {
    let folder = tempfile::tempdir().unwrap();
    write_frames(folder.path(), 3, 64, 64);
    let make = "-framerate 30 -i frame%d.png -c:v ffv1 -pix_fmt gbrp10le clip.mkv";
    let Some(video) = ffmpeg(folder.path(), make) else { return };
    let clip = read(&video, &config(None)).unwrap();
    assert!((clip.frames[1].at(0, 0, 0) - 0.81).abs() < 0.004, "{}", clip.frames[1].at(0, 0, 0));
}

#[test]
fn every_bad_video_has_its_own_error() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    fs::write(at("text.mp4"), "this is no video at all, whatever its name says".repeat(20)).unwrap();
    let without = Tools { ffmpeg: "no-such-ffmpeg".into(), ffprobe: "no-such-ffprobe".into() };
    let absent = read_with(&at("text.mp4"), &config(None), &without).unwrap_err();
    let message = absent.to_string();
    assert!(matches!(absent, CaptureError::NoFfmpeg { .. }));
    for part in ["apt install ffmpeg", "brew install ffmpeg", "folder of PNG"] {
        assert!(message.contains(part), "{message}");
    }
    fs::write(at("empty.mp4"), b"").unwrap();
    assert!(matches!(read(&at("empty.mp4"), &config(None)), Err(CaptureError::Empty { .. })));

    write_frames(folder.path(), 30, 96, 96);
    let Some(video) = ffmpeg(folder.path(), "-framerate 30 -i frame%d.png -c:v mpeg4 -q:v 2 clip.mp4") else { return };
    assert!(matches!(read(&at("text.mp4"), &config(None)), Err(CaptureError::NotAVideo { .. })));
    let bytes = fs::read(&video).unwrap();
    fs::write(at("cut.mp4"), &bytes[..bytes.len() / 2]).unwrap();
    let cut = read(&at("cut.mp4"), &config(None)).unwrap_err();
    assert!(matches!(cut, CaptureError::Truncated { .. }), "{cut}");
    let fast = ffmpeg(folder.path(), "-i clip.mp4 -c copy -movflags +faststart fast.mp4").unwrap();
    let bytes = fs::read(&fast).unwrap();
    fs::write(&fast, &bytes[..bytes.len() * 2 / 3]).unwrap();
    let cut = read(&fast, &config(None)).unwrap_err();
    assert!(matches!(cut, CaptureError::Truncated { .. }), "{cut}");
    let one = ffmpeg(folder.path(), "-i clip.mp4 -frames:v 1 -c:v mpeg4 one.mp4").unwrap();
    assert!(matches!(read(&one, &config(None)), Err(CaptureError::OneFrame { .. })));
    let sound = ffmpeg(folder.path(), "-f lavfi -i sine=duration=0.2 sound.wav").unwrap();
    assert!(matches!(read(&sound, &config(None)), Err(CaptureError::NoVideoStream { .. })));
    let black = ffmpeg(folder.path(), "-f lavfi -i color=black:size=96x96:rate=10 -t 1 -c:v mpeg4 black.mp4").unwrap();
    assert!(matches!(read(&black, &config(None)), Err(CaptureError::Black { black: 10, .. })));
}

#[test]
fn photos_are_fitted_like_frames_and_configs_are_strict() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("photo.exr");
    write_exr(&path, &Planes::constant(70, 90, &[0.18, 0.5, 2.0]), Overwrite::Refuse).unwrap();
    let photo = read_photo(&path, &config(Some(64))).unwrap();
    assert_eq!((photo.height, photo.width), (64, 64));
    assert!((photo.at(0, 9, 9) - 0.4587).abs() < 1e-3 && photo.at(2, 9, 9) > 0.999);
    assert!(matches!(read(folder.path(), &config(Some(8))), Err(CaptureError::Config { key: "resolution", found: 8, .. })));
    let error = toml::from_str::<CaptureConfig>("resolutions = 256").unwrap_err().to_string();
    assert!(error.contains("unknown field `resolutions`"), "{error}");
    assert_eq!(toml::from_str::<CaptureConfig>("crop = 'none'").unwrap().crop, Crop::None);
}
