//! Preview pictures: maps beside their targets and what they look like.

use ops::planes::Planes;
use render::brdf::BrdfModel;
use render::evaluation::encode;
use render::fused::render;
use render::svbrdf::SvbrdfImage;
use render::views::EvaluationViews;
use render::visual::{below, beside, row_picture};

/// Evaluation views that a preview shows: from the top and from a side at 45°.
const SHOWN_VIEWS: [usize; 2] = [0, 5];

/// One row per set of maps (prediction first, then its target): normal, diffuse, roughness, specular, and two renderings under a
/// flash, from the top and from a side at 45°.
///
/// # Shapes
/// 3 channels, rows · H, 6 · W; display values in [0, 1].
///
/// # Panics
/// If there are no maps or their widths differ.
pub fn preview(rows: &[&SvbrdfImage], model: BrdfModel) -> Planes {
    let views = EvaluationViews::standard().views;
    let pictures: Vec<Planes> = rows
        .iter()
        .map(|maps| {
            let seen = SHOWN_VIEWS.map(|i| encode(render(maps, &views[i], model)));
            beside(&[&row_picture(maps), &seen[0], &seen[1]])
        })
        .collect();
    below(&pictures.iter().collect::<Vec<_>>())
}
