use std::fs;

use ops::planes::Planes;
use proptest::prelude::*;

use super::*;
use crate::image_io::{Overwrite, write_exr, write_png8, write_png16};

/// A folder with a map per (name, colour); extension decides the format.
fn folder(maps: &[(&str, &[f32])]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for (name, colour) in maps {
        write_map(&folder.path().join(name), &Planes::constant(8, 8, colour));
    }
    folder
}

fn write_map(path: &Path, planes: &Planes) {
    match path.extension().unwrap().to_str().unwrap().to_lowercase().as_str() {
        "exr" => write_exr(path, planes, Overwrite::Allow).unwrap(),
        "png" => write_png8(path, planes, Overwrite::Allow).unwrap(),
        _ => {
            let bytes: Vec<u8> = (0..planes.area())
                .flat_map(|i| (0..3).map(move |c| (planes.plane(c.min(planes.channels - 1))[i] * 255.0 + 0.5) as u8))
                .collect();
            let image = image::RgbImage::from_raw(planes.width as u32, planes.height as u32, bytes).unwrap();
            image.save_with_format(path, image::ImageFormat::Jpeg).unwrap();
        }
    }
}

fn load(path: &Path) -> Result<Material, MaterialError> {
    PbrFolder::open(path, &Manifest::beside(path)?)?.load(4096, Wrap::Repeat)
}

fn middle(material: &Material) -> Texel {
    material.sample(3.5, 3.5, 1.0)
}

const FLAT: &[f32] = &[128.0 / 255.0, 128.0 / 255.0, 1.0];
/// x = y = 0.5 of the normal.
const TILTED: &[f32] = &[191.5 / 255.0, 191.5 / 255.0, 0.85];
const GREY: &[f32] = &[188.0 / 255.0; 3];

#[test]
fn the_names_of_all_libraries_are_understood() {
    let sets: &[[&str; 4]] = &[
        ["Bricks075B_1K_Color.jpg", "Bricks075B_1K_NormalGL.jpg", "Bricks075B_1K_Roughness.jpg", "Bricks075B_1K_Metalness.jpg"],
        [
            "Metal009_2K-PNG_Color.png",
            "Metal009_2K-PNG_NormalGL.png",
            "Metal009_2K-PNG_Roughness.png",
            "Metal009_2K-PNG_Metalness.png",
        ],
        [
            "rusty_metal_05_diff_1k.jpg",
            "rusty_metal_05_nor_gl_1k.exr",
            "rusty_metal_05_rough_1k.exr",
            "rusty_metal_05_metal_1k.png",
        ],
        ["basecolor.png", "normal.png", "roughness.png", "metallic.png"],
        [
            "RedBrick02_2K_BaseColor.png",
            "RedBrick02_2K_Normal.png",
            "RedBrick02_2K_Roughness.png",
            "RedBrick02_2K_Metallic.png",
        ],
        ["Brick_Wall_006_COLOR.jpg", "Brick_Wall_006_NORM.jpg", "Brick_Wall_006_ROUGH.jpg", "Brick_Wall_006_METALLIC.jpg"],
        ["Stone.Albedo.PNG", "Stone.Normal_OpenGL.PNG", "Stone.Roughness.PNG", "Stone.Metal.PNG"],
    ];
    for [base, normal, roughness, metal] in sets {
        let set = folder(&[(base, GREY), (normal, FLAT), (roughness, &[0.6; 3]), (metal, &[1.0; 3])]);
        let texel = middle(&load(set.path()).unwrap_or_else(|e| panic!("{base}: {e}")));
        assert!((texel.roughness - 0.6).abs() < 0.01, "{base}");
        assert!(texel.diffuse[0] < 0.01 && (texel.specular[1] - 0.503).abs() < 0.02, "{base}: {texel:?}");
        assert!(texel.normal[2] > 0.999);
    }
}

