//! Central differences: is a gradient right?

use burn::tensor::{Device, Tensor, TensorData};

/// The largest relative difference between autodiff's gradient of `f` at `x` and central differences of step `step`.
///
/// Every entry is probed, so keep `x` small. The difference of an entry is measured against the larger of 1e-3 times the
/// gradient's largest magnitude and its own magnitude.
///
/// # Shapes
/// `x` row-major of `shape`; `f` maps `[shape]` to a scalar tensor of one element.
pub fn largest_relative_error<const D: usize>(
    x: &[f32],
    shape: [usize; D],
    step: f32,
    f: impl Fn(Tensor<D>) -> Tensor<1>,
) -> f32 {
    let device = Device::flex().autodiff();
    let make = |v: Vec<f32>| Tensor::<D>::from_data(TensorData::new(v, shape), &device);
    let input = make(x.to_vec()).require_grad();
    let gradients = f(input.clone()).sum().backward();
    let exact = input.grad(&gradients).map_or_else(|| vec![0.0; x.len()], crate::planes::values);
    let value = |v: Vec<f32>| crate::planes::values(f(make(v)).inner()).iter().map(|&v| f64::from(v)).sum::<f64>();
    let scale = exact.iter().fold(0.0f32, |m, g| m.max(g.abs())) * 1e-3;
    let mut worst = 0.0f32;
    for (i, &g) in exact.iter().enumerate() {
        let (mut up, mut down) = (x.to_vec(), x.to_vec());
        up[i] += step;
        down[i] -= step;
        let width = f64::from(up[i]) - f64::from(down[i]);
        let numeric = ((value(up) - value(down)) / width) as f32;
        worst = worst.max((g - numeric).abs() / g.abs().max(numeric.abs()).max(scale).max(1e-6));
    }
    worst
}
