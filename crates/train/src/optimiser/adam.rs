//! Adam over named parameters (Kingma & Ba 2015).
//!
//! departs: burn's optimiser isn't used because its records go by random parameter numbers; with names and plain
//! tensors a run resumes to the last bit in another process.

use super::parameters::{Gradients, NamedTensors};
use crate::config::Adam;
use burn::tensor::Tensor;

/// The moments of every parameter and the number of steps so far.
#[derive(Clone)]
pub struct AdamOptimiser {
    constants: Adam,
    weight_decay: f64,
    /// Steps taken.
    pub time: u64,
    /// Running means of the gradients.
    pub first: NamedTensors,
    /// Running means of their squares.
    pub second: NamedTensors,
}

impl AdamOptimiser {
    /// An optimiser that has seen nothing.
    pub fn new(constants: Adam, weight_decay: f64) -> Self {
        Self { constants, weight_decay, time: 0, first: NamedTensors::new(), second: NamedTensors::new() }
    }

    /// One step: the new values of all parameters that have a gradient, the old ones of the others.
    pub fn step(&mut self, values: NamedTensors, gradients: Gradients, learning_rate: f64) -> NamedTensors {
        self.time += 1;
        let mut gradients = gradients.0;
        values
            .into_iter()
            .map(|(name, value)| match gradients.remove(&name) {
                Some(gradient) => {
                    let moved = self.update(&name, value, gradient, learning_rate);
                    (name, moved)
                }
                None => (name, value),
            })
            .collect()
    }

    fn update(&mut self, name: &str, value: Tensor<1>, mut gradient: Tensor<1>, learning_rate: f64) -> Tensor<1> {
        let Adam { beta1, beta2, epsilon } = self.constants;
        if self.weight_decay > 0.0 {
            gradient = gradient + value.clone().mul_scalar(self.weight_decay);
        }
        let square = gradient.clone().square();
        let first = decay(self.first.remove(name), gradient, beta1);
        let second = decay(self.second.remove(name), square, beta2);
        self.first.insert(name.into(), first.clone());
        self.second.insert(name.into(), second.clone());
        // Bias corrections folded into scalars: value − lr·(m/c1) / (√(v/c2) + ε).
        let time = self.time as f64;
        let (correction1, correction2) = (1.0 - beta1.powf(time), 1.0 - beta2.powf(time));
        let root = second.sqrt().mul_scalar(1.0 / correction2.sqrt()).add_scalar(epsilon);
        value - first.div(root).mul_scalar(learning_rate / correction1)
    }
}

fn decay(mean: Option<Tensor<1>>, value: Tensor<1>, beta: f64) -> Tensor<1> {
    let new = value.mul_scalar(1.0 - beta);
    match mean {
        Some(mean) => mean.mul_scalar(beta) + new,
        None => new,
    }
}

#[cfg(test)]
mod tests {
    use super::super::parameters::{from_vec, to_vec};
    use super::*;
    use burn::tensor::Device;

    fn named(values: &[f32]) -> NamedTensors {
        NamedTensors::from([("w".to_string(), from_vec(values.to_vec(), &Device::flex()))])
    }

    #[test]
    fn the_first_step_moves_every_value_by_the_rate() {
        // m/c1 = g and √(v/c2) = |g|: the step is lr·sign(g) up to ε.
        let mut adam = AdamOptimiser::new(Adam { beta1: 0.9, beta2: 0.999, epsilon: 1e-12 }, 0.0);
        let moved = adam.step(named(&[1.0, 1.0]), Gradients(named(&[3.0, -0.01])), 0.1);
        let moved = to_vec(&moved["w"]);
        approx::assert_relative_eq!(moved[0], 0.9, max_relative = 1e-5);
        approx::assert_relative_eq!(moved[1], 1.1, max_relative = 1e-5);
    }

    #[test]
    fn two_steps_equal_the_hand_computed_ones() {
        let mut adam = AdamOptimiser::new(Adam { beta1: 0.5, beta2: 0.75, epsilon: 1e-4 }, 0.1);
        let (mut w, mut m, mut v) = (2.0_f64, 0.0, 0.0);
        let mut values = named(&[2.0]);
        for (time, g) in [(1, 0.3_f64), (2, -0.7)] {
            let g_decayed = g + 0.1 * w;
            m = 0.5 * m + 0.5 * g_decayed;
            v = 0.75 * v + 0.25 * g_decayed * g_decayed;
            let (c1, c2) = (1.0 - 0.5_f64.powi(time), 1.0 - 0.75_f64.powi(time));
            w -= 0.01 * (m / c1) / ((v / c2).sqrt() + 1e-4);
            values = adam.step(values, Gradients(named(&[g as f32])), 0.01);
        }
        approx::assert_relative_eq!(f64::from(to_vec(&values["w"])[0]), w, max_relative = 1e-6);
    }

    #[test]
    fn a_parameter_without_gradient_stays() {
        let mut adam = AdamOptimiser::new(Adam::default(), 0.1);
        let stayed = adam.step(named(&[2.0]), Gradients::default(), 0.1);
        assert_eq!(to_vec(&stayed["w"]), [2.0]);
    }

    #[test]
    fn clipping_shortens_only_long_gradients() {
        let mut gradients = Gradients(named(&[3.0, 4.0]));
        assert_eq!(gradients.norm(), 5.0);
        gradients.clip(5.0, 10.0);
        assert_eq!(to_vec(&gradients.0["w"]), [3.0, 4.0]);
        gradients.clip(5.0, 1.0);
        approx::assert_relative_eq!(gradients.norm(), 1.0, max_relative = 1e-6);
    }

    #[test]
    fn a_gradient_that_is_not_a_number_shows_in_the_norm() {
        assert!(!Gradients(named(&[1.0, f32::NAN])).norm().is_finite());
    }
}
