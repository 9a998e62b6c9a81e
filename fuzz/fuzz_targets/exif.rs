//! What the EXIF data of photographs say of the lens, in any container that the reader knows.
#![no_main]

use dataset::image_io::lens;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let Some(lens) = lens::of_bytes(bytes) else { return };
    assert!(lens.focal_per_diagonal > 0.0 && lens.focal_per_diagonal.is_finite());
    assert!(lens.proportion.is_none_or(|p| p >= 1.0 && p.is_finite()));
    for size in [[4032, 3024], [3024, 4032], [64, 64]] {
        let fov = lens.fov_deg(size, size[0].min(size[1]));
        assert!(fov.is_none_or(|f| (1.0..=150.0).contains(&f)));
    }
});
