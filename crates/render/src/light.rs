//! Lights: the flash at the camera, a second light without fall-off, and directional lights, of which a few stand for an
//! [environment](crate::environment).

use serde::{Deserialize, Serialize};

use crate::brdf::BrdfModel;
use crate::direction::{dot, minus, scaled, unit};
use crate::pixel::shade;
use crate::texel::Texel;

/// What reaches a surface point from one light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Incident {
    /// Unit direction to the light.
    pub wi: [f32; 3],
    /// Irradiance on a surface perpendicular to `wi`, RGB.
    pub irradiance: [f32; 3],
}

/// A light source.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Light {
    /// A flash with a cosine-power cone: E = I·max(0, w·axis)^exponent / d² (paper §4), w from the light to the point.
    Flash {
        /// World position.
        position: [f32; 3],
        /// Unit vector of the cone's axis, into the scene.
        axis: [f32; 3],
        /// I.
        intensity: f32,
        /// Exponent e of the cone.
        exponent: f32,
    },
    /// A point light whose irradiance doesn't fall off with distance: the ambient-like second light of the flow sequences.
    Point {
        /// World position.
        position: [f32; 3],
        /// Irradiance everywhere.
        irradiance: [f32; 3],
    },
    /// Light from one direction.
    Directional {
        /// Unit direction to the light.
        wi: [f32; 3],
        /// Irradiance perpendicular to `wi`.
        irradiance: [f32; 3],
    },
}

impl Light {
    /// What reaches a world point.
    #[inline(always)]
    pub fn incident(&self, point: [f32; 3]) -> Incident {
        match *self {
            Self::Flash { position, axis, intensity, exponent } => {
                let to_light = minus(position, point);
                let squared = dot(to_light, to_light).max(1e-12);
                let wi = scaled(to_light, 1.0 / squared.sqrt());
                let cosine = (-dot(wi, axis)).max(0.0);
                let cone = crate::approximation::power(cosine, exponent);
                Incident { wi, irradiance: [intensity * cone / squared; 3] }
            }
            Self::Point { position, irradiance } => Incident { wi: unit(minus(position, point)), irradiance },
            Self::Directional { wi, irradiance } => Incident { wi, irradiance },
        }
    }
}

/// Linear radiance that leaves a world `point` of the material towards `eye`.
#[inline(always)]
pub fn radiance(texel: &Texel, point: [f32; 3], eye: [f32; 3], lights: &[Light], model: BrdfModel) -> [f32; 3] {
    let wo = unit(minus(eye, point));
    let mut sum = [0.0; 3];
    for light in lights {
        let Incident { wi, irradiance } = light.incident(point);
        let f = shade(texel, wi, wo, model);
        for c in 0..3 {
            sum[c] += f[c] * irradiance[c];
        }
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flash_falls_off_with_distance_and_angle() {
        let flash = Light::Flash { position: [0.0, 0.0, 2.0], axis: [0.0, 0.0, -1.0], intensity: 8.0, exponent: 3.0 };
        let centre = flash.incident([0.0; 3]);
        assert_eq!(centre.wi, [0.0, 0.0, 1.0]);
        assert!((centre.irradiance[0] - 2.0).abs() < 1e-5);
        // 60° off the axis: d = 4, cos = ½.
        let off = flash.incident([12f32.sqrt(), 0.0, 0.0]);
        assert!((off.irradiance[1] - 8.0 / 16.0 / 8.0).abs() < 1e-6);
        assert_eq!(flash.incident([0.0, 0.0, 5.0]).irradiance, [0.0; 3], "nothing behind the flash");
    }

    #[test]
    fn radiance_adds_lights() {
        let texel = Texel { specular: [0.0; 3], roughness: 1.0, ..Texel::matte([0.5, 0.25, 1.0]) };
        let sun = Light::Directional { wi: [0.0, 0.6, 0.8], irradiance: [std::f32::consts::PI; 3] };
        let lamp = Light::Point { position: [0.0, 0.0, 7.0], irradiance: [std::f32::consts::PI, 0.0, 0.0] };
        let model = BrdfModel::default();
        let lobe = |light: Light| radiance(&texel, [0.0; 3], [0.0, 0.0, 1.0], &[light], model);
        let both = radiance(&texel, [0.0; 3], [0.0, 0.0, 1.0], &[sun, lamp], model);
        for (c, both) in both.into_iter().enumerate() {
            assert!((both - lobe(sun)[c] - lobe(lamp)[c]).abs() < 1e-6);
        }
        assert!(lobe(sun)[2] >= 0.8 && lobe(lamp)[1] == 0.0);
    }
}
