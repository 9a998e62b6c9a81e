//! Whether a sample follows a law. Every bound holds for samples of any size, except those that speak of standard errors.

use std::ops::RangeInclusive;

/// Probability with which a sample of the right law is refused. Seeds are fixed: it says how many of them would do.
const REFUSED: f64 = 1e-5;
/// Standard errors that a normal quantity exceeds with that probability.
const STANDARD_ERRORS: f64 = 4.42;
/// By how much of a range single-precision arithmetic and stored maps may leave it.
const ROUNDING: f64 = 1e-4;

/// What was found wrong.
pub type Verdict = Result<(), String>;

fn verdict(right: bool, wrong: impl Fn() -> String) -> Verdict {
    if right { Ok(()) } else { Err(wrong()) }
}

/// One number of every draw.
pub fn column<T, V: Into<f64>>(draws: &[T], value: impl Fn(&T) -> V) -> Vec<f64> {
    draws.iter().map(|draw| value(draw).into()).collect()
}

/// Kolmogorov–Smirnov: the largest distance between the sample's distribution and the law's exceeds the bound of Dvoretzky,
/// Kiefer and Wolfowitz with Massart's constant, √(ln(2/α)/2n), with probability α at most.
pub fn follows(sample: &[f64], distribution: impl Fn(f64) -> f64) -> Verdict {
    let mut sorted = sample.to_vec();
    sorted.sort_by(f64::total_cmp);
    let n = sorted.len() as f64;
    let distance = sorted.iter().enumerate().map(|(i, &value)| {
        let share = distribution(value);
        (share - i as f64 / n).max((i + 1) as f64 / n - share)
    });
    let distance = distance.fold(0.0, f64::max);
    let bound = ((2.0 / REFUSED).ln() / (2.0 * n)).sqrt();
    verdict(distance <= bound && sample.iter().all(|v| v.is_finite()), || {
        format!("Kolmogorov–Smirnov distance {distance:.4} above {bound:.4}")
    })
}

/// U\[low, high\]: nothing outside, the right shape, and both ends reached: all of `n` draws miss a share s of the range with
/// probability (1 − s)ⁿ.
pub fn uniform(sample: &[f64], [low, high]: [f64; 2]) -> Verdict {
    let (least, most) = sample.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), &v| (a.min(v), b.max(v)));
    let range = high - low;
    let gap = (2.0 / REFUSED).ln() / sample.len() as f64 + ROUNDING;
    let inside = least >= low - ROUNDING * range && most <= high + ROUNDING * range;
    let full = least <= low + gap * range && most >= high - gap * range;
    verdict(inside && full, || format!("found {least} to {most} instead of {low} to {high}"))?;
    follows(sample, |v| ((v - low) / range).clamp(0.0, 1.0))
}

/// N(mean, deviation).
pub fn normal(sample: &[f64], mean: f64, deviation: f64) -> Verdict {
    let n = sample.len() as f64;
    let found = sample.iter().sum::<f64>() / n;
    verdict((found - mean).abs() <= STANDARD_ERRORS * deviation / n.sqrt(), || format!("mean {found} instead of {mean}"))?;
    let spread = (sample.iter().map(|v| (v - found).powi(2)).sum::<f64>() / n).sqrt();
    verdict((spread / deviation - 1.0).abs() <= STANDARD_ERRORS / (2.0 * n).sqrt(), || {
        format!("standard deviation {spread} instead of {deviation}")
    })?;
    follows(sample, |v| normal_distribution((v - mean) / deviation))
}

/// Probability that a standard normal number is below z, to 1e-7 (Abramowitz and Stegun 7.1.26).
pub fn normal_distribution(z: f64) -> f64 {
    let x = z.abs() / std::f64::consts::SQRT_2;
    let t = 1.0 / (1.0 + 0.327_591_1 * x);
    let series = [1.061_405_429, -1.453_152_027, 1.421_413_741, -0.284_496_736, 0.254_829_592];
    let tail = 0.5 * series.iter().fold(0.0, |sum, c| sum * t + c) * t * (-x * x).exp();
    if z < 0.0 { tail } else { 1.0 - tail }
}

/// Binomial: the inequality of Chernoff and Hoeffding bounds the probability of a share q of hits by exp(−n·KL(q‖p)) on
/// either side.
pub fn share(hits: usize, draws: usize, p: f64) -> Verdict {
    let (n, q) = (draws as f64, hits as f64 / draws as f64);
    let term = |q: f64, p: f64| if q > 0.0 { q * (q / p).ln() } else { 0.0 };
    let divergence = term(q, p) + term(1.0 - q, 1.0 - p);
    verdict(n * divergence <= (2.0 / REFUSED).ln(), || format!("{hits} of {draws} instead of a share of {p}"))
}

