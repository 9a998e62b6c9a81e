//! A scan prepared for alignment, and what is concluded about its key frames.

use ops::homography::Homography;
use ops::planes::{Mask, Planes};
use rayon::prelude::*;

use super::compose::FlowField;
use super::config::AlignConfig;
use super::contrast::ContrastPyramid;
use super::graph::Place;
use super::photometric::{Consistency, consistency};
use super::result::{Alignment, DropReason, KeyFrame, KeyFrameStatus, Warning};
use super::size::{Size, overlap, resized};
use super::steady::{self, SteadyPattern};
use super::steps::{NeighbourStep, neighbour_steps};

/// Deviation of the contrast-normalised image below which there is nothing to align by.
const LEAST_TEXTURE: f64 = 0.1;
/// Expected error beyond which a placed key frame is dropped, as a share of the frame's width.
const LARGEST_ERROR_SHARE: f64 = 0.05;
/// Expected error at which a key frame's confidence is one half, as a share of the frame's width.
const HALF_CONFIDENCE_SHARE: f64 = 0.005;

/// The frames and the nodes to be placed: node 0 is the guidance image, node i + 1 is key frame i.
pub(super) struct Scan<'a> {
    frames: &'a [Planes],
    /// Frame indices of the key frames.
    pub keys: Vec<usize>,
    /// Size of the frames for the steps between neighbours.
    pub step_size: Size,
    /// Full size of every node's image.
    pub full: Vec<Size>,
    /// Size at which every node is linked.
    pub sizes: Vec<Size>,
    /// The nodes' images at that size.
    pub images: Vec<Planes>,
    /// The same, contrast-normalised, without what stands still in the clip.
    pub pyramids: Vec<ContrastPyramid>,
    /// Whether a node's image has anything to align by.
    textured: Vec<bool>,
}

impl<'a> Scan<'a> {
    pub fn new(frames: &'a [Planes], guidance: Option<&'a Planes>, config: &AlignConfig) -> Self {
        let first = if guidance.is_some() { 0 } else { config.key_frame_step };
        let keys: Vec<usize> = (first..frames.len()).step_by(config.key_frame_step).collect();
        let key_images = keys.iter().map(|&k| &frames[k]);
        let nodes: Vec<&Planes> = std::iter::once(guidance.unwrap_or(&frames[0])).chain(key_images).collect();
        let full: Vec<Size> = nodes.iter().map(|n| Size::of(n)).collect();
        let sizes: Vec<Size> = full.iter().map(|s| s.limited(config.refine_size)).collect();
        let images: Vec<Planes> = nodes.par_iter().zip(&sizes).map(|(n, s)| n.resize_area(s.height, s.width)).collect();
        let mut pyramids: Vec<ContrastPyramid> =
            images.par_iter().map(|i| ContrastPyramid::new(i, &config.photometric)).collect();
        // Before the steady pattern goes: an empty frame minus a pattern isn't empty.
        let textured = pyramids.iter().map(|p| p.texture() >= LEAST_TEXTURE).collect();
        // A guidance image of its own was lit in its own way.
        let filmed = &mut pyramids[usize::from(guidance.is_some())..];
        if filmed.len() >= steady::FEWEST_FRAMES {
            take_out_steady(filmed, None, config);
        } else {
            // Too few key frames to tell the light from the surface: other frames of the clip help.
            let size = Size::of(&frames[0]).limited(config.refine_size);
            let spread: Vec<&Planes> = frames.iter().step_by((frames.len() / steady::FEWEST_FRAMES).max(1)).collect();
            let more = |f: &&Planes| ContrastPyramid::new(&f.resize_area(size.height, size.width), &config.photometric);
            take_out_steady(filmed, Some(spread.par_iter().map(more).collect()), config);
        }
        let step_size = Size::of(&frames[0]).limited(config.size);
        Self { frames, keys, step_size, full, sizes, images, pyramids, textured }
    }

