//! Frames → alignment → maps.

use flow::align::camera::{CameraUnknown, FocalSource, KnownFocal, ScanCamera};
use flow::align::localise::{ImpossibleSetting, LocaliseConfig, NotLocated};
use flow::align::{AlignConfig, AlignError, Alignment};
use ops::planes::{Mask, Planes};
use render::svbrdf::SvbrdfImage;
use serde::{Deserialize, Serialize};
use svbrdf::net::fusion::FusionError;

use crate::guidance::{GuidancePhoto, View};
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
    /// The camera.
    pub camera: CameraConfig,
    /// Where frame 0 is looked for in a guidance photo.
    pub localise: LocaliseConfig,
}

impl Default for ScanConfig {
    fn default() -> Self {
        Self {
            resolution: 512,
            key_frames: 29,
            align: AlignConfig::default(),
            camera: CameraConfig::default(),
            localise: LocaliseConfig::default(),
        }
    }
}

/// What is known of the camera beforehand; 0 stands for unknown.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CameraConfig {
    /// Field of view across a frame's width (of the square that is cut out of a clip), edge to edge, in degrees. It goes before
    /// the pictures' EXIF data, and these before the homographies.
    pub fov_deg: f64,
    /// Width of what the first frame shows, in millimetres: gives heights in millimetres.
    pub width_mm: f64,
}

impl CameraConfig {
    /// The focal length that needn't be found, with `exif_deg`, the field of view that the clip's metadata tell.
    pub fn known(&self, exif_deg: Option<f64>) -> Option<KnownFocal> {
        let config = (self.fov_deg > 0.0).then_some(KnownFocal { fov_deg: self.fov_deg, source: FocalSource::Config });
        config.or_else(|| exif_deg.map(|fov_deg| KnownFocal { fov_deg, source: FocalSource::Exif }))
    }
}

/// Why no material came out.
#[derive(Debug, thiserror::Error)]
pub enum ReconstructError {
    /// The alignment refused its input.
    #[error(transparent)]
    Align(#[from] AlignError),
    /// Frame 0 has no place in the guidance photo.
    #[error("{0}; `--start y0,y1,x0,x1` says by hand which rows and columns of the photo the first frame shows")]
    Guidance(NotLocated),
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

/// A reconstructed material in the axes of frame 0, or of the guidance photo, at the video's density.
#[derive(Clone, Debug)]
pub struct Reconstruction {
    /// Warps of the key frames, or why they were left out.
    pub alignment: Alignment,
    /// The camera that filmed them, or why it isn't known.
    pub camera: Result<ScanCamera, CameraUnknown>,
    /// The maps.
    pub maps: SvbrdfImage,
    /// Per pixel, how many frames saw it (the guidance frame included): 1 plane.
    pub coverage: Planes,
    /// The part of the guidance photo that all this shows; `None` where frame 0 is the guidance image.
    pub view: Option<View>,
}

impl ScanConfig {
    /// Checks the values before any work.
    ///
    /// # Errors
    /// Names the first value that can't work.
    pub fn validate(&self) -> Result<(), ReconstructError> {
        let error = |name, found: &dyn std::fmt::Display, expected| {
            Err(ReconstructError::Config { name, found: found.to_string(), expected })
        };
        let CameraConfig { fov_deg, width_mm } = self.camera;
        match self {
            Self { resolution: r, .. } if !(64..=4096).contains(r) => error("resolution", r, "64 to 4096 pixels"),
            Self { key_frames: k, .. } if !(2..=1000).contains(k) => error("key_frames", k, "2 to 1000 (paper: 29)"),
            _ if fov_deg != 0.0 && !(1.0..=150.0).contains(&fov_deg) => {
                error("camera.fov_deg", &fov_deg, "1 to 150 degrees, or 0 for unknown")
            }
            _ if width_mm != 0.0 && !(0.1..=1e5).contains(&width_mm) => {
                error("camera.width_mm", &width_mm, "0.1 to 100000 millimetres, or 0 for unknown")
            }
            _ => self.localise.validate().map_err(|ImpossibleSetting { name, found, expected }| ReconstructError::Config {
                name,
                found,
                expected,
            }),
        }
    }
}

/// Reconstructs the material that frame 0 shows. `exif_deg` is the field of view that the clip's metadata tell; with a guidance
/// photo everything is given in its axes.
///
/// # Shapes
/// All frames have 3 gamma-encoded planes and one size.
///
/// # Errors
/// See [`ReconstructError`].
pub fn reconstruct(
    frames: &[Planes],
    exif_deg: Option<f64>,
    guidance: Option<&GuidancePhoto>,
    nets: &ScanNets,
    config: &ScanConfig,
) -> Result<Reconstruction, ReconstructError> {
    config.validate()?;
    let mut align = config.align.clone();
    align.key_frame_step = (frames.len().saturating_sub(1) / (config.key_frames - 1)).max(1);
    // First of all: it takes seconds, and what it refuses would be in vain.
    let view = guidance.map(|g| g.view(&frames[0], &config.localise, &config.align.photometric)).transpose();
    let view = view.map_err(ReconstructError::Guidance)?;
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
    let camera = alignment.camera(config.camera.known(exif_deg));
    let result = Reconstruction { alignment, camera, maps, coverage, view: None };
    Ok(match view {
        Some(view) => view.of(result),
        None => result,
    })
}

fn add(coverage: &mut Planes, seen: &Mask) {
    coverage.data.iter_mut().zip(&seen.data).for_each(|(c, &s)| *c += f32::from(s));
}
