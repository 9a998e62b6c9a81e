//! Does a material show enough detail to align frames by?

use serde::{Deserialize, Serialize};

use super::stored::Material;

/// Windows per axis over the tile.
const WINDOWS: usize = 5;
/// Pixels per axis of a window: a quarter of a 256-pixel frame.
const WINDOW: usize = 64;
/// Texels of the grid per pixel: a frame of the scanning videos covers about 300 texels (§4, ξ ≈ 0.075).
const PITCH: f32 = 1.2;
/// How much a change of the normal counts beside one of the encoded albedo: under a light at the camera, a tilt darkens
/// little but moves the highlight.
const NORMAL_WEIGHT: f32 = 0.35;
/// The same for the roughness.
const ROUGHNESS_WEIGHT: f32 = 0.25;
/// Materials with less [`contrast`] count as low-texture.
///
/// Where the statistic agrees best with the classes of the procedural families (two materials of each: low-texture ones
/// reach 0.038, all textured families but brushed metal and the palest marble start at 0.041).
pub const TEXTURED_CONTRAST: f32 = 0.04;

/// Materials with less [`contrast`] count as featureless: half a code of an 8-bit frame or so, less than the noise of a pixel.
/// Nothing but the highlight moves in their videos.
pub const FEATURELESS_CONTRAST: f32 = 0.005;

/// What a material shows to align frames by.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Texture {
    /// Enough.
    Rich,
    /// A little: low texture.
    Faint,
    /// Nothing: featureless.
    Absent,
}

impl Texture {
    /// The class of a material.
    pub fn of(material: &Material) -> Self {
        if material.textured() {
            Self::Rich
        } else if contrast(material) >= FEATURELESS_CONTRAST {
            Self::Faint
        } else {
            Self::Absent
        }
    }
}

/// Median over windows of a quarter frame of the standard deviation, within the window, of encoded albedo, normal and
/// roughness (weighted and added as variances). Dimensionless; polished metal is near 0.005, brick near 0.15.
pub fn contrast(material: &Material) -> f32 {
    let [width, height] = material.size().map(|s| s as f32 * material.texel_size());
    let mut windows: Vec<f32> = (0..WINDOWS * WINDOWS)
        .map(|i| {
            let at = |k: usize, length: f32| (k as f32 + 0.5) / WINDOWS as f32 * length;
            window_contrast(material, at(i % WINDOWS, width), at(i / WINDOWS, height))
        })
        .collect();
    windows.sort_by(f32::total_cmp);
    windows[windows.len() / 2]
}

/// Whether the contrast reaches [`TEXTURED_CONTRAST`].
pub fn is_textured(material: &Material) -> bool {
    contrast(material) >= TEXTURED_CONTRAST
}

fn window_contrast(material: &Material, tx: f32, ty: f32) -> f32 {
    let (mut sum, mut square) = ([0.0f64; 4], [0.0f64; 4]);
    for i in 0..WINDOW * WINDOW {
        let texel = material.sample(tx + (i % WINDOW) as f32 * PITCH, ty + (i / WINDOW) as f32 * PITCH, PITCH);
        let luminance: f32 = (0..3).map(|c| [0.2126, 0.7152, 0.0722][c] * (texel.diffuse[c] + texel.specular[c])).sum();
        let values = [
            ops::colour::gamma_encode(luminance),
            NORMAL_WEIGHT * texel.normal[0],
            NORMAL_WEIGHT * texel.normal[1],
            ROUGHNESS_WEIGHT * texel.roughness,
        ];
        for k in 0..4 {
            sum[k] += f64::from(values[k]);
            square[k] += f64::from(values[k]).powi(2);
        }
    }
    let pixels = (WINDOW * WINDOW) as f64;
    let variance: f64 = (0..4).map(|k| (square[k] / pixels - (sum[k] / pixels).powi(2)).max(0.0)).sum();
    variance.sqrt() as f32
}

#[cfg(test)]
mod tests {
    use render::texel::Texel;

    use super::*;
    use crate::material::{MaterialInfo, Precision};

    fn material(texel: impl Fn(usize, usize) -> Texel + Sync) -> Material {
        let info = MaterialInfo { textured: None, ..MaterialInfo::made_up("test") };
        Material::build(info, 128, 128, Precision::Eight, texel).unwrap()
    }

    fn flat(albedo: f32) -> Texel {
        Texel { normal: [0.0, 0.0, 1.0], diffuse: [albedo; 3], roughness: 0.5, specular: [0.04; 3] }
    }

    #[test]
    fn even_materials_are_low_texture_and_patterns_are_not() {
        assert!(contrast(&material(|_, _| flat(0.3))) < 1e-6);
        let checks = |x: usize, y: usize| (x / 8 + y / 8).is_multiple_of(2);
        let painted = material(|x, y| flat(if checks(x, y) { 0.3 } else { 0.5 }));
        assert!(painted.textured(), "{}", contrast(&painted));
        let embossed = material(|x, y| Texel { normal: [if checks(x, y) { 0.3 } else { -0.3 }, 0.0, 0.95], ..flat(0.3) });
        assert!(embossed.textured(), "{}", contrast(&embossed));
        // A slow drift of colour is nothing to align by.
        let drifting = material(|x, _| flat(0.3 + 0.04 * (x as f32 / 128.0 * std::f32::consts::TAU).sin()));
        assert!(!drifting.textured(), "{}", contrast(&drifting));
    }
}
