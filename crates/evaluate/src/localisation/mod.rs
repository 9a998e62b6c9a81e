//! The localisation protocol (paper §7, Table 7's scales; spec 4.4): where frame 0 lies in a guidance photo of a larger area,
//! found by itself, at several scales and under other light.
//!
//! Every case takes frame 0 of a scan of a held-out material and renders photos of the same surface from higher up, somewhere
//! around it, turned and a little tilted, under one of three lights. `scale` is the size of a photo pixel in video pixels. A
//! photo of the next material's surface must be refused.

mod case;
mod table;

pub use case::{Case, Light, Outcome};
pub use table::{markdown, write};

use dataset::material::library::MaterialLibrary;
use dataset::stream::Stream;
use flow::align::localise::{ImpossibleSetting, LocaliseConfig};
use serde::{Deserialize, Serialize};

use crate::EvaluateError;
use crate::alignment::AlignmentConfig;

/// Settings of the protocol.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LocalisationConfig {
    /// Scans; each is measured at every scale.
    pub cases: usize,
    /// The first scan's number.
    pub first: usize,
    /// Sizes of a photo pixel in video pixels.
    pub scales: Vec<f64>,
    /// Width of the photo on the surface in widths of frame 0. Tiles of generated materials repeat after 2 to 2.5 of them: a
    /// wider photo shows the frame's place several times.
    pub cover: f64,
    /// Side of the frames in pixels.
    pub resolution: usize,
    /// Largest turn of the photo against the frame, in degrees.
    pub rotation_deg: f64,
    /// Largest tilt of the photo's camera, in degrees.
    pub tilt_deg: f64,
    /// Where the frame is looked for.
    pub localise: LocaliseConfig,
    /// Seed of paths, photos, lights and noise.
    pub seed: u64,
}

impl Default for LocalisationConfig {
    fn default() -> Self {
        Self {
            cases: 40,
            first: 0,
            scales: vec![1.0, 2.0, 5.0, 10.0],
            cover: 2.5,
            resolution: 1024,
            rotation_deg: 180.0,
            tilt_deg: 5.0,
            localise: LocaliseConfig::default(),
            seed: 7001,
        }
    }
}

impl LocalisationConfig {
    /// Checks the values before any work.
    ///
    /// # Errors
    /// Names the first value that can't work.
    pub fn validate(&self) -> Result<(), EvaluateError> {
        let error = |name, found: String, expected| Err(EvaluateError::Config { name, found, expected });
        match self {
            Self { cases: 0, .. } => error("cases", "0".into(), "at least one scan"),
            Self { scales, .. } if scales.is_empty() || scales.iter().any(|s| !(0.1..=100.0).contains(s)) => {
                error("scales", format!("{scales:?}"), "one or more factors from 0.1 to 100")
            }
            Self { cover, .. } if !(1.0..=20.0).contains(cover) => error("cover", cover.to_string(), "1 to 20 frame widths"),
            Self { resolution: r, .. } if !(64..=4096).contains(r) => error("resolution", r.to_string(), "64 to 4096 pixels"),
            Self { rotation_deg: r, .. } if !(0.0..=180.0).contains(r) => error("rotation_deg", r.to_string(), "0 to 180"),
            Self { tilt_deg: t, .. } if !(0.0..=30.0).contains(t) => error("tilt_deg", t.to_string(), "0 to 30"),
            _ => self.localise.validate().map_err(|ImpossibleSetting { name, found, expected }| EvaluateError::Config {
                name,
                found,
                expected,
            }),
        }
    }
}

/// Measures all cases; `progress` hears of each.
///
/// # Errors
/// If a material can't be loaded or a setting can't work.
pub fn run(
    library: &MaterialLibrary,
    config: &LocalisationConfig,
    mut progress: impl FnMut(&Case),
) -> Result<Vec<Case>, EvaluateError> {
    config.validate()?;
    let scans = AlignmentConfig { resolution: config.resolution, seed: config.seed, ..AlignmentConfig::default() };
    let streams = Stream::new(config.seed);
    let mut cases = Vec::new();
    for index in config.first..config.first + config.cases {
        let (own, other) = (scans.sequence(library, index)?, scans.sequence(library, index + 1)?);
        let frame = own.frame(0, config.resolution);
        for (k, &scale) in config.scales.iter().enumerate() {
            let light = Light::ALL[(index + k) % Light::ALL.len()];
            let mut rng = streams.rng("localisation", (index * 64 + k) as u64);
            // One photo of something else per scan.
            let foreign = (index % config.scales.len() == k).then_some(&other);
            for sequence in std::iter::once(&own).chain(foreign) {
                let case = Case::measure((&own, sequence), &frame, (index, scale, light), config, &mut rng);
                progress(&case);
                cases.push(case);
            }
        }
    }
    Ok(cases)
}

#[cfg(test)]
mod tests;
