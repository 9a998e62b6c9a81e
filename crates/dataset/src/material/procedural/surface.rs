//! From a height field and a coat of paint to material maps.

use ops::planes::Planes;

use super::colour::{Rgb, mix};
use super::draw::Draw;
use super::field::{Field, TILE, lerp};
use crate::material::maps::MaterialMaps;

/// Roughness of a mirror or of float glass: nothing real is smoother to a camera.
const SMOOTHEST: f32 = 0.01;

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

    /// A metal: coloured specular, no diffuse at all.
    #[inline]
    pub fn metal(specular: Rgb, roughness: f32) -> Self {
        Self { diffuse: [0.0; 3], roughness, specular }
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

/// Rain on a porous surface.
#[derive(Clone, Copy, Debug)]
pub struct Water(f32);

impl Water {
    /// Wet with probability `share`, from damp to soaked; dry otherwise.
    pub fn draw(draw: &mut Draw, share: f32) -> Self {
        Self(if draw.chance(share) { draw.between(0.3, 1.0) } else { 0.0 })
    }

    /// The coat with this water on it; the texel lies `relief` reference texels above its surroundings.
    ///
    /// Water in the pores scatters light forwards, so more of it is absorbed: the albedo falls and its colours deepen. The film
    /// on top is smoother than the substance. What sticks out dries first.
    ///
    /// # Source
    /// Lekner and Dorf, Why some things are darker when wet, Applied Optics 27(7), 1988.
    #[inline]
    pub fn over(self, coat: Coat, relief: f32) -> Coat {
        const FILM: f32 = 0.08;
        if self.0 == 0.0 {
            return coat;
        }
        let wet = self.0 * (0.8 - 0.15 * relief).clamp(0.3, 1.0);
        Coat {
            diffuse: coat.diffuse.map(|v| v * lerp(1.0, 0.35 + 0.65 * v, wet)),
            roughness: lerp(coat.roughness, FILM + 0.35 * coat.roughness, wet),
            ..coat
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
            let reflected = coat.specular[c].clamp(0.0, 1.0);
            // Only light that isn't reflected at the surface can come back from below it.
            diffuse.data[c * area + texel] = coat.diffuse[c].clamp(0.0, 1.0 - reflected);
            specular.data[c * area + texel] = reflected;
        }
        roughness.data[texel] = coat.roughness.clamp(SMOOTHEST, 1.0);
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
