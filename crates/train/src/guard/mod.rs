//! Numbers that go bad: found at once, with what led to them on the disk.

mod dump;

pub use dump::{Array, Dump, dump};

use crate::optimiser::{Gradients, NamedTensors, first_non_finite};

/// Name of what is minimised in the rows of a step.
pub const TOTAL: &str = "loss";

/// The first value of a step that isn't finite.
#[derive(Debug, Clone, PartialEq)]
pub struct NonFinite {
    /// Loss term, `gradient of` or `weight` with the parameter's name, or `gradient_norm`.
    pub term: String,
    /// NaN or an infinity.
    pub value: f64,
}

/// Looks for a loss that isn't finite: the term at fault before the total, which only inherits from it.
///
/// # Errors
/// The term.
pub fn check_losses(values: &[(String, f64)]) -> Result<(), NonFinite> {
    let bad = || values.iter().filter(|(_, value)| !value.is_finite());
    match bad().find(|(name, _)| name != TOTAL).or_else(|| bad().next()) {
        Some((term, value)) => Err(NonFinite { term: term.clone(), value: *value }),
        None => Ok(()),
    }
}

/// Looks for a gradient that isn't finite; `norm` is its norm, which is the cheap sign.
///
/// # Errors
/// The parameter whose gradient it is, or the norm when that alone is too large for a number.
pub fn check_gradients(norm: f32, gradients: &Gradients) -> Result<(), NonFinite> {
    if norm.is_finite() {
        return Ok(());
    }
    Err(match first_non_finite(&gradients.0) {
        Some((name, value)) => NonFinite { term: format!("gradient of {name}"), value: value.into() },
        None => NonFinite { term: "gradient_norm".into(), value: norm.into() },
    })
}

/// Looks for a weight that isn't finite: such weights must not become a checkpoint.
///
/// # Errors
/// The parameter.
pub fn check_weights(weights: &NamedTensors) -> Result<(), NonFinite> {
    match first_non_finite(weights) {
        Some((name, value)) => Err(NonFinite { term: format!("weight {name}"), value: value.into() }),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optimiser::from_vec;
    use burn::tensor::Device;

    #[test]
    fn the_term_at_fault_is_named_before_the_total() {
        let row =
            |values: [f64; 3]| [TOTAL, "maps", "renderings"].map(String::from).into_iter().zip(values).collect::<Vec<_>>();
        assert_eq!(check_losses(&row([1.0, 0.0, -3.0])), Ok(()));
        assert_eq!(check_losses(&row([f64::NAN, f64::INFINITY, f64::NAN])).unwrap_err().term, "maps");
        assert_eq!(check_losses(&row([f64::NAN, 1.0, 2.0])).unwrap_err().term, TOTAL);
    }

    #[test]
    fn the_parameter_of_a_bad_gradient_or_weight_is_named() {
        let named = |b: f32| {
            let tensor = |values: Vec<f32>| from_vec(values, &Device::flex());
            NamedTensors::from([("a".to_string(), tensor(vec![1.0])), ("b".to_string(), tensor(vec![2.0, b]))])
        };
        let check = |b: f32| {
            let gradients = Gradients(named(b));
            check_gradients(gradients.norm(), &gradients)
        };
        assert_eq!(check(3.0), Ok(()));
        assert_eq!(check(f32::NEG_INFINITY), Err(NonFinite { term: "gradient of b".into(), value: f64::NEG_INFINITY }));
        // Finite values whose squares no longer are.
        assert_eq!(check(1e30).unwrap_err().term, "gradient_norm");
        assert_eq!(check_weights(&named(3.0)), Ok(()));
        assert_eq!(check_weights(&named(f32::NAN)).unwrap_err().term, "weight b");
    }
}
