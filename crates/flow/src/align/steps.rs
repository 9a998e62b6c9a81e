//! The motion between all neighbouring frames (spec 3.2, step 1).

use ops::homography::Homography;
use rayon::prelude::*;

use super::candidates::{Candidate, Finalist, Origin, Step, finish, shortlist};
use super::compose::FlowField;
use super::config::AlignConfig;
use super::contrast::ContrastPyramid;
use super::phase::{Correlator, Spectrum};
use super::photometric::Consistency;
use super::planar::{RobustFit, fit, pairs_of_flow, sane};
use super::size::Size;
use super::smooth::smoothest;

/// Peaks of the phase correlation that compete.
pub const PEAKS: usize = 4;
/// Every this many pixels a flow vector enters the fit.
const FLOW_STRIDE: usize = 4;
/// Area factor beyond which a step between neighbours is not believed.
const AREA_FACTOR: f64 = 1.6;
/// Expected error of a step that had to be guessed, as a share of the frame's width: a mean step is 6 % (spec 1.3).
const GUESSED_SHARE: f64 = 0.1;

/// Below this the neighbouring steps' motions compete too.
const WEAK_SIGNIFICANCE: f64 = 12.0;

/// The step between two neighbouring frames.
#[derive(Clone, Copy, Debug)]
pub struct NeighbourStep {
    /// The chosen homography, at the size of the pyramids.
    pub step: Step,
    /// Whether the two frames themselves don't support it: it bridges a bad frame or repeats the motion around it.
    pub replaced: bool,
}

/// Finds the steps between all neighbours; `flows` are the `adjacent` net's, if there is one.
///
/// Where a frame is bad (black, blurred), the step over it, from the frame before to the frame after, stands in for both.
pub fn neighbour_steps(pyramids: &[ContrastPyramid], flows: Option<&[FlowField]>, config: &AlignConfig) -> Vec<NeighbourStep> {
    let Some(first) = pyramids.first() else { return Vec::new() };
    let correlator = Correlator::new(first.size());
    let spectra = pyramids.par_iter().map(|p| correlator.spectrum(&p.levels[0])).collect();
    let pairs = Pairs { pyramids, correlator, spectra, config };
    let net = |i: usize| {
        let flow = flows.filter(|_| config.candidates.net).map(|f| &f[i]);
        flow.and_then(|f| from_flow(f, config.seed.wrapping_add(i as u64)))
    };
    let mut options: Vec<Vec<Finalist>> =
        (0..pyramids.len() - 1).into_par_iter().map(|i| pairs.shortlist(i, i + 1, pairs.guesses(i, i + 1, net(i)))).collect();
    if config.candidates.velocity {
        options = pairs.with_velocities(options);
    }
    let path = smoothest(&options, first.size());
    let found: Vec<Option<Step>> =
        (0..options.len()).into_par_iter().map(|i| pairs.finish(i, i + 1, &options[i][path[i]?])).collect();
    let mut steps: Vec<NeighbourStep> = (0..found.len()).into_par_iter().map(|i| pairs.replace_failed(&found, i)).collect();
    pairs.bridge(&mut steps);
    steps
}

/// The robust homography of a flow field.
pub fn from_flow(field: &FlowField, seed: u64) -> Option<Candidate> {
    let pairs = pairs_of_flow(&field.flow, &field.valid, FLOW_STRIDE);
    let homography = fit(&pairs, &RobustFit { seed, ..RobustFit::default() })?.homography;
    Some(Candidate { origin: Origin::Net, homography })
}

/// The `peaks` strongest shifts between two images.
pub fn from_peaks(correlator: &Correlator, target: &Spectrum, source: &Spectrum, peaks: usize) -> Vec<Candidate> {
    let candidate = |(x, y)| Candidate { origin: Origin::PhaseCorrelation, homography: Homography::translation(x, y) };
    correlator.shifts(target, source, peaks).into_iter().map(candidate).collect()
}

/// All frames, ready to be compared in pairs.
struct Pairs<'a> {
    pyramids: &'a [ContrastPyramid],
    correlator: Correlator,
    spectra: Vec<Spectrum>,
    config: &'a AlignConfig,
}

