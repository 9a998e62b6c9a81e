//! Values and gradients of two routes to the same result.

use burn::tensor::{Device, Tensor, TensorData};
use ops::planes::values;

/// Where gradients are tracked.
pub fn device() -> Device {
    Device::flex().autodiff()
}

/// Values without order or symmetry in [−1, 1].
pub fn wave<const D: usize>(shape: [usize; D], phase: f32) -> Tensor<D> {
    let count = shape.iter().product::<usize>();
    let data: Vec<f32> = (0..count).map(|i| (((i * 7919) % 9973) as f32 * 0.31 + phase).sin()).collect();
    Tensor::from_data(TensorData::new(data, shape), &device())
}

/// Value of `f` and the gradients of a weighted sum of it with respect to every input.
pub fn value_and_gradients(inputs: &[Tensor<4>], f: impl Fn(&[Tensor<4>]) -> Tensor<4>) -> Vec<Vec<f32>> {
    value_and_weighted_gradients(inputs, f, |size| wave(size, 3.0))
}

/// The same with the caller's weights.
pub fn value_and_weighted_gradients(
    inputs: &[Tensor<4>],
    f: impl Fn(&[Tensor<4>]) -> Tensor<4>,
    weights: impl Fn([usize; 4]) -> Tensor<4>,
) -> Vec<Vec<f32>> {
    let inputs: Vec<_> = inputs.iter().map(|t| t.clone().require_grad()).collect();
    let out = f(&inputs);
    let weights = weights(out.dims());
    let gradients = (out.clone() * weights).sum().backward();
    let mut all = vec![values(out.inner())];
    all.extend(inputs.iter().map(|t| t.grad(&gradients).map(values).unwrap_or_default()));
    all
}

/// All parts agree to 2e-5 of their largest value.
pub fn assert_equal(name: &str, a: &[Vec<f32>], b: &[Vec<f32>]) {
    assert_near(name, a, b, 2e-5);
}

/// All parts agree to a share of their largest value.
pub fn assert_near(name: &str, a: &[Vec<f32>], b: &[Vec<f32>], share: f32) {
    for (part, (a, b)) in a.iter().zip(b).enumerate() {
        assert_eq!(a.len(), b.len(), "{name}, part {part}");
        let scale = b.iter().fold(1e-3f32, |m, v| m.max(v.abs()));
        let worst = a.iter().zip(b).fold(0.0f32, |m, (x, y)| m.max((x - y).abs()));
        assert!(worst <= share * scale, "{name}, part {part}: differs by {worst}, largest value {scale}");
    }
}
