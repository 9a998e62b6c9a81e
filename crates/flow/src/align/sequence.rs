//! The alignment of a whole scan: the door of this module.

use std::time::Instant;

use ops::planes::Planes;

use super::FlowEstimator;
use super::compose::FlowField;
use super::config::{AlignConfig, Regularise, SMALLEST_SIDE};
use super::dense;
use super::footage::{Footage, described};
use super::relief;
use super::result::{AlignError, Alignment, Seconds, Warning};
use super::scan::Scan;
use super::track::Tracker;

/// Aligns scans; holds the nets, where there are any.
pub struct Aligner<'a> {
    /// Switches and limits.
    pub config: AlignConfig,
    /// The net for neighbouring frames.
    pub adjacent: Option<&'a dyn FlowEstimator>,
    /// The net for what remains between the guidance image and a key frame.
    pub distant: Option<&'a dyn FlowEstimator>,
}

impl Aligner<'_> {
    /// Aligns every `key_frame_step`-th frame to the guidance image, or to frame 0 where none is given.
    ///
    /// # Errors
    /// For images of no use (no frame, different shapes, not RGB, tiny) and settings that can't work. A frame that can't be
    /// aligned isn't an error: it is dropped with a reason.
    pub fn align(&self, frames: &[Planes], guidance: Option<&Planes>) -> Result<Alignment, AlignError> {
        self.align_footage(&frames, guidance)
    }

    /// As [`Aligner::align`], of frames that needn't be in memory: each is asked for once and shrunk at once.
    ///
    /// # Errors
    /// As [`Aligner::align`].
    pub fn align_footage(&self, footage: &dyn Footage, guidance: Option<&Planes>) -> Result<Alignment, AlignError> {
        self.check_config()?;
        if footage.count() == 0 {
            return Err(AlignError::NoFrames);
        }
        let first = footage.frame(0);
        for (name, image) in [("frame 0", Some(&*first)), ("the guidance image", guidance)] {
            if let Some(image) = image.filter(|i| i.channels != 3 || i.height.min(i.width) < SMALLEST_SIDE) {
                return Err(AlignError::Unusable { image: name.into(), found: described(image), smallest: SMALLEST_SIDE });
            }
        }
        let mut clock = Clock::start();
        let scan = Scan::new(footage, &first, guidance, &self.config)?;
        let mut seconds = Seconds { reading: clock.lap(), ..Seconds::default() };
        if scan.keys.is_empty() {
            let warnings = vec![Warning::NoKeyFrames];
            let links = Vec::new();
            return Ok(Alignment { key_frames: Vec::new(), warnings, links, guidance_filmed: guidance.is_none(), seconds });
        }
        let flows = self.adjacent.map(|net| neighbour_flows(net, &scan.small));
        seconds.flows = clock.lap();
        let alignment = match (self.config.regularise, flows) {
            (Regularise::Pnp | Regularise::None, Some(flows)) => dense::align(&scan, &flows, self.distant, &self.config),
            (_, flows) => {
                let steps = scan.neighbour_steps(flows.as_deref(), &self.config);
                seconds.steps = clock.lap();
                let mut placed = Tracker { scan: &scan, aligner: self, steps: &steps, flows: flows.as_deref() }.place();
                // From links as sharp as they claim to be, so that the wrong ones count least.
                let camera = self.config.relief.then(|| scan.conclude(&placed, &steps).camera(None));
                if self.config.adjust {
                    placed.believe_disagreement(&scan);
                }
                if let Some(camera) = camera {
                    relief::settle(&scan, &mut placed, camera.as_ref().ok());
                }
                scan.conclude(&placed, &steps)
            }
        };
        seconds.placing = clock.lap();
        Ok(Alignment { seconds, ..alignment })
    }

    fn check_config(&self) -> Result<(), AlignError> {
        let config = |name, found: String, expected| Err(AlignError::Config { name, found, expected });
        self.config.validate()?;
        let chained = match self.config.regularise {
            Regularise::Homography => None,
            Regularise::Pnp => Some("pnp"),
            Regularise::None => Some("none"),
        };
        if let Some(name) = chained.filter(|_| self.adjacent.is_none()) {
            return config("regularise", name.into(), "the paper's chain needs the adjacent net; use \"homography\"");
        }
        Ok(())
    }
}

/// Wall time since the last look.
struct Clock(Instant);

impl Clock {
    fn start() -> Self {
        Self(Instant::now())
    }

    fn lap(&mut self) -> f64 {
        let now = Instant::now();
        (now - std::mem::replace(&mut self.0, now)).as_secs_f64()
    }
}

