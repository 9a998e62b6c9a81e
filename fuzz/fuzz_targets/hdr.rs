//! Radiance HDR images.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| fuzz::image(b"#?RADIANCE\n", bytes));
