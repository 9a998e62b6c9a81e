//! The isotropic BRDF of the paper (§3): ρd/π + D·F·G / (4 n·wi n·wo), by one term per file.
//!
//! Every term exists for one pixel (`f32`, no branches, so that loops over pixels vectorise) and for tensors.

pub mod diffuse;
pub mod fresnel;
pub mod masking;
pub mod ndf;

use serde::{Deserialize, Serialize};

/// Smallest perceptual roughness that is evaluated as such: alpha² = 1e-8 is the last value at which value and gradient
/// stay finite in `f32` at grazing angles.
pub const ROUGHNESS_MIN: f32 = 0.01;

/// Which specular lobe.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SpecularModel {
    /// GGX exactly as Walter et al. 2007: no clamps, separable Smith masking, Schlick's Fresnel term.
    #[default]
    Ggx,
    /// What the authors' released code computes, for comparison with published figures: clamps make the peak wrong below
    /// r = 0.178 (at r = 0.1 it is 31.8 instead of 3183).
    GgxClamped,
}

/// Which diffuse term.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DiffuseModel {
    /// ρd/π.
    #[default]
    Lambert,
    /// ρd·(1 − ρs)/π, as in Deschaintre et al. 2018.
    Inria,
}

/// The BRDF: a specular and a diffuse term (Table 3 reports two such models).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BrdfModel {
    /// The specular lobe.
    pub specular: SpecularModel,
    /// The diffuse term.
    pub diffuse: DiffuseModel,
}
