//! What this machine can do at most, for benchmarks to be held against.

use std::hint::black_box;
use std::time::Instant;

use rayon::prelude::*;

use super::tile::Instructions;

/// Numbers per thread that the bandwidth is measured on: far more than a cache holds.
const NUMBERS: usize = 16 << 20;
/// The best of so many tries counts: the others were disturbed.
const TRIES: usize = 5;

/// Measured limits of all threads of the current rayon pool together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Peak {
    /// Billions of `f32` operations per second; a fused multiply-add counts as two.
    pub gflops: f64,
    /// Billions of bytes per second, read and written, of copying what no cache holds.
    pub gbytes: f64,
}

impl Peak {
    /// Measures for about a second.
    pub fn measure() -> Self {
        let threads = rayon::current_num_threads();
        let rounds = 4_000_000;
        let instructions = Instructions::detect();
        let (_, per_round) = instructions.multiply_adds(0.0, 1);
        let operations = (per_round * rounds * threads) as f64;
        let arithmetic = best(|| {
            rayon::broadcast(|_| black_box(instructions.multiply_adds(black_box(0.999_9), rounds)));
        });
        let source = vec![1.0f32; NUMBERS * threads];
        let mut target = vec![0.0f32; NUMBERS * threads];
        let copying = best(|| {
            let parts = target.par_chunks_mut(NUMBERS).zip(source.par_chunks(NUMBERS));
            parts.for_each(|(target, source)| target.copy_from_slice(black_box(source)));
        });
        let bytes = (2 * 4 * NUMBERS * threads) as f64;
        Self { gflops: operations / arithmetic * 1e-9, gbytes: bytes / copying * 1e-9 }
    }
}

impl std::fmt::Display for Peak {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        let threads = rayon::current_num_threads();
        write!(f, "{threads} threads: at most {:.0} GFLOP/s, {:.1} GB/s (copy)", self.gflops, self.gbytes)
    }
}

/// Seconds of the fastest of some runs.
fn best(mut work: impl FnMut()) -> f64 {
    let mut seconds = || {
        let began = Instant::now();
        work();
        began.elapsed().as_secs_f64()
    };
    (0..TRIES).map(|_| seconds()).fold(f64::INFINITY, f64::min)
}
