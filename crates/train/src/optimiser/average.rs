//! Exponential moving average of the weights, which evaluation uses.

use super::parameters::NamedTensors;

/// The average so far.
#[derive(Clone)]
pub struct Average {
    decay: f64,
    /// Averaged values.
    pub values: NamedTensors,
}

impl Average {
    /// Starts from the present weights; a decay of 0 keeps no average.
    pub fn new(decay: f64, values: NamedTensors) -> Option<Self> {
        (decay > 0.0).then_some(Self { decay, values })
    }

    /// Takes in the weights after step `step` (from 1). Early on the decay is smaller, (1+t)/(10+t), so that the random
    /// start is soon forgotten.
    pub fn update(&mut self, values: &NamedTensors, step: u64) {
        let decay = self.decay.min((1.0 + step as f64) / (10.0 + step as f64));
        for (name, average) in &mut self.values {
            if let Some(value) = values.get(name) {
                *average = average.clone().mul_scalar(decay) + value.clone().mul_scalar(1.0 - decay);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::parameters::{from_vec, to_vec};
    use super::*;
    use burn::tensor::Device;

    fn named(value: f32) -> NamedTensors {
        NamedTensors::from([("w".to_string(), from_vec(vec![value, -value], &Device::flex()))])
    }

    #[test]
    fn the_average_follows_the_weights_by_its_decay() {
        let mut average = Average::new(0.5, named(0.0)).unwrap();
        let mut expected = 0.0_f64;
        for step in 1..=12 {
            let weight = (step * step) as f32;
            average.update(&named(weight), step);
            // Early on 2/11, 3/12, … are below the decay.
            let decay = [2.0 / 11.0, 3.0 / 12.0, 4.0 / 13.0].get(step as usize - 1).copied().unwrap_or(0.5_f64);
            let decay = if (4..=7).contains(&step) { (1.0 + step as f64) / (10.0 + step as f64) } else { decay };
            expected = decay * expected + (1.0 - decay) * f64::from(weight);
            let found = to_vec(&average.values["w"]);
            approx::assert_relative_eq!(f64::from(found[0]), expected, max_relative = 1e-6);
            approx::assert_relative_eq!(f64::from(found[1]), -expected, max_relative = 1e-6);
        }
    }

    #[test]
    fn the_average_of_resting_weights_is_the_weights_and_no_decay_keeps_none() {
        let mut average = Average::new(0.999, named(3.0)).unwrap();
        (1..5000).for_each(|step| average.update(&named(3.0), step));
        approx::assert_relative_eq!(to_vec(&average.values["w"])[0], 3.0, max_relative = 1e-4);
        assert!(Average::new(0.0, named(1.0)).is_none());
    }
}
