//! What an automatic control does over a video: it wanders.

use std::f64::consts::{PI, SQRT_2};

use rand::Rng;
use rand_distr::{Distribution, StandardNormal};

/// Terms of the series; the shortest wave is a quarter of the video, about a second.
const TERMS: usize = 8;

/// A smooth random walk that starts at 0 and has standard deviation `spread`·√t at share t of the video.
///
/// # Source
/// The first terms of the Karhunen–Loève series of Brownian motion, W(t) = √2·Σ Z_k·sin((k − ½)πt)/((k − ½)π): a walk
/// without the jitter of single frames, which is 0.975 of the variance at the end.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Drift {
    normal: [f64; TERMS],
    spread: f64,
}

impl Drift {
    /// One walk.
    pub fn draw(spread: f64, rng: &mut impl Rng) -> Self {
        Self { normal: std::array::from_fn(|_| StandardNormal.sample(rng)), spread }
    }

    /// Its value at a share of the video, 0 at the first and 1 at the last frame.
    pub fn at(&self, share: f64) -> f64 {
        let wave = |k: usize| {
            let frequency = (k as f64 + 0.5) * PI;
            self.normal[k] * (frequency * share).sin() / frequency
        };
        self.spread * SQRT_2 * (0..TERMS).map(wave).sum::<f64>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn drifts_start_at_nothing_and_spread_like_a_random_walk() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let drifts: Vec<Drift> = (0..6000).map(|_| Drift::draw(0.5, &mut rng)).collect();
        assert!(drifts.iter().all(|d| d.at(0.0) == 0.0));
        for share in [0.25, 0.5, 1.0] {
            let variance = drifts.iter().map(|d| d.at(share).powi(2)).sum::<f64>() / drifts.len() as f64;
            assert!((variance / (0.25 * share) - 0.97).abs() < 0.07, "{share}: {variance}");
        }
    }

    #[test]
    fn a_drift_is_smooth_and_none_at_spread_0() {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        for _ in 0..50 {
            let drift = Drift::draw(1.0, &mut rng);
            let steps = (0..140).map(|i| (drift.at((i + 1) as f64 / 140.0) - drift.at(i as f64 / 140.0)).abs());
            assert!(steps.fold(0.0, f64::max) < 0.15);
        }
        assert_eq!(Drift::draw(0.0, &mut rng).at(0.7), 0.0);
    }
}
