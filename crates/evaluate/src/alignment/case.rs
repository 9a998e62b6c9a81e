//! One scan under one condition.

use dataset::material::texture::Texture;
use dataset::sequence::{FrameWarp, Sequence};
use flow::align::metrics::{REFERENCE_WIDTH, ScanErrors, summarise};
use flow::align::size::Size;
use flow::align::{Aligner, Alignment, DropReason, KeyFrameStatus, Seconds};
use flow::weights::FlowNets;
use serde::{Deserialize, Serialize};

use crate::EvaluateError;
use crate::report::Figures;

use super::AlignmentConfig;
use super::camera;
use super::conditions::Condition;
use super::footage::footage;

/// An accepted scan or key frame with a larger mean error, in pixels at a width of 1024, is wrong.
const WRONG_PX: f64 = 10.0;
/// A scan of which a smaller share of the key frames is accepted counts as refused.
const ACCEPTED: f64 = 0.5;

/// Everything measured on one scan under one condition.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Case {
    /// Name of the condition.
    pub condition: String,
    /// The condition's settings.
    pub settings: Vec<String>,
    /// Number of the scan.
    pub sequence: usize,
    /// Name of the material.
    pub material: String,
    /// What it shows to align by.
    pub texture: Texture,
    /// The figures of spec 6.1 by name, with `refused`, `wrong` (accepted, but more than 10 px off on average) and
    /// `wrong_frames` (share of the accepted key frames of which that holds). Those that don't exist, such as the error of a
    /// scan without any accepted key frame, are absent. Those of the camera are explained in [`camera`].
    pub figures: Figures,
    /// What the aligner says of every key frame, and the truth.
    pub key_frames: Vec<KeyFrameRecord>,
    /// Where the time went; reading includes rendering.
    pub seconds: Seconds,
}

/// What is said of a key frame, and what is true.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct KeyFrameRecord {
    /// Index among the frames.
    pub frame: usize,
    /// Why it was dropped; absent for an accepted one.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub dropped: Option<DropReason>,
    /// Expected error in pixels at a width of 1024, where one is known.
    pub expected_px: Option<f64>,
    /// Correlation with the guidance image.
    pub zncc: f64,
    /// Mean distance to the truth in pixels at a width of 1024; absent for a dropped key frame.
    pub error_px: Option<f64>,
}

impl Case {
    /// Renders a scan, aligns it and compares it with the exact warps.
    ///
    /// # Errors
    /// If the aligner refuses its settings, or the scan can't be encoded.
    pub fn measure(
        condition: &Condition,
        index: usize,
        sequence: &Sequence,
        nets: &FlowNets,
        config: &AlignmentConfig,
    ) -> Result<Self, EvaluateError> {
        let aligner = Aligner { config: config.align.clone(), adjacent: Some(&nets.adjacent), distant: Some(&nets.distant) };
        let alignment = aligner.align_footage(&*footage(sequence, config)?, None)?;
        let warps: Vec<FrameWarp> = alignment.key_frames.iter().map(|k| sequence.warp(0, k.index, config.resolution)).collect();
        let step = config.align.key_frame_step;
        let exact = |frame: usize, x: f64, y: f64| warps[frame / step - 1].apply(x, y);
        let size = Size { height: config.resolution, width: config.resolution };
        let errors = ScanErrors::of_warps(&alignment, exact, size);
        Ok(Self {
            condition: condition.name.into(),
            settings: condition.settings.iter().map(ToString::to_string).collect(),
            sequence: index,
            material: sequence.material().into(),
            texture: sequence.texture(),
            figures: figures(&alignment, &errors).into_iter().chain(camera::figures(&alignment, sequence)).collect(),
            key_frames: records(&alignment, &errors, REFERENCE_WIDTH / config.resolution as f64),
            seconds: alignment.seconds,
        })
    }
}

fn figures(alignment: &Alignment, errors: &ScanErrors) -> Figures {
    let m = summarise(std::slice::from_ref(errors));
    let accepted = alignment.key_frames.iter().filter(|k| k.aligned()).count();
    let refused = (accepted as f64) < ACCEPTED * alignment.key_frames.len() as f64;
    let wrong_frames = errors.means().filter(|(_, mean)| *mean > WRONG_PX).count();
    let measured = m.valid_rate > 0.0;
    let figures = [
        ("valid_rate", Some(m.valid_rate)),
        ("pixel_error", measured.then_some(m.pixel_error)),
        ("pixel_error_median", measured.then_some(m.pixel_error_median)),
        ("pixel_error_p95", measured.then_some(m.pixel_error_p95)),
        ("penalised_error", Some(m.penalised_error)),
        ("within_20px", Some(m.within_20px)),
        ("within_4px", Some(m.within_4px)),
        ("diverged", Some(m.diverged)),
        ("refused", Some(f64::from(refused))),
        ("wrong", Some(f64::from(!refused && m.pixel_error > WRONG_PX))),
        ("wrong_frames", (accepted > 0).then(|| wrong_frames as f64 / accepted as f64)),
    ];
    figures.into_iter().filter_map(|(name, value)| Some((name.to_string(), value?))).collect()
}

fn records(alignment: &Alignment, errors: &ScanErrors, scale: f64) -> Vec<KeyFrameRecord> {
    let mut records: Vec<KeyFrameRecord> = alignment
        .key_frames
        .iter()
        .map(|k| KeyFrameRecord {
            frame: k.index,
            dropped: match k.status {
                KeyFrameStatus::Dropped(reason) => Some(reason),
                KeyFrameStatus::Aligned => None,
            },
            expected_px: Some(scale * k.residual_px).filter(|e| e.is_finite()),
            zncc: k.zncc,
            error_px: None,
        })
        .collect();
    errors.means().for_each(|(key_frame, mean)| records[key_frame].error_px = Some(mean));
    records
}
