//! Where the first frame of a scan lies in a guidance photo of another scale and light (paper §7, where it is set by hand).
//!
//! A disc of the frame is correlated with the photo at every density (`search`) and rotation (`bank`), both contrast-normalised
//! and so small that the frame measures a few dozen pixels. The strongest peaks are refined on the pixels, those that end at the
//! same place are one, and the places are compared (`verify`): one counts only if the images support it far beyond chance, in
//! most parts of the frame, and no other place nearly as much. Where a pattern repeats, all its places are looked for at a finer
//! density (`lattice`), and the best counts if the frame has what tells it from every other one (`votes`).

mod bank;
mod densities;
mod lattice;
mod search;
mod verify;
mod votes;

use std::fmt;

use ops::homography::Homography;
use ops::planes::Planes;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::config::PhotometricConfig;
use super::size::Size;
use densities::Densities;

/// Where the first frame is looked for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct LocaliseConfig {
    /// Least and most pixels of the video per pixel of the photo, measured along a side.
    pub scale: [f64; 2],
    /// Largest rotation between photo and first frame; 180 is any.
    #[schemars(extend("unit" = "degrees"))]
    pub rotation_deg: f64,
}

impl Default for LocaliseConfig {
    fn default() -> Self {
        Self { scale: [0.8, 12.5], rotation_deg: 180.0 }
    }
}

/// A setting of [`LocaliseConfig`] that can't work.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ImpossibleSetting {
    /// Its name, from `localise` on.
    pub name: &'static str,
    /// Its value.
    pub found: String,
    /// What would do.
    pub expected: &'static str,
}

impl LocaliseConfig {
    /// Checks the values before any work.
    ///
    /// # Errors
    /// The first setting that can't work.
    pub fn validate(&self) -> Result<(), ImpossibleSetting> {
        let Self { scale: [least, most], rotation_deg } = *self;
        let error = |name, found: String, expected| Err(ImpossibleSetting { name, found, expected });
        if !(0.05 <= least && least < most && most <= 100.0) {
            return error("localise.scale", format!("[{least}, {most}]"), "[least, most], two factors from 0.05 to 100");
        }
        if !(0.0..=180.0).contains(&rotation_deg) {
            return error("localise.rotation_deg", rotation_deg.to_string(), "0 to 180 degrees");
        }
        Ok(())
    }
}

/// The place of the first frame in the photo.
#[derive(Clone, Copy, Debug)]
pub struct Located {
    /// Photo pixel to frame pixel.
    pub homography: Homography,
    /// Pixels of the video per pixel of the photo, along a side.
    pub scale: f64,
    /// Correlation of the contrast-normalised images, −1 … 1.
    pub zncc: f64,
    /// How many standard errors that is above chance.
    pub significance: f64,
    /// The runner-up's evidence as a share of this place's, 0 … 1: a large one where the pattern repeats but for details.
    pub runner_up: f64,
    /// Expected error in pixels of the frame.
    pub expected_px: f64,
}

/// Why the first frame isn't placed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum NotLocated {
    /// An image is black, even or saturated.
    NoTexture {
        /// Which image.
        image: &'static str,
    },
    /// At no allowed density the photo is as large as the frame and shows it with enough pixels.
    Sizes {
        /// Of the photo.
        guidance: Size,
        /// Of the frame.
        frame: Size,
    },
    /// Nothing in the photo looks like the frame.
    NotFound {
        /// The best place's correlation.
        zncc: f64,
        /// Its standard errors above chance.
        significance: f64,
    },
    /// Several places look like it.
    Ambiguous {
        /// The runner-up's evidence as a share of the best place's.
        runner_up: f64,
    },
}

impl fmt::Display for NotLocated {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoTexture { image } => write!(f, "{image} is black, even or saturated: nothing to find it by"),
            Self::Sizes { guidance, frame } => write!(
                f,
                "a photo of {}×{} pixels can't show a frame of {}×{} with enough pixels at any density looked for; take a larger photo",
                guidance.width, guidance.height, frame.width, frame.height
            ),
            Self::NotFound { zncc, significance } => write!(
                f,
                "the first frame was not found in the photo (best correlation {zncc:.2}, {significance:.1} standard errors above \
                 chance): check that the photo shows the filmed surface, sharply and from above"
            ),
            Self::Ambiguous { runner_up } => write!(
                f,
                "the first frame fits several places of the photo almost equally well ({:.0} % as well at the second): the \
                 pattern repeats; say where it is",
                100.0 * runner_up
            ),
        }
    }
}

impl std::error::Error for NotLocated {}

/// Finds a frame of a scan in a photo that shows more of the surface. `config` is one that [`LocaliseConfig::validate`] lets pass.
///
/// # Shapes
/// Both have 3 gamma-encoded planes.
///
/// # Errors
/// See [`NotLocated`]: no place is better than a wrong one.
pub fn localise(
    guidance: &Planes,
    frame: &Planes,
    config: &LocaliseConfig,
    photometric: &PhotometricConfig,
) -> Result<Located, NotLocated> {
    let (guidance, frame) = (Densities::new(guidance), Densities::new(frame));
    let guesses = search::search(&guidance, &frame, config)?;
    verify::best(&guidance, &frame, &guesses, photometric)
}

/// Refines a place that a person gave: `corners` are row and column ranges `[y0, y1, x0, x1]` of the photo that frame 0 shows.
///
/// # Errors
/// [`NotLocated::NotFound`] where the images don't support a place near it.
pub fn localise_near(
    guidance: &Planes,
    frame: &Planes,
    [y0, y1, x0, x1]: [f64; 4],
    photometric: &PhotometricConfig,
) -> Result<Located, NotLocated> {
    let (sx, sy) = (frame.width as f64 / (x1 - x0), frame.height as f64 / (y1 - y0));
    // Edges of the box to edges of the frame; pixel centres are at integers.
    let matrix = nalgebra::Matrix3::new(sx, 0.0, 0.5 * sx - 0.5 - sx * x0, 0.0, sy, 0.5 * sy - 0.5 - sy * y0, 0.0, 0.0, 1.0);
    let guess = search::Guess { homography: Homography::new(matrix), scale: (sx * sy).sqrt() };
    verify::best(&Densities::new(guidance), &Densities::new(frame), &[guess], photometric)
}

#[cfg(test)]
mod tests;
