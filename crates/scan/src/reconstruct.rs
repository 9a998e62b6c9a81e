//! Frames → alignment → maps.

use flow::align::{AlignConfig, AlignError, Alignment};
use ops::planes::{Mask, Planes};
use render::svbrdf::SvbrdfImage;
use serde::{Deserialize, Serialize};
use svbrdf::net::fusion::FusionError;

use crate::nets::{ScanNets, key_frame};

/// How a clip becomes maps.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ScanConfig {
    /// Side of the square frames in pixels, and of the maps; a larger clip is made smaller by area filtering.
    pub resolution: usize,
    /// Key frames, the guidance frame among them, spread evenly over the clip (paper: 29 of 141).
    pub key_frames: usize,
    /// The alignment; its `key_frame_step` follows from `key_frames`.
    pub align: AlignConfig,
}

impl Default for ScanConfig {
    fn default() -> Self {
        Self { resolution: 512, key_frames: 29, align: AlignConfig::default() }
    }
}

/// Why no material came out.
#[derive(Debug, thiserror::Error)]
pub enum ReconstructError {
    /// The alignment refused its input.
    #[error(transparent)]
    Align(#[from] AlignError),
    /// The nets refused their input.
    #[error(transparent)]
    Fusion(#[from] FusionError),
    /// Not one key frame could be aligned.
    #[error(
        "none of the {key_frames} key frames could be aligned to frame 0 ({reason}); scan a flat material with visible texture, \
         slowly and from one height, and keep the flash on"
    )]
    NothingAligned {
        /// How many were tried.
        key_frames: usize,
        /// What the first of them says.
        reason: String,
    },
    /// A setting that can't work.
    #[error("scan: {name} = {found}: {expected}")]
    Config {
        /// Its name.
        name: &'static str,
        /// Its value.
        found: String,
        /// What would do.
        expected: &'static str,
    },
}

/// A reconstructed material in the guidance frame's axes and at its resolution.
#[derive(Clone, Debug)]
pub struct Reconstruction {
    /// Warps of the key frames, or why they were left out.
    pub alignment: Alignment,
    /// The maps.
    pub maps: SvbrdfImage,
    /// Per pixel, how many frames saw it (the guidance frame included): 1 plane.
    pub coverage: Planes,
}

impl ScanConfig {
    /// Checks the values before any work.
    ///
    /// # Errors
    /// Names the first value that can't work.
    pub fn validate(&self) -> Result<(), ReconstructError> {
        let error = |name, found: usize, expected| Err(ReconstructError::Config { name, found: found.to_string(), expected });
        match self {
            Self { resolution: r, .. } if !(64..=4096).contains(r) => error("resolution", *r, "64 to 4096 pixels"),
            Self { key_frames: k, .. } if !(2..=1000).contains(k) => error("key_frames", *k, "2 to 1000 (paper: 29)"),
            _ => Ok(()),
        }
    }
}

/// Reconstructs the material that frame 0 shows.
///
/// # Shapes
/// All frames have 3 gamma-encoded planes and one size.
///
/// # Errors
/// See [`ReconstructError`].
pub fn reconstruct(frames: &[Planes], nets: &ScanNets, config: &ScanConfig) -> Result<Reconstruction, ReconstructError> {
    config.validate()?;
    let mut align = config.align.clone();
    align.key_frame_step = (frames.len().saturating_sub(1) / (config.key_frames - 1)).max(1);
    let alignment = nets.aligner(align).align(frames, None)?;
    let aligned = || alignment.key_frames.iter().filter(|k| k.aligned());
    if aligned().next().is_none() {
        let reason = alignment.warnings.last().map_or_else(|| "no motion was found".into(), ToString::to_string);
        return Err(ReconstructError::NothingAligned { key_frames: alignment.key_frames.len(), reason });
    }
    let (height, width) = (frames[0].height, frames[0].width);
    let mut coverage = Planes::constant(height, width, &[1.0]);
    let keys = aligned().map(|k| {
        let (flow, valid) = k.warp(height, width);
        add(&mut coverage, &valid);
        key_frame(frames[k.index].clone(), (flow, valid))
    });
    let maps = nets.maps(&frames[0], keys)?;
    Ok(Reconstruction { alignment, maps, coverage })
}

fn add(coverage: &mut Planes, seen: &Mask) {
    coverage.data.iter_mut().zip(&seen.data).for_each(|(c, &s)| *c += f32::from(s));
}
