use std::fs;
use std::path::Path;

use ops::planes::Planes;

use super::*;
use crate::image_io::{Overwrite, write_png8};
use crate::material::AlbedoEncoding;

fn procedural(count: usize, families: &[&str]) -> SourceConfig {
    let families = families.iter().map(|f| (*f).to_string()).collect();
    SourceConfig::Procedural(ProceduralConfig { size: 64, count, families, ..ProceduralConfig::default() })
}

#[test]
fn the_material_of_a_video_is_a_function_of_seed_side_and_number() {
    let sources = [procedural(60, &["plaster", "leather", "concrete"])];
    let open = |seed| MaterialLibrary::open(&sources, seed, 1 << 24).unwrap();
    let names = |library: &MaterialLibrary, order: &[u64]| {
        let mut named: Vec<_> = order.iter().map(|&v| (v, library.name(Split::Train, v).unwrap().to_string())).collect();
        named.sort();
        named
    };
    let forward: Vec<u64> = (0..50).collect();
    let backward: Vec<u64> = (0..50).rev().collect();
    assert_eq!(names(&open(1), &forward), names(&open(1), &backward));
    assert_ne!(names(&open(1), &forward), names(&open(2), &forward));
    let library = open(1);
    for video in 0..3 {
        assert_eq!(library.material(Split::Train, video).unwrap().name(), library.name(Split::Train, video).unwrap());
    }
}

#[test]
fn the_sides_share_nothing_and_more_materials_move_none() {
    let manifest = |count| MaterialLibrary::open(&[procedural(count, &[])], 0, 0).unwrap().manifest();
    let (few, many) = (manifest(400), manifest(800));
    let share = few.iter().filter(|m| m.split == Split::Test).count() as f64 / 400.0;
    assert!((0.14..0.26).contains(&share), "{share}");
    for entry in &few {
        assert!(many.contains(entry), "{entry:?}");
        let other = many.iter().find(|m| m.identity == entry.identity && m.split != entry.split);
        assert_eq!(other, None);
    }
}

#[test]
fn sources_are_drawn_by_weight() {
    let mut often = ProceduralConfig { size: 64, count: 40, families: vec!["plaster".into()], ..ProceduralConfig::default() };
    often.weight = 3.0;
    let rare = ProceduralConfig { families: vec!["leather".into()], weight: 1.0, ..often.clone() };
    let library = MaterialLibrary::open(&[SourceConfig::Procedural(often), SourceConfig::Procedural(rare)], 4, 0).unwrap();
    let plaster = (0..2000).filter(|&v| library.name(Split::Train, v).unwrap().starts_with("plaster")).count();
    assert!((1420..1580).contains(&plaster), "{plaster}");
}

fn inria(path: &Path) -> InriaConfig {
    InriaConfig { path: path.into(), albedo_encoding: AlbedoEncoding::Linear, texels: GRID, wrap: Wrap::Mirror, weight: 1.0 }
}

fn npy(path: &Path) -> NpyConfig {
    let InriaConfig { path, albedo_encoding, texels, wrap, weight } = inria(path);
    NpyConfig { path, albedo_encoding, roughness_squared: true, texels, wrap, weight }
}

fn write_strip(path: &Path) {
    write_png8(path, &Planes::constant(8, 32, &[0.6; 3]), Overwrite::Refuse).unwrap();
}

fn write_array(path: &Path) {
    fs::write(path, crate::npy::file("|u1", "8, 8, 12", &[153; 8 * 8 * 12])).unwrap();
}

