//! Renderings by which the evaluation compares maps (paper §8).

use ops::colour::GAMMA;
use ops::planes::Planes;

use crate::approximation::power;
use crate::brdf::BrdfModel;
use crate::fused::render;
use crate::svbrdf::SvbrdfImage;
use crate::views::EvaluationViews;

/// Every view's picture of the maps: clip(radiance, 0, 1)^(1/2.2), not quantised, RGB.
///
/// Light is taken at the maps' own pixels, so the maps are rendered by `ggx` with a Lambertian diffuse term; use
/// [`render_views_with`] for another model.
pub fn render_views(maps: &SvbrdfImage, views: &EvaluationViews) -> Vec<Planes> {
    render_views_with(maps, views, BrdfModel::default())
}

/// [`render_views`] with a given reflectance model.
pub fn render_views_with(maps: &SvbrdfImage, views: &EvaluationViews, model: BrdfModel) -> Vec<Planes> {
    views.views.iter().map(|view| encode(render(maps, view, model))).collect()
}

/// clip(x, 0, 1)^(1/2.2).
pub fn encode(linear: Planes) -> Planes {
    linear.map(|v| power(v.clamp(0.0, 1.0), 1.0 / GAMMA))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::texel::Texel;

    #[test]
    fn pictures_are_encoded_and_lit_from_their_side() {
        let maps = SvbrdfImage::constant(16, 24, &Texel::matte([0.6, 0.3, 0.0]));
        let pictures = render_views(&maps, &EvaluationViews::standard());
        assert_eq!(pictures.len(), 18);
        for picture in &pictures {
            assert_eq!((picture.channels, picture.height, picture.width), (3, 16, 24));
            assert!(picture.data.iter().all(|v| (0.0..=1.0).contains(v)));
        }
        // The first side view (22.5°) is lit from +x: the right half is brighter than the left.
        let half = |from: usize| (0..16).map(|y| (from..from + 12).map(|x| pictures[1].at(0, y, x)).sum::<f32>()).sum::<f32>();
        assert!(half(12) > half(0) * 1.01);
        assert!(encode(Planes::constant(1, 1, &[7.0, -1.0])).data == [1.0, 0.0]);
    }
}
