//! The loops by vectors of four numbers.

use std::arch::aarch64::*;

use super::loops::vector_loops;
use super::transforms::winograd_transforms;
use super::{CHAINS, Outputs, TILE, Window};

// 6 × 16 accumulators fill 24 of 32 registers.
vector_loops!(
    "neon", float32x4_t, 4, 6, [1 2 3 4 5 6], 6,
    vdupq_n_f32(0.0), vdupq_n_f32, vld1q_f32, vst1q_f32, four_tiles, four_rows,
    |sum, a, b| vfmaq_f32(*sum, a, b)
);

/// The pixels in a row of four neighbouring tiles whose second ones start at `from`, four apart: `[x][tile]`.
///
/// # Safety
/// Needs NEON, 16 pixels there, one before and one behind.
#[target_feature(enable = "neon")]
unsafe fn four_tiles(from: *const f32) -> [float32x4_t; 6] {
    // SAFETY: the caller's promise.
    let (float32x4x4_t(one, two, three, four), before, behind) =
        unsafe { (vld4q_f32(from), vdupq_n_f32(*from.sub(1)), vdupq_n_f32(*from.add(16))) };
    [vextq_f32::<3>(before, four), one, two, three, four, vextq_f32::<1>(one, behind)]
}

/// Four results in a row of four neighbouring tiles, `[x][tile]`, as they follow each other.
#[target_feature(enable = "neon")]
fn four_rows([one, two, three, four]: [float32x4_t; 4]) -> [float32x4_t; 4] {
    let pairs = |a, b| [vtrn1q_f32(a, b), vtrn2q_f32(a, b)].map(|v| vreinterpretq_f64_f32(v));
    let ([zero, one], [two, three]) = (pairs(one, two), pairs(three, four));
    let whole = [vtrn1q_f64(zero, two), vtrn1q_f64(one, three), vtrn2q_f64(zero, two), vtrn2q_f64(one, three)];
    whole.map(|v| vreinterpretq_f32_f64(v))
}
