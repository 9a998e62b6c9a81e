//! What this machine can do at most, for benchmarks to be held against.

use std::hint::black_box;
use std::time::Instant;

use rayon::prelude::*;

use super::tile::Instructions;

/// Independent chains of multiply-adds: enough to hide the latency of one.
const CHAINS: usize = 10;
/// Lanes of a chain.
const LANES: usize = 8;
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
        let operations = (2 * CHAINS * LANES * rounds * threads) as f64;
        let arithmetic = best(|| {
            rayon::broadcast(|_| black_box(multiply_adds(black_box(0.999_9), rounds)));
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

fn multiply_adds(factor: f32, rounds: usize) -> f32 {
    #[cfg(target_arch = "x86_64")]
    if Instructions::detect() == Instructions::Avx2 {
        // SAFETY: AVX2 and FMA were found just above.
        return unsafe { multiply_adds_avx2(factor, rounds) };
    }
    let mut chains = [[1.0f32; LANES]; CHAINS];
    for _ in 0..rounds {
        for lane in chains.as_flattened_mut() {
            *lane = *lane * factor + 0.5;
        }
    }
    chains.as_flattened().iter().sum()
}

/// By intrinsics: of a plain loop the compiler makes scalar instructions.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn multiply_adds_avx2(factor: f32, rounds: usize) -> f32 {
    use std::arch::x86_64::{_mm256_add_ps, _mm256_cvtss_f32, _mm256_fmadd_ps, _mm256_set1_ps};
    let (factor, half) = (_mm256_set1_ps(factor), _mm256_set1_ps(0.5));
    // Equal chains would be computed once.
    let mut chains: [_; CHAINS] = std::array::from_fn(|i| _mm256_set1_ps(i as f32));
    for _ in 0..rounds {
        for chain in &mut chains {
            *chain = _mm256_fmadd_ps(*chain, factor, half);
        }
    }
    _mm256_cvtss_f32(chains.into_iter().fold(half, |sum, chain| _mm256_add_ps(sum, chain)))
}
