//! Diffuse term.

use std::f32::consts::FRAC_1_PI;

use burn::tensor::Tensor;

use super::DiffuseModel;

/// ρd/π or ρd(1 − ρs)/π.
#[inline(always)]
pub fn term(model: DiffuseModel, diffuse: f32, specular: f32) -> f32 {
    match model {
        DiffuseModel::Lambert => diffuse * FRAC_1_PI,
        DiffuseModel::Inria => diffuse * (1.0 - specular) * FRAC_1_PI,
    }
}

/// [`term`] for tensors.
pub fn term_tensor(model: DiffuseModel, diffuse: Tensor<4>, specular: Tensor<4>) -> Tensor<4> {
    match model {
        DiffuseModel::Lambert => diffuse * FRAC_1_PI,
        DiffuseModel::Inria => diffuse * (specular.neg() + 1.0) * FRAC_1_PI,
    }
}
