//! Following the key frames through a scan: the links between them, found one key frame after the other.

use ops::flow_field::warp_planes;
use ops::homography::Homography;
use ops::planes::{Mask, Planes};
use rayon::prelude::*;

use super::FlowEstimator;
use super::candidates::{Candidate, Finalist, Origin, Step, choose, finish, largest_shift};
use super::compose::{FlowField, chain};
use super::config::AlignConfig;
use super::graph::{Link, Place, adjust, disagreement, shortest_paths};
use super::phase::{Correlator, Spectrum};
use super::photometric::warp;
use super::planar::{PointPair, RobustFit, fit, pairs_of_flow};
use super::rivals::{CLEARER_SIGNIFICANCE, Rivals, stands_out};
use super::scan::{FEWEST_JUDGED, Scan, masked};
use super::sequence::Aligner;
use super::size::{Size, overlap, resized};
use super::steps::{NeighbourStep, PEAKS, from_flow, from_peaks};

/// A key frame is linked directly to an image of which it shows at least this share.
const LINK_OVERLAP: f64 = 0.3;
/// Earlier key frames to which a key frame is linked.
const LOOPS: usize = 3;
/// A link may move the prediction by this many expected errors …
const GATE_DEVIATIONS: f64 = 4.0;
/// … and by this share of the frame's width in any case.
const GATE_SHARE: f64 = 0.03;
/// Displaced places that are tried: the neighbours on a lattice, and those once removed …
const PERIODS: usize = 12;
/// … but none further away than this share of the frame's width. Steps between frames are less than half as long as a rule (spec
/// 1.3) and don't jump further; what looks more alike there is relief that the travelling light happens to light alike, such as
/// the next ridge of a corrugated sheet.
const LARGEST_JUMP_SHARE: f64 = 0.15;
/// Key frames before a lost one among which it is looked for.
const SEARCHED_BACK: usize = 4;
/// Where another place is this much as strong as the measured one, the measured one doesn't overrule the steps …
const AMBIGUOUS: f64 = 0.9;
/// … and where that is so for most of a scan, its surface repeats itself: nothing tells the places apart (chainmail).
const REPEATING: f64 = 0.93;

/// What is known while the key frames are followed.
pub(super) struct Tracker<'a> {
    pub scan: &'a Scan,
    pub aligner: &'a Aligner<'a>,
    pub steps: &'a [NeighbourStep],
    pub flows: Option<&'a [FlowField]>,
}

/// Where the nodes are, and what says so.
pub(super) struct Placed {
    /// The place of every node, `None` where no link reaches it.
    pub places: Vec<Option<Place>>,
    /// The links between them.
    pub links: Vec<Link>,
    /// Whether most key frames fit just as well at another place of a pattern that repeats.
    pub repeating: bool,
}

impl Placed {
    /// Makes all expected errors larger by the share by which the links disagree more than they let expect.
    pub fn believe_disagreement(&mut self, scan: &Scan) {
        let larger = disagreement(&self.places, &self.links, &scan.sizes);
        self.places.iter_mut().flatten().for_each(|p| p.error_px *= larger);
        self.links.iter_mut().for_each(|l| l.error_px *= larger);
    }
}

