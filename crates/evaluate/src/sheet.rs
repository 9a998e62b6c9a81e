//! Contact sheets: guidance, aligned frames, maps against reference, renderings.

use ops::planes::Planes;
use render::brdf::BrdfModel;
use render::visual::{below, beside};

use crate::synthetic::Pictures;

/// Side of one picture on the sheet.
const SIDE: usize = 192;
/// Pictures per row: maps and renderings.
const COLUMNS: usize = 6;

/// One material: guidance and aligned frames above, reconstructed maps below, true maps at the bottom.
pub fn contact_sheet(pictures: &Pictures) -> Planes {
    let shrink = |p: &Planes| p.resize_area(SIDE, SIDE);
    let mut frames = vec![shrink(&pictures.guidance)];
    frames.extend(pictures.aligned.iter().map(shrink));
    frames.resize_with(COLUMNS, || Planes::new(3, SIDE, SIDE));
    let frames = beside(&frames[..COLUMNS].iter().collect::<Vec<_>>());
    let maps = svbrdf::visual::preview(&[&pictures.predicted, &pictures.reference], BrdfModel::default());
    let maps = maps.resize_area(2 * SIDE, COLUMNS * SIDE);
    below(&[&frames, &maps])
}
