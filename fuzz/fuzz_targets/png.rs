//! PNG images.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(init: fuzz::allow_caught_panics(), |bytes: &[u8]| fuzz::image(b"\x89PNG\r\n\x1a\n", bytes));
