use std::fs;
use std::path::Path;

use ops::planes::Planes;
use proptest::prelude::*;

use super::*;
use crate::damage::Damage;
use crate::image_io::{ImageError, Overwrite, write_exr, write_png8, write_png16};
use crate::material::{Wrap, inria, npy};
use crate::npy::file as npy_file;

const SIDE: usize = 6;

/// A stored byte; neighbours differ in every map and channel, and normals point up.
fn stored(map: usize, channel: usize, x: usize, y: usize) -> u8 {
    let value = ((x * 31 + y * 57 + map * 97 + channel * 13) * 7919 % 101) as u8;
    match (map, channel) {
        (0, 0 | 1) => 78 + value,
        (0, _) => 230,
        _ => 2 * value + 30,
    }
}

/// The strip as planes of shares.
fn strip() -> Planes {
    let mut planes = Planes::new(3, SIDE, 4 * SIDE);
    for (c, y, x) in (0..3 * SIDE * 4 * SIDE).map(|i| (i % 3, i / 3 / (4 * SIDE), i / 3 % (4 * SIDE))) {
        planes.set(c, y, x, f32::from(stored(x / SIDE, c, x % SIDE, y)) / 255.0);
    }
    planes
}

fn array() -> Vec<u8> {
    let place = |i: usize| stored(i % 12 / 3, i % 3, i / 12 % SIDE, i / 12 / SIDE);
    npy_file("|u1", &format!("{SIDE}, {SIDE}, 12"), &(0..SIDE * SIDE * 12).map(place).collect::<Vec<_>>())
}

fn expected(albedo: AlbedoEncoding, roughness_squared: bool, x: usize, y: usize) -> Texel {
    let share = |map, c| f32::from(stored(map, c, x, y)) / 255.0;
    let colour = |map| {
        std::array::from_fn(|c| match albedo {
            AlbedoEncoding::Gamma => share(map, c).powf(2.2),
            AlbedoEncoding::Linear => share(map, c),
        })
    };
    let normal: [f32; 3] = std::array::from_fn(|c| (share(0, c) * 255.0 - 128.0) / 127.0);
    let length = normal.iter().map(|v| v * v).sum::<f32>().sqrt();
    let roughness = if roughness_squared { share(2, 0).powi(2) } else { share(2, 0) };
    Texel { normal: normal.map(|v| v / length), diffuse: colour(1), roughness, specular: colour(3) }
}

fn assert_close(found: &Texel, expected: &Texel, tolerance: f32) {
    let numbers = |t: &Texel| [&t.normal[..], &t.diffuse, &[t.roughness], &t.specular].concat();
    for (a, b) in numbers(found).iter().zip(numbers(expected)) {
        assert!((a - b).abs() < tolerance, "{found:?} {expected:?}");
    }
}

#[test]
fn strips_and_arrays_hold_the_same_material() {
    let folder = tempfile::tempdir().unwrap();
    let [png, npy] = ["a.png", "a.npy"].map(|name| folder.path().join(name));
    write_png8(&png, &strip(), Overwrite::Refuse).unwrap();
    fs::write(&npy, array()).unwrap();
    for albedo in [AlbedoEncoding::Gamma, AlbedoEncoding::Linear] {
        let strip = inria::load(&png, albedo, MaterialInfo { wrap: Wrap::Mirror, ..MaterialInfo::made_up("test") }).unwrap();
        let plain =
            npy::load(&npy, albedo, false, MaterialInfo { wrap: Wrap::Mirror, ..MaterialInfo::made_up("test") }).unwrap();
        let squared =
            npy::load(&npy, albedo, true, MaterialInfo { wrap: Wrap::Mirror, ..MaterialInfo::made_up("test") }).unwrap();
        assert_eq!((strip.size(), plain.size()), ([SIDE, SIDE], [SIDE, SIDE]));
        for (x, y) in (0..SIDE * SIDE).map(|i| (i % SIDE, i / SIDE)) {
            let at = |material: &Material| material.sample(x as f32, y as f32, 1.0);
            assert_eq!(at(&strip), at(&plain));
            assert_close(&at(&strip), &expected(albedo, false, x, y), 0.009);
            assert_close(&at(&squared), &expected(albedo, true, x, y), 0.009);
            // Enlarged by mirroring: the texel left of the edge is the one right of it, its normal turned.
            let beyond = strip.sample(-1.0 - x as f32, y as f32, 1.0);
            let [nx, ny, nz] = beyond.normal;
            assert_close(&Texel { normal: [-nx, ny, nz], ..beyond }, &at(&strip), 1e-6);
        }
    }
}

#[test]
fn strips_of_sixteen_bits_keep_their_steps() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.png");
    write_png16(&path, &strip(), Overwrite::Refuse).unwrap();
    let fine = inria::load(&path, AlbedoEncoding::Gamma, MaterialInfo::made_up("test")).unwrap();
    for (x, y) in (0..SIDE * SIDE).map(|i| (i % SIDE, i / SIDE)) {
        let texel = fine.sample(x as f32, y as f32, 1.0);
        let mut expected = expected(AlbedoEncoding::Gamma, false, x, y);
        // The centre of 16 bits isn't that of 8 bits to the last step.
        expected.normal = texel.normal;
        assert_close(&texel, &expected, 2e-4);
    }
    write_png8(&path, &strip(), Overwrite::Allow).unwrap();
    let coarse = inria::load(&path, AlbedoEncoding::Gamma, MaterialInfo::made_up("test")).unwrap();
    assert_eq!(fine.bytes(), 2 * coarse.bytes());
}

