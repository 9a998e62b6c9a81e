//! Guesses of the motion between two frames, and the choice between them: a failed step is replaced, not inherited.

use ops::homography::Homography;
use serde::Serialize;

use super::config::PhotometricConfig;
use super::contrast::ContrastPyramid;
use super::photometric::{Consistency, Refined, consistency, refine};
use super::size::{Size, overlap};

/// Pyramid level on which guesses are compared before refinement, and the level on which refinement starts.
pub(super) const COMPARE_LEVEL: usize = 1;
const START_LEVEL: usize = 2;
/// How many guesses are refined on the first level, and how many of them on the next.
const REFINED: usize = 5;
const FINALISTS: usize = 3;
/// Expected error of a guess that isn't refined, in pixels.
const UNREFINED_PX: f64 = 3.0;
/// Guesses closer than this, in pixels, are one guess.
const SAME_PX: f64 = 1.0;
/// A step needs at least this share of common pixels.
pub const SMALLEST_OVERLAP: f64 = 0.15;
/// A reliable step correlates at least this much …
const RELIABLE_ZNCC: f64 = 0.12;
/// … this many standard errors above chance: the best of many guesses, each refined, is well above it by luck …
const RELIABLE_SIGNIFICANCE: f64 = 6.0;
/// … and this much better than when displaced: the camera-fixed light correlates at any small displacement.
const RELIABLE_MARGIN: f64 = 0.06;
/// Displacement of the counter-trials, in pixels of the comparing level.
const DISPLACED_PX: f64 = 5.0;

/// Where a guess comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Origin {
    /// The robust homography of a net's flow.
    Net,
    /// A peak of the phase correlation.
    PhaseCorrelation,
    /// The motion of the steps before and after.
    Velocity,
    /// No motion.
    Identity,
    /// The product of the steps in between.
    Chain,
}

/// A guess of the homography between two frames.
#[derive(Clone, Copy, Debug)]
pub struct Candidate {
    /// Where it comes from.
    pub origin: Origin,
    /// Target pixel to source pixel at the pyramids' finest level.
    pub homography: Homography,
}

/// The chosen homography between two frames.
#[derive(Clone, Copy, Debug)]
pub struct Step {
    /// Which guess won.
    pub origin: Origin,
    /// Target pixel to source pixel at the pyramids' finest level.
    pub homography: Homography,
    /// How alike the frames are under it.
    pub consistency: Consistency,
    /// By how much the correlation exceeds that of displaced homographies.
    pub margin: f64,
    /// Expected error over the whole target, in pixels of the finest level.
    pub expected_px: f64,
}

impl Step {
    /// Whether the images support this step beyond what a wrong one could reach.
    pub fn reliable(&self) -> bool {
        self.consistency.zncc >= RELIABLE_ZNCC
            && self.consistency.significance() >= RELIABLE_SIGNIFICANCE
            && self.margin >= RELIABLE_MARGIN
            && self.consistency.overlap >= SMALLEST_OVERLAP
            && self.expected_px.is_finite()
    }
}

/// A guess that has been refined as far as is needed to compare it with others.
#[derive(Clone, Copy, Debug)]
pub struct Finalist {
    /// Where it comes from.
    pub origin: Origin,
    /// What became of it.
    pub refined: Refined,
}

