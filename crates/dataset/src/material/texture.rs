//! Does a material show enough detail to align frames by?

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
pub const TEXTURED_CONTRAST: f32 = 0.05;

/// Median over windows of a quarter frame of the standard deviation, within the window, of encoded albedo, normal and
/// roughness (weighted and added as variances). Dimensionless; smooth paint is near 0.01, brick near 0.15.
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
