//! How sure a mean is, and whether two methods differ on the same cases.

use statrs::distribution::{ContinuousCDF, StudentsT};
use statrs::function::erf::erfc;

/// Differences up to which the signed-rank test counts every assignment of signs.
const EXACT: usize = 50;
/// Confidence of all intervals.
const CONFIDENCE: f64 = 0.95;

/// A mean and half the width of its 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mean {
    /// The mean.
    pub value: f64,
    /// Half the width by Student's t; `None` for a single value.
    pub half_width: Option<f64>,
}

impl Mean {
    /// Of independent values; `None` without any.
    pub fn of(values: &[f64]) -> Option<Self> {
        let count = values.len() as f64;
        let value = values.iter().sum::<f64>() / count;
        if values.is_empty() {
            return None;
        }
        let square = |v: &f64| (v - value).powi(2);
        let half_width = StudentsT::new(0.0, 1.0, count - 1.0).ok().map(|student| {
            let error = (values.iter().map(square).sum::<f64>() / (count - 1.0) / count).sqrt();
            student.inverse_cdf(0.5 + CONFIDENCE / 2.0) * error
        });
        Some(Self { value, half_width })
    }

    /// Whether the interval leaves zero out.
    pub fn is_certain(&self) -> bool {
        self.half_width.is_some_and(|half| self.value.abs() > half)
    }
}

/// Wilcoxon's signed-rank test of paired differences, two-sided; `None` when all of them are zero.
///
/// Differences of zero take no part. Up to 50 differences, the probability is exact given their ranks, ties included; beyond,
/// it is the normal approximation, corrected for ties.
///
/// # Source
/// Wilcoxon 1945; the corrections as in Hollander, Wolfe, Chicken, *Nonparametric Statistical Methods*, §3.1.
pub fn signed_rank(differences: &[f64]) -> Option<f64> {
    let mut sorted: Vec<f64> = differences.iter().copied().filter(|d| *d != 0.0 && d.is_finite()).collect();
    if sorted.is_empty() {
        return None;
    }
    sorted.sort_by(|a, b| a.abs().total_cmp(&b.abs()));
    let groups: Vec<&[f64]> = sorted.chunk_by(|a, b| a.abs() == b.abs()).collect();
    // Twice the mid-ranks, which are whole numbers: 1, 2 and 3 tied have ranks 2, doubled 4.
    let mut doubled = Vec::with_capacity(sorted.len());
    for group in &groups {
        let before = doubled.len();
        doubled.extend(std::iter::repeat_n(2 * before + group.len() + 1, group.len()));
    }
    let total: usize = doubled.iter().sum();
    let positive: usize = doubled.iter().zip(&sorted).filter(|(_, d)| **d > 0.0).map(|(rank, _)| rank).sum();
    let smaller = positive.min(total - positive);
    let count = sorted.len() as f64;
    if sorted.len() <= EXACT {
        return Some((2.0 * share_at_most(&doubled, smaller)).min(1.0));
    }
    let ties: f64 = groups.iter().map(|group| (group.len() as f64).powi(3) - group.len() as f64).sum();
    let deviation = ((count * (count + 1.0) * (2.0 * count + 1.0) - ties / 2.0) / 24.0).sqrt();
    let distance = (smaller as f64 / 2.0 - count * (count + 1.0) / 4.0).abs() / deviation;
    Some(erfc(distance / std::f64::consts::SQRT_2))
}

/// Spearman's rank correlation of pairs, −1 to 1; `None` for fewer than three pairs or when all values of one side are equal.
///
/// Equal values share the mean of their ranks.
pub fn spearman(pairs: &[(f64, f64)]) -> Option<f64> {
    if pairs.len() < 3 {
        return None;
    }
    let ranks = |side: fn(&(f64, f64)) -> f64| {
        let mut order: Vec<(f64, usize)> = pairs.iter().map(side).zip(0..).collect();
        order.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut ranks = vec![0.0; pairs.len()];
        let mut before = 0;
        for group in order.chunk_by(|a, b| a.0 == b.0) {
            let shared = before as f64 + 0.5 * (group.len() as f64 + 1.0);
            group.iter().for_each(|(_, i)| ranks[*i] = shared);
            before += group.len();
        }
        ranks
    };
    let (a, b) = (ranks(|p| p.0), ranks(|p| p.1));
    let middle = 0.5 * (pairs.len() as f64 + 1.0);
    let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - middle) * (b - middle)).sum::<f64>();
    let spread = (product(&a, &a) * product(&b, &b)).sqrt();
    (spread > 0.0).then(|| product(&a, &b) / spread)
}

