//! Hand values, masks and gradients of the flow loss.

use burn::tensor::{Device, Tensor, TensorData};
use ops::{gradcheck::largest_relative_error, planes::values};

use super::*;

const FACTOR: usize = 4;
const RADIUS: usize = 4;

fn device() -> Device {
    Device::flex()
}

fn constant_flow(h: usize, w: usize, x: f32, y: f32) -> Tensor<4> {
    let data = [vec![x; h * w], vec![y; h * w]].concat();
    Tensor::from_data(TensorData::new(data, [1, 2, h, w]), &device())
}

/// One level whose flow is constant, in pixels.
fn output(h: usize, w: usize, x_px: f32, y_px: f32) -> PwcOutput {
    let flow = constant_flow(h, w, x_px, y_px) / FLOW_UNIT_PX;
    let logits = Tensor::zeros([1, (2 * RADIUS + 1).pow(2), h, w], &device());
    PwcOutput { levels: vec![LevelFlow { flow, logits, start: None, factor: FACTOR }] }
}

fn target(h: usize, w: usize, x_px: f32, y_px: f32, valid: Tensor<4>) -> FlowTarget {
    FlowTarget::new(constant_flow(h * FACTOR, w * FACTOR, x_px, y_px), valid)
}

fn everywhere(h: usize, w: usize) -> Tensor<4> {
    Tensor::ones([1, 1, h * FACTOR, w * FACTOR], &device())
}

fn scalar(t: Tensor<1>) -> f32 {
    values(t)[0]
}

#[test]
fn the_euclidean_sum_by_hand() {
    let config = FlowLossConfig::default();
    let loss = config.forward(&output(2, 3, 3.0, 4.0), &target(2, 3, 0.0, 0.0, everywhere(2, 3)));
    // Six pixels, each 5 px = 0.25 units off, the last level's weight.
    assert!((scalar(loss.total) - 6.0 * 0.25 * 0.005).abs() < 1e-6);
    assert_eq!(loss.levels.len(), 1);
    assert!(loss.matching.is_none());
}

#[test]
fn the_robust_sum_by_hand() {
    let config = FlowLossConfig { error: FlowError::Robust, ..FlowLossConfig::default() };
    let loss = config.forward(&output(2, 3, 3.0, 4.0), &target(2, 3, 0.0, 0.0, everywhere(2, 3)));
    assert!((scalar(loss.total) - 6.0 * (0.35f32 + 0.01).powf(0.4) * 0.005).abs() < 1e-6);
}

#[test]
fn invalid_pixels_do_not_count_whatever_they_hold() {
    let (h, w) = (2, 2);
    // The left column of blocks is valid; half of the upper right block's rows too, which isn't enough.
    let valid: Vec<f32> = (0..h * w * FACTOR * FACTOR).map(|i| f32::from(i % 8 < 4 || i / 8 < 2)).collect();
    let valid = Tensor::from_data(TensorData::new(valid, [1, 1, 8, 8]), &device());
    let mut flow = vec![4.0f32; 2 * 64];
    (0..2 * 64).filter(|i| i % 8 >= 4 && i % 64 / 8 >= 2).for_each(|i| flow[i] = f32::NAN);
    let flow = Tensor::from_data(TensorData::new(flow, [1, 2, 8, 8]), &device());
    let loss = FlowLossConfig::teaching().forward(&output(h, w, 4.0, 1.0), &FlowTarget::new(flow, valid));
    assert!((scalar(loss.levels[0].clone()) - 2.0 * 0.15 * 0.005).abs() < 1e-6);
    assert!(scalar(loss.total).is_finite());
}

#[test]
fn nothing_valid_gives_zero() {
    let none = Tensor::zeros([1, 1, 8, 8], &device());
    let loss = FlowLossConfig::teaching().forward(&output(2, 2, 4.0, 1.0), &target(2, 2, 1.0, 1.0, none));
    assert_eq!(scalar(loss.total), 0.0);
}

#[test]
fn the_gradient_is_finite_where_the_error_is_zero() {
    let device = device().autodiff();
    for error in [FlowError::Euclidean, FlowError::Robust] {
        let mut output = output(2, 2, 0.0, 0.0);
        let flow = Tensor::<4>::zeros([1, 2, 2, 2], &device).require_grad();
        output.levels[0].flow = flow.clone();
        output.levels[0].logits = Tensor::from_inner(output.levels[0].logits.clone());
        let truth = FlowTarget::new(Tensor::zeros([1, 2, 8, 8], &device), Tensor::ones([1, 1, 8, 8], &device));
        let config = FlowLossConfig { error, ..FlowLossConfig::teaching() };
        let gradients = config.forward(&output, &truth).total.backward();
        assert!(values(flow.grad(&gradients).unwrap()).iter().all(|g| *g == 0.0), "{error:?}");
    }
}

