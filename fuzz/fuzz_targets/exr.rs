//! EXR images.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(init: fuzz::allow_caught_panics(), |bytes: &[u8]| fuzz::image(b"\x76\x2f\x31\x01", bytes));
