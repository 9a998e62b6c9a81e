//! Light from everywhere: a lat-long picture of radiances, and the few directional lights that stand for it.

use rand::{Rng, RngExt};

use crate::direction::{dot, scaled};
use crate::light::Light;

/// A lat-long environment: row 0 is the zenith (+z, towards the viewer), the last row the nadir; column 0 is azimuth 0 (+x),
/// azimuth grows counter-clockwise (towards +y).
#[derive(Clone, Debug, PartialEq)]
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

    /// Irradiance of the plane z = 0, RGB: ∫ L(ω) cosθ dω over the upper hemisphere.
    pub fn irradiance(&self) -> [f32; 3] {
        let mut sum = [0.0f64; 3];
        let solid = std::f64::consts::PI / self.rows as f64 * std::f64::consts::TAU / self.columns as f64;
        for (i, radiance) in self.radiance.iter().enumerate() {
            let weight = self.weight(i) * solid;
            (0..3).for_each(|c| sum[c] += weight * f64::from(radiance[c]));
        }
        sum.map(|v| v as f32)
    }

    /// The environment turned counter-clockwise, as seen from above, by a share of a whole turn (rounded to a column).
    pub fn turned(mut self, share: f32) -> Self {
        let columns = (share.rem_euclid(1.0) * self.columns as f32) as usize % self.columns;
        self.radiance.chunks_exact_mut(self.columns).for_each(|row| row.rotate_right(columns));
        self
    }

    fn cell(&self, i: usize) -> [f32; 3] {
        direction(i / self.columns, i % self.columns, self.rows, self.columns)
    }

    /// cosθ sinθ of a cell: what it adds to the plane's irradiance, per radiance and angles.
    fn weight(&self, i: usize) -> f64 {
        let z = self.cell(i)[2];
        f64::from(z.max(0.0) * (1.0 - z * z).max(0.0).sqrt())
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
    /// irradiance of the plane z = 0 (stratified importance sampling), with the plane's irradiance (mean of RGB) scaled to
    /// `irradiance`.
    ///
    /// An environment that is black above the plane gives no light.
    pub fn lights(&self, count: usize, irradiance: f32, rng: &mut impl Rng) -> Vec<Light> {
        let mut cumulative = Vec::with_capacity(self.radiance.len());
        let mut total = 0.0;
        for i in 0..self.radiance.len() {
            total += self.weight(i) * f64::from(self.radiance[i].iter().sum::<f32>() / 3.0);
            cumulative.push(total);
        }
        if total <= 0.0 {
            return Vec::new();
        }
        (0..count)
            .map(|k| {
                let u = (k as f64 + rng.random::<f64>()) / count as f64 * total;
                let i = cumulative.partition_point(|&c| c <= u).min(self.radiance.len() - 1);
                let (wi, colour) = (self.cell(i), self.radiance[i]);
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
    use crate::brdf::BrdfModel;
    use crate::direction::unit;
    use crate::light::{Incident, radiance};
    use crate::pixel::shade;
    use crate::texel::Texel;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

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

    /// Many lights converge to the integral of radiance · BRDF · cosine over all cells, for every surface.
    #[test]
    fn lights_converge_to_the_integral_over_the_hemisphere() {
        let sky = Environment::sky(&mut ChaCha8Rng::seed_from_u64(3));
        let mean = sky.irradiance().iter().sum::<f32>() / 3.0;
        let lights = sky.lights(20_000, mean, &mut ChaCha8Rng::seed_from_u64(1));
        let wo = unit([0.3, -0.2, 1.0]);
        let solid = std::f32::consts::PI / 32.0 * std::f32::consts::TAU / 64.0;
        for (roughness, normal) in [(1.0, [0.0, 0.0, 1.0]), (0.4, unit([0.2, 0.1, 1.0]))] {
            let texel = Texel { normal, roughness, specular: [0.04, 0.3, 0.9], diffuse: [0.5, 0.2, 0.1] };
            let model = BrdfModel::default();
            let mut integral = [0.0; 3];
            for i in 0..32 * 64 {
                let wi = sky.cell(i);
                let sine = (1.0 - wi[2] * wi[2]).max(0.0).sqrt();
                let f = if wi[2] > 0.0 { shade(&texel, wi, wo, model) } else { [0.0; 3] };
                (0..3).for_each(|c| integral[c] += f[c] * sky.radiance[i][c] * sine * solid);
            }
            let sum = radiance(&texel, [0.0; 3], wo.map(|v| 1e4 * v), &lights, model);
            for (sum, integral) in sum.into_iter().zip(integral) {
                assert!((sum - integral).abs() < 0.02 * integral, "r {roughness}: {sum}, integral {integral}");
            }
        }
    }

    #[test]
    fn an_even_sky_has_an_irradiance_of_pi_and_turning_moves_the_sun() {
        let even = Environment::new(64, 128, vec![[1.0; 3]; 64 * 128]).unwrap();
        assert!((even.irradiance()[0] - std::f32::consts::PI).abs() < 2e-3, "{:?}", even.irradiance());
        let mut sun = vec![[0.0; 3]; 8 * 16];
        sun[16] = [1.0; 3];
        let sun = Environment::new(8, 16, sun).unwrap().turned(0.25);
        let Light::Directional { wi, .. } = sun.lights(1, 1.0, &mut ChaCha8Rng::seed_from_u64(1))[0] else { panic!() };
        // Column 0 is half a column beyond azimuth 0; a quarter turn brings it beyond +y.
        assert!(wi[1] > 0.9 * wi[0].hypot(wi[1]) && wi[0] < 0.0, "{wi:?}");
        assert_eq!(sun.clone().turned(1.0), sun);
    }
}
