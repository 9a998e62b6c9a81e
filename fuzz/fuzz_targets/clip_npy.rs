//! Clips as NumPy arrays. The first byte says how frames are cut, shrunk and thinned.
#![no_main]

use std::path::Path;

use dataset::capture::{CaptureConfig, Crop, decode_npy};
use fuzz::{NAME, show};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|input: &[u8]| {
    let Some((options, bytes)) = input.split_first() else { return };
    let config = CaptureConfig {
        resolution: [None, Some(64), Some(65), Some(1 << 20)][usize::from(options & 3)],
        crop: if options & 4 == 0 { Crop::Square } else { Crop::None },
        max_frames: if options & 8 == 0 { 600 } else { 2 },
        max_mib: if options & 16 == 0 { 2048 } else { 1 },
    };
    match decode_npy(bytes, bytes.len() as u64, Path::new(NAME), &config) {
        Ok(clip) => {
            let size = (clip.frames[0].width, clip.frames[0].height);
            assert_eq!(clip.frames.len(), clip.indices.len());
            assert!((2..=config.max_frames).contains(&clip.frames.len()));
            for frame in &clip.frames {
                assert_eq!((frame.channels, frame.width, frame.height), (3, size.0, size.1));
                assert!(frame.data.iter().all(|v| (0.0..=1.0001).contains(v)));
            }
        }
        Err(error) => show(&error),
    }
});
