use super::*;
use crate::align::candidates::Origin;
use crate::align::photometric::Consistency;
use crate::align::result::{DropReason, KeyFrameStatus};
use crate::align::scene::{Scene, between, view, weave};

const SIZE: Size = Size { height: 128, width: 128 };
const PERIOD: f64 = 16.0;

/// Contrast of what tells one thread from the next.
const OWN: f32 = 0.1;

/// The steps think much of themselves: a jump must be outvoted all the same.
fn exact_step(homography: Homography) -> NeighbourStep {
    let consistency = Consistency { zncc: 0.8, overlap: 0.9, compared: 10_000 };
    let step = Step { origin: Origin::Net, homography, consistency, margin: 0.5, expected_px: 0.02 };
    NeighbourStep { step, replaced: false }
}

/// A scan of a weave along a line, with exact steps.
struct Woven {
    views: Vec<Homography>,
    scan: Scan,
    steps: Vec<NeighbourStep>,
    config: AlignConfig,
}

impl Woven {
    fn new(own: f32) -> Self {
        let views: Vec<Homography> = (0..41).map(|i| view(SIZE, f64::from(i), 0.0, 0.0, 1.0, 0.0)).collect();
        let frames: Vec<Planes> = views.iter().map(|v| weave(v, SIZE, PERIOD, own)).collect();
        let config = AlignConfig::default();
        let scan = Scan::new(&&frames[..], &frames[0], None, &config).unwrap();
        let steps = views.windows(2).map(|w| exact_step(between(&w[0], &w[1]))).collect();
        Self { views, scan, steps, config }
    }

    fn place(&self, flows: Option<&[FlowField]>) -> Placed {
        let aligner = Aligner { config: self.config.clone(), adjacent: None, distant: None };
        Tracker { scan: &self.scan, aligner: &aligner, steps: &self.steps, flows }.place()
    }

    fn assert_exact(&self, placed: &Placed) {
        for (node, place) in placed.places.iter().enumerate().skip(1) {
            let exact = between(&self.views[0], &self.views[self.scan.keys[node - 1]]);
            let error = largest_shift(&place.unwrap().homography, &exact, SIZE);
            assert!(error < 1.0, "key frame {node}: {error} px");
        }
    }
}

#[test]
fn a_step_that_jumps_by_a_period_takes_no_frame_along() {
    let mut woven = Woven::new(OWN);
    let jump = Homography::translation(-PERIOD, 0.0);
    woven.steps[7].step.homography = jump.after(&woven.steps[7].step.homography);
    let placed = woven.place(None);
    assert!(!placed.repeating);
    woven.assert_exact(&placed);
}

#[test]
fn a_step_that_jumps_far_is_overruled_by_the_flow() {
    let mut woven = Woven::new(OWN);
    let flow = |s: &NeighbourStep| FlowField::inside(s.step.homography.flow(SIZE.height, SIZE.width), SIZE.height, SIZE.width);
    let flows: Vec<FlowField> = woven.steps.iter().map(flow).collect();
    let jump = Homography::translation(-2.5 * PERIOD, 0.5 * PERIOD);
    woven.steps[7].step.homography = jump.after(&woven.steps[7].step.homography);
    woven.assert_exact(&woven.place(Some(&flows)));
}

#[test]
fn a_surface_that_repeats_exactly_is_refused() {
    let woven = Woven::new(0.0);
    let placed = woven.place(None);
    assert!(placed.repeating);
    let concluded = woven.scan.conclude(&placed, &woven.steps);
    let repeats = KeyFrameStatus::Dropped(DropReason::Repeats);
    assert!(concluded.key_frames.iter().all(|k| k.status == repeats), "{:?}", concluded.key_frames);
}

#[test]
fn a_jump_is_looked_for_no_further_away_than_steps_go() {
    let still = view(SIZE, 0.0, 0.0, 0.0, 1.0, 0.0);
    let offered = |period: f64| {
        let frames: Vec<Planes> = (0..6).map(|_| weave(&still, SIZE, period, OWN)).collect();
        let scan = Scan::new(&&frames[..], &frames[0], None, &AlignConfig::default()).unwrap();
        let guesses = Search::new(&scan).displaced(&scan, 0, 1, &Homography::identity());
        let away = |c: &Candidate| c.homography.apply(0.0, 0.0).map(|(x, y)| x.hypot(y)).unwrap();
        guesses.iter().map(away).collect::<Vec<f64>>()
    };
    // The product of two waves repeats on the diagonals at half a period, too.
    let nearest = |period: f64| period / std::f64::consts::SQRT_2;
    assert!(offered(PERIOD).iter().any(|away| (away - nearest(PERIOD)).abs() < 1.0), "{:?}", offered(PERIOD));
    // A ridge of a corrugated sheet is not a thread.
    let wide = 2.5 * PERIOD;
    assert!(!offered(wide).is_empty());
    assert!(offered(wide).iter().all(|away| *away < nearest(wide) - 5.0), "{:?}", offered(wide));
}

#[test]
fn frames_that_lie_wrong_or_somewhere_about_are_dropped() {
    let views: Vec<Homography> = (0..13).map(|i| view(SIZE, 3.0 * f64::from(i), 0.0, 0.0, 1.0, 0.0)).collect();
    let frames: Vec<Planes> = views.iter().map(|v| Scene::new(8).frame(v, SIZE)).collect();
    let config = AlignConfig { key_frame_step: 2, ..AlignConfig::default() };
    let scan = Scan::new(&&frames[..], &frames[0], None, &config).unwrap();
    let concluded = |off: f64, error_px: f64| {
        let place = |node: usize| {
            let exact = if node == 0 { Homography::identity() } else { between(&views[0], &views[scan.keys[node - 1]]) };
            let wrong = Homography::translation(if node == 0 { 0.0 } else { off }, 0.0);
            Some(Place { homography: wrong.after(&exact), error_px })
        };
        let placed = Placed { places: (0..7).map(place).collect(), links: Vec::new(), repeating: false };
        scan.conclude(&placed, &[]).key_frames.iter().map(|k| k.status).collect::<Vec<_>>()
    };
    assert_eq!(concluded(0.0, 0.2), [KeyFrameStatus::Aligned; 6]);
    assert_eq!(concluded(37.0, 0.2), [KeyFrameStatus::Dropped(DropReason::UnlikeGuidance); 6]);
    assert_eq!(concluded(0.0, 0.01 * SIZE.width as f64), [KeyFrameStatus::Dropped(DropReason::Uncertain); 6]);
}
