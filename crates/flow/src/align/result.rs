//! What an alignment hands on: a warp or a reason for every key frame.

use std::fmt;

use ops::flow_field::warp_planes;
use ops::homography::Homography;
use ops::planes::{Mask, Planes};
use serde::{Deserialize, Serialize};

use super::compose::FlowField;
use super::graph::Link;
use super::size::{Size, overlap};

/// Input that can't be aligned at all.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
pub enum AlignError {
    /// There is no frame.
    #[error("a scan needs at least one frame, found none: check the clip or folder that was read")]
    NoFrames,
    /// A frame differs in size or in its number of channels.
    #[error("frame {index} is {found}, but frame 0 is {expected}: all frames of a scan must come from one clip")]
    FrameShape {
        /// Which frame.
        index: usize,
        /// Its channels, height and width.
        found: String,
        /// Those of the first frame.
        expected: String,
    },
    /// An image isn't RGB or is too small to align.
    #[error("{image} is {found}; alignment needs RGB images of at least {smallest}×{smallest} pixels")]
    Unusable {
        /// Which image.
        image: String,
        /// Its channels, height and width.
        found: String,
        /// Smallest side in pixels.
        smallest: usize,
    },
    /// A setting that can't work.
    #[error("align.{name} = {found}: {expected}")]
    Config {
        /// Its name.
        name: &'static str,
        /// Its value.
        found: String,
        /// What would do.
        expected: &'static str,
    },
}

/// Why a key frame doesn't take part.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DropReason {
    /// The frame is black, even or saturated.
    NoTexture,
    /// The guidance image is black, even or saturated.
    GuidanceWithoutTexture,
    /// No consistent link leads from the guidance image to this frame.
    LostTrack,
    /// The frame was placed, but too uncertainly to be used.
    Uncertain,
    /// The frame shows nothing of what the guidance image shows.
    NoOverlap,
    /// The frame was placed, but the surface repeats itself, or has streaks that run one way: most frames fit just as well
    /// somewhere else.
    Repeats,
    /// The frame was placed, but most frames don't look like the guidance image where they were placed.
    UnlikeGuidance,
}

impl fmt::Display for DropReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::NoTexture => "it is black, even or saturated: nothing to align by",
            Self::GuidanceWithoutTexture => "the guidance image is black, even or saturated: nothing to align to",
            Self::LostTrack => "no consistent motion leads from the guidance image to it: scan more slowly or closer",
            Self::Uncertain => "its place is too uncertain",
            Self::UnlikeGuidance => "most key frames don't look like the guidance image where they were placed: there is too little texture, or other light; film closer, or begin where the surface shows more",
            Self::Repeats => "the surface looks the same at several places, as a pattern that repeats or streaks that run one way: begin where a mark or an edge can be seen, or film closer",
            Self::NoOverlap => "it shows nothing of what the guidance image shows",
        })
    }
}

/// Whether a key frame takes part.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum KeyFrameStatus {
    /// Its warp is usable.
    Aligned,
    /// It must be left out.
    Dropped(DropReason),
}

/// A key frame and its place relative to the guidance image.
#[derive(Clone, Debug)]
pub struct KeyFrame {
    /// Index among the frames.
    pub index: usize,
    /// Whether it takes part.
    pub status: KeyFrameStatus,
    /// Guidance pixel to frame pixel, both at full size. For a dropped frame the last estimate, not to be used.
    pub homography: Homography,
    /// Expected error in frame pixels, from the residuals along the links to the guidance image; infinite if unknown.
    pub residual_px: f64,
    /// Share of the guidance image's pixels that the frame shows.
    pub valid_share: f64,
    /// Correlation of the contrast-normalised guidance image and aligned frame over what they share, −1 … 1.
    pub zncc: f64,
    /// Trust in the warp, 0 … 1: 1 for an expected error of 0, ½ for one of 0.5 % of the frame's width.
    pub confidence: f64,
    /// The unregularised warp, where regularisation was switched off.
    pub(super) dense: Option<FlowField>,
    pub(super) frame_size: Size,
}

impl KeyFrame {
    /// Whether it takes part.
    pub fn aligned(&self) -> bool {
        self.status == KeyFrameStatus::Aligned
    }