#[test]
fn strips_and_arrays_are_drawn_by_weight_and_recorded() {
    let root = tempfile::tempdir().unwrap();
    for i in 0..20 {
        write_strip(&root.path().join(format!("strip-{i}.png")));
        write_array(&root.path().join(format!("array-{i}.npy")));
    }
    fs::write(root.path().join("manifest.tsv"), "name\tlicence\nstrip-3\tCC-BY-4.0\n").unwrap();
    let sources = [SourceConfig::Inria(InriaConfig { weight: 3.0, ..inria(root.path()) }), SourceConfig::Npy(npy(root.path()))];
    let library = MaterialLibrary::open(&sources, 4, 1 << 20).unwrap();
    let strips = (0..2000).filter(|&v| library.name(Split::Train, v).unwrap().starts_with("strip")).count();
    assert!((1420..1580).contains(&strips), "{strips}");

    let manifest = library.manifest();
    assert_eq!(manifest.len(), 40);
    let line = |name: &str| manifest.iter().find(|m| m.name == name).unwrap();
    assert_eq!((line("strip-3").licence.as_str(), line("strip-4").licence.as_str()), ("CC-BY-4.0", "not stated"));
    let source = &line("array-7").source;
    assert!(source.starts_with("npy ") && source.ends_with("array-7.npy"), "{source}");

    let count = library.len(Split::Train);
    for index in 0..count {
        let material = library.nth(Split::Train, index).unwrap();
        let line = line(material.name());
        assert_eq!((&material.info().identity, &material.info().licence), (&line.identity, &line.licence));
        let roughness = if material.name().starts_with("array") { 0.36 } else { 0.6 };
        assert!((material.sample(3.0, 3.0, 1.0).roughness - roughness).abs() < 3e-3, "{}", material.name());
    }
    assert!(library.cached_bytes() > 0);
}

#[test]
fn one_scan_in_several_sources_stays_on_one_side() {
    let root = tempfile::tempdir().unwrap();
    let folders = ["pbr", "strips", "arrays"].map(|name| root.path().join(name));
    folders.iter().for_each(|folder| fs::create_dir(folder).unwrap());
    let [pbr, strips, arrays] = &folders;
    for i in 10..40 {
        let folder = pbr.join(format!("Bricks0{i}A_2K-PNG"));
        fs::create_dir(&folder).unwrap();
        for map in ["Color", "NormalGL", "Roughness"] {
            write_png8(&folder.join(format!("a_{map}.png")), &Planes::constant(8, 8, &[0.5; 3]), Overwrite::Refuse).unwrap();
        }
        write_strip(&strips.join(format!("00000{i};Bricks0{i};1X2.png")));
        write_strip(&strips.join(format!("10000{i};Bricks0{i};2X0.png")));
        write_array(&arrays.join(format!("Bricks0{i}C_4096.npy")));
    }
    let pbr = PbrConfig { path: pbr.clone(), texels: GRID, wrap: Wrap::Repeat, weight: 1.0 };
    let sources = [SourceConfig::Pbr(pbr), SourceConfig::Inria(inria(strips)), SourceConfig::Npy(npy(arrays))];
    let library = MaterialLibrary::open(&sources, 0, 0).unwrap();
    assert!(!library.is_empty(Split::Train) && !library.is_empty(Split::Test));
    for i in 10..40 {
        let identity = format!("bricks0{i}");
        let sides: Vec<Split> = library.manifest().iter().filter(|m| m.identity == identity).map(|m| m.split).collect();
        assert!(sides.len() == 4 && sides.iter().all(|side| *side == sides[0]), "{identity}: {sides:?}");
    }
}

#[test]
fn the_cache_stays_within_its_budget_and_returns_what_it_holds() {
    let sources = [procedural(20, &["plaster"])];
    let one = MaterialLibrary::open(&sources, 0, 0).unwrap().nth(Split::Train, 0).unwrap().bytes();
    let library = MaterialLibrary::open(&sources, 0, 2 * one + one / 2).unwrap();
    let first = library.nth(Split::Train, 0).unwrap();
    assert!(Arc::ptr_eq(&first, &library.nth(Split::Train, 0).unwrap()));
    let second = library.nth(Split::Train, 1).unwrap();
    library.nth(Split::Train, 0).unwrap();
    library.nth(Split::Train, 2).unwrap();
    assert!(library.cached_bytes() <= 2 * one + one / 2);
    assert!(Arc::ptr_eq(&first, &library.nth(Split::Train, 0).unwrap()), "the least recently used one leaves");
    assert!(!Arc::ptr_eq(&second, &library.nth(Split::Train, 1).unwrap()));
    assert!(matches!(library.nth(Split::Train, 500), Err(LibraryError::Index { index: 500, .. })));
}

