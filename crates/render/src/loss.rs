//! The rendering losses L_r and L_t (paper §6) by the tensor route. Training on a CPU uses [`crate::fused`], which means
//! the same.

use burn::tensor::Tensor;

use crate::brdf::BrdfModel;
use crate::shade::render;
use crate::svbrdf::Svbrdf;
use crate::views::{LossViews, View};

/// Added to a radiance before its logarithm.
pub const LOG_OFFSET: f32 = 0.1;

/// The two rendering losses of one step, each differentiable.
#[derive(Clone, Debug)]
pub struct RenderingLosses {
    /// L_r: over the diffuse and specular renderings.
    pub rendering: Tensor<1>,
    /// L_t: over the renderings from the top.
    pub top: Tensor<1>,
    /// Value of L_r.
    pub rendering_value: f64,
    /// Value of L_t.
    pub top_value: f64,
}

/// Mean |ln(R + 0.1) − ln(R* + 0.1)| over pixels and channels.
pub fn log_difference(rendering: Tensor<4>, target: Tensor<4>) -> Tensor<1> {
    ((rendering + LOG_OFFSET).log() - (target + LOG_OFFSET).log()).abs().mean()
}

/// L_r and L_t by the tensor route.
///
/// # Panics
/// If a list of views is empty.
pub fn rendering_losses(pred: &Svbrdf, target: &Svbrdf, views: &LossViews, model: BrdfModel) -> RenderingLosses {
    let (rendering, top) = (mean(pred, target, &views.rendering, model), mean(pred, target, &views.top, model));
    let value = |t: &Tensor<1>| t.clone().into_scalar::<f32>().into();
    RenderingLosses { rendering_value: value(&rendering), top_value: value(&top), rendering, top }
}

fn mean(pred: &Svbrdf, target: &Svbrdf, views: &[View], model: BrdfModel) -> Tensor<1> {
    let terms = views.iter().map(|view| log_difference(render(pred, view, model), render(target, view, model)));
    terms.reduce(|a, b| a + b).expect("a loss needs at least one view") / views.len() as f32
}