    /// The backward flow on the guidance image's pixels and where it leads into the frame.
    ///
    /// # Shapes
    /// `height × width` is the guidance image's full size; the flow has 2 planes (x, y) in pixels of the full frame.
    pub fn warp(&self, height: usize, width: usize) -> (Planes, Mask) {
        let Some(field) = &self.dense else {
            let flow = self.homography.flow(height, width);
            return (flow, self.homography.valid(height, width, self.frame_size.height, self.frame_size.width));
        };
        let (fy, fx) = (height as f32 / field.flow.height as f32, width as f32 / field.flow.width as f32);
        let mut flow = field.flow.resize_bilinear(height, width);
        flow.plane_mut(0).iter_mut().for_each(|v| *v *= fx);
        flow.plane_mut(1).iter_mut().for_each(|v| *v *= fy);
        let known = field.valid.to_planes().resize_bilinear(height, width);
        let inside = FlowField::inside(flow, self.frame_size.height, self.frame_size.width);
        let data = inside.valid.data.iter().zip(&known.data).map(|(&i, &k)| i && k > 0.99).collect();
        (inside.flow, Mask { data, height, width })
    }

    /// The frame as the guidance image's camera would see it, and where it is known.
    pub fn aligned_frame(&self, frame: &Planes, height: usize, width: usize) -> (Planes, Mask) {
        let (flow, valid) = self.warp(height, width);
        let (warped, inside) = warp_planes(frame, &flow);
        (warped, inside.and(&valid))
    }
}

/// Something that the report must tell.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Warning {
    /// The motion between two neighbouring frames had to be taken from the motion before and after.
    StepReplaced {
        /// The first of the two frames.
        frame: usize,
    },
    /// A key frame was dropped.
    Dropped {
        /// Its index among the frames.
        frame: usize,
        /// Why.
        reason: DropReason,
    },
    /// Too little of a key frame's warp was known to make it regular: it was used as it was.
    NotRegularised {
        /// Its index among the frames.
        frame: usize,
    },
    /// There is no key frame beside the guidance image.
    NoKeyFrames,
}

impl fmt::Display for Warning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::StepReplaced { frame } => {
                write!(f, "the motion from frame {frame} to {} was not found and is guessed from its neighbours", frame + 1)
            }
            Self::Dropped { frame, reason } => write!(f, "key frame {frame} is left out: {reason}"),
            Self::NotRegularised { frame } => write!(f, "too little of key frame {frame}'s warp is known to make it regular"),
            Self::NoKeyFrames => write!(f, "the scan is too short for a key frame beside the guidance image"),
        }
    }
}

/// The key frames of a scan, aligned to its guidance image.
#[derive(Clone, Debug)]
pub struct Alignment {
    /// In the order of the frames; without the guidance image where that is a frame of the scan.
    pub key_frames: Vec<KeyFrame>,
    /// What the report must tell.
    pub warnings: Vec<Warning>,
    /// The homographies that were measured between nodes (0 the guidance image, i + 1 key frame i), between full pixels.
    pub(super) links: Vec<Link>,
    /// Whether the guidance image is a frame of the scan.
    pub(super) guidance_filmed: bool,
    /// Where the time went.
    pub seconds: Seconds,
}

impl Alignment {
    /// The same alignment to another image: `view` maps its pixels, `size` in all, to those of the guidance image. What no key
    /// frame shows of it lowers the valid shares. The camera is that of the old guidance image: ask for it before.
    pub fn in_view(self, view: &Homography, size: Size) -> Self {
        let seen = |k: KeyFrame| {
            let homography = k.homography.after(view);
            KeyFrame { valid_share: overlap(&homography, size, k.frame_size), homography, dense: None, ..k }
        };
        let key_frames = self.key_frames.into_iter().map(seen).collect();
        Self { key_frames, links: Vec::new(), guidance_filmed: false, ..self }
    }
}

/// Wall time of the parts of an alignment, in seconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Seconds {
    /// Frames read (or rendered), shrunk and contrast-normalised.
    pub reading: f64,
    /// The `adjacent` net's flows.
    pub flows: f64,
    /// Steps between neighbouring frames.
    pub steps: f64,
    /// Key frames linked and placed.
    pub placing: f64,
}

impl Seconds {
    /// All but reading.
    pub fn aligning(&self) -> f64 {
        self.flows + self.steps + self.placing
    }
}