impl Tracker<'_> {
    /// The place of every node.
    pub fn place(&self) -> Placed {
        let nodes = self.scan.sizes.len();
        let mut running = vec![Place { homography: Homography::identity(), error_px: 0.0 }];
        let mut links: Vec<Link> = Vec::new();
        let search = Search::new(self.scan);
        // The node from which the next one is reached: one that was lost is stepped over.
        let mut before = 0;
        let mut rivalries: Vec<f64> = Vec::new();
        for node in 1..nodes {
            let (place, found) = self.track(before, node, &running, &search);
            before = if found.links.is_empty() { before } else { node };
            running.push(place);
            links.extend(found.links);
            rivalries.extend(found.rivalry);
        }
        let mut places = shortest_paths(nodes, &links);
        if self.config().loops {
            links.extend(self.close_loops(&places, &links));
            places = shortest_paths(nodes, &links);
        }
        if self.config().adjust {
            adjust(&mut places, &links, &self.scan.sizes);
        }
        rivalries.sort_by(f64::total_cmp);
        let repeating = rivalries.len() >= FEWEST_JUDGED && rivalries[rivalries.len() / 2] > REPEATING;
        Placed { places, links, repeating }
    }

    fn config(&self) -> &AlignConfig {
        &self.aligner.config
    }

    /// Links one key frame to the one before, to the guidance image and, where both fail, to whatever it resembles; returns
    /// its most certain place with the links.
    fn track(&self, before: usize, node: usize, running: &[Place], search: &Search) -> (Place, Found) {
        let predicted = self.predict(before, node, running);
        if !self.scan.textured(node) || !self.scan.textured(0) {
            return (predicted.unwrap_or(running[0]), Found::default());
        }
        let mut found = Found { predicted, ..Found::default() };
        let (tie, rivalry) = self.step_link(before, node, search);
        found.rivalry = rivalry;
        found.add(tie);
        if found.links.is_empty() && self.config().candidates.phase_correlation {
            found.links.extend(search.link(self.scan, node, self.moves_visibly(node), self.config()));
        }
        let tied = found.links.iter().any(|l| l.target == 0);
        let near = found.place(running).filter(|p| !tied && self.scan.share(node, &p.homography) >= LINK_OVERLAP);
        found.add(near.and_then(|p| self.guidance_link(node, &p, search)));
        (found.place(running).unwrap_or(running[0]), found)
    }

    /// Whether most frames around a node can be told from their neighbours: where they can't, looking at the last key
    /// frames takes long and finds nothing.
    fn moves_visibly(&self, node: usize) -> bool {
        let (frame, around) = (self.scan.keys[node - 1], self.config().key_frame_step);
        let near = frame.saturating_sub(around)..(frame + around).min(self.steps.len());
        2 * self.steps[near.clone()].iter().filter(|s| s.step.reliable()).count() >= near.len()
    }

    /// The steps from one node to another; `None` where the first is a guidance image that isn't a frame of the scan.
    fn span(&self, before: usize, node: usize) -> Option<std::ops::Range<usize>> {
        let guidance_is_frame = self.scan.guidance_filmed();
        match before {
            0 if guidance_is_frame => Some(0..self.scan.keys[node - 1]),
            0 => None,
            _ => Some(self.scan.keys[before - 1]..self.scan.keys[node - 1]),
        }
    }

    /// Where the steps since an earlier node lead.
    fn predict(&self, before: usize, node: usize, running: &[Place]) -> Option<Place> {
        let steps = &self.steps[self.span(before, node)?];
        let before = running[before];
        let error_px = steps.iter().map(|s| s.step.expected_px.powi(2)).sum::<f64>().sqrt();
        Some(Place { homography: product(steps).after(&before.homography), error_px: before.error_px.hypot(error_px) })
    }

    /// The tie to the node before: the most consistent of the product of the steps and the composed flow, refined; where
    /// the two frames are too far apart for that, the product itself if all its steps are reliable. With it the rivalry of
    /// other places, where one was measured.
    fn step_link(&self, before: usize, node: usize, search: &Search) -> (Option<Tie>, Option<f64>) {
        let Some(span) = self.span(before, node) else { return (None, None) };
        let steps = &self.steps[span.clone()];
        let chained = product(steps);
        let error_px = steps.iter().map(|s| s.step.expected_px.powi(2)).sum::<f64>().sqrt();
        let mut guesses = vec![Candidate { origin: Origin::Chain, homography: chained }];
        guesses.extend(self.composed_flow(node, span));
        let sound = steps.iter().all(|s| s.step.reliable());
        if !sound && self.config().candidates.phase_correlation {
            guesses.extend(search.guesses(before, node));
        }
        let link = |homography, error_px| Link { target: before, source: node, homography, error_px };
        let measured = measure(self.scan, before, node, &guesses, self.config());
        let rivals = measured.and_then(|s| self.displaced(before, node, &s, search));
        let rivalry = rivals.as_ref().map(|r| r.0);
        if let Some(other) = rivals.and_then(|r| r.1) {
            return (Some(Tie::Corrects(link(other.homography, other.expected_px))), rivalry);
        }
        let within = |s: &Step| within_gate(s, &chained, error_px, self.scan.sizes[node]);
        let pair = (&self.scan.pyramids[before], &self.scan.pyramids[node]);
        // One of the steps jumped, and another guess was right.
        let jumped =
            |s: &Step| !within(s) && rivalry.is_some_and(|r| r < AMBIGUOUS) && stands_out(&s.homography, &chained, pair);
        if let Some(step) = measured.filter(jumped) {
            return (Some(Tie::Corrects(link(step.homography, step.expected_px))), rivalry);
        }
        let direct = measured.filter(within);
        let agrees = match direct {
            Some(step) if !sound || step.expected_px <= error_px => Some(link(step.homography, step.expected_px)),
            _ => sound.then(|| link(chained, error_px)),
        };
        (agrees.map(Tie::Agrees), rivalry)
    }

    /// The homography of the flows composed since the node before (spec 3.2, steps 2 and 3).
    fn composed_flow(&self, node: usize, span: std::ops::Range<usize>) -> Option<Candidate> {
        let flows = self.flows.filter(|_| self.config().candidates.net)?;
        let guess = from_flow(&chain(&flows[span])?, self.config().seed)?;
        let (from, to) = (self.scan.step_size, self.scan.sizes[node]);
        Some(Candidate { homography: resized(&guess.homography, (from, to), (from, to)), ..guess })
    }

    /// The link to the guidance image near a prediction (spec 3.2, step 4), if the images support one. On a periodic pattern the
    /// prediction may be a period off: then a displaced place shows clearly more of the guidance image.
    fn guidance_link(&self, node: usize, predicted: &Place, search: &Search) -> Option<Tie> {
        let mut guesses = vec![Candidate { origin: Origin::Chain, homography: predicted.homography }];
        if let Some(net) = self.aligner.distant.filter(|_| self.config().distant) {
            guesses.extend(self.remaining_flow(net, node, &predicted.homography));
        }
        let step = measure(self.scan, 0, node, &guesses, self.config())?;
        let near = within_gate(&step, &predicted.homography, predicted.error_px, self.scan.sizes[node]);
        let link = |s: &Step| Link { target: 0, source: node, homography: s.homography, error_px: s.expected_px };
        match Some(step).filter(|_| near).and_then(|s| self.displaced(0, node, &s, search)?.1) {
            Some(other) => Some(Tie::Corrects(link(&other))),
            None => near.then(|| Tie::Agrees(link(&step))),
        }
    }

    /// How strong other places are beside a measured one (see [`Rivals`]), and the one that stands out and shows clearly more of
    /// the target: on a periodic pattern a guess may be a period off, and refining it finds the nearest fit. `None` where no
    /// other place is looked for.
    fn displaced(&self, target: usize, node: usize, measured: &Step, search: &Search) -> Option<(f64, Option<Step>)> {
        if !self.config().candidates.phase_correlation {
            return None;
        }
        let pair = (&self.scan.pyramids[target], &self.scan.pyramids[node]);
        let clearer = |f: Finalist| {
            let step = finish(pair.0, pair.1, &f, &self.config().photometric);
            let clear = step.consistency.significance() > measured.consistency.significance() + CLEARER_SIGNIFICANCE;
            Some(step).filter(|s| clear && s.reliable())
        };
        let guesses = search.displaced(self.scan, target, node, &measured.homography);
        let rivals = Rivals::among(&guesses, &measured.homography, pair, &self.config().photometric);
        Some((rivals.rivalry, rivals.outstanding.and_then(clearer)))
    }

    /// The `distant` net's estimate of what remains after the regularised warp, superposed and made a homography again.
    /// Both images are masked to what they share; no rectangle is cut out of it.
    fn remaining_flow(&self, net: &dyn FlowEstimator, node: usize, predicted: &Homography) -> Option<Candidate> {
        let Size { height, width } = self.scan.sizes[0];
        let (warped, shared) = warp_planes(&self.scan.images[node], &predicted.flow(height, width));
        let remaining = net.flow(&masked(&self.scan.images[0], &shared), &warped);
        let pairs = superposed(&remaining, &shared, predicted);
        let homography = fit(&pairs, &RobustFit { seed: self.config().seed, ..RobustFit::default() })?.homography;
        Some(Candidate { origin: Origin::Net, homography })
    }

    /// Links every placed node to the earlier ones that show most of the same and aren't linked yet.
    fn close_loops(&self, places: &[Option<Place>], links: &[Link]) -> Vec<Link> {
        let partners = (1..places.len()).flat_map(|node| partners(self.scan, node, places, links));
        let wanted: Vec<(usize, usize)> = partners.collect();
        let (scan, config) = (self.scan, self.config());
        let found = wanted.into_par_iter().filter_map(|(target, source)| {
            let (from, to) = (places[target]?, places[source]?);
            let predicted = to.homography.after(&from.homography.inverse()?);
            let guess = Candidate { origin: Origin::Chain, homography: predicted };
            let step = measure(scan, target, source, &[guess], config)?;
            let near = within_gate(&step, &predicted, from.error_px.hypot(to.error_px), scan.sizes[source]);
            near.then_some(Link { target, source, homography: step.homography, error_px: step.expected_px })
        });
        found.collect()
    }
}

