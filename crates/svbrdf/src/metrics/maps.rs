//! Errors of the maps themselves.

use ops::planes::{Mask, Planes};
use render::svbrdf::SvbrdfImage;
use serde::{Deserialize, Serialize};

/// Mean errors over valid pixels and channels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MapErrors {
    /// L1 of the normals, renormalised and encoded to [0, 1].
    pub normal_l1: f64,
    /// Mean angle between the normals in degrees.
    pub normal_deg: f64,
    /// L1 of the linear diffuse albedo.
    pub diffuse_l1: f64,
    /// L1 of the linear specular albedo.
    pub specular_l1: f64,
    /// L1 of the perceptual roughness.
    pub roughness_l1: f64,
}

impl MapErrors {
    /// Compares maps pixel by pixel; without a mask every pixel counts.
    ///
    /// `None` when the sizes differ or no pixel is valid.
    pub fn between(predicted: &SvbrdfImage, reference: &SvbrdfImage, valid: Option<&Mask>) -> Option<Self> {
        let area = reference.roughness.data.len();
        let size = |i: &SvbrdfImage| (i.roughness.height, i.roughness.width);
        if size(predicted) != size(reference) || valid.is_some_and(|m| m.data.len() != area) {
            return None;
        }
        let pixels: Vec<usize> = (0..area).filter(|&i| valid.is_none_or(|m| m.data[i])).collect();
        if pixels.is_empty() {
            return None;
        }
        let (mut encoded, mut angle) = (0.0, 0.0);
        for &i in &pixels {
            let (p, r) = (unit_normal(&predicted.normal, i), unit_normal(&reference.normal, i));
            encoded += (0..3).map(|c| (p[c] - r[c]).abs()).sum::<f64>() / 6.0;
            // The chord keeps small angles exact where the arc cosine loses them.
            let chord = (0..3).map(|c| (p[c] - r[c]).powi(2)).sum::<f64>().sqrt();
            angle += 2.0 * (chord / 2.0).min(1.0).asin().to_degrees();
        }
        let count = pixels.len() as f64;
        let l1 = |p: &Planes, r: &Planes| {
            let sum: f64 = (0..r.channels)
                .map(|c| pixels.iter().map(|&i| f64::from((p.plane(c)[i] - r.plane(c)[i]).abs())).sum::<f64>())
                .sum();
            sum / (count * r.channels as f64)
        };
        Some(Self {
            normal_l1: encoded / count,
            normal_deg: angle / count,
            diffuse_l1: l1(&predicted.diffuse, &reference.diffuse),
            specular_l1: l1(&predicted.specular, &reference.specular),
            roughness_l1: l1(&predicted.roughness, &reference.roughness),
        })
    }

    /// The four L1 errors added up.
    pub fn sum_l1(&self) -> f64 {
        self.normal_l1 + self.diffuse_l1 + self.specular_l1 + self.roughness_l1
    }

    /// Mean of several materials' errors; `None` for none.
    pub fn mean(errors: &[Self]) -> Option<Self> {
        let n = errors.len() as f64;
        let mean = |f: fn(&Self) -> f64| errors.iter().map(f).sum::<f64>() / n;
        (!errors.is_empty()).then(|| Self {
            normal_l1: mean(|e| e.normal_l1),
            normal_deg: mean(|e| e.normal_deg),
            diffuse_l1: mean(|e| e.diffuse_l1),
            specular_l1: mean(|e| e.specular_l1),
            roughness_l1: mean(|e| e.roughness_l1),
        })
    }
}

/// The pixel's normal at unit length; a zero vector stands for (0, 0, 1).
fn unit_normal(normal: &Planes, pixel: usize) -> [f64; 3] {
    let n: [f64; 3] = std::array::from_fn(|c| f64::from(normal.plane(c)[pixel]));
    let length = n.iter().map(|v| v * v).sum::<f64>().sqrt();
    if length > 0.0 { n.map(|v| v / length) } else { [0.0, 0.0, 1.0] }
}
