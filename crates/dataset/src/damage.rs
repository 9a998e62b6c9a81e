//! Damage to the bytes of a good file, for tests of readers: bytes replaced anywhere, the end cut off.

use proptest::prelude::*;

/// What happens to a file; places are shares of its length.
#[derive(Clone, Debug)]
pub(crate) struct Damage {
    kept: f64,
    edits: Vec<(f64, u8)>,
}

impl Damage {
    /// Few edits and mostly whole files, so that readers also get past the header.
    pub(crate) fn any() -> impl Strategy<Value = Self> {
        let edits = prop::collection::vec((0.0..1.0f64, any::<u8>()), 0..12);
        (0.0..1.0f64, edits).prop_map(|(cut, edits)| Self { kept: 1.0 - cut * cut, edits })
    }

    /// The file after the damage.
    pub(crate) fn done_to(&self, bytes: &[u8]) -> Vec<u8> {
        let mut bytes = bytes.to_vec();
        for (place, value) in &self.edits {
            let at = (place * bytes.len() as f64) as usize;
            bytes[at] = *value;
        }
        bytes.truncate((self.kept * bytes.len() as f64).ceil() as usize);
        bytes
    }
}
