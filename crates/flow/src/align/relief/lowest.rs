//! Where a loss is lowest, and how well that can be told.

/// The share of the way is followed downhill from none in steps of this …
const STEP: f64 = 0.004;
/// … up to so many: motion blur takes a surface's detail before its shading, which then misleads most.
const STEPS: usize = 12;
/// The largest share that is found.
pub(super) const LARGEST: f64 = STEP * STEPS as f64;
/// Refinements of the best one, each with half the step.
const REFINEMENTS: usize = 2;
/// A loss that is larger by this share of itself may be the better one: no model of shading is that exact.
const TOLERANCE: f64 = 1.5e-3;

/// A share of the way with its standard deviation.
#[derive(Clone, Copy, Debug)]
pub(super) struct Estimate {
    pub share: f64,
    pub deviation: f64,
}

impl Estimate {
    /// Where a loss is lowest, going downhill from no share at all; `None` where it falls all the way. The flatter it is, the
    /// less is known.
    pub fn lowest(loss: impl Fn(f64) -> f64) -> Option<Self> {
        let (mut share, mut step) = (0.0, STEP);
        let mut around = [loss(-STEP), loss(0.0), loss(STEP)];
        let downhill = if around[0] < around[2] { -STEP } else { STEP };
        for _ in 0..STEPS {
            let [behind, here, ahead] = if downhill < 0.0 { [around[2], around[1], around[0]] } else { around };
            if behind >= here && here <= ahead {
                break;
            }
            share += downhill;
            let next = loss(share + downhill);
            around = if downhill < 0.0 { [next, ahead, here] } else { [here, ahead, next] };
        }
        if around[1] > around[0].min(around[2]) {
            return None;
        }
        let bend = |around: [f64; 3]| around[0] + around[2] - 2.0 * around[1];
        let deviation = step * (2.0 * TOLERANCE * around[1] / bend(around)).sqrt();
        for refinement in 0..=REFINEMENTS {
            let towards = 0.5 * step * (around[0] - around[2]) / bend(around);
            share += if bend(around) > 0.0 { towards.clamp(-step, step) } else { 0.0 };
            if refinement < REFINEMENTS {
                step *= 0.5;
                around = [loss(share - step), loss(share), loss(share + step)];
            }
        }
        deviation.is_finite().then_some(Self { share, deviation })
    }

    /// The share that independent estimates agree on best; `None` without any.
    pub fn combined(estimates: impl IntoIterator<Item = Self>) -> Option<f64> {
        let weigh = |(sum, weights): (f64, f64), e: Self| (sum + e.share / e.deviation.powi(2), weights + e.deviation.powi(-2));
        let (sum, weights) = estimates.into_iter().fold((0.0, 0.0), weigh);
        (weights > 0.0).then(|| sum / weights)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lowest_place_is_found_and_a_sharper_one_counts_more() {
        let parabola = |at: f64, bend: f64| Estimate::lowest(|p| 0.2 + bend * (p - at).powi(2)).unwrap();
        let (sharp, flat) = (parabola(-0.004, 4000.0), parabola(0.0071, 10.0));
        assert!((sharp.share + 0.004).abs() < 1e-9 && (flat.share - 0.0071).abs() < 1e-9, "{sharp:?} {flat:?}");
        assert!((flat.deviation / sharp.deviation - 20.0).abs() < 0.1);
        assert!((flat.deviation - (TOLERANCE * 0.2 / 10.0).sqrt()).abs() < 1e-4, "the tolerance's width");
        let both = Estimate::combined([sharp, flat]).unwrap();
        assert!((both - (sharp.share + (flat.share - sharp.share) / 401.0)).abs() < 1e-5);
        assert!(Estimate::combined([]).is_none());
    }

    #[test]
    fn nothing_is_told_by_an_even_loss_or_one_that_falls_to_the_end() {
        assert!(Estimate::lowest(|_| 0.3).is_none());
        assert!(Estimate::lowest(|p| 0.3 - p).is_none());
        assert!(Estimate::lowest(|_| f64::NAN).is_none());
    }
}
