//! NumPy arrays of four maps. The first byte says how they are stored.
#![no_main]

use std::path::Path;

use dataset::material::{AlbedoEncoding, npy};
use fuzz::{NAME, material_info, sampled, show};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|input: &[u8]| {
    let Some((options, bytes)) = input.split_first() else { return };
    let albedo = if options & 1 == 0 { AlbedoEncoding::Gamma } else { AlbedoEncoding::Linear };
    let info = material_info(options & 12 == 12);
    match npy::decode(bytes, bytes.len() as u64, Path::new(NAME), albedo, options & 2 == 0, info) {
        Ok(material) => sampled(&material),
        Err(error) => show(&error),
    }
});
