//! The loops by vectors of sixteen numbers.

use std::arch::x86_64::*;

use super::loops::vector_loops;
use super::transforms::winograd_transforms;
use super::{CHAINS, Outputs, TILE, Window};

// One accumulator per output: sixteen of 32 registers, and weights come straight from memory into the multiply-add.
vector_loops!(
    "avx512f", __m512, 16, 16, [1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16], 8,
    _mm512_setzero_ps(), _mm512_set1_ps, _mm512_loadu_ps, _mm512_storeu_ps, sixteen_tiles, sixteen_rows,
    |sum, a, b| _mm512_fmadd_ps(a, b, *sum)
);

/// The pixels in a row of sixteen neighbouring tiles whose second ones start at `from`, four apart: `[x][tile]`.
///
/// # Safety
/// Needs AVX-512, 64 pixels there, one before and one behind.
#[target_feature(enable = "avx512f")]
unsafe fn sixteen_tiles(from: *const f32) -> [__m512; 6] {
    // SAFETY: the caller's promise.
    let (parts, before, behind): ([__m512; 4], _, _) = unsafe {
        (
            std::array::from_fn(|i| _mm512_loadu_ps(from.add(16 * i))),
            _mm512_set1_ps(*from.sub(1)),
            _mm512_set1_ps(*from.add(64)),
        )
    };
    // Two of every four pixels, of 32 pixels at a time, then of all.
    let first = _mm512_setr_epi32(0, 4, 8, 12, 16, 20, 24, 28, 1, 5, 9, 13, 17, 21, 25, 29);
    let second = _mm512_add_epi32(first, _mm512_set1_epi32(2));
    let low = _mm512_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7, 16, 17, 18, 19, 20, 21, 22, 23);
    let high = _mm512_add_epi32(low, _mm512_set1_epi32(8));
    let pick = |a, b, which| _mm512_permutex2var_ps(a, which, b);
    let [near, far] = [first, second].map(|which| [pick(parts[0], parts[1], which), pick(parts[2], parts[3], which)]);
    let (one, two) = (pick(near[0], near[1], low), pick(near[0], near[1], high));
    let (three, four) = (pick(far[0], far[1], low), pick(far[0], far[1], high));
    let shifted = |a, b| _mm512_castsi512_ps(_mm512_alignr_epi32::<1>(_mm512_castps_si512(a), _mm512_castps_si512(b)));
    let zero = _mm512_castsi512_ps(_mm512_alignr_epi32::<15>(_mm512_castps_si512(four), _mm512_castps_si512(before)));
    [zero, one, two, three, four, shifted(behind, one)]
}

/// Four results in a row of sixteen neighbouring tiles, `[x][tile]`, as they follow each other.
#[target_feature(enable = "avx512f")]
fn sixteen_rows([one, two, three, four]: [__m512; 4]) -> [__m512; 4] {
    let pairs = [(one, two), (three, four)].map(|(a, b)| (_mm512_unpacklo_ps(a, b), _mm512_unpackhi_ps(a, b)));
    // Quarter `q` has the four results of tile 4·q + i.
    let tiles = |low: __m512, high: __m512| {
        let (low, high) = (_mm512_castps_pd(low), _mm512_castps_pd(high));
        [_mm512_unpacklo_pd(low, high), _mm512_unpackhi_pd(low, high)].map(|v| _mm512_castpd_ps(v))
    };
    let ([a, b], [c, d]) = (tiles(pairs[0].0, pairs[1].0), tiles(pairs[0].1, pairs[1].1));
    let halves = |a, b| (_mm512_shuffle_f32x4::<0x88>(a, b), _mm512_shuffle_f32x4::<0xdd>(a, b));
    let ((ab_even, ab_odd), (cd_even, cd_odd)) = (halves(a, b), halves(c, d));
    let whole = |ab, cd| [_mm512_shuffle_f32x4::<0x88>(ab, cd), _mm512_shuffle_f32x4::<0xdd>(ab, cd)];
    let ([zeroth, second], [first, third]) = (whole(ab_even, cd_even), whole(ab_odd, cd_odd));
    [zeroth, first, second, third]
}
