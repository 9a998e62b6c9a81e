//! Images of the published FlyingChairs set.
#![no_main]

use dataset::chairs::ppm;
use fuzz::show;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| match ppm::parse(bytes) {
    Ok(image) => {
        assert_eq!(image.channels, 3);
        assert!(image.data.iter().all(|v| (0.0..=1.0).contains(v)));
    }
    Err(error) => show(&error),
});
