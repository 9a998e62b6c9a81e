//! Lights: the flash at the camera, a second light without fall-off, directional lights, and environments as a small set of
//! directional lights.

use rand::{Rng, RngExt};
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
    #[inline]
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
#[inline]
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

/// A lat-long environment: row 0 is the zenith (+z, towards the viewer), the last row the nadir; column 0 is azimuth 0 (+x),
/// azimuth grows counter-clockwise (towards +y).
#[derive(Clone, Debug)]
pub struct Environment {
    rows: usize,
    columns: usize,
    radiance: Vec<[f32; 3]>,
}

impl Environment {
    /// Wraps linear radiance values, row-major.
    ///
    /// # Errors
    /// When `radiance` isn't `rows × columns` finite, non-negative values.
    pub fn new(rows: usize, columns: usize, radiance: Vec<[f32; 3]>) -> Result<Self, EnvironmentError> {
        if rows == 0 || columns == 0 || radiance.len() != rows * columns {
            return Err(EnvironmentError::Size { rows, columns, found: radiance.len() });
        }
        match radiance.iter().position(|v| v.iter().any(|c| !(c.is_finite() && *c >= 0.0))) {
            Some(i) => Err(EnvironmentError::Value { row: i / columns, column: i % columns }),
            None => Ok(Self { rows, columns, radiance }),
        }
    }

    /// A procedural overcast sky with a soft bright window at a random azimuth.
    pub fn sky(rng: &mut impl Rng) -> Self {
        let (rows, columns) = (32, 64);
        let azimuth: f32 = rng.random_range(0.0..std::f32::consts::TAU);
        let elevation: f32 = rng.random_range(0.3..1.2);
        let window = [azimuth.cos() * elevation.cos(), azimuth.sin() * elevation.cos(), elevation.sin()];
        let radiance = (0..rows * columns)
            .map(|i| {
                let d = direction(i / columns, i % columns, rows, columns);
                let overcast = (1.0 + 2.0 * d[2].max(0.0)) / 3.0; // CIE overcast sky
                let glow = dot(d, window).max(0.0).powi(24) * 4.0;
                [overcast + glow, overcast + 0.95 * glow, 1.08 * overcast + 0.85 * glow]
            })
            .collect();
        Self { rows, columns, radiance }
    }

    /// `count` directional lights that stand for the upper hemisphere, drawn in proportion to what each part adds to the
    /// irradiance of the plane z = 0 (stratified importance sampling), with the plane's irradiance scaled to `irradiance`.
    ///
    /// An environment that is black above the plane gives no light.
    pub fn lights(&self, count: usize, irradiance: f32, rng: &mut impl Rng) -> Vec<Light> {
        let cell = |i: usize| direction(i / self.columns, i % self.columns, self.rows, self.columns);
        let weight = |i: usize| {
            let d = cell(i);
            let sine = (1.0 - d[2] * d[2]).max(0.0).sqrt();
            f64::from(d[2].max(0.0) * sine * self.radiance[i].iter().sum::<f32>() / 3.0)
        };
        let mut cumulative = Vec::with_capacity(self.radiance.len());
        let mut total = 0.0;
        for i in 0..self.radiance.len() {
            total += weight(i);
            cumulative.push(total);
        }
        if total <= 0.0 {
            return Vec::new();
        }
        (0..count)
            .map(|k| {
                let u = (k as f64 + rng.random::<f64>()) / count as f64 * total;
                let i = cumulative.partition_point(|&c| c <= u).min(self.radiance.len() - 1);
                let (wi, colour) = (cell(i), self.radiance[i]);
                let mean = colour.iter().sum::<f32>() / 3.0;
                // Each light adds the same irradiance to the plane: perpendicular to wi that is more by 1/cos.
                let share = irradiance / count as f32 / wi[2].max(1e-3) / mean.max(1e-12);
                Light::Directional { wi, irradiance: scaled(colour, share) }
            })
            .collect()
    }
}

fn direction(row: usize, column: usize, rows: usize, columns: usize) -> [f32; 3] {
    let polar = (row as f32 + 0.5) / rows as f32 * std::f32::consts::PI;
    let azimuth = (column as f32 + 0.5) / columns as f32 * std::f32::consts::TAU;
    [azimuth.cos() * polar.sin(), azimuth.sin() * polar.sin(), polar.cos()]
}

/// Why an environment can't be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum EnvironmentError {
    /// The number of values doesn't fit the size.
    #[error("an environment of {rows}×{columns} pixels needs {} values and at least one, found {found}", rows * columns)]
    Size {
        /// Rows announced.
        rows: usize,
        /// Columns announced.
        columns: usize,
        /// Values found.
        found: usize,
    },
    /// A value is negative or not finite.
    #[error(
        "the environment's pixel at row {row}, column {column} is negative or not finite; expected linear radiance of at \
         least 0: store the picture as EXR or Radiance HDR without such pixels"
    )]
    Value {
        /// Row of the first such value.
        row: usize,
        /// Its column.
        column: usize,
    },
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

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

    #[test]
    fn an_environment_keeps_its_irradiance_and_its_side() {
        let mut radiance = vec![[0.0; 3]; 16 * 32];
        radiance[4 * 32 + 7] = [3.0, 2.0, 1.0]; // one bright window above the plane
        radiance[12 * 32 + 1] = [9.0; 3]; // below it: must not matter
        let environment = Environment::new(16, 32, radiance).unwrap();
        let lights = environment.lights(8, 0.3, &mut ChaCha8Rng::seed_from_u64(1));
        let mut plane = [0.0; 3];
        for light in &lights {
            let Incident { wi, irradiance } = light.incident([0.0; 3]);
            assert!(wi[2] > 0.0 && wi[0] > 0.0 && wi[1] > 0.0);
            (0..3).for_each(|c| plane[c] += wi[2] * irradiance[c]);
        }
        assert!((plane.iter().sum::<f32>() / 3.0 - 0.3).abs() < 1e-5 && (plane[0] / plane[2] - 3.0).abs() < 1e-4);
        assert_eq!(lights, environment.lights(8, 0.3, &mut ChaCha8Rng::seed_from_u64(1)));
        assert!(Environment::new(1, 1, vec![[0.0; 3]]).unwrap().lights(4, 1.0, &mut ChaCha8Rng::seed_from_u64(1)).is_empty());
        assert_eq!(Environment::new(2, 2, vec![]).unwrap_err(), EnvironmentError::Size { rows: 2, columns: 2, found: 0 });
        assert!(Environment::new(1, 1, vec![[f32::NAN; 3]]).is_err());
        assert_eq!(
            Environment::sky(&mut ChaCha8Rng::seed_from_u64(3)).lights(16, 1.0, &mut ChaCha8Rng::seed_from_u64(1)).len(),
            16
        );
    }
}
