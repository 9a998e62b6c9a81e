//! What a method must beat: constant maps and the identity alignment (spec 6.3).

use dataset::material::library::MaterialLibrary;
use dataset::material::split::Split;
use dataset::sequence::{Sequence, SequenceConfig};
use dataset::stream::Stream;
use svbrdf::constants::ConstantMaps;

use crate::EvaluateError;

/// Side of the target maps that the medians are taken of.
const MEDIAN_RESOLUTION: usize = 32;

/// The medians of the *training* targets: the best maps that don't look at the frames.
///
/// # Errors
/// If a training material can't be loaded.
pub fn constant_maps(
    library: &MaterialLibrary,
    config: &SequenceConfig,
    streams: &Stream,
    videos: u64,
) -> Result<ConstantMaps, EvaluateError> {
    let mut targets = Vec::new();
    for video in 0..videos {
        let material = library.material(Split::Train, video)?;
        targets.push(Sequence::new(material, config, streams, video).target_maps(0, MEDIAN_RESOLUTION));
    }
    ConstantMaps::medians(&targets).ok_or(EvaluateError::Config {
        name: "constant_videos",
        found: "0".into(),
        expected: "at least one training video to take the medians of",
    })
}
