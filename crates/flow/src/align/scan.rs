//! A scan prepared for alignment, and what is concluded about its key frames.

use ops::homography::Homography;
use ops::planes::{Mask, Planes};
use rayon::prelude::*;

use super::compose::FlowField;
use super::config::AlignConfig;
use super::contrast::ContrastPyramid;
use super::footage::{Footage, digest};
use super::graph::{Link, Place};
use super::photometric::{Consistency, consistency};
use super::result::{AlignError, Alignment, DropReason, KeyFrame, KeyFrameStatus, Seconds, Warning};
use super::size::{Size, overlap, resized};
use super::steady::{self, SteadyPattern};
use super::steps::{NeighbourStep, neighbour_steps};
use super::track::Placed;

/// Deviation of the contrast-normalised image below which there is nothing to align by.
const LEAST_TEXTURE: f64 = 0.1;
/// Expected error beyond which a placed key frame is dropped, as a share of the frame's width. Scans that can be aligned stay
/// below 0.0045; where links disagree as on brushed metal, true errors are 2.5 times the expected ones.
const LARGEST_ERROR_SHARE: f64 = 0.007;
/// Expected error at which a key frame's confidence is one half, as a share of the frame's width.
const HALF_CONFIDENCE_SHARE: f64 = 0.005;

/// Of the key frames that show at least this share of the guidance image, most must resemble it …
const JUDGED_SHARE: f64 = 0.3;
/// … this many standard errors beyond chance on one of the finest levels: faint texture drowns in the noise of the first.
const ALIKE_SIGNIFICANCE: f64 = 4.0;
const JUDGED_LEVELS: usize = 3;
/// … and when they don't, the others are believed only at this many times as many.
const LUCK: f64 = 3.0;
/// Fewer key frames say nothing of a scan.
pub(super) const FEWEST_JUDGED: usize = 5;

/// The frames and the nodes to be placed: node 0 is the guidance image, node i + 1 is key frame i.
pub(super) struct Scan {
    /// All frames, at the size of the steps between neighbours.
    pub small: Vec<Planes>,
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

impl Scan {
    /// Reads every frame once; `first` is frame 0.
    pub fn new(
        footage: &dyn Footage,
        first: &Planes,
        guidance: Option<&Planes>,
        config: &AlignConfig,
    ) -> Result<Self, AlignError> {
        let (count, step) = (footage.count(), config.key_frame_step);
        let keys: Vec<usize> = (if guidance.is_some() { 0 } else { step }..count).step_by(step).collect();
        let (frame_size, limited) = (Size::of(first), |image: &Planes, side| {
            let Size { height, width } = Size::of(image).limited(side);
            image.resize_area(height, width)
        });
        // Too few key frames to tell the light from the surface: other frames of the clip help.
        let filmed = keys.len() + usize::from(guidance.is_none());
        let spread = (filmed < steady::FEWEST_FRAMES).then_some((count / steady::FEWEST_FRAMES).max(1));
        let is_node = |i: usize| i.is_multiple_of(step);
        let digested = digest(footage, first, |i, frame| {
            let wanted = is_node(i) || spread.is_some_and(|s| i.is_multiple_of(s));
            (limited(frame, config.size), wanted.then(|| limited(frame, config.refine_size)))
        })?;
        let (small, large): (Vec<Planes>, Vec<Option<Planes>>) = digested.into_iter().unzip();
        let pyramid = |image: &Planes| ContrastPyramid::new(image, &config.photometric);
        let examples: Option<Vec<ContrastPyramid>> =
            spread.map(|s| large.par_iter().step_by(s).flatten().map(pyramid).collect());
        let filmed_nodes = large.into_iter().enumerate().filter(|(i, _)| is_node(*i)).filter_map(|(_, image)| image);
        let images: Vec<Planes> = guidance.map(|g| limited(g, config.refine_size)).into_iter().chain(filmed_nodes).collect();
        let mut pyramids: Vec<ContrastPyramid> = images.par_iter().map(pyramid).collect();
        // Before the steady pattern goes: an empty frame minus a pattern isn't empty.
        let textured = pyramids.iter().map(|p| p.texture() >= LEAST_TEXTURE).collect();
        // A guidance image of its own was lit in its own way.
        take_out_steady(&mut pyramids[usize::from(guidance.is_some())..], examples, config);
        let full = std::iter::once(guidance.map_or(frame_size, Size::of)).chain(keys.iter().map(|_| frame_size)).collect();
        let sizes = images.iter().map(Size::of).collect();
        Ok(Self { small, keys, step_size: frame_size.limited(config.size), full, sizes, images, pyramids, textured })
    }

