//! PNG strips of four maps. The first byte says how albedos are stored.
#![no_main]

use std::path::Path;

use dataset::material::{AlbedoEncoding, inria};
use fuzz::{NAME, allow_caught_panics, material_info, sampled, show};
use libfuzzer_sys::fuzz_target;

fuzz_target!(init: allow_caught_panics(), |input: &[u8]| {
    let Some((options, bytes)) = input.split_first() else { return };
    let albedo = if options & 1 == 0 { AlbedoEncoding::Gamma } else { AlbedoEncoding::Linear };
    match inria::decode(bytes, Path::new(NAME), albedo, material_info(options & 6 == 6)) {
        Ok(material) => sampled(&material),
        Err(error) => show(&error),
    }
});
