//! From values to places on the paper.

/// Ticks that an axis has about.
const TICKS: f64 = 4.0;

/// How values are spread.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scale {
    /// Evenly.
    Linear,
    /// By their logarithm; all are above 0.
    Logarithmic,
}

/// An axis.
#[derive(Clone, Copy, Debug)]
pub struct Axis {
    scale: Scale,
    low: f64,
    high: f64,
    /// Places of the lowest and the highest value.
    pub ends: [f64; 2],
}

impl Axis {
    /// Covers `low` to `high`, which differ, between two places.
    pub fn new(scale: Scale, [low, high]: [f64; 2], ends: [f64; 2]) -> Self {
        Self { scale, low, high, ends }
    }

    /// Whether a value is on the axis.
    pub fn covers(&self, value: f64) -> bool {
        (self.low..=self.high).contains(&value)
    }

    /// Values beyond the ends stand at the ends.
    pub fn place(&self, value: f64) -> f64 {
        let share = match self.scale {
            Scale::Linear => (value - self.low) / (self.high - self.low),
            Scale::Logarithmic => (value.max(f64::MIN_POSITIVE) / self.low).ln() / (self.high / self.low).ln(),
        };
        self.ends[0] + share.clamp(0.0, 1.0) * (self.ends[1] - self.ends[0])
    }

    /// A few round values with their labels.
    pub fn ticks(&self) -> Vec<(f64, String)> {
        match self.scale {
            Scale::Linear => self.even_ticks(),
            Scale::Logarithmic => self.powers(),
        }
    }

    fn even_ticks(&self) -> Vec<(f64, String)> {
        let raw = (self.high - self.low) / TICKS;
        let power = 10f64.powf(raw.log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0].map(|factor| factor * power).into_iter().find(|step| *step >= raw).unwrap_or(raw);
        let digits = (-step.log10().floor()).max(0.0) as usize;
        let first = (self.low / step).ceil() as i64;
        let ticks = (first..).map(|i| i as f64 * step).take_while(|value| *value <= self.high);
        ticks.map(|value| (value, format!("{value:.digits$}"))).collect()
    }

    /// Powers of ten, not all of them over many decades; between them 2 and 5 over few.
    fn powers(&self) -> Vec<(f64, String)> {
        let decades = (self.high / self.low).log10();
        let every = (decades / TICKS).ceil().max(1.0) as i32;
        let factors: &[f64] = if decades < 2.0 { &[1.0, 2.0, 5.0] } else { &[1.0] };
        let exponents = self.low.log10().floor() as i32..=self.high.log10().ceil() as i32;
        let values = exponents
            .filter(|exponent| exponent.rem_euclid(every) == 0)
            .flat_map(|exponent| factors.iter().map(move |factor| (exponent, factor * 10f64.powi(exponent))));
        let label = |exponent: i32, value: f64| match exponent {
            -3..0 => format!("{value:.*}", exponent.unsigned_abs() as usize),
            0..6 => format!("{value:.0}"),
            _ => format!("{value:.0e}"),
        };
        values.filter(|(_, value)| self.covers(*value)).map(|(exponent, value)| (value, label(exponent, value))).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(scale: Scale, range: [f64; 2]) -> Vec<String> {
        Axis::new(scale, range, [0.0, 1.0]).ticks().into_iter().map(|(_, label)| label).collect()
    }

    #[test]
    fn ticks_are_round_and_few() {
        assert_eq!(labels(Scale::Linear, [0.03, 0.42]), ["0.1", "0.2", "0.3", "0.4"]);
        assert_eq!(labels(Scale::Linear, [0.0, 600.0]), ["0", "200", "400", "600"]);
        assert_eq!(labels(Scale::Logarithmic, [0.015, 0.6]), ["0.02", "0.05", "0.1", "0.2", "0.5"]);
        assert_eq!(labels(Scale::Logarithmic, [1e-7, 2.0]), ["1e-6", "1e-4", "0.01", "1"]);
        assert_eq!(labels(Scale::Logarithmic, [3.0, 2e4]), ["10", "100", "1000", "10000"]);
    }

    #[test]
    fn places_lie_between_the_ends_and_half_a_decade_is_half_way() {
        let axis = Axis::new(Scale::Logarithmic, [0.01, 1.0], [100.0, 0.0]);
        assert!((axis.place(0.1) - 50.0).abs() < 1e-9);
        assert_eq!([axis.place(-3.0), axis.place(7.0)], [100.0, 0.0]);
        assert_eq!(Axis::new(Scale::Linear, [2.0, 4.0], [0.0, 10.0]).place(3.0), 5.0);
    }
}