/// A link from a node to an earlier one.
enum Tie {
    /// It agrees with the prediction.
    Agrees(Link),
    /// It leads elsewhere, and the images say that it is right.
    Corrects(Link),
}

/// What is known of a node's place.
#[derive(Default)]
struct Found {
    /// Where the steps lead.
    predicted: Option<Place>,
    links: Vec<Link>,
    /// How strong other places are beside the one measured from the node before; `None` where none was.
    rivalry: Option<f64>,
}

impl Found {
    /// Adds a tie. What led elsewhere before one that corrects it has jumped: it must not speak for the wrong place.
    fn add(&mut self, tie: Option<Tie>) {
        match tie {
            Some(Tie::Agrees(link)) => self.links.push(link),
            Some(Tie::Corrects(link)) => *self = Self { predicted: None, links: vec![link], ..*self },
            None => {}
        }
    }

    /// The most certain place.
    fn place(&self, running: &[Place]) -> Option<Place> {
        self.links.iter().map(|l| via(l, running)).chain(self.predicted).reduce(better)
    }
}

/// Phase correlation between nodes, for key frames whose track was lost or jumped.
struct Search {
    correlator: Correlator,
    spectra: Vec<Spectrum>,
}

impl Search {
    fn new(scan: &Scan) -> Self {
        let largest = |side: fn(&Size) -> usize| scan.sizes.iter().map(side).max().unwrap_or(1);
        let correlator = Correlator::new(Size { height: largest(|s| s.height), width: largest(|s| s.width) });
        let spectra = scan.pyramids.par_iter().map(|p| correlator.spectrum(&p.levels[0])).collect();
        Self { correlator, spectra }
    }