    /// The steps between neighbouring frames, at the size on which key frames are linked.
    pub fn neighbour_steps(&self, flows: Option<&[FlowField]>, config: &AlignConfig) -> Vec<NeighbourStep> {
        let mut pyramids: Vec<ContrastPyramid> =
            self.small.par_iter().map(|f| ContrastPyramid::new(f, &config.photometric)).collect();
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
    pub fn conclude(&self, Placed { places, links, repeating }: &Placed, steps: &[NeighbourStep]) -> Alignment {
        let nodes = (1..self.sizes.len()).into_par_iter();
        let mut key_frames: Vec<KeyFrame> = nodes.map(|n| self.key_frame(n, &places[n])).collect();
        self.drop_unlike(&mut key_frames, places);
        if *repeating {
            key_frames.iter_mut().filter(|k| k.aligned()).for_each(|k| k.status = KeyFrameStatus::Dropped(DropReason::Repeats));
        }
        let replaced = steps.iter().enumerate().filter(|(_, s)| s.replaced);
        let mut warnings: Vec<Warning> = replaced.map(|(frame, _)| Warning::StepReplaced { frame }).collect();
        warnings.extend(dropped(&key_frames));
        let links = links.iter().map(|&l| self.at_full_size(l)).collect();
        Alignment { key_frames, warnings, links, guidance_filmed: self.guidance_filmed(), seconds: Seconds::default() }
    }

    /// Drops the key frames of a scan of which most don't resemble the guidance image where they should show much of it. One
    /// frame alone may look otherwise in its right place: the shading of relief is reversed when the light comes from the other
    /// side.
    fn drop_unlike(&self, key_frames: &mut [KeyFrame], places: &[Option<Place>]) {
        let alike = |(i, key): (usize, &KeyFrame)| {
            let place = places[i + 1].filter(|_| key.aligned() && key.valid_share >= JUDGED_SHARE)?;
            let (guidance, frame) = (&self.pyramids[0], &self.pyramids[i + 1]);
            let significance = |level| consistency(guidance, frame, &place.homography, level).significance();
            Some((0..JUDGED_LEVELS).map(significance).fold(0.0, f64::max))
        };
        let alike: Vec<Option<f64>> = key_frames.par_iter().enumerate().map(alike).collect();
        let judged: Vec<f64> = alike.iter().flatten().copied().collect();
        let unlike = judged.iter().filter(|s| **s < ALIKE_SIGNIFICANCE).count();
        if judged.len() < FEWEST_JUDGED || 2 * unlike <= judged.len() {
            return;
        }
        for (key, alike) in key_frames.iter_mut().zip(alike) {
            // Among many that are wrong, some look right by luck.
            if key.aligned() && alike.is_none_or(|significance| significance < LUCK * ALIKE_SIGNIFICANCE) {
                key.status = KeyFrameStatus::Dropped(DropReason::UnlikeGuidance);
            }
        }
    }

    /// Whether the guidance image is a frame of the scan.
    pub fn guidance_filmed(&self) -> bool {
        self.keys[0] > 0
    }

    /// A link between the nodes' full pixels.
    fn at_full_size(&self, link: Link) -> Link {
        let Link { target, source, homography, error_px } = link;
        let sizes = |node: usize| (self.sizes[node], self.full[node]);
        let larger = self.full[source].width as f64 / self.sizes[source].width as f64;
        Link { homography: resized(&homography, sizes(target), sizes(source)), error_px: error_px * larger, ..link }
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