#[test]
fn colours_are_decoded_and_metalness_mixes_diffuse_and_specular() {
    let quarter =
        folder(&[("basecolor.png", GREY), ("normal.png", FLAT), ("roughness.png", &[0.5]), ("metallic.png", &[0.25])]);
    let texel = middle(&load(quarter.path()).unwrap());
    let base = ops::colour::srgb_to_linear(GREY[0]);
    assert!((texel.diffuse[0] - base * 0.75).abs() < 4e-3);
    assert!((texel.specular[0] - (0.04 * 0.75 + base * 0.25)).abs() < 4e-3);

    let linear = folder(&[("color.exr", &[0.5, 0.25, 0.125]), ("normal.png", FLAT), ("gloss.png", &[0.2])]);
    let texel = middle(&load(linear.path()).unwrap());
    assert!((texel.diffuse[2] - 0.125).abs() < 1e-4 && (texel.specular[0] - 0.04).abs() < 1e-4, "{texel:?}");
    assert!((texel.roughness - 0.8).abs() < 0.01, "gloss is inverted");
}

#[test]
fn specular_maps_packed_maps_and_sixteen_bits() {
    let coloured = folder(&[
        ("x_diffuse.png", GREY),
        ("x_normal.png", FLAT),
        ("x_roughness.png", &[0.5]),
        ("x_specular.png", &[1.0, 0.5, 0.0]),
    ]);
    let texel = middle(&load(coloured.path()).unwrap());
    assert!((texel.specular[0] - 1.0).abs() < 1e-3 && texel.specular[2] < 1e-3 && texel.diffuse[0] > 0.5, "{texel:?}");
    let level = folder(&[("x_diff.png", GREY), ("x_nor_gl.png", FLAT), ("x_rough.png", &[0.5]), ("x_spec.png", &[0.5])]);
    assert!((middle(&load(level.path()).unwrap()).specular[0] - 0.04).abs() < 1e-3);
    let packed = folder(&[("x_diff_1k.png", GREY), ("x_nor_gl_1k.png", FLAT), ("x_arm_1k.png", &[0.9, 0.3, 1.0])]);
    let texel = middle(&load(packed.path()).unwrap());
    assert!((texel.roughness - 0.3).abs() < 0.01 && texel.diffuse[0] < 1e-3);

    let fine = folder(&[("color.png", GREY), ("normal.png", FLAT)]);
    write_png16(&fine.path().join("roughness.png"), &Planes::constant(8, 8, &[0.123_45]), Overwrite::Allow).unwrap();
    assert!((middle(&load(fine.path()).unwrap()).roughness - 0.123_45).abs() < 1e-5);
}

#[test]
fn direct_x_normals_are_flipped_and_open_gl_is_preferred() {
    let only_dx = folder(&[("a_Color.png", GREY), ("a_NormalDX.png", TILTED), ("a_Roughness.png", &[0.5])]);
    let normal = middle(&load(only_dx.path()).unwrap()).normal;
    assert!(normal[0] > 0.45 && normal[1] < -0.45, "{normal:?}");
    write_map(&only_dx.path().join("a_NormalGL.png"), &Planes::constant(8, 8, TILTED));
    assert!(middle(&load(only_dx.path()).unwrap()).normal[1] > 0.45);
    // Floats may be stored signed.
    let signed = folder(&[("a_Color.png", GREY), ("a_Normal.exr", &[-0.6, 0.0, 0.8]), ("a_Roughness.png", &[0.5])]);
    assert!((middle(&load(signed.path()).unwrap()).normal[0] + 0.6).abs() < 1e-3);
}

#[test]
fn manifests_say_which_materials_are_metals() {
    let root = tempfile::tempdir().unwrap();
    for name in ["gold", "wood", "unused"] {
        fs::create_dir(root.path().join(name)).unwrap();
        for (map, colour) in [("basecolor.png", GREY), ("normal.png", FLAT), ("roughness.png", GREY)] {
            write_map(&root.path().join(name).join(map), &Planes::constant(8, 8, colour));
        }
    }
    fs::create_dir(root.path().join("notes")).unwrap();
    fs::write(
        root.path().join("MANIFEST.tsv"),
        "name\tlicence\tmetallic\tused\r\ngold\tCC0\t1\tyes\r\nwood\tCC-BY\t0(painted)\t\r\nunused\t\t\tno\r\n",
    )
    .unwrap();
    let folders = find_folders(root.path()).unwrap();
    assert_eq!(folders.iter().map(|f| f.name.as_str()).collect::<Vec<_>>(), ["gold", "wood"]);
    let [gold, wood] = [&folders[0], &folders[1]].map(|f| f.load(4096, Wrap::Repeat).unwrap());
    assert!(middle(&gold).diffuse[0] < 1e-3 && middle(&gold).specular[0] > 0.4);
    assert!(middle(&wood).diffuse[0] > 0.4 && wood.info().licence == "CC-BY");
    let one = find_folders(&root.path().join("gold")).unwrap();
    assert_eq!((one.len(), one[0].manifest.metallic), (1, Some(Metallic::Yes)));

    fs::write(root.path().join("MANIFEST.tsv"), "name\tmetallic\nwood\tmap\n").unwrap();
    assert!(matches!(find_folders(root.path()), Err(MaterialError::MissingMap { map: "metalness", .. })));
    for (text, bad_line) in [("folder\nwood\n", 1), ("name\tmetallic\nwood\tperhaps\n", 2), ("name\nwood\n\nwood\n", 4)] {
        fs::write(root.path().join("MANIFEST.tsv"), text).unwrap();
        assert!(matches!(find_folders(root.path()), Err(MaterialError::Line { line, .. }) if line == bad_line), "{text}");
    }
}

