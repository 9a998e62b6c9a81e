//! Microfacet normal distribution D.

use std::f32::consts::{FRAC_1_PI, PI};

use burn::tensor::Tensor;

/// Smallest denominator of the authors' distribution.
pub const CLAMP: f32 = 1e-3;

/// Smallest value of GGX's bracket. For unit vectors it is at least the smallest alpha², 1e-8; only where light and viewer are
/// exactly opposite, so that there is no half vector, would it vanish.
const BRACKET_MIN: f32 = 1e-10;

/// GGX: alpha² / (π ((n·h)²(alpha² − 1) + 1)²).
///
/// The bracket is evaluated as alpha²(n·h)² + |n×h|², which is the same for unit vectors and doesn't cancel to zero at
/// n = h in `f32`.
///
/// # Source
/// Walter et al. 2007, Eq. 33; paper §3.
#[inline(always)]
pub fn ggx(alpha2: f32, nh: f32, sin2: f32) -> f32 {
    let t = (alpha2 * nh * nh + sin2).max(BRACKET_MIN);
    alpha2 / (PI * t * t)
}

/// The authors' released distribution: (alpha / max(1e-3, (n·h)²(alpha² − 1) + 1))² / π.
///
/// # Source
/// Released code; departs from Walter et al. by the clamp.
#[inline(always)]
pub fn ggx_clamped(alpha: f32, nh: f32) -> f32 {
    let nh = nh.max(0.0);
    let q = alpha / (nh * nh * (alpha * alpha - 1.0) + 1.0).max(CLAMP);
    q * q * FRAC_1_PI
}

/// [`ggx`] for tensors of one shape (or broadcastable).
pub fn ggx_tensor(alpha2: Tensor<4>, nh: Tensor<4>, sin2: Tensor<4>) -> Tensor<4> {
    let t = (alpha2.clone() * nh.square() + sin2).clamp_min(BRACKET_MIN);
    alpha2 / (t.square() * PI)
}

/// [`ggx_clamped`] for tensors of one shape (or broadcastable).
pub fn ggx_clamped_tensor(alpha: Tensor<4>, nh: Tensor<4>) -> Tensor<4> {
    let bracket = nh.clamp_min(0.0).square() * (alpha.clone().square() - 1.0) + 1.0;
    (alpha / bracket.clamp_min(CLAMP)).square() * FRAC_1_PI
}
