//! The laws of distribution of everything that a synthetic scan draws, against the numbers of §4 written out here.
//!
//! A range is checked by its shape (Kolmogorov–Smirnov) and by its ends, which a hundred thousand draws reach to within a
//! ten-thousandth of the range: a constant that is a little off fails.

mod laws;
mod path;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

fn rng(seed: u64) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(seed)
}