#[test]
fn maps_of_other_sizes_are_fitted_and_of_other_shapes_refused() {
    let set = folder(&[("color.png", GREY), ("normal.png", FLAT)]);
    let roughness = set.path().join("roughness.png");
    write_map(&roughness, &Planes::constant(16, 16, &[0.4]));
    assert!((middle(&load(set.path()).unwrap()).roughness - 0.4).abs() < 0.01);
    write_map(&roughness, &Planes::constant(4, 4, &[0.4]));
    assert!((middle(&load(set.path()).unwrap()).roughness - 0.4).abs() < 0.01);
    write_map(&roughness, &Planes::constant(16, 8, &[0.4]));
    let error = load(set.path()).unwrap_err();
    assert!(matches!(error, MaterialError::Aspect { size: [8, 16], base_size: [8, 8], .. }));
    assert!(error.to_string().contains("roughness.png") && error.to_string().contains("8×16"), "{error}");
}

#[test]
fn what_is_missing_or_broken_is_named() {
    let set = folder(&[("color.png", GREY), ("normal.png", FLAT), ("preview.png", GREY)]);
    let error = load(set.path()).unwrap_err().to_string();
    for part in [set.path().to_str().unwrap(), "no roughness map", "*roughness", "*gloss", ".exr"] {
        assert!(error.contains(part), "{error}");
    }
    assert!(matches!(load(folder(&[("normal.png", FLAT)]).path()), Err(MaterialError::MissingMap { map: "base colour", .. })));
    let grey_normal = folder(&[("color.png", GREY), ("normal.png", &[0.5]), ("roughness.png", GREY)]);
    assert!(matches!(load(grey_normal.path()), Err(MaterialError::GreyNormal { .. })));
    let empty = tempfile::tempdir().unwrap();
    assert!(matches!(find_folders(empty.path()), Err(MaterialError::NoMaterials { .. })));
    assert!(matches!(find_folders(&empty.path().join("gone")), Err(MaterialError::Folder { .. })));
    fs::write(set.path().join("roughness.png"), b"").unwrap();
    assert!(matches!(load(set.path()), Err(MaterialError::Image(crate::image_io::ImageError::Empty { .. }))));
}

#[test]
fn a_word_of_the_name_is_not_a_map() {
    // `rusty_metal.png` is a preview of the material, not a metalness map.
    let set = folder(&[
        ("rusty_metal_diff.png", GREY),
        ("rusty_metal_nor_gl.png", FLAT),
        ("rusty_metal_rough.png", GREY),
        ("rusty_metal.png", &[1.0]),
    ]);
    assert!(SetFiles::find(set.path()).unwrap().metalness.is_none());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn manifests_of_any_text_never_panic(text in "(name|metallic|used|\t|\n|\r\n|[a-z01ä]{0,4}){0,30}") {
        if let Ok(manifest) = Manifest::parse(Path::new("manifest.tsv"), &text) {
            let _ = manifest.row("a");
        }
    }

    #[test]
    fn file_names_of_any_kind_never_panic(name in "[a-zA-Z0-9_. ä-]{1,20}\\.(png|jpg|exr)") {
        let _ = names::is_map(Path::new(&name));
    }
}