impl Pairs<'_> {
    fn size(&self) -> Size {
        self.pyramids[0].size()
    }

    /// All guesses for a pair.
    fn guesses(&self, target: usize, source: usize, net: Option<Candidate>) -> Vec<Candidate> {
        let mut guesses: Vec<Candidate> = net.into_iter().collect();
        if self.config.candidates.phase_correlation {
            guesses.extend(from_peaks(&self.correlator, &self.spectra[target], &self.spectra[source], PEAKS));
        }
        if self.config.candidates.identity {
            guesses.push(Candidate { origin: Origin::Identity, homography: Homography::identity() });
        }
        guesses
    }

    fn shortlist(&self, target: usize, source: usize, guesses: Vec<Candidate>) -> Vec<Finalist> {
        shortlist(&self.pyramids[target], &self.pyramids[source], &guesses, &self.config.photometric)
    }

    fn finish(&self, target: usize, source: usize, finalist: &Finalist) -> Option<Step> {
        let step = finish(&self.pyramids[target], &self.pyramids[source], finalist, &self.config.photometric);
        sane(&step.homography, self.size(), AREA_FACTOR).then_some(step)
    }

    fn among(&self, target: usize, source: usize, guesses: Vec<Candidate>) -> Option<Step> {
        self.finish(target, source, self.shortlist(target, source, guesses).first()?)
    }

    /// The options with the neighbouring steps' motions added where the evidence is weak.
    fn with_velocities(&self, options: Vec<Vec<Finalist>>) -> Vec<Vec<Finalist>> {
        let path = smoothest(&options, self.size());
        let chosen = |i: usize| Some(&options.get(i)?[(*path.get(i)?)?]);
        let weak = |i: usize| chosen(i).is_none_or(|f| f.refined.consistency.significance() < WEAK_SIGNIFICANCE);
        let extended = (0..options.len()).into_par_iter().map(|i| {
            if !weak(i) {
                return options[i].clone();
            }
            let around = [i.checked_sub(1), Some(i + 1)].into_iter().flatten().filter_map(chosen);
            let velocities = around.map(|f| Candidate { origin: Origin::Velocity, homography: f.refined.homography });
            let own = options[i].iter().map(|f| Candidate { origin: f.origin, homography: f.refined.homography });
            self.shortlist(i, i + 1, own.chain(velocities).collect())
        });
        extended.collect()
    }

    /// A reliable step as it is; else the motion of the reliable steps around it competes, and where nothing is reliable
    /// the step is a guess with a large expected error.
    fn replace_failed(&self, found: &[Option<Step>], i: usize) -> NeighbourStep {
        if let Some(step) = found[i].filter(Step::reliable) {
            return NeighbourStep { step, replaced: false };
        }
        let reliable = |j: &usize| found[*j].is_some_and(|s| s.reliable());
        let around = [(0..i).rev().find(reliable), (i + 1..found.len()).find(reliable)];
        let mut guesses: Vec<Candidate> = Vec::new();
        if self.config.candidates.velocity {
            let velocity = |j: usize| found[j].map(|s| Candidate { origin: Origin::Velocity, homography: s.homography });
            guesses.extend(around.into_iter().flatten().filter_map(velocity));
        }
        guesses.extend(found[i].map(|s| Candidate { origin: s.origin, homography: s.homography }));
        let chosen = self.among(i, i + 1, guesses.clone());
        if let Some(step) = chosen.filter(Step::reliable) {
            return NeighbourStep { step, replaced: step.origin == Origin::Velocity };
        }
        let still = Candidate { origin: Origin::Identity, homography: Homography::identity() };
        let guess = unsupported(guesses.first().unwrap_or(&still), GUESSED_SHARE * self.size().width as f64);
        NeighbourStep { step: chosen.map_or(guess, |s| Step { expected_px: guess.expected_px, ..s }), replaced: true }
    }

    /// Replaces runs of unreliable steps by one step over them where that is reliable.
    fn bridge(&self, steps: &mut [NeighbourStep]) {
        let mut i = 0;
        while i < steps.len() {
            let end = (i..steps.len()).find(|&j| steps[j].step.reliable()).unwrap_or(steps.len());
            // A single failed step has no frame to leave out; a long run has no overlap left.
            let bridgeable = (2..=4).contains(&(end - i));
            let over = bridgeable.then(|| self.among(i, end, self.guesses(i, end, None))).flatten();
            if let Some(step) = over.filter(Step::reliable) {
                let nothing = Candidate { origin: step.origin, homography: Homography::identity() };
                let rest = Step { consistency: step.consistency, margin: step.margin, ..unsupported(&nothing, 0.0) };
                steps[i..end].fill(NeighbourStep { step: rest, replaced: true });
                steps[i].step = step;
            }
            i = end + 1;
        }
    }
}

/// A guess that no image supports.
fn unsupported(guess: &Candidate, expected_px: f64) -> Step {
    let Candidate { origin, homography } = *guess;
    Step { origin, homography, consistency: Consistency::NONE, margin: 0.0, expected_px }
}
