use std::fs;

use ops::planes::Planes;
use proptest::prelude::*;

use super::*;
use crate::damage::Damage;
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

/// Whole folders as they come: every map is there, and what isn't wanted would show as white, dark or tilted.
#[test]
fn folders_as_the_libraries_ship_them_are_understood() {
    let folders: &[(&str, &[&str], &[&str])] = &[
        (
            "Metal009_1K-JPG",
            &["_Color.jpg", "_NormalGL.jpg", "_Roughness.jpg", "_Metalness.jpg"],
            &["_NormalDX.jpg", "_AmbientOcclusion.jpg", "_Displacement.jpg", "_Opacity.jpg", ".png"],
        ),
        (
            "rusty_metal_05",
            &["_diff_2k.jpg", "_nor_gl_2k.exr", "_rough_2k.exr", "_metal_2k.png"],
            &["_nor_dx_2k.exr", "_arm_2k.jpg", "_ao_2k.jpg", "_disp_2k.png", "_spec_2k.png", "_mask_2k.png", ".png"],
        ),
        (
            "",
            &["basecolor.png", "normal.png", "roughness.png", "metallic.png"],
            &["diffuse.png", "specular.png", "displacement.png", "height.png", "opacity.png", "blend_mask.png"],
        ),
        (
            "RustyMetal01_2K",
            &["_BaseColor.png", "_Normal.png", "_Roughness.png", "_Metallic.png"],
            &["_AO.png", "_Height.png", "_Opacity.png"],
        ),
        (
            "Metal_Plate_048",
            &["_basecolor.jpg", "_normal.jpg", "_roughness.jpg", "_metallic.jpg"],
            &["_ambientOcclusion.jpg", "_height.png", "_opacity.jpg"],
        ),
        (
            "Sci-fi_Metal_003",
            &["_COLOR.jpg", "_NORM.jpg", "_ROUGH.jpg", "_METALLIC.jpg"],
            &["_OCC.jpg", "_DISP.png", "_SPEC.jpg", "_EMISSION.jpg"],
        ),
    ];
    for (name, maps, others) in folders {
        let set = tempfile::tempdir().unwrap();
        let write = |ending: &str, colour: &[f32]| {
            write_map(&set.path().join(format!("{name}{ending}")), &Planes::constant(8, 8, colour));
        };
        for (map, colour) in maps.iter().zip([GREY, FLAT, &[0.6; 3], &[1.0; 3]]) {
            write(map, colour);
        }
        for other in *others {
            let tilted = other.to_lowercase().contains("nor");
            write(other, if tilted { TILTED } else { &[1.0, 0.0, 0.0] });
        }
        let texel = middle(&load(set.path()).unwrap_or_else(|e| panic!("{name}: {e}")));
        assert!(texel.normal[2] > 0.999 && (texel.roughness - 0.6).abs() < 0.01, "{name}: {texel:?}");
        assert!(texel.diffuse[0] < 0.01 && (texel.specular[1] - 0.503).abs() < 0.02, "{name}: {texel:?}");
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
fn specular_maps_and_packed_maps() {
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

    // Beside a specular map it is the diffuse colour that counts, not the colour of what is metal, too.
    write_map(&coloured.path().join("x_basecolor.png"), &Planes::constant(8, 8, &[1.0; 3]));
    assert!((middle(&load(coloured.path()).unwrap()).diffuse[0] - 0.503).abs() < 0.02);
}

#[test]
fn sixteen_bits_of_any_map_are_kept() {
    let maps: [(&str, &[f32]); 4] = [
        ("diffuse.png", &[0.123_45; 3]),
        ("normal.png", &[0.512_34, 0.487_65, 1.0]),
        ("roughness.png", &[0.123_45]),
        ("specular.png", &[0.2; 3]),
    ];
    let set = folder(&maps.map(|(name, _)| (name, GREY)));
    let eight = load(set.path()).unwrap().bytes();
    for (name, colour) in maps {
        let path = set.path().join(name);
        write_png16(&path, &Planes::constant(8, 8, colour), Overwrite::Allow).unwrap();
        let material = load(set.path()).unwrap();
        write_map(&path, &Planes::constant(8, 8, GREY));
        assert_eq!(material.bytes(), 2 * eight, "{name}");
        let texel = middle(&material);
        let linear = ops::colour::srgb_to_linear(colour[0]);
        let (found, expected) = match name {
            "diffuse.png" => (texel.diffuse[0], linear),
            "normal.png" => (texel.normal[0], 2.0 * colour[0] - 1.0),
            "roughness.png" => (texel.roughness, colour[0]),
            _ => (texel.specular[0], linear),
        };
        assert!((found - expected).abs() < 1e-4, "{name}: {found} {expected}");
    }
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
    // Nor is `robot_arm.png` a packed one.
    let set = folder(&[
        ("robot_arm_diff.png", GREY),
        ("robot_arm_nor_gl.png", FLAT),
        ("robot_arm_rough.png", GREY),
        ("robot_arm.png", &[1.0; 3]),
    ]);
    assert!(SetFiles::find(set.path()).unwrap().metalness.is_none());
}

#[test]
fn what_a_mac_adds_to_an_archive_is_no_map() {
    let set = folder(&[("a_Color.png", GREY), ("a_NormalGL.png", FLAT), ("a_Roughness.png", GREY)]);
    for map in ["Color", "NormalGL", "Roughness", "Metalness"] {
        fs::write(set.path().join(format!("._a_{map}.png")), b"\x00\x05\x16\x07").unwrap();
    }
    load(set.path()).unwrap();
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn manifests_of_any_text_never_panic(text in "(name|metallic|used|\t|\n|\r\n|[a-z01ä]{0,4}){0,30}") {
        if let Ok(manifest) = Manifest::parse(Path::new("manifest.tsv"), &text) {
            let _ = manifest.row("a");
        }
    }

    /// Whatever one of the maps holds, loading the folder ends in a material or an error.
    #[test]
    fn damaged_maps_never_panic(map in 0..4usize, damage in Damage::any()) {
        let names = ["a_Color.jpg", "a_NormalGL.png", "a_Roughness.exr", "a_Metalness.png"];
        let set = folder(&[(names[0], GREY), (names[1], FLAT), (names[2], &[0.5]), (names[3], &[1.0])]);
        let path = set.path().join(names[map]);
        fs::write(&path, damage.done_to(&fs::read(&path).unwrap())).unwrap();
        if let Ok(material) = load(set.path()) {
            let texel = middle(&material);
            prop_assert!(texel.normal[2].is_finite() && (0.0..=1.0).contains(&texel.roughness));
        }
    }

    #[test]
    fn file_names_of_any_kind_never_panic(name in "[a-zA-Z0-9_. ä-]{1,20}\\.(png|jpg|exr)") {
        let _ = names::is_map(Path::new(&name));
    }
}
