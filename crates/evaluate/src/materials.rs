//! Which held-out materials a protocol uses.

use std::sync::Arc;

use dataset::material::library::MaterialLibrary;
use dataset::material::split::Split;
use dataset::material::stored::Material;

use crate::EvaluateError;

/// Up to `textured` materials with and `low_texture` without visible texture, from the test side in the manifest's order.
///
/// # Errors
/// If a material can't be loaded, or the test side is empty.
pub fn held_out(library: &MaterialLibrary, textured: usize, low_texture: usize) -> Result<Vec<Arc<Material>>, EvaluateError> {
    let (mut chosen, mut left) = (Vec::new(), [low_texture, textured]);
    let count = library.len(Split::Test);
    for index in 0..count {
        if left == [0, 0] {
            break;
        }
        let material = library.nth(Split::Test, index)?;
        let class = &mut left[usize::from(material.textured())];
        if *class > 0 {
            *class -= 1;
            chosen.push(material);
        }
    }
    if chosen.is_empty() {
        // Says which side is empty and what to do.
        library.material(Split::Test, 0)?;
    }
    Ok(chosen)
}
