//! Masking and shadowing G, in the form the BRDF needs it: G / (4 n·wi n·wo) is split into one factor per direction, which
//! stays finite at grazing angles where G and the cosines vanish together.

use burn::tensor::Tensor;

/// Largest value of a factor of the authors' masking is 1 / this.
pub const CLAMP: f32 = 1e-3;

/// Smith's G1 for GGX divided by 2 n·w: 1 / (c + √(alpha² + (1 − alpha²)c²)), c = n·w ≥ 0.
///
/// The product over both directions is G/(4 n·wi n·wo) with separable masking.
///
/// # Source
/// Walter et al. 2007, Eqs. 23 and 34.
#[inline(always)]
pub fn smith_factor(alpha2: f32, cosine: f32) -> f32 {
    1.0 / (cosine + (alpha2 + (1.0 - alpha2) * cosine * cosine).sqrt())
}

/// The authors' factor 1 / max(c(1 − k) + k, 1e-3), k = alpha/2; the product over both directions is G/(n·wi n·wo), that
/// is, **without** the 4.
///
/// # Source
/// Released code (Karis 2013 with another k).
#[inline(always)]
pub fn clamped_factor(alpha: f32, cosine: f32) -> f32 {
    let k = 0.5 * alpha;
    1.0 / (cosine * (1.0 - k) + k).max(CLAMP)
}

/// [`smith_factor`] for tensors.
pub fn smith_factor_tensor(alpha2: Tensor<4>, cosine: Tensor<4>) -> Tensor<4> {
    let root = (alpha2.clone() + (alpha2.neg() + 1.0) * cosine.clone().square()).sqrt();
    (cosine + root).recip()
}

/// [`clamped_factor`] for tensors.
pub fn clamped_factor_tensor(alpha: Tensor<4>, cosine: Tensor<4>) -> Tensor<4> {
    let k = alpha * 0.5;
    (cosine * (k.clone().neg() + 1.0) + k).clamp_min(CLAMP).recip()
}
