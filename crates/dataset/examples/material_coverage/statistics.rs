//! What is measured of one material.

use dataset::material::Material;
use ops::colour::gamma_encode;
use ops::planes::Planes;
use render::texel::Texel;

use crate::spectrum::Spectrum;

/// Side of the window that is looked at, in texels of the grid: a whole tile of 1024².
pub const SIDE: usize = 1024;
/// Steps of the histograms, over 0 to 1.
pub const STEPS: usize = 1024;
/// Largest tilt that the histograms tell apart.
///
/// # Units
/// Degrees.
pub const MAX_TILT: f32 = 90.0;

/// What is measured of every texel.
pub const QUANTITIES: [&str; 5] = ["diffuse", "saturation", "specular", "roughness", "tilt"];

/// What a histogram's 0 to 1 stands for: degrees for the tilt, the values themselves for the rest.
pub const SCALE: [f32; 5] = [1.0, 1.0, 1.0, 1.0, MAX_TILT];

/// The measurements of one material.
pub struct Statistics {
    /// Its name.
    pub name: String,
    /// Where it comes from: the family of a generated material, the folder of another.
    pub source: String,
    /// Share of the texels per step, for each of the [`QUANTITIES`].
    pub histograms: Vec<Histogram>,
    /// Mean and standard deviation of each.
    pub moments: [[f32; 2]; 5],
    /// How detail is spread over scales.
    pub spectrum: Spectrum,
}

impl Statistics {
    /// Measures a material at one sample per texel of the grid.
    pub fn of(material: &Material) -> Self {
        let mut planes = Planes::new(QUANTITIES.len(), SIDE, SIDE);
        let mut brightness = Planes::new(1, SIDE, SIDE);
        for y in 0..SIDE {
            for x in 0..SIDE {
                let texel = material.sample(x as f32, y as f32, 1.0);
                quantities(&texel).into_iter().enumerate().for_each(|(c, value)| planes.set(c, y, x, value));
                brightness.set(0, y, x, gamma_encode(luminance(total(&texel))));
            }
        }
        let histograms: Vec<_> = (0..QUANTITIES.len()).map(|c| Histogram::of(planes.plane(c), SCALE[c])).collect();
        Self {
            name: material.name().to_owned(),
            source: material.info().source.clone(),
            histograms,
            moments: std::array::from_fn(|c| moments(planes.plane(c))),
            spectrum: Spectrum::of(brightness.plane(0), SIDE),
        }
    }

    /// The values that materials are compared by, named by [`value_names`].
    pub fn values(&self) -> Vec<f32> {
        let of_quantity = |c: usize| {
            let [mean, deviation] = self.moments[c];
            [mean, self.histograms[c].percentile(5.0), self.histograms[c].percentile(95.0), deviation]
        };
        (0..QUANTITIES.len()).flat_map(of_quantity).chain([self.spectrum.slope]).collect()
    }
}

/// Names of [`Statistics::values`].
pub fn value_names() -> Vec<String> {
    let kinds = ["mean", "5th percentile", "95th percentile", "contrast"];
    let names = QUANTITIES.iter().flat_map(|quantity| kinds.map(|kind| format!("{quantity}, {kind}")));
    names.chain(["spectral slope".into()]).collect()
}

/// Which of [`Statistics::values`] span the space in which neighbours are looked for: means, contrasts and the slope. The
/// percentiles say little more than these two and would only weigh them twice.
pub fn is_axis(value: usize) -> bool {
    matches!(value % 4, 0 | 3)
}

/// In the order of [`QUANTITIES`]. Luminances are gamma-encoded, as pictures show them: 0.04 is 0.23.
fn quantities(texel: &Texel) -> [f32; 5] {
    // A metal's colour lies in its specular map, any other material's in its diffuse map.
    let total = total(texel);
    let highest = total.into_iter().fold(0.0, f32::max);
    let lowest = total.into_iter().fold(f32::INFINITY, f32::min);
    let saturation = if highest > 1e-3 { (highest - lowest) / highest } else { 0.0 };
    let tilt = texel.normal[2].clamp(-1.0, 1.0).acos().to_degrees();
    [gamma_encode(luminance(texel.diffuse)), saturation, gamma_encode(luminance(texel.specular)), texel.roughness, tilt]
}

fn total(texel: &Texel) -> [f32; 3] {
    std::array::from_fn(|c| texel.diffuse[c] + texel.specular[c])
}

fn luminance(linear: [f32; 3]) -> f32 {
    linear.into_iter().zip([0.2126, 0.7152, 0.0722]).map(|(v, weight)| v * weight).sum()
}

fn moments(values: &[f32]) -> [f32; 2] {
    let count = values.len() as f64;
    let mean = values.iter().map(|v| f64::from(*v)).sum::<f64>() / count;
    let variance = values.iter().map(|v| (f64::from(*v) - mean).powi(2)).sum::<f64>() / count;
    [mean as f32, variance.sqrt() as f32]
}

/// Shares of values per step.
#[derive(Clone)]
pub struct Histogram {
    shares: Vec<f32>,
    scale: f32,
}

impl Histogram {
    /// Of values between 0 and `scale`.
    pub fn of(values: &[f32], scale: f32) -> Self {
        let mut shares = vec![0.0; STEPS];
        let weight = 1.0 / values.len() as f64;
        let mut counts = vec![0.0f64; STEPS];
        for value in values {
            counts[((value / scale * STEPS as f32) as usize).min(STEPS - 1)] += weight;
        }
        shares.iter_mut().zip(counts).for_each(|(share, count)| *share = count as f32);
        Self { shares, scale }
    }

    /// The mean of several, so that every material counts the same.
    pub fn pooled<'a>(histograms: impl ExactSizeIterator<Item = &'a Self>) -> Self {
        let weight = 1.0 / histograms.len() as f32;
        let mut pooled = Self { shares: vec![0.0; STEPS], scale: 1.0 };
        for histogram in histograms {
            pooled.scale = histogram.scale;
            pooled.shares.iter_mut().zip(&histogram.shares).for_each(|(sum, share)| *sum += weight * share);
        }
        pooled
    }

    /// The value that `percent` of the values lie below.
    pub fn percentile(&self, percent: f32) -> f32 {
        let mut below = 0.0;
        for (step, share) in self.shares.iter().enumerate() {
            if below + share >= percent / 100.0 && *share > 0.0 {
                let within = ((percent / 100.0 - below) / share).clamp(0.0, 1.0);
                return (step as f32 + within) / STEPS as f32 * self.scale;
            }
            below += share;
        }
        self.scale
    }

    /// The shares in `bins` wider steps between 0 and `highest`; what lies above counts as the last.
    pub fn binned(&self, bins: usize, highest: f32) -> Vec<f32> {
        let mut binned = vec![0.0; bins];
        for (step, share) in self.shares.iter().enumerate() {
            let value = (step as f32 + 0.5) / STEPS as f32 * self.scale;
            binned[((value / highest * bins as f32) as usize).min(bins - 1)] += share;
        }
        binned
    }
}