/// Share of all subsets of the ranks whose sum is at most `limit`.
fn share_at_most(ranks: &[usize], limit: usize) -> f64 {
    let mut shares = vec![0.0; limit + 1];
    shares[0] = 1.0;
    for &rank in ranks {
        for sum in (0..=limit).rev() {
            let with = if sum >= rank { shares[sum - rank] } else { 0.0 };
            shares[sum] = (shares[sum] + with) / 2.0;
        }
    }
    shares.iter().sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::Deserialize;

    #[derive(Deserialize)]
    struct Fixture {
        means: Vec<MeanCase>,
        signed_ranks: Vec<RankCase>,
    }

    #[derive(Deserialize)]
    struct MeanCase {
        values: Vec<f64>,
        mean: f64,
        half_width: f64,
    }

    #[derive(Deserialize)]
    struct RankCase {
        name: String,
        differences: Vec<f64>,
        p: f64,
    }

    /// Values that SciPy computed, see `tests/golden/generate/comparison.py`.
    fn fixture() -> Fixture {
        serde_json::from_str(include_str!("../../../tests/golden/statistics.json")).unwrap()
    }

    #[test]
    fn means_and_intervals_are_scipys() {
        for MeanCase { values, mean, half_width } in fixture().means {
            let found = Mean::of(&values).unwrap();
            assert!((found.value - mean).abs() < 1e-12 * mean.abs().max(1.0), "{values:?}");
            assert!((found.half_width.unwrap() / half_width - 1.0).abs() < 1e-9, "{values:?}: {found:?}, {half_width}");
        }
    }

    #[test]
    fn signed_rank_probabilities_are_scipys() {
        for RankCase { name, differences, p } in fixture().signed_ranks {
            let found = signed_rank(&differences).unwrap();
            assert!((found / p - 1.0).abs() < 1e-9, "{name}: {found}, SciPy says {p}");
        }
    }

    #[test]
    fn rank_correlation_follows_order_alone() {
        let of = |b: &[f64]| spearman(&(0..b.len()).map(|i| i as f64).zip(b.iter().copied()).collect::<Vec<_>>());
        assert_eq!(of(&[1.0, 10.0, 1e6, 1e7]), Some(1.0));
        assert_eq!(of(&[5.0, 2.0, -1.0]), Some(-1.0));
        // 1 − 6·Σd²/(n(n² − 1)) with d = (−1, 1, −1, 1, 0).
        assert!((of(&[2.0, 1.0, 4.0, 3.0, 5.0]).unwrap() - (1.0 - 6.0 * 4.0 / 120.0)).abs() < 1e-12);
        // Ranks 1.5, 1.5, 3 against 1, 2, 3.
        assert!((of(&[7.0, 7.0, 9.0]).unwrap() - 3.0f64.sqrt() / 2.0).abs() < 1e-12);
        assert_eq!(of(&[1.0, 2.0]), None);
        assert_eq!(of(&[1.0, 1.0, 1.0]), None);
    }

    #[test]
    fn a_single_value_has_no_interval_and_no_value_no_mean() {
        assert_eq!(Mean::of(&[3.0]), Some(Mean { value: 3.0, half_width: None }));
        assert_eq!(Mean::of(&[]), None);
        assert!(!Mean::of(&[3.0]).unwrap().is_certain());
        assert!(Mean::of(&[3.0, 3.1, 2.9]).unwrap().is_certain() && !Mean::of(&[3.0, -2.0]).unwrap().is_certain());
    }

    #[test]
    fn five_equal_signs_have_one_chance_in_sixteen() {
        assert_eq!(signed_rank(&[1.0, 2.0, 3.0, 4.0, 5.0, 0.0]), Some(2.0 / 32.0));
        assert_eq!(signed_rank(&[0.0, 0.0]), None);
        assert_eq!(signed_rank(&[1.0, -1.0]), Some(1.0));
    }
}