/// Scores the guesses, refines the best few on the coarse levels and returns them, the most consistent first; empty when no
/// guess leaves enough in common.
pub fn shortlist(
    target: &ContrastPyramid,
    source: &ContrastPyramid,
    candidates: &[Candidate],
    config: &PhotometricConfig,
) -> Vec<Finalist> {
    let deepest = target.levels.len() - 1;
    let (start, compare) = (START_LEVEL.min(deepest), COMPARE_LEVEL.min(deepest));
    let at = |homography: &Homography, level| consistency(target, source, homography, level);
    let unrefined = |c: &Candidate| {
        // A guess may be so good that it shows on the fine level only, where threads are seen.
        let (coarse, fine) = (at(&c.homography, start), at(&c.homography, compare));
        let consistency = if fine.score() > coarse.score() { fine } else { coarse };
        let refined = Refined { homography: c.homography, consistency, converged: false, expected_px: UNREFINED_PX };
        Finalist { origin: c.origin, refined }
    };
    let shared = |c: &&Candidate| overlap(&c.homography, target.size(), source.size()) >= SMALLEST_OVERLAP;
    let candidates = distinct(candidates, target.size());
    let mut best: Vec<Finalist> = candidates.iter().filter(shared).map(unrefined).collect();
    keep_best(&mut best, REFINED);
    if !config.enabled {
        return best;
    }
    let coarse = |f: &Finalist| {
        let before = Refined { consistency: at(&f.refined.homography, compare), ..f.refined };
        let after = refine(target, source, &f.refined.homography, (start, start), config);
        let after = after.map(|r| Refined { consistency: at(&r.homography, compare), ..r });
        let refined = after.filter(|a| a.consistency.score() > before.consistency.score()).unwrap_or(before);
        Finalist { refined, ..*f }
    };
    best = best.iter().map(coarse).collect();
    keep_best(&mut best, FINALISTS);
    let fine = |f: &Finalist| {
        let refined = refine(target, source, &f.refined.homography, (compare, compare), config)?;
        Some(Finalist { refined, ..*f })
    };
    best = best.iter().filter_map(fine).collect();
    keep_best(&mut best, FINALISTS);
    best
}

fn keep_best(finalists: &mut Vec<Finalist>, count: usize) {
    finalists.sort_by(|a, b| b.refined.consistency.score().total_cmp(&a.refined.consistency.score()));
    finalists.truncate(count);
}

/// Refines a finalist on the finest level and makes the counter-trials.
pub fn finish(target: &ContrastPyramid, source: &ContrastPyramid, finalist: &Finalist, config: &PhotometricConfig) -> Step {
    let coarse = finalist.refined;
    let fine = refine(target, source, &coarse.homography, (0, 0), config).filter(|_| config.enabled);
    let refined = fine.unwrap_or(coarse);
    Step {
        origin: finalist.origin,
        homography: refined.homography,
        consistency: clearest(target, source, &refined.homography),
        margin: margin(target, source, &refined.homography),
        expected_px: refined.expected_px,
    }
}

/// The most consistent guess, refined; `None` when no guess leaves enough in common.
pub fn choose(
    target: &ContrastPyramid,
    source: &ContrastPyramid,
    candidates: &[Candidate],
    config: &PhotometricConfig,
) -> Option<Step> {
    let best = shortlist(target, source, candidates, config);
    best.first().map(|finalist| finish(target, source, finalist, config))
}

/// The consistency on the finest level or, where noise hides it there, on the comparing level: whichever is more significant.
fn clearest(target: &ContrastPyramid, source: &ContrastPyramid, homography: &Homography) -> Consistency {
    let [fine, coarse] = [0, COMPARE_LEVEL].map(|level| consistency(target, source, homography, level));
    if coarse.significance() > fine.significance() { coarse } else { fine }
}

/// Correlation minus the mean of eight displaced homographies'.
fn margin(target: &ContrastPyramid, source: &ContrastPyramid, homography: &Homography) -> f64 {
    let level = COMPARE_LEVEL.min(target.levels.len() - 1);
    let here = consistency(target, source, homography, level).zncc;
    let distance = DISPLACED_PX * target.size().width as f64 / target.levels[level].width as f64;
    let displaced = (0..8).map(|i| {
        let (sin, cos) = (f64::from(i) * std::f64::consts::FRAC_PI_4).sin_cos();
        let moved = Homography::translation(distance * cos, distance * sin).after(homography);
        consistency(target, source, &moved, level).zncc
    });
    here - displaced.sum::<f64>() / 8.0
}