#[test]
fn workers_share_one_copy() {
    let library = MaterialLibrary::open(&[procedural(8, &["plaster"])], 0, 1 << 24).unwrap();
    let materials: Vec<_> = std::thread::scope(|scope| {
        let handles: Vec<_> = (0..4).map(|_| scope.spawn(|| library.nth(Split::Train, 0).unwrap())).collect();
        handles.into_iter().map(|h| h.join().unwrap()).collect()
    });
    assert!(materials.iter().all(|m| Arc::ptr_eq(m, &materials[0])));
}

#[test]
fn a_smaller_tile_shows_the_same_ground() {
    let mut sizes = [64, 128].map(|size| {
        let config = ProceduralConfig { size, count: 1, families: vec!["bricks".into()], ..ProceduralConfig::default() };
        let library = MaterialLibrary::open(&[SourceConfig::Procedural(config)], 0, 0).unwrap();
        let material = library.nth(library.manifest()[0].split, 0).unwrap();
        material.size()[0] as f32 * material.texel_size()
    });
    sizes.sort_by(f32::total_cmp);
    assert_eq!(sizes, [1024.0; 2]);
}

#[test]
fn configs_are_strict_and_say_what_is_wrong() {
    let parse = |text: &str| toml::from_str::<SourceConfig>(text).map_err(|e| e.to_string());
    let pbr = parse("type = 'pbr'\npath = 'x'\nwrap = 'mirror'").unwrap();
    assert_eq!(pbr, SourceConfig::Pbr(PbrConfig { path: "x".into(), texels: 4096, wrap: Wrap::Mirror, weight: 1.0 }));
    let strips = parse("type = 'inria'\npath = 'x'\nalbedo_encoding = 'linear'").unwrap();
    assert_eq!(strips, SourceConfig::Inria(inria(Path::new("x"))));
    assert!(parse("type = 'inria'\npath = 'x'").unwrap_err().contains("missing field `albedo_encoding`"));
    let srgb = parse("type = 'inria'\npath = 'x'\nalbedo_encoding = 'srgb'").unwrap_err();
    assert!(srgb.contains("unknown variant `srgb`, expected `gamma` or `linear`"), "{srgb}");
    let arrays = "type = 'npy'\npath = 'x'\nalbedo_encoding = 'linear'";
    assert_eq!(parse(&format!("{arrays}\nroughness_squared = true")).unwrap(), SourceConfig::Npy(npy(Path::new("x"))));
    assert!(parse(arrays).unwrap_err().contains("missing field `roughness_squared`"));
    assert_eq!(parse("type = 'procedural'").unwrap(), SourceConfig::Procedural(ProceduralConfig::default()));
    assert!(parse("type = 'procedural'\nsizes = 3").unwrap_err().contains("unknown field `sizes`"));
    assert!(parse("type = 'pbr'").unwrap_err().contains("missing field `path`"));
    assert!(parse("type = 'adobe'").unwrap_err().contains("unknown variant `adobe`"));

    let open = |source| MaterialLibrary::open(&[source], 0, 0).unwrap_err().to_string();
    assert!(open(pbr).contains("path is x; expected an existing folder"));
    assert!(open(strips).contains("source 1 (inria): path is x; expected an existing folder"));
    let coarse = SourceConfig::Npy(NpyConfig { texels: 4, ..npy(Path::new(".")) });
    assert!(open(coarse).contains("source 1 (npy): texels is 4; expected 16 to 65536"));
    assert!(open(procedural(0, &[])).contains("count is 0"));
    let unknown = open(procedural(1, &["brocks"]));
    assert!(unknown.contains("`brocks`") && unknown.contains("bricks, "), "{unknown}");
    assert!(matches!(MaterialLibrary::open(&[], 0, 0), Err(LibraryError::NoSource)));
    let one = MaterialLibrary::open(&[procedural(1, &["bricks"])], 0, 0).unwrap();
    let other = if one.is_empty(Split::Test) { Split::Test } else { Split::Train };
    assert!(matches!(one.material(other, 0), Err(LibraryError::EmptySplit { total: 1, .. })));
}
