//! The frames of a scan as the aligner, and programs that are compared with it, get them.

use std::borrow::Cow;

use dataset::sequence::Sequence;
use flow::align::Footage;
use ops::planes::Planes;

use crate::EvaluateError;

use super::AlignmentConfig;
use super::film::Film;

/// A scan that is rendered while it is read.
struct Rendered<'a> {
    sequence: &'a Sequence,
    resolution: usize,
}

impl Footage for Rendered<'_> {
    fn count(&self) -> usize {
        self.sequence.len()
    }

    fn frame(&self, index: usize) -> Cow<'_, Planes> {
        Cow::Owned(self.sequence.frame(index, self.resolution))
    }
}

/// A scan's frames under these settings: as they come from the sensor, or from the encoder if there is one.
///
/// # Errors
/// If the scan can't be encoded.
pub fn footage<'a>(sequence: &'a Sequence, config: &AlignmentConfig) -> Result<Box<dyn Footage + 'a>, EvaluateError> {
    let AlignmentConfig { resolution, ref encoding, .. } = *config;
    Ok(if encoding.encodes() {
        Box::new(Film::shoot(sequence, resolution, encoding)?)
    } else {
        Box::new(Rendered { sequence, resolution })
    })
}
