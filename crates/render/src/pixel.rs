//! One pixel in plain `f32`: the route that renders frames and evaluation images.

use crate::brdf::{BrdfModel, ROUGHNESS_MIN, SpecularModel, diffuse, fresnel, masking, ndf};
use crate::direction::{cross, dot, half};
use crate::texel::Texel;

/// BRDF · max(n·wi, 0).
///
/// Light from below the shading normal's horizon gives 0. The `ggx` lobe vanishes for viewers below it, the diffuse term
/// doesn't: it has no view direction, and a normal map may tilt normals away from a viewer who still sees the surface.
///
/// # Units
/// 1/sr times a cosine: multiply by the irradiance perpendicular to wi to get radiance.
#[inline(always)]
pub fn shade(texel: &Texel, wi: [f32; 3], wo: [f32; 3], model: BrdfModel) -> [f32; 3] {
    let h = half(wi, wo);
    let nl = dot(texel.normal, wi).max(0.0);
    let vh = dot(wo, h);
    let lobe = lobe(texel, wi, wo, h, model.specular);
    let weight = match model.specular {
        SpecularModel::Ggx => fresnel::schlick_weight(vh),
        SpecularModel::GgxClamped => fresnel::gaussian_weight(vh),
    };
    std::array::from_fn(|c| {
        let diffuse = diffuse::term(model.diffuse, texel.diffuse[c], texel.specular[c]);
        nl * (diffuse + lobe * fresnel::reflectance(texel.specular[c], weight))
    })
}

/// D·G / (4 n·wi n·wo): the specular BRDF without its Fresnel term.
#[inline(always)]
pub fn lobe(texel: &Texel, wi: [f32; 3], wo: [f32; 3], h: [f32; 3], model: SpecularModel) -> f32 {
    let n = texel.normal;
    let r = texel.roughness.max(ROUGHNESS_MIN);
    let alpha = r * r;
    let (nl, nv, nh) = (dot(n, wi), dot(n, wo), dot(n, h));
    match model {
        SpecularModel::Ggx => {
            let alpha2 = alpha * alpha;
            let sine = cross(n, h);
            let d = ndf::ggx(alpha2, nh, dot(sine, sine));
            let g = masking::smith_factor(alpha2, nl.max(0.0)) * masking::smith_factor(alpha2, nv.max(0.0));
            if nl > 0.0 && nv > 0.0 { d * g } else { 0.0 }
        }
        SpecularModel::GgxClamped => {
            let d = ndf::ggx_clamped(alpha, nh);
            let g = masking::clamped_factor(alpha, nl.max(0.0)) * masking::clamped_factor(alpha, nv.max(0.0));
            0.25 * d * g
        }
    }
}
