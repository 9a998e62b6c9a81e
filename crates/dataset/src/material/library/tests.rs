use super::*;

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
    let (few, many) = (manifest(340), manifest(680));
    let share = few.iter().filter(|m| m.split == Split::Test).count() as f64 / 340.0;
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
    assert_eq!(parse("type = 'procedural'").unwrap(), SourceConfig::Procedural(ProceduralConfig::default()));
    assert!(parse("type = 'procedural'\nsizes = 3").unwrap_err().contains("unknown field `sizes`"));
    assert!(parse("type = 'pbr'").unwrap_err().contains("missing field `path`"));
    assert!(parse("type = 'adobe'").unwrap_err().contains("unknown variant `adobe`"));

    let open = |source| MaterialLibrary::open(&[source], 0, 0).unwrap_err().to_string();
    assert!(open(pbr).contains("path is x; expected an existing folder"));
    assert!(open(procedural(0, &[])).contains("count is 0"));
    let unknown = open(procedural(1, &["brocks"]));
    assert!(unknown.contains("`brocks`") && unknown.contains("bricks, "), "{unknown}");
    assert!(matches!(MaterialLibrary::open(&[], 0, 0), Err(LibraryError::NoSource)));
    let one = MaterialLibrary::open(&[procedural(1, &["bricks"])], 0, 0).unwrap();
    let other = if one.is_empty(Split::Test) { Split::Test } else { Split::Train };
    assert!(matches!(one.material(other, 0), Err(LibraryError::EmptySplit { total: 1, .. })));
}