#[test]
fn gradients_agree_with_central_differences() {
    let flow: Vec<f32> = (0..8).map(|i| 0.3 + 0.11 * i as f32).collect();
    for error in [FlowError::Euclidean, FlowError::Robust] {
        let config = FlowLossConfig { error, level_weights: vec![1.0], ..FlowLossConfig::default() };
        let worst = largest_relative_error(&flow, [1, 2, 2, 2], 1e-2, |flow: Tensor<4>| {
            let device = flow.device();
            let truth = FlowTarget::new(Tensor::zeros([1, 2, 8, 8], &device), Tensor::ones([1, 1, 8, 8], &device));
            let logits = Tensor::zeros([1, 81, 2, 2], &device);
            let level = LevelFlow { flow, logits, start: None, factor: FACTOR };
            config.forward(&PwcOutput { levels: vec![level] }, &truth).total
        });
        assert!(worst < 1e-2, "{error:?}: {worst}");
    }
}

/// Logits that are sure of one displacement everywhere.
fn sure_of(dx: i64, dy: i64, h: usize, w: usize) -> Tensor<4> {
    let side = 2 * RADIUS + 1;
    let index = ((dy + RADIUS as i64) * side as i64 + dx + RADIUS as i64) as usize;
    let data = (0..side * side * h * w).map(|i| if i / (h * w) == index { 30.0 } else { 0.0f32 }).collect();
    Tensor::from_data(TensorData::new(data, [1, side * side, h, w]), &device())
}

#[test]
fn matching_is_right_only_for_the_true_displacement() {
    let config = FlowLossConfig::teaching();
    // 8 px and −4 px are +2 and −1 pixels of a level of factor 4.
    let truth = target(8, 8, 8.0, -4.0, everywhere(8, 8));
    let entropy = |logits: Tensor<4>, start: Option<Tensor<4>>| {
        let mut output = output(8, 8, 0.0, 0.0);
        output.levels[0].logits = logits;
        output.levels[0].start = start;
        scalar(config.forward(&output, &truth).matching.unwrap())
    };
    assert!(entropy(sure_of(2, -1, 8, 8), None) < 1e-3);
    assert!(entropy(sure_of(-1, 2, 8, 8), None) > 10.0);
    // Started from one pixel of the level to the right, one is left.
    let start = constant_flow(8, 8, 4.0, 0.0) / FLOW_UNIT_PX;
    assert!(entropy(sure_of(1, -1, 8, 8), Some(start.clone())) < 1e-3);
    assert!(entropy(sure_of(2, -1, 8, 8), Some(start)) > 10.0);
    let uniform = entropy(sure_of(0, 0, 8, 8) * 0.0, None);
    let counted = 6.0 * 7.0;
    assert!((uniform - 81f32.ln() * counted / (counted + 1.0)).abs() < 1e-3, "two columns and a row leave the image");
}

#[test]
fn displacements_the_cost_volume_lacks_teach_nothing() {
    let truth = target(8, 8, 19.0, 0.0, everywhere(8, 8));
    let loss = FlowLossConfig::teaching().forward(&output(8, 8, 0.0, 0.0), &truth);
    assert_eq!(scalar(loss.matching.unwrap()), 0.0);
}

#[test]
fn impossible_weights_are_named() {
    let weights = |level_weights: &[f32], matching_weight| FlowLossConfig {
        level_weights: level_weights.to_vec(),
        matching_weight,
        ..FlowLossConfig::default()
    };
    assert_eq!(FlowLossConfig::default().validate(5), Ok(()));
    assert_eq!(weights(&[1.0], 0.0).validate(3), Err(FlowLossConfigError::TooFew { needed: 3, found: 1 }));
    assert_eq!(weights(&[1.0, -1.0], 0.0).validate(2), Err(FlowLossConfigError::Weight(-1.0)));
    assert!(matches!(weights(&[1.0], f32::NAN).validate(1), Err(FlowLossConfigError::Weight(_))));
}
