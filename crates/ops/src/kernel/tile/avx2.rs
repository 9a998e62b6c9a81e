//! The loops by vectors of eight numbers.

use std::arch::x86_64::*;

use super::loops::vector_loops;
use super::transforms::winograd_transforms;
use super::{CHAINS, Outputs, TILE, Window};

// 6 × 16 accumulators fill twelve of sixteen registers.
vector_loops!(
    "avx2,fma", __m256, 8, 6, [1 2 3 4 5 6], 6,
    _mm256_setzero_ps(), _mm256_set1_ps, _mm256_loadu_ps, _mm256_storeu_ps, eight_tiles, eight_rows,
    |sum, a, b| _mm256_fmadd_ps(a, b, *sum)
);

/// The pixels in a row of eight neighbouring tiles whose second ones start at `from`, four apart: `[x][tile]`.
///
/// # Safety
/// Needs AVX2, 32 pixels there, one before and one behind.
#[target_feature(enable = "avx2")]
unsafe fn eight_tiles(from: *const f32) -> [__m256; 6] {
    // Four pixels of tile `i` and of tile `i + 4`.
    // SAFETY: the caller's promise.
    let [a, b, c, d] = std::array::from_fn(|i| unsafe { _mm256_loadu2_m128(from.add(4 * i + 16), from.add(4 * i)) });
    // SAFETY: the caller's promise.
    let (before, behind) = unsafe { (_mm256_set1_ps(*from.sub(1)), _mm256_set1_ps(*from.add(32))) };
    let [(a, b), (c, d)] = [(a, b), (c, d)].map(|(a, b)| (_mm256_unpacklo_ps(a, b), _mm256_unpackhi_ps(a, b)));
    let [(one, two), (three, four)] =
        [(a, c), (b, d)].map(|(a, b)| (_mm256_shuffle_ps::<0x44>(a, b), _mm256_shuffle_ps::<0xee>(a, b)));
    // A vector's last `4 − n / 4` numbers in each half, and the first ones of another's.
    let joined = |a, b| (_mm256_castps_si256(a), _mm256_castps_si256(b));
    let (a, b) = joined(four, _mm256_insertf128_ps::<1>(before, _mm256_castps256_ps128(four)));
    let zero = _mm256_castsi256_ps(_mm256_alignr_epi8::<12>(a, b));
    let (a, b) = joined(_mm256_permute2f128_ps::<0x21>(one, behind), one);
    [zero, one, two, three, four, _mm256_castsi256_ps(_mm256_alignr_epi8::<4>(a, b))]
}

/// Four results in a row of eight neighbouring tiles, `[x][tile]`, as they follow each other.
#[target_feature(enable = "avx2")]
fn eight_rows([one, two, three, four]: [__m256; 4]) -> [__m256; 4] {
    let [(a, b), (c, d)] = [(one, two), (three, four)].map(|(a, b)| (_mm256_unpacklo_ps(a, b), _mm256_unpackhi_ps(a, b)));
    // Each half has the four results of tile `i` or `i + 4`.
    let [(zero, one), (two, three)] =
        [(a, c), (b, d)].map(|(a, b)| (_mm256_shuffle_ps::<0x44>(a, b), _mm256_shuffle_ps::<0xee>(a, b)));
    let (low, high) = (|a, b| _mm256_permute2f128_ps::<0x20>(a, b), |a, b| _mm256_permute2f128_ps::<0x31>(a, b));
    [low(zero, one), low(two, three), high(zero, one), high(two, three)]
}