    fn guesses(&self, target: usize, source: usize) -> Vec<Candidate> {
        from_peaks(&self.correlator, &self.spectra[target], &self.spectra[source], PEAKS)
    }

    /// Shifts of a node's image over a target's from where `place` lays it.
    fn displaced(&self, scan: &Scan, target: usize, node: usize, place: &Homography) -> Vec<Candidate> {
        let (Size { height, width }, source) = (scan.sizes[target], &scan.pyramids[node].levels[0]);
        let mut warped = vec![0.0; height * width];
        warp(source, 0, place, width, &mut warped);
        warped.iter_mut().filter(|v| v.is_nan()).for_each(|v| *v = 0.0);
        let spectrum = self.correlator.spectrum(&Planes::from_vec(1, height, width, warped));
        let shifted = from_peaks(&self.correlator, &self.spectra[target], &spectrum, PERIODS).into_iter();
        let near = |c: &Candidate| {
            let reach = LARGEST_JUMP_SHARE * width as f64;
            c.homography.apply(0.0, 0.0).is_some_and(|(x, y)| x.hypot(y) <= reach)
        };
        shifted.filter(near).map(|c| Candidate { homography: place.after(&c.homography), ..c }).collect()
    }

    /// The link to the guidance image or, where `recent` ones are searched too, to one of the last key frames that the images
    /// support best.
    fn link(&self, scan: &Scan, node: usize, recent: bool, config: &AlignConfig) -> Option<Link> {
        let back = if recent { SEARCHED_BACK } else { 0 };
        let recent = (node.saturating_sub(back).max(1)..node).rev();
        let references: Vec<usize> = std::iter::once(0).chain(recent).filter(|&r| scan.textured(r)).collect();
        let found = references.into_par_iter().filter_map(|reference| {
            let mut guesses = self.guesses(reference, node);
            if config.candidates.identity {
                guesses.push(Candidate { origin: Origin::Identity, homography: Homography::identity() });
            }
            Some((reference, measure(scan, reference, node, &guesses, config)?))
        });
        let found: Vec<(usize, Step)> = found.collect();
        let score = |s: &Step| s.consistency.score();
        let (target, step) = found.into_iter().max_by(|a, b| score(&a.1).total_cmp(&score(&b.1)))?;
        Some(Link { target, source: node, homography: step.homography, error_px: step.expected_px })
    }
}