/// The `adjacent` net's flows between all neighbours at the steps' size, with their validity.
fn neighbour_flows(net: &dyn FlowEstimator, frames: &[Planes]) -> Vec<FlowField> {
    let pairs: Vec<(&Planes, &Planes)> = frames.windows(2).map(|w| (&w[0], &w[1])).collect();
    net.flows(&pairs).into_iter().map(|flow| FlowField::inside(flow, frames[0].height, frames[0].width)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::metrics::{ScanErrors, summarise};
    use crate::align::result::{DropReason, KeyFrameStatus};
    use crate::align::scene::{Scene, between, view};
    use crate::align::size::Size;
    use ops::homography::Homography;

    const SIZE: Size = Size { height: 96, width: 96 };

    /// A scan over a square path with jitter: 7 px per frame.
    fn views(count: usize) -> Vec<Homography> {
        let place = |i: usize| {
            let t = i as f64;
            let side = (i / 8) % 4;
            let along = 7.0 * (i % 8) as f64;
            let (x, y) = [(along, 0.0), (56.0, along), (56.0 - along, 56.0), (0.0, 56.0 - along)][side];
            view(
                SIZE,
                x + 2.0 * (1.7 * t).sin(),
                y + 2.0 * (2.3 * t).cos(),
                0.04 * (0.6 * t).sin(),
                1.0 + 0.03 * (0.5 * t).sin(),
                0.02 * (0.4 * t).sin(),
            )
        };
        (0..count).map(place).collect()
    }

    struct Exact<'a>(&'a [Planes], Vec<Homography>);

    impl FlowEstimator for Exact<'_> {
        fn flow(&self, first: &Planes, second: &Planes) -> Planes {
            let index = |image: &Planes| self.0.iter().position(|f| f == image);
            let (Some(a), Some(b)) = (index(first), index(second)) else {
                return Planes::new(2, first.height, first.width);
            };
            between(&self.1[a], &self.1[b]).flow(first.height, first.width)
        }
    }

    fn scene() -> Scene {
        Scene { highlight: 0.3, noise: 0.015, ..Scene::new(21) }
    }

    fn aligner(config: AlignConfig) -> Aligner<'static> {
        Aligner { config, adjacent: None, distant: None }
    }

    fn truth(views: &[Homography], alignment: &Alignment) -> Vec<Homography> {
        alignment.key_frames.iter().map(|k| between(&views[0], &views[k.index])).collect()
    }

    #[test]
    fn a_lit_scan_is_aligned_without_any_net_and_the_same_every_time() {
        let views = views(31);
        let frames: Vec<Planes> = views.iter().map(|v| scene().frame(v, SIZE)).collect();
        let aligned = aligner(AlignConfig::default()).align(&frames, None).unwrap();
        assert_eq!(aligned.key_frames.iter().map(|k| k.index).collect::<Vec<_>>(), [5, 10, 15, 20, 25, 30]);
        let m = summarise(&[ScanErrors::new(&aligned, &truth(&views, &aligned), SIZE)]);
        assert!(m.pixel_error < 4.0 && m.within_20px == 1.0 && m.valid_rate > 0.98, "{m:?}");
        let again = aligner(AlignConfig::default()).align(&frames, None).unwrap();
        assert!(aligned.key_frames.iter().zip(&again.key_frames).all(|(a, b)| a.homography == b.homography));
        let key = &aligned.key_frames[0];
        let (warped, valid) = key.aligned_frame(&frames[5], 96, 96);
        assert!((valid.share() - key.valid_share).abs() < 0.05 && warped.channels == 3);
    }

    #[test]
    fn a_lost_step_is_replaced_and_later_frames_survive_it() {
        let views = views(26);
        let mut frames: Vec<Planes> = views.iter().map(|v| scene().frame(v, SIZE)).collect();
        frames[7] = Planes::new(3, 96, 96);
        frames[15] = Planes::new(3, 96, 96);
        let aligned = aligner(AlignConfig::default()).align(&frames, None).unwrap();
        assert!(aligned.warnings.contains(&Warning::StepReplaced { frame: 6 }));
        assert!(aligned.warnings.contains(&Warning::Dropped { frame: 15, reason: DropReason::NoTexture }));
        for (key, exact) in aligned.key_frames.iter().zip(truth(&views, &aligned)) {
            assert_eq!(key.aligned(), key.index != 15, "{key:?}");
            let error = crate::align::candidates::largest_shift(&key.homography, &exact, SIZE);
            assert!(!key.aligned() || error < 1.5, "{}: {error}", key.index);
        }
    }

    #[test]
    fn the_papers_chain_follows_an_exact_net_with_and_without_a_pose() {
        let views = views(11);
        let frames: Vec<Planes> = views.iter().map(|v| scene().frame(v, SIZE)).collect();
        let net = Exact(&frames, views.clone());
        // The scene's cameras turn, tilt and rise, but their field of view isn't the assumed one.
        for (regularise, largest) in [(Regularise::None, 1.0), (Regularise::Pnp, 8.0)] {
            let config = AlignConfig { regularise, ..AlignConfig::default() };
            let refused = aligner(config.clone()).align(&frames, None);
            assert!(matches!(refused, Err(AlignError::Config { name: "regularise", .. })));
            let aligned = Aligner { config, adjacent: Some(&net), distant: None }.align(&frames, None).unwrap();
            let m = summarise(&[ScanErrors::new(&aligned, &truth(&views, &aligned), SIZE)]);
            assert!(m.pixel_error < largest && m.valid_rate > 0.8, "{regularise:?}: {m:?}");
        }
    }

    #[test]
    fn a_guidance_image_of_its_own_is_found() {
        let views = views(11);
        let frames: Vec<Planes> = views.iter().map(|v| scene().frame(v, SIZE)).collect();
        let large = Size { height: 128, width: 120 };
        let own = view(large, 6.0, -4.0, 0.02, 1.0, 0.0);
        let guidance = scene().frame(&own, large);
        let aligned = aligner(AlignConfig::default()).align(&frames, Some(&guidance)).unwrap();
        assert_eq!(aligned.key_frames.len(), 3);
        let exact: Vec<Homography> = aligned.key_frames.iter().map(|k| between(&own, &views[k.index])).collect();
        let m = summarise(&[ScanErrors::new(&aligned, &exact, large)]);
        assert!(m.within_4px == 1.0, "{m:?}");
    }

    #[test]
    fn frames_without_content_are_dropped_with_a_reason() {
        for value in [0.0, 0.5, 1.0, f32::NAN] {
            let frames = vec![Planes::constant(64, 64, &[value; 3]); 11];
            let aligned = aligner(AlignConfig::default()).align(&frames, None).unwrap();
            let reason = KeyFrameStatus::Dropped(DropReason::GuidanceWithoutTexture);
            assert!(aligned.key_frames.len() == 2 && aligned.key_frames.iter().all(|k| k.status == reason));
        }
        let still = vec![scene().frame(&Homography::identity(), SIZE); 6];
        let aligned = aligner(AlignConfig::default()).align(&still, None).unwrap();
        assert!(aligned.key_frames[0].aligned() && aligned.key_frames[0].valid_share > 0.9);
        let one = aligner(AlignConfig::default()).align(&still[..1], None).unwrap();
        assert!(one.key_frames.is_empty() && one.warnings == [Warning::NoKeyFrames]);
    }

    #[test]
    fn a_highlight_over_an_even_surface_is_not_taken_for_the_surface() {
        let scene = Scene { contrast: 0.0, highlight: 0.4, noise: 0.02, ..Scene::new(1) };
        let frames: Vec<Planes> = views(31).iter().map(|v| scene.frame(v, SIZE)).collect();
        let aligned = aligner(AlignConfig::default()).align(&frames, None).unwrap();
        assert!(aligned.key_frames.iter().all(|k| !k.aligned()), "{:?}", aligned.key_frames);
    }

    #[test]
    fn unrelated_frames_are_dropped_rather_than_placed() {
        let frame = |seed: u64| Scene::new(seed).frame(&Homography::identity(), SIZE);
        let frames: Vec<Planes> = (0..11).map(|i| frame(if i < 6 { 1 } else { 100 + i })).collect();
        let aligned = aligner(AlignConfig::default()).align(&frames, None).unwrap();
        assert!(aligned.key_frames[0].aligned());
        assert_eq!(aligned.key_frames[1].status, KeyFrameStatus::Dropped(DropReason::LostTrack));
    }

    #[test]
    fn unusable_input_is_refused_with_what_would_do() {
        let with = |config: AlignConfig, frames: &[Planes]| aligner(config).align(frames, None).unwrap_err();
        let default = AlignConfig::default;
        assert_eq!(with(default(), &[]), AlignError::NoFrames);
        let mixed = [Planes::new(3, 64, 64), Planes::new(3, 64, 80)];
        assert!(matches!(with(default(), &mixed), AlignError::FrameShape { index: 1, .. }));
        assert!(matches!(with(default(), &[Planes::new(3, 8, 64)]), AlignError::Unusable { .. }));
        assert!(matches!(with(default(), &[Planes::new(1, 64, 64)]), AlignError::Unusable { .. }));
        let config = AlignConfig { key_frame_step: 0, ..default() };
        assert!(with(config, &[Planes::new(3, 64, 64)]).to_string().contains("key_frame_step"));
    }
}
