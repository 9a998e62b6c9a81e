//! Guesses refined on the pixels, and whether the best of them is believed.

use nalgebra::Matrix3;
use ops::homography::Homography;
use ops::planes::Planes;
use rayon::prelude::*;

use super::super::candidates::{Candidate, Finalist, Origin, Step, choose, finish};
use super::super::config::PhotometricConfig;
use super::super::contrast::{ContrastPyramid, normalised};
use super::super::photometric::{refine, warp};
use super::super::size::Size;
use super::densities::Densities;
use super::search::Guess;
use super::votes::{agreement, preference};
use super::{Located, NotLocated, lattice};

/// Between these sides, in pixels, lies the frame when all guesses are refined, then the best places, then the best one: as
/// near to the photo's density as they let it.
const SIDES: [[f64; 2]; 3] = [[64.0, 96.0], [96.0, 256.0], [96.0, 512.0]];
/// Places that are refined on the second of these sides.
const PLACES: usize = 12;
/// The photo is cut out with this border, as a share of the frame's side.
const BORDER: f64 = 0.15;
/// The correlation of a place that is believed …
const LEAST_ZNCC: f64 = 0.15;
/// … its standard errors above chance: the best of some million places is five above it by luck …
const LEAST_SIGNIFICANCE: f64 = 8.0;
/// … by how much it exceeds the same place displaced …
const LEAST_MARGIN: f64 = 0.08;
/// … and the votes of the frame's blocks for it.
const LEAST_AGREEMENT: f64 = 8.0;
/// A place with more than this share of the best one's evidence is another that the pattern repeats at: there may be better ones.
const REPEATS: f64 = 0.6;
/// Share of the best place's evidence that another place may have …
const LARGEST_RUNNER_UP: f64 = 0.8;
/// … unless the frame's blocks prefer the best place by this many votes: patterns that repeat exactly reached 2.1
/// in 120 pairs of noisy images.
const LEAST_PREFERENCE: f64 = 4.0;
/// Share of the frame that the photo must show.
const LEAST_OVERLAP: f64 = 0.5;
/// Places further apart than this share of the frame's side are different places …
const APART: f64 = 0.1;
/// … and where a pattern repeats, its own period may be as little as this.
const PERIOD: f64 = 0.02;
/// Places that are tried to see whether it repeats.
const PROBED: usize = 6;
/// Repeated places that are refined on the second of the sides.
const RIVALS: usize = 16;
/// How often places are looked for, each time from those found before.
const ROUNDS: usize = 2;
/// Places have a say in how the others are seen if they have this share of the best one's evidence.
const SEEN_ALIKE: f64 = 0.5;
/// Weight of the colours, which don't change with the side that the light comes from as relief does, where they help.
const CHROMA: f32 = 1.0;
/// Guesses whose densities differ by no more than this factor are compared on the same pixels.
const SAME_DENSITY: f64 = 1.1;

/// A guess refined: photo pixel to frame pixel at full size.
struct Tried {
    homography: Homography,
    guess: Guess,
    step: Step,
    /// What [`Consistency::significance`](super::super::photometric::Consistency::significance) is lessened by.
    certainty: f64,
    /// Sides of the template.
    sides: [usize; 2],
    /// The photo on the template's pixels, contrast-normalised; NaN is unknown.
    seen: Planes,
}

/// How far a guess may be off.
#[derive(Clone, Copy)]
enum Reach {
    /// Some pixels of a frame of [`SIDES`].
    Far,
    /// Hardly any: it has been refined, or was found on finer pixels. A pattern's next period is never reached.
    Near,
}

impl Tried {
    /// Per root of the frame's pixels, so that halved images, on which a place is judged where noise hides it in the finer ones,
    /// count for the quarter of the pixels that they have.
    fn evidence(&self) -> f64 {
        self.step.consistency.significance() / (self.seen.area() as f64).sqrt()
    }

    fn significance(&self) -> f64 {
        self.certainty * self.step.consistency.significance()
    }

    fn believable(&self) -> bool {
        let Step { consistency, margin, .. } = self.step;
        consistency.zncc >= LEAST_ZNCC && self.significance() >= LEAST_SIGNIFICANCE && margin >= LEAST_MARGIN
    }

    fn not_found(&self) -> NotLocated {
        NotLocated::NotFound { zncc: self.step.consistency.zncc, significance: self.significance() }
    }

    /// Of another place's evidence.
    fn share(&self, of: &Self) -> f64 {
        self.evidence().max(0.0) / of.evidence()
    }

