//! Named random streams: every draw of the data set comes from a generator that is named by (seed, purpose, index).
//!
//! A stream is a pure function of its name, so an item comes out the same whatever the number of workers, the order of
//! requests, or a resume in between. Two names share nothing: the ChaCha key is a SHA-256 digest of the whole name.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use sha2::{Digest, Sha256};

/// Changing this renames every stream, and so changes every data set: never do it without a note in the change log.
const DOMAIN: &[u8] = b"deep reflectance scanning, stream 1";

/// The family of random streams of one seed.
///
/// ```
/// use dataset::stream::Stream;
/// use rand::RngExt;
/// let mut path = Stream::new(7).rng("camera path", 12);
/// let _: f64 = path.random_range(0.0..1.0);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stream {
    seed: u64,
}

impl Stream {
    /// The streams of a seed.
    pub fn new(seed: u64) -> Self {
        Self { seed }
    }

    /// The seed that the streams belong to.
    pub fn seed(&self) -> u64 {
        self.seed
    }

    /// The generator for one purpose ("camera path", "material" …) of one item (a video, a step, a material).
    ///
    /// The key is SHA-256(domain, seed, length of purpose, purpose, index), integers as little-endian 64 bit; the
    /// generator itself is ChaCha with 8 rounds, whose output its crate guarantees across versions.
    pub fn rng(&self, purpose: &str, index: u64) -> ChaCha8Rng {
        let mut hash = Sha256::new();
        hash.update(DOMAIN);
        hash.update(self.seed.to_le_bytes());
        hash.update((purpose.len() as u64).to_le_bytes());
        hash.update(purpose.as_bytes());
        hash.update(index.to_le_bytes());
        ChaCha8Rng::from_seed(hash.finalize().into())
    }

    /// The family of streams that belongs to a part of the run, for parts that have streams of their own.
    pub fn child(&self, purpose: &str, index: u64) -> Self {
        use rand_chacha::rand_core::Rng;
        Self { seed: self.rng(purpose, index).next_u64() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_chacha::rand_core::Rng;

    #[test]
    fn a_name_gives_the_same_numbers_and_every_part_of_it_matters() {
        let first = |seed, purpose: &str, index| Stream::new(seed).rng(purpose, index).next_u64();
        let reference = first(1, "noise", 2);
        assert_eq!(reference, first(1, "noise", 2));
        for other in [first(2, "noise", 2), first(1, "noise ", 2), first(1, "nois", 2), first(1, "noise", 3)] {
            assert_ne!(reference, other);
        }
        assert_ne!(Stream::new(1).child("a", 0), Stream::new(1).child("a", 1));
    }

    /// The numbers themselves are frozen: a run of an older version must be repeatable.
    #[test]
    fn streams_are_stable_across_versions() {
        let mut rng = Stream::new(0).rng("material", 0);
        assert_eq!([rng.next_u64(), rng.next_u64()], FROZEN);
    }

    /// From Python: `sha256(domain + pack('<QQ', 0, 8) + b'material' + pack('<Q', 0))` as the key of ChaCha8, nonce 0.
    const FROZEN: [u64; 2] = [0xf450_e0bc_1bdb_e219, 0xc2b8_7fe3_22b5_90ab];
}
