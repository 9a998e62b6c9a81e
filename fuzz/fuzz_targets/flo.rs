//! Flow of the published FlyingChairs set.
#![no_main]

use dataset::chairs::flo;
use fuzz::show;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| match flo::parse(bytes) {
    Ok(flow) => {
        assert_eq!(flow.channels, 2);
        assert!(flow.data.iter().all(|v| v.is_nan() || v.abs() < 1e9));
    }
    Err(error) => show(&error),
});