    /// As a guess to refine further.
    fn again(&self, frame: Size) -> Guess {
        Guess { homography: self.homography, scale: scale(&self.homography, frame).unwrap_or(self.guess.scale) }
    }
}

/// The guess that the images support best, refined.
pub(super) fn best(
    guidance: &Densities,
    frame: &Densities,
    guesses: &[Guess],
    photometric: &PhotometricConfig,
) -> Result<Located, NotLocated> {
    let size = frame.size();
    let images = Images { guidance, frame, photometric };
    let coloured = coloured(photometric);
    let (_, first) = images.refined(guesses, SIDES[0], Reach::Far, APART);
    let (mut templates, mut tried) =
        images.refined(&again(&first[..first.len().min(PLACES)], size), SIDES[1], Reach::Far, APART);
    if tried.first().is_some_and(Tried::believable) && (repeats(&tried) || images.repeats_elsewhere(&tried[0])) {
        (templates, tried) = images.repeated(tried);
    }
    let Some((best, others)) = tried.split_first() else { return Err(NotLocated::NotFound { zncc: 0.0, significance: 0.0 }) };
    if !best.believable() || templates.agreement(best) < LEAST_AGREEMENT {
        return Err(best.not_found());
    }
    if let Some(runner_up) = templates.rival(guidance, best, others) {
        return Err(NotLocated::Ambiguous { runner_up });
    }
    let runner_up = largest_share(others, best);
    let in_colour = Images { photometric: &coloured, ..images };
    // The colours of a grey surface are noise, which makes the correlation less significant.
    let finer = [images, in_colour].into_iter().flat_map(|i| i.refined(&[best.again(size)], SIDES[2], Reach::Near, APART).1);
    let finer = finer.filter(|t| !apart(t, best, size, PERIOD) && t.significance() >= LEAST_SIGNIFICANCE);
    let finer = finer.max_by(|a, b| a.significance().total_cmp(&b.significance()));
    let end = finer.as_ref().unwrap_or(best);
    let sides = if finer.is_some() { SIDES[2] } else { SIDES[1] };
    let larger = size.width as f64 / compared(size, end.guess.scale, sides).width as f64;
    Ok(Located {
        homography: end.homography,
        scale: scale(&end.homography, size).unwrap_or(end.guess.scale),
        zncc: best.step.consistency.zncc,
        significance: best.significance(),
        runner_up,
        expected_px: end.step.expected_px * larger,
    })
}

/// What places are refined on.
#[derive(Clone, Copy)]
struct Images<'a> {
    guidance: &'a Densities<'a>,
    frame: &'a Densities<'a>,
    photometric: &'a PhotometricConfig,
}

impl<'a> Images<'a> {
    /// The places that guesses end at, the best first, and the frame as they were compared with it. Places are further apart
    /// than `share` of the frame's side.
    fn refined(&self, guesses: &[Guess], sides: [f64; 2], reach: Reach, share: f64) -> (Templates<'a>, Vec<Tried>) {
        let templates = Templates::new(self.frame, guesses, sides, self.photometric);
        let tried = guesses.par_iter().with_max_len(1).filter_map(|g| templates.try_out(self.guidance, g, reach));
        let tried = tried.filter(|t| t.step.consistency.overlap >= LEAST_OVERLAP).collect();
        (templates, places(tried, self.frame.size(), share))
    }

    /// Whether places that the first search may have missed look nearly as much like the frame.
    fn repeats_elsewhere(&self, best: &Tried) -> bool {
        let guesses = lattice::guesses(self.guidance, self.frame, &[best.again(self.frame.size())]);
        repeats(&self.refined(&guesses[..guesses.len().min(PROBED)], SIDES[0], Reach::Near, PERIOD).1)
    }

    /// The places and the frame where the pattern repeats, with all the places that `tried` leads to.
    fn repeated(&self, mut tried: Vec<Tried>) -> (Templates<'a>, Vec<Tried>) {
        let size = self.frame.size();
        let mut seen = alike(&tried, size);
        let mut round = 1;
        loop {
            let mut guesses = again(&tried, size);
            guesses.extend(lattice::guesses(self.guidance, self.frame, &seen));
            same_densities(&mut guesses);
            let (_, places) = self.refined(&guesses, SIDES[0], Reach::Near, PERIOD);
            let mut guesses = again(&places[..places.len().min(RIVALS)], size);
            same_densities(&mut guesses);
            let templates;
            (templates, tried) = self.refined(&guesses, SIDES[1], Reach::Near, PERIOD);
            let told_apart =
                tried.split_first().is_some_and(|(best, others)| templates.rival(self.guidance, best, others).is_none());
            if told_apart || round == ROUNDS {
                return (templates, tried);
            }
            // There are more of them now, which agree better on how the photo sees the frame.
            seen = alike(&places, size);
            round += 1;
        }
    }
}

