//! Errors of what the maps look like: the evaluation's renderings compared (spec 6.1).

use render::brdf::BrdfModel;
use render::evaluation::encode;
use render::fused::render;
use render::svbrdf::SvbrdfImage;
use render::views::EvaluationViews;
use serde::{Deserialize, Serialize};

use super::ssim::dssim;

/// Mean errors over the evaluation's renderings.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RenderErrors {
    /// Mean absolute difference of the encoded renderings.
    pub l1: f64,
    /// Mean (1 − SSIM) / 2; absent when the maps are smaller than the SSIM's window.
    pub dssim: Option<f64>,
}

impl RenderErrors {
    /// Renders both maps from every view and compares; `None` when the sizes differ or there is no view.
    pub fn between(
        predicted: &SvbrdfImage,
        reference: &SvbrdfImage,
        views: &EvaluationViews,
        model: BrdfModel,
    ) -> Option<Self> {
        let size = |i: &SvbrdfImage| (i.height(), i.width());
        if size(predicted) != size(reference) || views.views.is_empty() {
            return None;
        }
        let (mut l1, mut structure) = (0.0, Some(0.0));
        for view in &views.views {
            let [a, b] = [predicted, reference].map(|maps| encode(render(maps, view, model)));
            let sum: f64 = a.data.iter().zip(&b.data).map(|(a, b)| f64::from((a - b).abs())).sum();
            l1 += sum / a.data.len() as f64;
            structure = structure.zip(dssim(&a, &b)).map(|(sum, d)| sum + d);
        }
        let count = views.views.len() as f64;
        Some(Self { l1: l1 / count, dssim: structure.map(|sum| sum / count) })
    }

    /// Mean of several materials' errors; `None` for none.
    pub fn mean(errors: &[Self]) -> Option<Self> {
        let count = errors.len() as f64;
        let dssim = errors.iter().map(|e| e.dssim).sum::<Option<f64>>().map(|sum| sum / count);
        (!errors.is_empty()).then(|| Self { l1: errors.iter().map(|e| e.l1).sum::<f64>() / count, dssim })
    }
}
