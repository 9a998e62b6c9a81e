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