    /// The steps between neighbouring frames, at the size on which key frames are linked.
    pub fn neighbour_steps(&self, flows: Option<&[FlowField]>, config: &AlignConfig) -> Vec<NeighbourStep> {
        let Size { height, width } = self.step_size;
        let small = |f: &Planes| ContrastPyramid::new(&f.resize_area(height, width), &config.photometric);
        let mut pyramids: Vec<ContrastPyramid> = self.frames.par_iter().map(small).collect();
        take_out_steady(&mut pyramids, None, config);
        let mut steps = neighbour_steps(&pyramids, flows, config);
        let (from, to) = (self.step_size, Size::of(&self.images[self.images.len() - 1]));
        for step in &mut steps {
            step.step.homography = resized(&step.step.homography, (from, to), (from, to));
            step.step.expected_px *= to.width as f64 / from.width as f64;
        }
        steps
    }

    /// The share of the guidance image that a node shows.
    pub fn share(&self, node: usize, homography: &Homography) -> f64 {
        overlap(homography, self.sizes[0], self.sizes[node])
    }

    /// Whether a node's image has anything to align by.
    pub fn textured(&self, node: usize) -> bool {
        self.textured[node]
    }

    /// The key frames at their places, with the warnings of all steps.
    pub fn conclude(&self, places: &[Option<Place>], steps: &[NeighbourStep]) -> Alignment {
        let nodes = (1..self.sizes.len()).into_par_iter();
        let key_frames: Vec<KeyFrame> = nodes.map(|n| self.key_frame(n, &places[n])).collect();
        let replaced = steps.iter().enumerate().filter(|(_, s)| s.replaced);
        let mut warnings: Vec<Warning> = replaced.map(|(frame, _)| Warning::StepReplaced { frame }).collect();
        warnings.extend(dropped(&key_frames));
        Alignment { key_frames, warnings }
    }

    fn key_frame(&self, node: usize, place: &Option<Place>) -> KeyFrame {
        let known = place.unwrap_or(Place { homography: Homography::identity(), error_px: f64::INFINITY });
        let share = self.share(node, &known.homography);
        let alike = match place {
            Some(p) => consistency(&self.pyramids[0], &self.pyramids[node], &p.homography, 0),
            None => Consistency::NONE,
        };
        let relative = known.error_px / self.sizes[node].width as f64;
        let status = match place {
            _ if !self.textured(0) => KeyFrameStatus::Dropped(DropReason::GuidanceWithoutTexture),
            _ if !self.textured(node) => KeyFrameStatus::Dropped(DropReason::NoTexture),
            None => KeyFrameStatus::Dropped(DropReason::LostTrack),
            Some(_) if relative > LARGEST_ERROR_SHARE => KeyFrameStatus::Dropped(DropReason::Uncertain),
            Some(_) if share == 0.0 => KeyFrameStatus::Dropped(DropReason::NoOverlap),
            Some(_) => KeyFrameStatus::Aligned,
        };
        KeyFrame {
            index: self.keys[node - 1],
            status,
            homography: resized(&known.homography, (self.sizes[0], self.full[0]), (self.sizes[node], self.full[node])),
            residual_px: relative * self.full[node].width as f64,
            valid_share: share,
            zncc: alike.zncc,
            confidence: 1.0 / (1.0 + (relative / HALF_CONFIDENCE_SHARE).powi(2)),
            dense: None,
            frame_size: self.full[node],
        }
    }
}

/// Takes what stands still out of the frames, as it shows in `examples` or in the frames themselves.
fn take_out_steady(pyramids: &mut [ContrastPyramid], examples: Option<Vec<ContrastPyramid>>, config: &AlignConfig) {
    let pattern = SteadyPattern::measure(examples.as_deref().unwrap_or(pyramids));
    if let Some(pattern) = pattern.filter(|_| config.steady) {
        pyramids.par_iter_mut().for_each(|p| pattern.remove(p));
    }
}

/// A warning for every dropped key frame.
pub(super) fn dropped(key_frames: &[KeyFrame]) -> impl Iterator<Item = Warning> + '_ {
    key_frames.iter().filter_map(|k| match k.status {
        KeyFrameStatus::Dropped(reason) => Some(Warning::Dropped { frame: k.index, reason }),
        KeyFrameStatus::Aligned => None,
    })
}

/// The image with everything outside the mask set to 0.
pub(super) fn masked(image: &Planes, mask: &Mask) -> Planes {
    let mut out = image.clone();
    out.data.chunks_mut(mask.data.len()).for_each(|plane| {
        plane.iter_mut().zip(&mask.data).filter(|(_, m)| !**m).for_each(|(v, _)| *v = 0.0);
    });
    out
}
