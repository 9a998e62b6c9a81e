//! Which held-out materials a protocol uses.

use std::sync::Arc;

use dataset::material::library::MaterialLibrary;
use dataset::material::split::Split;
use dataset::material::stored::Material;
use dataset::material::texture::Texture;

use crate::EvaluateError;

/// All classes.
const TEXTURES: [Texture; 3] = [Texture::Rich, Texture::Faint, Texture::Absent];

/// Up to so many materials of each class, from the test side in the manifest's order.
///
/// # Errors
/// If a material can't be loaded, or the test side is empty.
pub fn held_out(library: &MaterialLibrary, most: impl Fn(Texture) -> usize) -> Result<Vec<Arc<Material>>, EvaluateError> {
    let mut chosen: Vec<(Texture, Arc<Material>)> = Vec::new();
    let taken = |chosen: &[(Texture, _)], texture| chosen.iter().filter(|(t, _)| *t == texture).count();
    let count = library.len(Split::Test);
    for index in 0..count {
        if TEXTURES.into_iter().all(|texture| taken(&chosen, texture) >= most(texture)) {
            break;
        }
        let material = library.nth(Split::Test, index)?;
        let texture = Texture::of(&material);
        if taken(&chosen, texture) < most(texture) {
            chosen.push((texture, material));
        }
    }
    if chosen.is_empty() {
        // Says which side is empty and what to do.
        library.material(Split::Test, 0)?;
    }
    Ok(chosen.into_iter().map(|(_, material)| material).collect())
}
