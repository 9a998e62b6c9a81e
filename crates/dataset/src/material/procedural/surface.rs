//! From a height field and a coat of paint to material maps.

use ops::planes::Planes;

use super::colour::{Rgb, mix};
use super::field::{Field, TILE, lerp};
use crate::material::maps::MaterialMaps;

/// What the surface is made of at one texel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Coat {
    /// Linear diffuse albedo.
    pub diffuse: Rgb,
    /// Perceptual roughness.
    pub roughness: f32,
    /// Linear reflectance at normal incidence.
    pub specular: Rgb,
}

impl Coat {
    /// A non-metal: coloured diffuse, colourless specular (0.02 to 0.06 for common substances).
    #[inline]
    pub fn dielectric(diffuse: Rgb, roughness: f32, specular: f32) -> Self {
        Self { diffuse, roughness, specular: [specular; 3] }
    }

    /// A metal: coloured specular, almost no diffuse.
    #[inline]
    pub fn metal(specular: Rgb, roughness: f32) -> Self {
        Self { diffuse: specular.map(|v| 0.01 * v), roughness, specular }
    }

    /// This coat with a share `t` of the other over it.
    #[inline]
    pub fn under(self, other: Self, t: f32) -> Self {
        let t = t.clamp(0.0, 1.0);
        Self {
            diffuse: mix(self.diffuse, other.diffuse, t),
            roughness: lerp(self.roughness, other.roughness, t),
            specular: mix(self.specular, other.specular, t),
        }
    }
}

/// The maps of a surface: normals by central differences of the height, the coat of every texel as `coat(texel index)`.
///
/// # Units
/// Height in reference texels, so a slope is independent of the resolution.
pub fn paint(height: Field, coat: impl Fn(usize) -> Coat) -> MaterialMaps {
    let size = height.size;
    let area = size * size;
    let (mut diffuse, mut specular) = (Planes::new(3, size, size), Planes::new(3, size, size));
    let mut roughness = Planes::new(1, size, size);
    for texel in 0..area {
        let coat = coat(texel);
        for c in 0..3 {
            diffuse.data[c * area + texel] = coat.diffuse[c].clamp(0.0, 1.0);
            specular.data[c * area + texel] = coat.specular[c].clamp(0.0, 1.0);
        }
        roughness.data[texel] = coat.roughness.clamp(0.02, 1.0);
    }
    let normal = normals(&height);
    let height_field = Some(Planes::from_vec(1, size, size, height.data));
    MaterialMaps { normal, diffuse, roughness, specular, height_field }
}

/// Unit normals (+x right, +y up, +z to the viewer) of a periodic height field whose rows run down.
fn normals(height: &Field) -> Planes {
    let size = height.size;
    let area = size * size;
    // Central differences span two texels.
    let per_texel = size as f32 / TILE * 0.5;
    let mut normal = Planes::new(3, size, size);
    for y in 0..size {
        let row = |y: usize| &height.data[(y % size) * size..][..size];
        let (above, here, below) = (row(y + size - 1), row(y), row(y + 1));
        for x in 0..size {
            let (left, right) = (if x == 0 { size - 1 } else { x - 1 }, if x + 1 == size { 0 } else { x + 1 });
            let nx = (here[left] - here[right]) * per_texel;
            let ny = (below[x] - above[x]) * per_texel;
            let scale = 1.0 / (nx * nx + ny * ny + 1.0).sqrt();
            let texel = y * size + x;
            normal.data[texel] = nx * scale;
            normal.data[area + texel] = ny * scale;
            normal.data[2 * area + texel] = scale;
        }
    }
    normal
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A wave that rises to the right leans its normals to the left, one that rises downwards leans them up.
    #[test]
    fn slopes_lean_the_normals_the_opengl_way() {
        let wave = |t: f32| 10.0 * (t * std::f32::consts::TAU / TILE).sin();
        let coat = Coat::dielectric([0.5; 3], 0.5, 0.04);
        let maps = paint(Field::from_fn(64, |x, _| wave(x)), |_| coat);
        assert!(maps.normal.at(0, 5, 0) < -0.05 && maps.normal.at(1, 5, 0).abs() < 1e-6);
        let maps = paint(Field::from_fn(64, |_, y| wave(y)), |_| coat);
        assert!(maps.normal.at(1, 0, 5) > 0.05 && maps.normal.at(0, 0, 5).abs() < 1e-6);
    }

    #[test]
    fn a_coat_covers_by_its_share() {
        let (steel, paint) = (Coat::metal([0.5; 3], 0.3), Coat::dielectric([0.4, 0.2, 0.1], 0.7, 0.04));
        assert_eq!(steel.under(paint, 0.0), steel);
        let full = steel.under(paint, 2.0);
        assert!((full.specular[0] - 0.04).abs() < 1e-6 && (full.diffuse[0] - 0.4).abs() < 1e-6);
        let half = steel.under(paint, 0.5);
        assert!((half.roughness - 0.5).abs() < 1e-6 && (half.specular[0] - 0.27).abs() < 1e-6);
    }
}
