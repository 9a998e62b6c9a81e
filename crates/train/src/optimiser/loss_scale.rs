//! The factor on the loss that keeps small gradients from vanishing in half precision.

use serde::{Deserialize, Serialize};

/// Where the factor starts: gradients of a mean over 256² pixels are about 1e-6, the smallest half-precision number is 6e-8.
const START: f64 = 65536.0;
/// Steps of the optimiser without overflow after which a larger factor is tried.
const PATIENCE: u64 = 1000;
const LARGEST: f64 = 16_777_216.0;

/// A power of two, so that multiplying by it and dividing by it lose nothing. It is halved when a gradient overflows and doubled
/// when none has for a while.
///
/// # Source
/// Micikevicius et al. 2018, "Mixed precision training", §3.2.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct LossScale {
    /// The factor.
    pub factor: f64,
    /// Steps of the optimiser since it last changed, however many batches each has.
    pub steps: u64,
}

impl Default for LossScale {
    fn default() -> Self {
        Self { factor: START, steps: 0 }
    }
}

impl LossScale {
    /// Half the factor, after an overflow; `None` when the factor isn't to blame: it is 1 already.
    pub fn halved(self) -> Option<Self> {
        (self.factor > 1.0).then_some(Self { factor: self.factor / 2.0, steps: 0 })
    }

    /// The factor after a step without overflow.
    pub fn stepped(self) -> Self {
        match self.steps + 1 {
            PATIENCE => Self { factor: (self.factor * 2.0).min(LARGEST), steps: 0 },
            steps => Self { steps, ..self },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_factor_halves_down_to_one_and_doubles_after_a_thousand_good_steps() {
        let mut scale = LossScale::default();
        let mut halvings = 0;
        while let Some(smaller) = scale.halved() {
            (scale, halvings) = (smaller, halvings + 1);
        }
        assert_eq!((scale.factor, halvings), (1.0, 16));
        scale = (0..999).fold(scale, |scale, _| scale.stepped());
        assert_eq!(scale.factor, 1.0);
        assert_eq!(scale.stepped(), LossScale { factor: 2.0, steps: 0 });
        assert_eq!((0..99_999).fold(scale, |scale, _| scale.stepped()).factor, LARGEST);
    }
}