/// Every integer of a range equally often, and no other.
pub fn uniform_integers(sample: &[i64], range: RangeInclusive<i64>) -> Verdict {
    let (low, high) = (*range.start(), *range.end());
    let stray = sample.iter().find(|v| !range.contains(v));
    verdict(stray.is_none(), || format!("{stray:?} is outside {low} to {high}"))?;
    let p = 1.0 / (high - low + 1) as f64;
    range.into_iter().try_for_each(|value| {
        let hits = sample.iter().filter(|v| **v == value).count();
        share(hits, sample.len(), p).map_err(|wrong| format!("{value}: {wrong}"))
    })
}

/// No two columns are correlated.
pub fn unrelated(columns: &[&[f64]]) -> Verdict {
    let standard: Vec<Vec<f64>> = columns.iter().map(|column| standardised(column)).collect();
    for (i, a) in standard.iter().enumerate() {
        for (j, b) in standard[..i].iter().enumerate() {
            let correlation = a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>() / a.len() as f64;
            let bound = STANDARD_ERRORS / (a.len() as f64).sqrt();
            verdict(correlation.abs() <= bound, || format!("columns {j} and {i} correlate by {correlation}"))?;
        }
    }
    Ok(())
}

fn standardised(column: &[f64]) -> Vec<f64> {
    let n = column.len() as f64;
    let mean = column.iter().sum::<f64>() / n;
    let deviation = (column.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n).sqrt();
    column.iter().map(|v| (v - mean) / deviation).collect()
}

/// Laws that are refused: what the other tests of this binary rely on.
mod tests {
    use super::*;
    use rand::RngExt;
    use rand_distr::{Distribution, StandardNormal};

    const DRAWS: usize = 100_000;

    fn sample(value: impl Fn(f64, f64) -> f64) -> Vec<f64> {
        let mut rng = crate::rng(1);
        (0..DRAWS).map(|_| value(rng.random_range(0.0..1.0), StandardNormal.sample(&mut rng))).collect()
    }

    #[test]
    fn a_range_is_told_from_one_that_is_half_a_thousandth_longer_and_from_another_shape() {
        let even = sample(|u, _| u);
        uniform(&even, [0.0, 1.0]).unwrap();
        for range in [[0.0, 1.0005], [0.0, 0.9995], [-0.0005, 1.0], [0.0005, 1.0]] {
            uniform(&even, range).unwrap_err();
        }
        uniform(&sample(|u, _| u.powf(1.05)), [0.0, 1.0]).unwrap_err();
    }

    #[test]
    fn a_normal_law_is_told_from_its_neighbours() {
        let bell = sample(|_, z| 2.0 + 0.3 * z);
        normal(&bell, 2.0, 0.3).unwrap();
        normal(&bell, 2.01, 0.3).unwrap_err();
        normal(&bell, 2.0, 0.306).unwrap_err();
        let root = 3f64.sqrt();
        normal(&sample(|u, _| 2.0 + 0.3 * root * (2.0 * u - 1.0)), 2.0, 0.3).unwrap_err();
        for (z, below) in [(0.0, 0.5), (1.0, 0.841_344_746), (-1.96, 0.024_997_895), (3.0, 0.998_650_102)] {
            assert!((normal_distribution(z) - below).abs() < 2e-7, "{z}");
        }
    }

    #[test]
    fn a_share_is_told_from_its_neighbours_and_a_relation_is_seen() {
        share(3333, 10_000, 1.0 / 3.0).unwrap();
        share(3333, 10_000, 0.36).unwrap_err();
        share(0, 100, 0.2).unwrap_err();
        let dice: Vec<i64> = sample(|u, _| 1.0 + 6.0 * u).iter().map(|v| *v as i64).collect();
        uniform_integers(&dice, 1..=6).unwrap();
        uniform_integers(&dice, 1..=5).unwrap_err();
        uniform_integers(&dice, 1..=7).unwrap_err();
        let (a, b) = (sample(|u, _| u), sample(|_, z| z));
        let mixed: Vec<f64> = a.iter().zip(&b).map(|(a, b)| b + 0.1 * a).collect();
        unrelated(&[&a, &b]).unwrap();
        unrelated(&[&a, &mixed]).unwrap_err();
    }
}
