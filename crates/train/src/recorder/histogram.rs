//! How the values of one layer are spread.

use crate::optimiser::{NamedTensors, to_vec};

/// Bars of a histogram, all of one width.
const BARS: usize = 48;
/// Values of a layer that are looked at, evenly over all of them: bounds the cost, and enough for every bar.
const MOST_VALUES: usize = 1 << 16;

/// What the values of a layer are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Quantity {
    /// The weights after a step.
    Weights,
    /// The gradients of a step, before they are clipped.
    Gradients,
}

impl Quantity {
    /// The word in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Weights => "weights",
            Self::Gradients => "gradients",
        }
    }
}

/// A histogram of the finite ones of a layer's values.
#[derive(Debug, Clone, PartialEq)]
pub struct Histogram {
    /// The least value.
    pub least: f64,
    /// Their sum.
    pub sum: f64,
    /// The sum of their squares.
    pub sum_of_squares: f64,
    /// Upper ends of the bars; the last one is the largest value.
    pub ends: Vec<f64>,
    /// Values in each bar, as a number of values looked at.
    pub counts: Vec<f64>,
}

impl Histogram {
    /// Of at most 65 536 of the values; `None` where none of them is finite.
    pub fn of(values: &[f32]) -> Option<Self> {
        let stride = values.len().div_ceil(MOST_VALUES).max(1);
        let values: Vec<f64> = values.iter().step_by(stride).filter(|v| v.is_finite()).map(|v| f64::from(*v)).collect();
        let (least, largest) =
            values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(*v), high.max(*v)));
        if values.is_empty() {
            return None;
        }
        let width = (largest - least) / BARS as f64;
        let bars = if width > 0.0 { BARS } else { 1 };
        let mut counts = vec![0.0; bars];
        for value in &values {
            counts[(((value - least) / width.max(f64::MIN_POSITIVE)) as usize).min(bars - 1)] += 1.0;
        }
        let mut ends: Vec<f64> = (1..=bars).map(|i| least + width * i as f64).collect();
        ends[bars - 1] = largest;
        let (sum, sum_of_squares) = (values.iter().sum(), values.iter().map(|v| v * v).sum());
        Some(Self { least, sum, sum_of_squares, ends, counts })
    }

    /// Of every tensor, by its name.
    pub fn of_all(tensors: &NamedTensors) -> impl Iterator<Item = (&str, Self)> {
        tensors.iter().filter_map(|(name, tensor)| Some((name.as_str(), Self::of(&to_vec(tensor))?)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_finite_value_is_in_a_bar() {
        let mut values: Vec<f32> = (0..1000).map(|i| (i as f32 / 999.0).powi(2) - 0.25).collect();
        values.extend([f32::NAN, f32::INFINITY]);
        let found = Histogram::of(&values).unwrap();
        assert_eq!(found.counts.iter().sum::<f64>(), 1000.0);
        assert_eq!((found.least, found.ends[BARS - 1]), (-0.25, 0.75));
        let below = |end: f64| values.iter().filter(|v| f64::from(**v) < end).count() as f64;
        assert_eq!(found.counts[..10].iter().sum::<f64>(), below(found.ends[9]));
        assert!((found.sum - values[..1000].iter().map(|v| f64::from(*v)).sum::<f64>()).abs() < 1e-9);
    }

    #[test]
    fn equal_values_are_one_bar_and_no_value_is_no_histogram() {
        let found = Histogram::of(&[0.5; 7]).unwrap();
        assert_eq!((found.ends, found.counts, found.sum_of_squares), (vec![0.5], vec![7.0], 1.75));
        assert_eq!(Histogram::of(&[f32::NAN]), None);
        assert_eq!(Histogram::of(&[]), None);
    }

    #[test]
    fn large_layers_are_sampled() {
        let found = Histogram::of(&vec![1.0; 3 * MOST_VALUES + 1]).unwrap();
        assert!(found.counts[0] <= MOST_VALUES as f64 && found.counts[0] > 0.7 * MOST_VALUES as f64);
    }
}
