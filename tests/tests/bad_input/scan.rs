//! Bad input of `scan`.

use crate::case::{Case, Needs, Place, case, check, nothing};
use crate::input::{SIDE, detail, grey};

fn two_frames(place: &Place) {
    place.clip(&[detail(1), detail(2)]);
}

#[test]
fn clips_that_cannot_be_read() {
    let cases = [
        case("no clip", nothing, "clip.mp4 …", 1, &["clip.mp4: no such file or folder"]),
        case("an empty file", |p| p.file("clip.mp4", ""), "clip.mp4 …", 1, &["the file is empty", "again"]),
        case(
            "a folder without frames",
            |p| p.file("clip/notes.txt", "x"),
            "clip …",
            1,
            &["no frame in it", "PNG, JPEG or EXR"],
        ),
        case("a folder with one frame", |p| p.clip(&[detail(1)]), "clip …", 1, &["single frame", "at least 2 frames"]),
        case("one picture", |p| p.clip(&[detail(1)]), "clip/000.png …", 1, &["single frame", "video or a folder"]),
        case(
            "frames of different sizes",
            |p| p.clip(&[detail(1), detail(2).resize_area(SIDE, SIDE + 8)]),
            "clip …",
            1,
            &["001.png", "72×64", "64×64", "one camera setting"],
        ),
        case(
            "tiny frames",
            |p| p.clip(&[detail(1).crop(0, 0, 32, 32), detail(2).crop(0, 0, 32, 32)]),
            "clip …",
            1,
            &["32×32", "at least 64×64"],
        ),
        case("black frames", |p| p.clip(&vec![grey(0.0); 12]), "clip …", 1, &["black", "flash on"]),
        case(
            "a picture that is cut off",
            |p| {
                two_frames(p);
                p.cut_in_half("clip/001.png");
            },
            "clip …",
            1,
            &["001.png", "truncated", "copy or export it again"],
        ),
        case(
            "text in a picture's clothes",
            |p| {
                two_frames(p);
                p.file("clip/002.png", "hello, this is no picture");
            },
            "clip …",
            1,
            &["002.png", "not a PNG, JPEG, EXR or HDR", "convert"],
        ),
        case(
            "NaN in an EXR",
            |p| {
                p.empty_folder("clip");
                for i in 0..2 {
                    let value = |x: u32, y: u32| if (x, y, i) == (9, 5, 1) { f32::NAN } else { 0.3 };
                    let picture = image::Rgb32FImage::from_fn(SIDE as u32, SIDE as u32, |x, y| image::Rgb([value(x, y); 3]));
                    picture.save(p.path(&format!("clip/{i}.exr"))).unwrap();
                }
            },
            "clip …",
            1,
            &["1.exr", "NaN", "column 9, row 5", "export it again"],
        ),
    ];
    check("scan", &cases);
}

#[test]
fn arrays_that_cannot_be_read() {
    let wanted = "uint8 or float32 with shape (frames, height, width, 3)";
    let says: &'static [&'static str] = Box::leak(Box::new([wanted]));
    let cases = [
        case("no NumPy file", |p| p.file("a.npy", "frames"), "a.npy …", 1, says),
        case("a wrong shape", |p| p.npy("a.npy", "|u1", &[2, SIDE, SIDE], &vec![9; 2 * SIDE * SIDE]), "a.npy …", 1, says),
        case("a wrong type", |p| p.npy("a.npy", "<f8", &[2, SIDE, SIDE, 3], &[0; 64]), "a.npy …", 1, &["<f8", "float32"]),
        case(
            "an array that is cut off",
            |p| p.npy("a.npy", "|u1", &[20, SIDE, SIDE, 3], &vec![9; 3 * SIDE * SIDE * 3]),
            "a.npy …",
            1,
            &["20 frames are announced, 3 are there", "again"],
        ),
        case(
            "floats from 0 to 255",
            |p| p.npy("a.npy", "<f4", &[2, SIDE, SIDE, 3], &200f32.to_le_bytes().repeat(2 * SIDE * SIDE * 3)),
            "a.npy …",
            1,
            &["200", "within [0, 1]"],
        ),
        case(
            "NaN in an array",
            |p| p.npy("a.npy", "<f4", &[2, SIDE, SIDE, 3], &f32::NAN.to_le_bytes().repeat(2 * SIDE * SIDE * 3)),
            "a.npy …",
            1,
            &["frame 0", "NaN"],
        ),
    ];
    check("scan", &cases);
}

