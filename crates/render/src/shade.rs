//! The tensor route: renderings of the maps on any device, differentiable by autodiff. The readable reference that the
//! other routes are tested against.

use burn::tensor::{Device, Tensor, TensorData};

use crate::brdf::{BrdfModel, ROUGHNESS_MIN, SpecularModel, diffuse, fresnel, masking, ndf};
use crate::svbrdf::Svbrdf;
use crate::views::{Emission, LOSS_COSINE_MIN, Origin, View, plane_x, plane_y};

/// Directions and light at every pixel of a view: what a rendering needs beside the maps.
#[derive(Clone, Debug)]
pub struct Geometry {
    /// Unit directions to the light, `[1, 3, H, W]` (or `[1, 3, 1, 1]`).
    pub wi: Tensor<4>,
    /// Unit directions to the viewer, same shape.
    pub wo: Tensor<4>,
    /// Irradiance perpendicular to wi, `[1, 1, H, W]`.
    pub irradiance: Tensor<4>,
}

impl Geometry {
    /// The geometry of a view of `height × width` maps.
    pub fn new(view: &View, height: usize, width: usize, device: &Device) -> Self {
        let [camera, light] = [view.camera, view.light].map(|origin| constant(origin.position().0, device));
        Self::from_positions(view, camera, light, height, width)
    }

    /// The geometry of a view whose camera and light are tensors, so that gradients reach them: positions (or directions,
    /// where the view has such) that replace those of `view`.
    ///
    /// # Shapes
    /// `[1, 3, 1, 1]` each
    pub fn from_positions(view: &View, camera: Tensor<4>, light: Tensor<4>, height: usize, width: usize) -> Self {
        let x = (0..height * width).map(|i| plane_x(i % width, width));
        let y = (0..height * width).map(|i| plane_y(i / width, height));
        let data: Vec<f32> = x.chain(y).chain(std::iter::repeat_n(0.0, height * width)).collect();
        let plane = Tensor::<4>::from_data(TensorData::new(data, [1, 3, height, width]), &camera.device());
        let to_light = towards(light.clone(), view.light, &plane);
        let wi = unit(to_light.clone());
        let wo = unit(towards(camera, view.camera, &plane));
        let irradiance = irradiance(view, &wi, to_light, light);
        Self { wi, wo, irradiance }
    }
}

fn constant(v: [f32; 3], device: &Device) -> Tensor<4> {
    Tensor::from_data(TensorData::new(v.to_vec(), [1, 3, 1, 1]), device)
}

/// From every point of the plane to a position, or the direction itself.
fn towards(position: Tensor<4>, origin: Origin, plane: &Tensor<4>) -> Tensor<4> {
    position - plane.clone() * origin.position().1
}

fn unit(v: Tensor<4>) -> Tensor<4> {
    let length = v.clone().square().sum_dim(1).clamp_min(1e-30).sqrt();
    v / length
}

fn dot(a: &Tensor<4>, b: &Tensor<4>) -> Tensor<4> {
    (a.clone() * b.clone()).sum_dim(1)
}

fn irradiance(view: &View, wi: &Tensor<4>, to_light: Tensor<4>, light: Tensor<4>) -> Tensor<4> {
    let cosine = wi.clone().narrow(1, 2, 1);
    match (view.emission, view.light) {
        (Emission::Even { intensity }, _) => cosine.clamp_min(LOSS_COSINE_MIN).recip() * intensity,
        (Emission::Flash { intensity, .. }, Origin::Direction(_)) => cosine.ones_like() * intensity,
        (Emission::Flash { intensity, exponent }, Origin::Point(_)) => {
            let cone = dot(wi, &unit(light)).clamp_min(0.0).powf_scalar(exponent);
            cone / to_light.square().sum_dim(1).clamp_min(1e-12) * intensity
        }
    }
}

/// BRDF · max(n·wi, 0) at every pixel; [`crate::pixel::shade`] says what happens below the horizon.
///
/// # Shapes
/// maps `[N, …, H, W]`, directions `[1, 3, H, W]`; result `[N, 3, H, W]`.
pub fn shade(maps: &Svbrdf, wi: &Tensor<4>, wo: &Tensor<4>, model: BrdfModel) -> Tensor<4> {
    let h = unit(wi.clone() + wo.clone());
    let nl = dot(&maps.normal, wi).clamp_min(0.0);
    let vh = dot(wo, &h);
    let weight = match model.specular {
        SpecularModel::Ggx => fresnel::schlick_weight_tensor(vh),
        SpecularModel::GgxClamped => fresnel::gaussian_weight_tensor(vh),
    };
    let diffuse = diffuse::term_tensor(model.diffuse, maps.diffuse.clone(), maps.specular.clone());
    let reflectance = fresnel::reflectance_tensor(maps.specular.clone(), weight);
    let lobe = lobe(maps, wi, wo, &h, model.specular);
    nl * (diffuse + lobe * reflectance)
}

/// D·G / (4 n·wi n·wo), `[N, 1, H, W]`.
fn lobe(maps: &Svbrdf, wi: &Tensor<4>, wo: &Tensor<4>, h: &Tensor<4>, model: SpecularModel) -> Tensor<4> {
    let n = &maps.normal;
    let alpha = maps.roughness.clone().clamp_min(ROUGHNESS_MIN).square();
    let (nv, nh) = (dot(n, wo), dot(n, h));
    let nl = dot(n, wi).clamp_min(0.0);
    match model {
        SpecularModel::Ggx => {
            let alpha2 = alpha.square();
            let d = ndf::ggx_tensor(alpha2.clone(), nh, squared_sine(n, h));
            let visible = nv.clone().greater_elem(0.0).float();
            let gl = masking::smith_factor_tensor(alpha2.clone(), nl);
            let gv = masking::smith_factor_tensor(alpha2, nv.clamp_min(0.0));
            d * gl * gv * visible
        }
        SpecularModel::GgxClamped => {
            let d = ndf::ggx_clamped_tensor(alpha.clone(), nh);
            let gl = masking::clamped_factor_tensor(alpha.clone(), nl);
            let gv = masking::clamped_factor_tensor(alpha, nv.clamp_min(0.0));
            d * gl * gv * 0.25
        }
    }
}

/// |n × h|²: what is left of 1 − (n·h)² without its cancellation.
fn squared_sine(n: &Tensor<4>, h: &Tensor<4>) -> Tensor<4> {
    let part = |t: &Tensor<4>, i: usize| t.clone().narrow(1, i, 1);
    let component = |i: usize, j: usize| part(n, i) * part(h, j) - part(n, j) * part(h, i);
    component(1, 2).square() + component(2, 0).square() + component(0, 1).square()
}

/// Linear radiance of the maps seen in a view.
///
/// # Shapes
/// `[N, 3, H, W]`
pub fn render(maps: &Svbrdf, view: &View, model: BrdfModel) -> Tensor<4> {
    let [_, height, width] = maps.dims();
    render_with(maps, &Geometry::new(view, height, width, &maps.device()), model)
}

/// [`render`] with a geometry at hand, which may carry gradients to the positions of camera and light.
pub fn render_with(maps: &Svbrdf, geometry: &Geometry, model: BrdfModel) -> Tensor<4> {
    shade(maps, &geometry.wi, &geometry.wo, model) * geometry.irradiance.clone()
}