#[test]
fn every_bad_strip_has_its_own_error() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.png");
    let load = || {
        inria::load(&path, AlbedoEncoding::Linear, MaterialInfo { wrap: Wrap::Mirror, ..MaterialInfo::made_up("test") })
            .unwrap_err()
    };
    assert!(matches!(load(), MaterialError::Image(ImageError::Missing { .. })));
    for (channels, width, part) in [(3, 40, "40×8 pixels, five squares"), (3, 31, "31×8 pixels;"), (1, 32, "a grey picture")]
    {
        write_png8(&path, &Planes::new(channels, 8, width), Overwrite::Allow).unwrap();
        let error = load();
        assert!(matches!(error, MaterialError::Strip { .. }));
        for part in [path.to_str().unwrap(), part, "normal, diffuse, roughness and specular"] {
            assert!(error.to_string().contains(part), "{error}");
        }
    }
    write_exr(&path, &Planes::new(3, 8, 32), Overwrite::Allow).unwrap();
    assert!(load().to_string().contains("floats of an EXR"));
    write_png8(&path, &strip(), Overwrite::Allow).unwrap();
    let bytes = fs::read(&path).unwrap();
    fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    assert!(matches!(load(), MaterialError::Image(ImageError::Truncated { .. })));
    fs::write(&path, b"").unwrap();
    assert!(matches!(load(), MaterialError::Image(ImageError::Empty { .. })));
    fs::write(&path, b"no picture").unwrap();
    assert!(matches!(load(), MaterialError::Image(ImageError::Format { .. })));
}

#[test]
fn every_bad_array_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.npy");
    let load = || {
        npy::load(&path, AlbedoEncoding::Linear, false, MaterialInfo { wrap: Wrap::Mirror, ..MaterialInfo::made_up("test") })
            .unwrap_err()
    };
    assert!(matches!(load(), MaterialError::Read { .. }));
    let says = |bytes: &[u8], part: &str| {
        fs::write(&path, bytes).unwrap();
        let error = load();
        assert!(matches!(error, MaterialError::Npy { .. }));
        for part in [path.to_str().unwrap(), part, "(height, width, 12)"] {
            assert!(error.to_string().contains(part), "{error}");
        }
    };
    says(b"", "shorter than a header");
    says(b"PK\x03\x04 a zip archive", "doesn't begin like a NumPy array");
    says(&array()[..60], "the header is cut off");
    says(&array()[..array().len() - 1], "432 bytes are announced, 431 are there: the file is truncated");
    says(&npy_file("<f4", "6, 6, 12", &[0; 1728]), "numbers of type <f4");
    says(&npy_file("|u1", "6, 72", &[0; 432]), "shape (6, 72)");
    says(&npy_file("|u1", "6, 24, 3", &[0; 432]), "shape (6, 24, 3)");
    says(&npy_file("|u1", "12, 6, 6", &[0; 432]), "shape (12, 6, 6)");
    says(&npy_file("|u1", "0, 6, 12", &[]), "shape (0, 6, 12)");
    says(&npy_file("|u1", "4096, 4096, 12", &[]), "201326592 bytes are announced, 0 are there");
    says(&npy_file("|u1", "4097, 6, 12", &[]), "more than 4096 texels a side");
    says(&npy_file("|u1", "18446744073709551615, 18446744073709551615, 12", &[]), "more than 4096 texels a side");
    says(&npy_file("|u1", "18446744073709551616, 6, 12", &[]), "shape (18446744073709551616, 6, 12)");
    let mut bytes = array();
    let at = bytes.windows(5).position(|w| w == b"False").unwrap();
    bytes[at..at + 5].copy_from_slice(b"True ");
    says(&bytes, "Fortran order");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]

    /// Whatever a file holds, reading it ends in a material or an error.
    #[test]
    fn damaged_files_never_panic(is_strip: bool, sixteen: bool, damage in Damage::any()) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        match (is_strip, sixteen) {
            (true, true) => write_png16(&path, &strip(), Overwrite::Allow).unwrap(),
            (true, false) => write_png8(&path, &strip(), Overwrite::Allow).unwrap(),
            (false, _) => fs::write(&path, array()).unwrap(),
        }
        fs::write(&path, damage.done_to(&fs::read(&path).unwrap())).unwrap();
        let material = load_any(&path, is_strip);
        if let Ok(material) = material {
            let texel = material.sample(1.0, 1.0, 1.0);
            prop_assert!(texel.normal[2].is_finite() && (0.0..=1.0).contains(&texel.diffuse[0]));
        }
    }

    #[test]
    fn arbitrary_bytes_never_panic(start in 0..4usize, bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        let magic: &[u8] = [b"\x89PNG\r\n\x1a\n" as &[u8], b"\x93NUMPY\x01\x00", b"\x93NUMPY\x02\x00", b""][start];
        fs::write(&path, [magic, &bytes].concat()).unwrap();
        let _ = [load_any(&path, true), load_any(&path, false)];
    }
}

fn load_any(path: &Path, is_strip: bool) -> Result<Material, MaterialError> {
    let info = MaterialInfo { wrap: Wrap::Mirror, ..MaterialInfo::made_up("test") };
    if is_strip { inria::load(path, AlbedoEncoding::Gamma, info) } else { npy::load(path, AlbedoEncoding::Gamma, true, info) }
}