/// With the colours beside the luminance.
fn coloured(photometric: &PhotometricConfig) -> PhotometricConfig {
    PhotometricConfig { chroma: CHROMA, ..photometric.clone() }
}

/// Places as guesses to refine further.
fn again(tried: &[Tried], frame: Size) -> Vec<Guess> {
    tried.iter().map(|t| t.again(frame)).collect()
}

/// Those of the places, the best first, that may show how the photo sees the frame.
fn alike(tried: &[Tried], frame: Size) -> Vec<Guess> {
    again(&tried[..tried.iter().take_while(|t| t.share(&tried[0]) >= SEEN_ALIKE).count()], frame)
}

/// Whether the second of the places, the best first, is nearly as good as the first.
fn repeats(tried: &[Tried]) -> bool {
    tried.split_first().is_some_and(|(best, others)| largest_share(others, best) > REPEATS)
}

/// The runner-up's share of the best place's evidence.
fn largest_share(others: &[Tried], best: &Tried) -> f64 {
    others.first().map_or(0.0, |t| t.share(best))
}

/// The best of each place, the best place first; places are further apart than `share` of the frame's side.
fn places(mut tried: Vec<Tried>, frame: Size, share: f64) -> Vec<Tried> {
    tried.sort_by(|a, b| b.evidence().total_cmp(&a.evidence()));
    let mut kept: Vec<Tried> = Vec::new();
    for t in tried {
        if kept.iter().all(|k| apart(&t, k, frame, share)) {
            kept.push(t);
        }
    }
    kept
}

/// Frame pixels per photo pixel at the frame's middle.
fn scale(homography: &Homography, frame: Size) -> Option<f64> {
    let back = homography.inverse()?;
    let (cx, cy) = (0.5 * frame.width as f64, 0.5 * frame.height as f64);
    let step = 0.1 * cx;
    let (a, b, c) = (back.apply(cx, cy)?, back.apply(cx + step, cy)?, back.apply(cx, cy + step)?);
    let area = ((b.0 - a.0) * (c.1 - a.1) - (b.1 - a.1) * (c.0 - a.0)).abs();
    Some(step / area.sqrt())
}

/// Whether the frame's middle lies elsewhere, by more than `share` of its side, or the frame is turned or scaled otherwise.
fn apart(a: &Tried, b: &Tried, frame: Size, share: f64) -> bool {
    let relative = |x: f64, y: f64| {
        let back = b.homography.inverse()?;
        let (u, v) = back.apply(x, y)?;
        let (p, q) = a.homography.apply(u, v)?;
        Some((p - x).hypot(q - y))
    };
    let (w, h) = (frame.width as f64, frame.height as f64);
    let corners = [(0.5 * w, 0.5 * h), (0.25 * w, 0.25 * h), (0.75 * w, 0.25 * h), (0.25 * w, 0.75 * h), (0.75 * w, 0.75 * h)];
    corners.iter().any(|&(x, y)| relative(x, y).is_none_or(|d| d > share * w.min(h)))
}

/// Gives guesses of about one density the first one's.
fn same_densities(guesses: &mut [Guess]) {
    let mut densities: Vec<f64> = Vec::new();
    for guess in guesses {
        match densities.iter().find(|d| (*d / guess.scale).ln().abs() < SAME_DENSITY.ln()) {
            Some(density) => guess.scale = *density,
            None => densities.push(guess.scale),
        }
    }
}

/// Size of the frame when it is compared at the photo's density.
fn compared(frame: Size, scale: f64, [least, most]: [f64; 2]) -> Size {
    let side = frame.width.min(frame.height) as f64;
    frame.limited((side / scale).clamp(least.min(side), most.min(side)).round() as usize)
}

/// Share, along a side, of the pixels compared that tell something of their own. Two of an enlarged image's pixels along a side
/// hold what one did, when the normalisation has blurred them; and where a few pixels have most of the contrast, as a highlight
/// on an even surface does, the others count for little. That highlight is in both pictures wherever they were taken.
fn certainty(frame: &ContrastPyramid, [side, seen]: [usize; 2]) -> f64 {
    let sharp = (2.0 * seen as f64 / side as f64).min(1.0);
    let spread = frame.levels.iter().take(2).map(|level| spread(level.plane(0))).fold(1.0, f64::min);
    sharp * spread.sqrt()
}

