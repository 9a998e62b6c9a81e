//! Names that libraries of materials come with: those of the maps in a folder (one per line), and a manifest with the same
//! text.
#![no_main]

use std::path::{Path, PathBuf};

use dataset::material::manifest::Manifest;
use dataset::material::pbr::SetFiles;
use dataset::material::split::{identity_of_file, identity_of_scan, split_of};
use fuzz::{NAME, show};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|text: &str| {
    let names = || text.lines().filter(|name| !name.is_empty());
    let files: Vec<PathBuf> = names().map(PathBuf::from).collect();
    match SetFiles::among(Path::new(NAME), &files) {
        Ok(found) => {
            let channels = [Some(found.roughness.path), found.metalness.map(|map| map.path)];
            let maps = [Some(found.base), Some(found.normal), found.specular.map(|(path, _)| path)];
            assert!(maps.into_iter().chain(channels).flatten().all(|path| files.contains(&path)));
        }
        Err(error) => show(&error),
    }
    match Manifest::parse(Path::new(NAME), text) {
        Ok(manifest) => names().for_each(|name| drop(manifest.row(name))),
        Err(error) => show(&error),
    }
    for name in names() {
        // The same scan under another name of the same identity stays on its side.
        let identities = [identity_of_scan(name), identity_of_file(name)];
        identities.iter().for_each(|identity| {
            split_of(identity);
        });
    }
});
