//! Convolutions in half precision equal those in single precision to its rounding, in value and gradient.

#[allow(dead_code, reason = "shared with `kernels`")]
mod comparison;

use burn::tensor::{DType, Tensor};
use comparison::{value_and_gradients, wave};
use ops::compute::Compute;
use ops::conv::{Conv3x3, Padding, conv3x3};

/// Rounding of a number of each format.
const FORMATS: [(Compute, f32); 2] = [(Compute::F16, 1.0 / 2048.0), (Compute::Bf16, 1.0 / 256.0)];
fn relative_norm(found: &[f32], expected: &[f32]) -> f32 {
    let norm = |values: &mut dyn Iterator<Item = f32>| values.map(|v| v * v).sum::<f32>().sqrt();
    norm(&mut found.iter().zip(expected).map(|(f, e)| f - e)) / norm(&mut expected.iter().copied())
}

#[test]
fn convolutions_agree_to_the_rounding_of_their_format() {
    for padding in [Padding::Edge, Padding::Zero] {
        let same = Conv3x3::same(padding);
        for geometry in [same, Conv3x3::halving(padding), Conv3x3 { dilation: 2, ..same }, Conv3x3::enlarging(padding)] {
            let inputs = [wave([2, 5, 9, 7], 0.0), wave([6, 5, 3, 3], 1.0)];
            let single = value_and_gradients(&inputs, |t| conv3x3(t[0].clone(), t[1].clone(), geometry));
            for (format, rounding) in FORMATS {
                let half = |t: &[Tensor<4>]| format.within(|| conv3x3(t[0].clone(), t[1].clone(), geometry));
                let kernels = value_and_gradients(&inputs, half);
                let composed = value_and_gradients(&inputs, |t| ops::kernel::without(|| half(t)));
                // Inputs and results are rounded, and terms cancel to a twentieth; but burn's CPU back end adds up tens to hundreds
                // of them in f16 itself.
                for (name, found, roundings) in [("kernels", kernels, 4.0), ("composed", composed, 24.0)] {
                    for (part, (found, single)) in found.iter().zip(&single).enumerate() {
                        let error = relative_norm(found, single);
                        let name = || format!("{name}, {format:?}, {geometry:?}, part {part}: {}", error / rounding);
                        assert!(error < roundings * rounding, "{}", name());
                        // Otherwise nothing was rounded.
                        assert!(error > 0.05 * rounding, "{}", name());
                    }
                }
            }
        }
    }
}

#[test]
fn results_and_gradients_come_back_in_single_precision() {
    for (format, _) in FORMATS {
        let (x, weight): (Tensor<4>, Tensor<4>) =
            (wave([1, 2, 4, 4], 0.0).require_grad(), wave([3, 2, 3, 3], 1.0).require_grad());
        let out = format.within(|| conv3x3(x.clone(), weight.clone(), Conv3x3::same(Padding::Edge)));
        assert_eq!(out.dtype(), DType::F32);
        let gradients = out.sum().backward();
        assert!([x, weight].iter().all(|t| t.grad(&gradients).unwrap().dtype() == DType::F32));
    }
}

#[test]
fn gradients_too_small_for_f16_vanish_there_and_only_there() {
    let inputs = [wave([1, 2, 5, 5], 0.0), wave([3, 2, 3, 3], 1.0)];
    let largest = |format: Compute, scale: f32| {
        let faint = |t: &[Tensor<4>]| conv3x3(t[0].clone(), t[1].clone(), Conv3x3::same(Padding::Edge)) * scale;
        let gradients = value_and_gradients(&inputs, |t| format.within(|| faint(t)));
        gradients[1].iter().fold(0.0f32, |m, v| m.max(v.abs()))
    };
    assert_eq!(largest(Compute::F16, 1e-9), 0.0);
    assert!(largest(Compute::Bf16, 1e-9) > 0.0 && largest(Compute::F32, 1e-9) > 0.0);
    // What the factor on the loss is for.
    assert!(largest(Compute::F16, 1e-9 * 65536.0) > 0.0);
}