/// How evenly the contrast is spread, 0 … 1: 1 for the values of a normal distribution, of which the fourth moment is three
/// times the second squared, or for less extreme ones.
fn spread(plane: &[f32]) -> f64 {
    let known = || plane.iter().filter(|v| !v.is_nan()).map(|&v| f64::from(v));
    let [count, squares, fourths] = known().fold([0.0; 3], |[n, s, f], v| [n + 1.0, s + v * v, f + v.powi(4)]);
    if fourths > 0.0 { (3.0 * squares * squares / (count * fourths)).min(1.0) } else { 0.0 }
}

/// The frame as guesses are compared with it.
struct Template {
    /// See [`Templates::sides`].
    sides: [usize; 2],
    pyramid: ContrastPyramid,
    /// The finest level in colour.
    coloured: Planes,
}

/// The frame at the sizes and as sharp as guesses are compared with it.
struct Templates<'a> {
    frame: Size,
    sides: [f64; 2],
    photometric: &'a PhotometricConfig,
    coloured: PhotometricConfig,
    templates: Vec<Template>,
}

impl<'a> Templates<'a> {
    fn new(frame: &Densities, guesses: &[Guess], sides: [f64; 2], photometric: &'a PhotometricConfig) -> Self {
        let mut used: Vec<[usize; 2]> = guesses.iter().map(|g| Self::sides(frame.size(), g.scale, sides)).collect();
        used.sort_unstable();
        used.dedup();
        let Size { height, width } = frame.size();
        let at = |side: usize| frame.resized([0.0, height as f64, 0.0, width as f64], frame.size().limited(side)).0;
        let coloured = coloured(photometric);
        let template = |&[side, seen]: &[usize; 2]| {
            // What the photo is too coarse to show must not count against it.
            let image = if seen < side {
                let Size { height, width } = frame.size().limited(side);
                at(seen).resize_bilinear(height, width)
            } else {
                at(side)
            };
            let pyramid = ContrastPyramid::new(&image, photometric);
            Template { sides: [side, seen], pyramid, coloured: normalised(&image, &coloured) }
        };
        let templates = used.par_iter().map(template).collect();
        Self { frame: frame.size(), sides, photometric, coloured, templates }
    }

    /// Side of the frame when it is compared, and its side in pixels of the photo (in steps of a tenth), if that is less.
    fn sides(frame: Size, scale: f64, sides: [f64; 2]) -> [usize; 2] {
        let size = compared(frame, scale, sides);
        let side = size.width.min(size.height);
        let native = frame.width.min(frame.height) as f64 / scale;
        let seen = 1.1f64.powf((native.ln() / 1.1f64.ln()).round()).round() as usize;
        [side, seen.max(16).min(side)]
    }

    fn of(&self, sides: [usize; 2]) -> Option<&Template> {
        self.templates.iter().find(|t| t.sides == sides)
    }

    /// Votes of the frame's blocks for a place.
    fn agreement(&self, place: &Tried) -> f64 {
        self.of(place.sides).map_or(0.0, |t| agreement(&t.pyramid.levels[0], &place.seen))
    }

    /// The first of the other places, the best first, that is nearly as good and can't be told from the best one: its share of
    /// the evidence.
    fn rival(&self, guidance: &Densities, best: &Tried, others: &[Tried]) -> Option<f64> {
        let near = &others[..others.iter().take_while(|t| t.share(best) > LARGEST_RUNNER_UP).count()];
        let template = self.of(best.sides)?;
        let seen = |place: &Tried| self.seen_in_colour(guidance, place, &template.coloured);
        let first = near.first().and_then(|_| seen(best));
        let told_apart = |t: &Tried| {
            let votes = |first| Some(preference(&template.coloured, first, &seen(t)?));
            t.sides == best.sides && first.as_ref().and_then(votes).is_some_and(|v| v >= LEAST_PREFERENCE)
        };
        near.iter().find(|t| !told_apart(t)).map(|t| t.share(best))
    }

    /// The photo at a place on the template's pixels, contrast-normalised in colour.
    fn seen_in_colour(&self, guidance: &Densities, place: &Tried, template: &Planes) -> Option<Planes> {
        let small = Size::of(template);
        let (patch, to_patch) = self.patch(guidance, &place.again(self.frame), small)?;
        let to_patch = Homography::new(to_patch * place.homography.inverse()?.matrix * small.resize_matrix(self.frame));
        let (patch, mut seen) = (normalised(&patch, &self.coloured), template.clone());
        let area = seen.area();
        seen.data.chunks_mut(area).enumerate().for_each(|(c, plane)| warp(&patch, c, &to_patch, small.width, plane));
        Some(seen)
    }

