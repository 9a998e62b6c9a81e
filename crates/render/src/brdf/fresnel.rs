//! Fresnel term F = ρs + (1 − ρs)·w: its weight w depends on the directions alone, not on the material.

use burn::tensor::Tensor;

/// Schlick's weight (1 − wo·h)⁵.
///
/// # Source
/// Schlick 1994; paper §3.
#[inline(always)]
pub fn schlick_weight(vh: f32) -> f32 {
    let m = (1.0 - vh).clamp(0.0, 1.0);
    let m2 = m * m;
    m2 * m2 * m
}

/// The authors' weight 2^((−5.55473 wo·h − 6.98316) wo·h), a spherical-Gaussian fit of Schlick's.
///
/// # Source
/// Released code; Karis 2013.
#[inline(always)]
pub fn gaussian_weight(vh: f32) -> f32 {
    crate::approximation::exp2((-5.55473 * vh - 6.98316) * vh)
}

/// ρs + (1 − ρs)·w.
#[inline(always)]
pub fn reflectance(specular: f32, weight: f32) -> f32 {
    specular + (1.0 - specular) * weight
}

/// [`schlick_weight`] for tensors.
pub fn schlick_weight_tensor(vh: Tensor<4>) -> Tensor<4> {
    let m = (vh.neg() + 1.0).clamp(0.0, 1.0);
    m.clone().square().square() * m
}

/// [`gaussian_weight`] for tensors.
pub fn gaussian_weight_tensor(vh: Tensor<4>) -> Tensor<4> {
    ((vh.clone() * -5.55473 - 6.98316) * vh * std::f32::consts::LN_2).exp()
}

/// [`reflectance`] for tensors.
pub fn reflectance_tensor(specular: Tensor<4>, weight: Tensor<4>) -> Tensor<4> {
    specular.clone() + (specular.neg() + 1.0) * weight
}