/// The candidates without near duplicates; the first of two similar ones stays.
fn distinct(candidates: &[Candidate], size: Size) -> Vec<Candidate> {
    let mut kept: Vec<Candidate> = Vec::new();
    for candidate in candidates {
        let near = |k: &Candidate| largest_shift(&k.homography, &candidate.homography, size) < SAME_PX;
        if !kept.iter().any(near) {
            kept.push(*candidate);
        }
    }
    kept
}

/// The largest distance, in source pixels, between where two homographies send a coarse grid of target positions; infinite
/// where one of them has no image.
pub fn largest_shift(a: &Homography, b: &Homography, size: Size) -> f64 {
    let distance = |(x, y)| match (a.apply(x, y), b.apply(x, y)) {
        (Some(p), Some(q)) => (p.0 - q.0).hypot(p.1 - q.1),
        _ => f64::INFINITY,
    };
    size.grid(4).map(distance).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::scene::{Scene, between, view, weave};

    const SIZE: Size = Size { height: 128, width: 128 };

    fn pyramids(scene: &Scene, a: &Homography, b: &Homography) -> [ContrastPyramid; 2] {
        [a, b].map(|v| ContrastPyramid::new(&scene.frame(v, SIZE), &PhotometricConfig::default()))
    }

    fn candidate(origin: Origin, homography: Homography) -> Candidate {
        Candidate { origin, homography }
    }

    #[test]
    fn the_right_guess_wins_whatever_the_order() {
        let scene = Scene { highlight: 0.4, noise: 0.02, ..Scene::new(1) };
        let (a, b) = (view(SIZE, 0.0, 0.0, 0.0, 1.0, 0.0), view(SIZE, 17.0, -9.0, 0.02, 1.0, 0.0));
        let [target, source] = pyramids(&scene, &a, &b);
        let truth = between(&a, &b);
        let mut guesses = vec![
            candidate(Origin::Identity, Homography::identity()),
            candidate(Origin::Net, Homography::translation(12.0, 30.0)),
            candidate(Origin::PhaseCorrelation, Homography::translation(-17.0, 9.0)),
            candidate(Origin::Velocity, Homography::translation(400.0, 0.0)),
        ];
        for _ in 0..guesses.len() {
            guesses.rotate_left(1);
            let step = choose(&target, &source, &guesses, &PhotometricConfig::default()).unwrap();
            assert!(step.reliable() && largest_shift(&step.homography, &truth, SIZE) < 0.4);
        }
    }

    #[test]
    fn no_guess_gives_no_step() {
        let still = view(SIZE, 0.0, 0.0, 0.0, 1.0, 0.0);
        let [target, source] = pyramids(&Scene::new(1), &still, &still);
        assert!(choose(&target, &source, &[], &PhotometricConfig::default()).is_none());
    }

    #[test]
    fn an_exact_guess_survives_where_the_coarse_levels_show_nothing() {
        // Threads of 7 px are gone on the level on which refinement starts; what is left there is noise.
        let (a, b) = (view(SIZE, 0.0, 0.0, 0.0, 1.0, 0.0), view(SIZE, 9.0, -6.0, 0.01, 1.0, 0.0));
        let pyramid = |v: &Homography| ContrastPyramid::new(&weave(v, SIZE, 7.0, 0.03), &PhotometricConfig::default());
        let truth = between(&a, &b);
        let wrong = |i: f64| candidate(Origin::PhaseCorrelation, Homography::translation(-3.0 - 7.0 * i, 3.0 + 4.0 * i));
        let mut guesses: Vec<Candidate> = (0..6).map(|i| wrong(f64::from(i))).collect();
        guesses.push(candidate(Origin::Net, truth));
        let finalists = shortlist(&pyramid(&a), &pyramid(&b), &guesses, &PhotometricConfig::default());
        let exact = |f: &Finalist| f.origin == Origin::Net && largest_shift(&f.refined.homography, &truth, SIZE) < 0.3;
        assert!(finalists.iter().any(exact), "{finalists:?}");
    }
}