    fn try_out(&self, guidance: &Densities, guess: &Guess, reach: Reach) -> Option<Tried> {
        let sides = Self::sides(self.frame, guess.scale, self.sides);
        let target = &self.of(sides)?.pyramid;
        let small = target.size();
        let (patch, to_patch) = self.patch(guidance, guess, small)?;
        let from_small = small.resize_matrix(self.frame);
        let initial = Homography::new(to_patch * guess.homography.inverse()?.matrix * from_small);
        let source = ContrastPyramid::new(&patch, self.photometric);
        let origin = Origin::PhaseCorrelation;
        let step = match reach {
            Reach::Far => choose(target, &source, &[Candidate { origin, homography: initial }], self.photometric)?,
            Reach::Near => {
                let refined = refine(target, &source, &initial, (1, 1), self.photometric)?;
                finish(target, &source, &Finalist { origin, refined }, self.photometric)
            }
        };
        let mut seen = Planes::new(1, small.height, small.width);
        warp(&source.levels[0], 0, &step.homography, small.width, &mut seen.data);
        let found = Homography::new(to_patch.try_inverse()? * step.homography.matrix * from_small.try_inverse()?);
        Some(Tried { homography: found.inverse()?, guess: *guess, step, certainty: certainty(target, sides), sides, seen })
    }

    /// The part of the photo that the frame shows, with a border, at the density of the frame of size `small`; and photo pixel
    /// to its pixel.
    fn patch(&self, guidance: &Densities, guess: &Guess, small: Size) -> Option<(Planes, Matrix3<f64>)> {
        let back = guess.homography.inverse()?;
        let (w, h) = (self.frame.width as f64, self.frame.height as f64);
        let corners =
            [(0.0, 0.0), (w, 0.0), (w, h), (0.0, h)].iter().map(|&(x, y)| back.apply(x, y)).collect::<Option<Vec<_>>>()?;
        let border = BORDER * w.min(h) / guess.scale;
        let range = |of: fn(&(f64, f64)) -> f64, length: usize| {
            let low = corners.iter().map(of).fold(f64::INFINITY, f64::min) - border;
            let high = corners.iter().map(of).fold(f64::NEG_INFINITY, f64::max) + border;
            (low.floor().clamp(0.0, length as f64), high.ceil().clamp(0.0, length as f64))
        };
        let (photo, factor) = (guidance.size(), guess.scale * small.width as f64 / w);
        let ((x0, x1), (y0, y1)) = (range(|c| c.0, photo.width), range(|c| c.1, photo.height));
        if (x1 - x0).min(y1 - y0) * factor < 16.0 {
            return None;
        }
        let scaled = |v: f64| (v * factor).round() as usize;
        let size = Size { height: scaled(y1 - y0), width: scaled(x1 - x0) };
        let (patch, [y0, y1, x0, x1]) = guidance.resized([y0, y1, x0, x1], size);
        // Edges of the part to edges of the patch; pixel centres are at integers.
        let (sx, sy) = (size.width as f64 / (x1 - x0), size.height as f64 / (y1 - y0));
        let matrix = Matrix3::new(sx, 0.0, sx * (0.5 - x0) - 0.5, 0.0, sy, sy * (0.5 - y0) - 0.5, 0.0, 0.0, 1.0);
        Some((patch, matrix))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::photometric::Consistency;

    #[test]
    fn places_judged_on_halved_images_are_rivals_of_those_judged_on_all_pixels() {
        let homography = Homography::identity();
        let judged = |zncc, compared| Tried {
            homography,
            guess: Guess { homography, scale: 1.0 },
            step: Step {
                origin: Origin::PhaseCorrelation,
                homography,
                consistency: Consistency { zncc, overlap: 1.0, compared },
                margin: 0.5,
                expected_px: 0.1,
            },
            certainty: 1.0,
            sides: [128, 128],
            seen: Planes::new(1, 128, 128),
        };
        // Noise that halving takes away hides as much of one as the halved pixels are fewer of the other.
        let (halved, whole) = (judged(0.9708, 64 * 64), judged(0.7848, 128 * 128));
        assert!((whole.share(&halved) - 1.0).abs() < 0.01, "{}", whole.share(&halved));
    }
}