#[test]
fn videos_that_cannot_be_read() {
    const VIDEO: &str = "testsrc=size=96x96:rate=10:duration=2";
    let video = |name, input, arguments, says| Case { name, needs: Needs::Ffmpeg, input, arguments, code: 1, says };
    let cases = [
        video("text named .mp4", |p| p.file("a.mp4", "hello ".repeat(99)), "a.mp4 …", &["not a video", "folder of frames"]),
        video(
            "a video that is cut off",
            |p| {
                p.ffmpeg(VIDEO, "a.mp4");
                p.cut_in_half("a.mp4");
            },
            "a.mp4 …",
            &["a.mp4", "truncated", "copy it from the camera again"],
        ),
        video("sound only", |p| p.ffmpeg("sine=duration=1", "a.wav"), "a.wav …", &["no video stream", "as a video"]),
        video(
            "a video of one frame",
            |p| p.ffmpeg("testsrc=size=96x96:rate=1:duration=1", "a.mp4"),
            "a.mp4 …",
            &["single frame"],
        ),
        Case {
            name: "no ffmpeg",
            needs: Needs::EmptyPath,
            input: |p| p.file("a.mp4", "anything"),
            arguments: "a.mp4 …",
            code: 1,
            says: &["ffprobe", "PATH", "apt install ffmpeg", "folder of PNG or JPEG"],
        },
    ];
    check("scan", &cases);
}

#[test]
fn clips_that_cannot_be_aligned() {
    let cases = [
        case("frames without texture", |p| p.clip(&vec![grey(0.4); 12]), "clip …", 3, &["could be aligned", "texture"]),
        case(
            "frames of nothing in common",
            |p| p.clip(&(0..12).map(detail).collect::<Vec<_>>()),
            "clip … --key-frames 4",
            3,
            &["none of the", "slowly"],
        ),
    ];
    check("scan", &cases);
}

#[test]
fn outputs_that_cannot_be_written() {
    let cases = [
        case(
            "an output that exists",
            |p| {
                p.good_clip();
                p.file("out/precious.txt", "x");
            },
            "clip …",
            2,
            &["out exists already", "--force"],
        ),
        case(
            "an output below a file",
            |p| {
                p.good_clip();
                p.file("note", "x");
            },
            "clip --out note/out --weights WEIGHTS",
            1,
            &["can't write", "note"],
        ),
        Case {
            needs: Needs::Permissions,
            ..case(
                "an output in a locked folder",
                |p| {
                    p.good_clip();
                    p.locked_folder();
                },
                "clip --out locked/out --weights WEIGHTS",
                1,
                &["can't write", "locked"],
            )
        },
    ];
    check("scan", &cases);
}

#[test]
fn weights_that_do_not_fit() {
    const LINE: &str = "clip --out out --weights broken";
    let cases = [
        case("no weights", two_frames, LINE, 1, &["broken/manifest.json doesn't exist", "train"]),
        case(
            "weights that are cut off",
            |p| {
                two_frames(p);
                p.copy_weights();
                p.cut_in_half("broken/svbrdf.safetensors");
            },
            LINE,
            1,
            &["svbrdf.safetensors", "SHA-256", "copy both again"],
        ),
        case(
            "a net that isn't there",
            |p| {
                two_frames(p);
                p.copy_weights();
                std::fs::remove_file(p.path("broken/distant.safetensors")).unwrap();
            },
            LINE,
            1,
            &["distant.safetensors doesn't exist"],
        ),
        case(
            "a net of another kind",
            |p| {
                two_frames(p);
                p.copy_weights();
                p.edit_manifest("\"kind\": \"svbrdf\"", "\"kind\": \"pwc\"");
            },
            LINE,
            1,
            &["`svbrdf`", "is a `pwc`"],
        ),
        case(
            "a net of another size",
            |p| {
                two_frames(p);
                p.copy_weights();
                p.edit_manifest("\"width\": 4", "\"width\": 8");
            },
            LINE,
            1,
            &["svbrdf.safetensors", "expects"],
        ),
        case(
            "a manifest of another sort",
            |p| {
                two_frames(p);
                p.file("broken/manifest.json", "{\"format\": 99}");
            },
            LINE,
            1,
            &["manifest.json", "format 99"],
        ),
    ];
    check("scan", &cases);
}

#[test]
fn command_lines_that_make_no_sense() {
    let cases = [
        case("no argument", nothing, "", 2, &["required", "--help"]),
        case("no output", nothing, "clip", 2, &["--out"]),
        case("an unknown option", nothing, "clip … --resolutoin 64", 2, &["--resolutoin", "--resolution"]),
        case(
            "an unknown key",
            two_frames,
            "clip … --set align.key_frame_stp=5",
            2,
            &["key_frame_stp", "did you mean `key_frame_step`"],
        ),
        case("a setting without a value", two_frames, "clip … --set key_frames", 2, &["KEY=VALUE"]),
        case("a value of another type", two_frames, "clip … --set key_frames=many", 2, &["key_frames=many"]),
        case("too small a resolution", two_frames, "clip … --resolution 8", 2, &["resolution = 8", "64 to 4096"]),
        case("too few key frames", two_frames, "clip … --key-frames 1", 2, &["key_frames = 1", "2 to 1000"]),
        case("an unknown device", two_frames, "clip … --device tpu", 2, &["--device tpu", "cpu"]),
    ];
    check("scan", &cases);
}