/// The most consistent guess between two nodes, if the images support it.
fn measure(scan: &Scan, target: usize, source: usize, guesses: &[Candidate], config: &AlignConfig) -> Option<Step> {
    choose(&scan.pyramids[target], &scan.pyramids[source], guesses, &config.photometric).filter(Step::reliable)
}

/// Whether a measured step is as near to its prediction as the prediction's error lets expect.
fn within_gate(step: &Step, predicted: &Homography, error_px: f64, size: Size) -> bool {
    largest_shift(&step.homography, predicted, size) <= (GATE_DEVIATIONS * error_px).max(GATE_SHARE * size.width as f64)
}

/// The earlier nodes that a node should be linked to.
fn partners(scan: &Scan, node: usize, places: &[Option<Place>], links: &[Link]) -> Vec<(usize, usize)> {
    let Some(place) = places[node] else { return Vec::new() };
    let linked = |other: usize| links.iter().any(|l| (l.target, l.source) == (other, node));
    let share = |other: usize| {
        let relative = places[other].and_then(|p| Some(place.homography.after(&p.homography.inverse()?)));
        relative.map_or(0.0, |h| overlap(&h, scan.sizes[other], scan.sizes[node]))
    };
    let mut others: Vec<(f64, usize)> = (0..node).filter(|&o| !linked(o)).map(|o| (share(o), o)).collect();
    others.retain(|(s, _)| *s >= LINK_OVERLAP);
    others.sort_by(|a, b| b.0.total_cmp(&a.0));
    others.into_iter().take(LOOPS).map(|(_, other)| (other, node)).collect()
}

fn product(steps: &[NeighbourStep]) -> Homography {
    steps.iter().fold(Homography::identity(), |h, s| s.step.homography.after(&h))
}

fn better(a: Place, b: Place) -> Place {
    if b.error_px < a.error_px { b } else { a }
}

/// Where a link leads from a node that was placed before.
fn via(link: &Link, running: &[Place]) -> Place {
    let start = running[link.target];
    Place { homography: link.homography.after(&start.homography), error_px: start.error_px.hypot(link.error_px) }
}

/// Target positions and where `predicted` sends them after the remaining flow, for flow that starts and ends in the mask.
fn superposed(remaining: &Planes, shared: &Mask, predicted: &Homography) -> Vec<PointPair> {
    let ends_shared = |p: &PointPair| {
        let (x, y) = (p.source[0].round(), p.source[1].round());
        let inside = x >= 0.0 && y >= 0.0 && x < shared.width as f64 && y < shared.height as f64;
        inside && shared.at(y as usize, x as usize)
    };
    let through = |p: PointPair| predicted.apply(p.source[0], p.source[1]).map(|(x, y)| PointPair { source: [x, y], ..p });
    pairs_of_flow(remaining, shared, 4).into_iter().filter(ends_shared).filter_map(through).collect()
}

#[cfg(test)]
mod tests;
