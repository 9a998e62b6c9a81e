//! Sixteen pixels at a time in plain `f32`: the route of [`crate::pixel`] for frames, as loops that vectorise.
//!
//! Every pixel's result has the bits that the one-pixel route gives it.

#![allow(clippy::needless_range_loop, reason = "lockstep loops over a dozen arrays are plainest with one index")]

use crate::brdf::BrdfModel;
use crate::light::{Incident, Light};
use crate::pixel::shade;
use crate::texel::Texel;

/// Pixels per block.
pub const LANES: usize = 16;
/// One value per pixel.
pub type Lane = [f32; LANES];

/// The reflectance of a block's pixels.
#[derive(Clone, Debug)]
pub struct TexelBlock {
    /// Unit normals.
    pub normal: [Lane; 3],
    /// Linear diffuse albedos.
    pub diffuse: [Lane; 3],
    /// Perceptual roughness.
    pub roughness: Lane,
    /// Linear specular albedos.
    pub specular: [Lane; 3],
}

impl TexelBlock {
    /// Pixel `k`.
    #[inline(always)]
    pub fn at(&self, k: usize) -> Texel {
        let three = |lanes: &[Lane; 3]| [lanes[0][k], lanes[1][k], lanes[2][k]];
        Texel {
            normal: three(&self.normal),
            diffuse: three(&self.diffuse),
            roughness: self.roughness[k],
            specular: three(&self.specular),
        }
    }

    /// Adds to `sum` the linear radiance (RGB) that leaves the points (x, y, 0) towards `eye`: [`crate::light::radiance`].
    #[inline(always)]
    pub fn add_radiance(&self, [x, y]: [&Lane; 2], eye: [f32; 3], lights: &[Light], model: BrdfModel, sum: &mut [Lane; 3]) {
        for light in lights {
            // A loop for each kind of light, so that no loop holds a branch.
            match light {
                Light::Flash { .. } => self.add_light([x, y], eye, light, model, sum),
                Light::Point { .. } => self.add_light([x, y], eye, light, model, sum),
                Light::Directional { .. } => self.add_light([x, y], eye, light, model, sum),
            }
        }
    }

    #[inline(always)]
    fn add_light(&self, [x, y]: [&Lane; 2], eye: [f32; 3], light: &Light, model: BrdfModel, sum: &mut [Lane; 3]) {
        for k in 0..LANES {
            let point = [x[k], y[k], 0.0];
            let wo = crate::direction::unit(crate::direction::minus(eye, point));
            let Incident { wi, irradiance } = light.incident(point);
            let f = shade(&self.at(k), wi, wo, model);
            // Spelt out: a loop over channels would keep the one over pixels from being vectorised.
            sum[0][k] += f[0] * irradiance[0];
            sum[1][k] += f[1] * irradiance[1];
            sum[2][k] += f[2] * irradiance[2];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::direction::unit;
    use crate::light::radiance;
    use ops::kernel::vectorise::vectorised;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn a_block_has_the_bits_of_its_pixels() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let eye = [0.1, -0.2, 0.3];
        let lights = [
            Light::Flash { position: eye, axis: unit([0.1, 0.0, -1.0]), intensity: 0.1, exponent: 4.7 },
            Light::Point { position: [1.0, -2.0, 1.5], irradiance: [0.3, 0.2, 0.1] },
            Light::Directional { wi: unit([-0.5, 0.2, 0.4]), irradiance: [0.1, 0.2, 0.3] },
        ];
        for model in
            [BrdfModel::default(), BrdfModel { specular: crate::brdf::SpecularModel::GgxClamped, ..BrdfModel::default() }]
        {
            let mut three = |low: f32| std::array::from_fn::<f32, 3, _>(|_| rng.random_range(low..1.0));
            let texels: Vec<Texel> = (0..LANES)
                .map(|_| {
                    let [x, y, roughness] = three(-1.0);
                    let normal = unit([x, y, 1.0]);
                    Texel { normal, diffuse: three(0.0), roughness: roughness.abs(), specular: three(0.0) }
                })
                .collect();
            let lane = |value: &dyn Fn(&Texel) -> f32| std::array::from_fn(|k| value(&texels[k]));
            let block = TexelBlock {
                normal: [0, 1, 2].map(|c| lane(&|t| t.normal[c])),
                diffuse: [0, 1, 2].map(|c| lane(&|t| t.diffuse[c])),
                roughness: lane(&|t| t.roughness),
                specular: [0, 1, 2].map(|c| lane(&|t| t.specular[c])),
            };
            let [x, y] = std::array::from_fn(|_| std::array::from_fn::<f32, LANES, _>(|_| rng.random_range(-0.9..0.9)));
            let mut sum = [[0.0; LANES]; 3];
            vectorised(
                #[inline(always)]
                || block.add_radiance([&x, &y], eye, &lights, model, &mut sum),
            );
            for (k, texel) in texels.iter().enumerate() {
                let expected = radiance(texel, [x[k], y[k], 0.0], eye, &lights, model);
                assert_eq!([sum[0][k], sum[1][k], sum[2][k]].map(f32::to_bits), expected.map(f32::to_bits));
            }
        }
    }
}
