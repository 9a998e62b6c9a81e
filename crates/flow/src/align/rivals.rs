//! Other places where a frame looks much as it does where it was measured: the neighbours on a pattern that repeats.

use ops::homography::Homography;

use super::candidates::{COMPARE_LEVEL, Candidate, Finalist, largest_shift, shortlist};
use super::config::PhotometricConfig;
use super::contrast::ContrastPyramid;
use super::photometric::consistency;

/// Places closer than this share of the width are one place.
const SAME_SHARE: f64 = 0.01;
/// A place stands out when all others, and the measured one, reach at most this share of its Fisher's z. The true place of woven
/// cloth, denim and knits leaves the others 0.2 to 0.7; one ridge of a corrugated sheet leaves the next 0.7 to 0.9.
const OUTSTANDING: f64 = 0.75;
/// A place that stands out is believed when its correlation is higher by so many standard errors: shading makes a difference of
/// a few.
pub(super) const CLEARER_SIGNIFICANCE: f64 = 10.0;

/// The places that compete with a measured one.
pub(super) struct Rivals {
    /// Fisher's z of the most alike over that of the measured place; 0 where there is none.
    pub rivalry: f64,
    /// The one that stands out from all others and from the measured place.
    pub outstanding: Option<Finalist>,
}

/// Whether a place stands out from another one, and by more than chance makes of two that show little.
pub(super) fn stands_out(place: &Homography, other: &Homography, pair: (&ContrastPyramid, &ContrastPyramid)) -> bool {
    let [here, there] = [place, other].map(|h| consistency(pair.0, pair.1, h, COMPARE_LEVEL));
    there.fisher_z() <= OUTSTANDING * here.fisher_z() && here.significance() > there.significance() + CLEARER_SIGNIFICANCE
}

impl Rivals {
    /// Refines the guesses and keeps those that don't end at the measured place.
    pub fn among(
        guesses: &[Candidate],
        measured: &Homography,
        (target, source): (&ContrastPyramid, &ContrastPyramid),
        config: &PhotometricConfig,
    ) -> Self {
        let apart =
            |a: &Homography, b: &Homography| largest_shift(a, b, target.size()) > SAME_SHARE * target.size().width as f64;
        let own = consistency(target, source, measured, COMPARE_LEVEL).fisher_z();
        let mut others = shortlist(target, source, guesses, config);
        others.retain(|f| apart(&f.refined.homography, measured));
        let of = |f: &Finalist| f.refined.consistency.fisher_z();
        let Some(first) = others.iter().copied().max_by(|a, b| of(a).total_cmp(&of(b))) else {
            return Self { rivalry: 0.0, outstanding: None };
        };
        let second =
            others.iter().filter(|f| apart(&f.refined.homography, &first.refined.homography)).map(of).fold(own, f64::max);
        let outstanding = Some(first).filter(|f| second <= OUTSTANDING * of(f));
        Self { rivalry: of(&first) / own.max(1e-3), outstanding }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::candidates::Origin;
    use crate::align::scene::{view, weave};
    use crate::align::size::Size;

    const SIZE: Size = Size { height: 128, width: 128 };
    const PERIOD: f64 = 16.0;

    /// The rivals of a place `off` pixels from the true one, among the places half a period and a whole one from it.
    fn rivals(own: f32, off: f64) -> Rivals {
        let still = view(SIZE, 0.0, 0.0, 0.0, 1.0, 0.0);
        let pyramid = |view: &Homography| ContrastPyramid::new(&weave(view, SIZE, PERIOD, own), &PhotometricConfig::default());
        let (target, source) = (pyramid(&still), pyramid(&view(SIZE, 3.0, 0.0, 0.0, 1.0, 0.0)));
        let at = |x: f64, y: f64| Homography::translation(x - 3.0, y);
        let guess = |(x, y): (f64, f64)| Candidate { origin: Origin::PhaseCorrelation, homography: at(x, y) };
        let guesses = [(0.0, 0.0), (PERIOD, 0.0), (0.5 * PERIOD, 0.5 * PERIOD)].map(guess);
        Rivals::among(&guesses, &at(off, 0.0), (&target, &source), &PhotometricConfig::default())
    }

    #[test]
    fn the_true_place_has_weak_rivals_and_stands_out_from_a_wrong_one() {
        let right = rivals(0.15, 0.0);
        assert!(right.rivalry > 0.1 && right.rivalry < OUTSTANDING && right.outstanding.is_none(), "{}", right.rivalry);
        let wrong = rivals(0.15, PERIOD);
        let found = wrong.outstanding.unwrap().refined.homography;
        assert!(largest_shift(&found, &Homography::translation(-3.0, 0.0), SIZE) < 0.3);
    }

    #[test]
    fn on_an_exact_pattern_nothing_stands_out() {
        let exact = rivals(0.0, 0.0);
        assert!((exact.rivalry - 1.0).abs() < 0.1 && exact.outstanding.is_none(), "{}", exact.rivalry);
        assert!(rivals(0.0, PERIOD).outstanding.is_none());
    }
}
