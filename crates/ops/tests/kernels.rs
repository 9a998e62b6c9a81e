//! Every kernel equals its composed reference in value and gradient: odd sizes, one-pixel images, borders, batches.

#[allow(dead_code, reason = "shared with `layouts`")]
mod comparison;

use burn::tensor::Tensor;
use comparison::{assert_equal, device, value_and_gradients, value_and_weighted_gradients, wave};
use ops::conv::{Conv3x3, Padding};
use ops::planes::values;

#[test]
fn convolution_equals_its_reference() {
    let sizes = [
        (1, 1, 1, 1, 1),
        (2, 3, 5, 7, 9),
        (1, 5, 2, 33, 18),
        (2, 18, 7, 16, 40),
        (3, 4, 13, 20, 17),
        (1, 2, 6, 4, 64),
        (1, 3, 2, 40, 39),
        (2, 1, 18, 41, 40),
        (2, 19, 3, 3, 2),
        // More taps than one task of the weights' gradient has.
        (1, 75, 17, 5, 16),
    ];
    for padding in [Padding::Edge, Padding::Zero] {
        for (stride, dilation) in [(1, 1), (2, 1), (1, 2), (1, 4)] {
            for (n, i, o, h, w) in sizes {
                let geometry = Conv3x3 { stride, dilation, ..Conv3x3::same(padding) };
                let inputs = [wave([n, i, h, w], 0.0), wave([o, i, 3, 3], 1.0)];
                let fast = value_and_gradients(&inputs, |t| ops::conv::conv3x3(t[0].clone(), t[1].clone(), geometry));
                let plain = value_and_gradients(&inputs, |t| ops::conv::reference(t[0].clone(), t[1].clone(), geometry));
                assert_equal(&format!("{geometry:?} on {n}×{i}→{o}×{h}×{w}"), &fast, &plain);
            }
        }
    }
}

#[test]
fn enlarging_convolution_equals_its_reference() {
    for padding in [Padding::Edge, Padding::Zero] {
        let geometry = Conv3x3::enlarging(padding);
        for (n, i, o, h, w) in [(1, 1, 1, 1, 1), (2, 3, 5, 4, 9), (1, 2, 1, 1, 16), (2, 40, 7, 5, 17), (3, 4, 13, 20, 33)] {
            let inputs = [wave([n, i, h, w], 0.0), wave([o, i, 3, 3], 1.0)];
            let fast = value_and_gradients(&inputs, |t| ops::conv::conv3x3(t[0].clone(), t[1].clone(), geometry));
            let plain = value_and_gradients(&inputs, |t| ops::conv::reference(t[0].clone(), t[1].clone(), geometry));
            assert_equal(&format!("{geometry:?} on {n}×{i}→{o}×{h}×{w}"), &fast, &plain);
        }
    }
}

#[test]
fn convolutions_large_enough_for_fewer_multiplications_equal_their_reference() {
    for padding in [Padding::Edge, Padding::Zero] {
        for (geometry, n, i, o, h, w) in [
            (Conv3x3::same(padding), 1, 23, 24, 50, 67),
            (Conv3x3::same(padding), 2, 30, 19, 61, 34),
            (Conv3x3::enlarging(padding), 1, 14, 10, 49, 66),
            (Conv3x3 { dilation: 5, ..Conv3x3::same(padding) }, 2, 20, 9, 53, 38),
            (Conv3x3 { dilation: 16, ..Conv3x3::same(padding) }, 1, 12, 14, 64, 33),
        ] {
            let inputs = [wave([n, i, h, w], 0.0), wave([o, i, 3, 3], 1.0)];
            let fast = value_and_gradients(&inputs, |t| ops::conv::conv3x3(t[0].clone(), t[1].clone(), geometry));
            let reference = |t: &[Tensor<4>]| ops::conv::reference(t[0].clone(), t[1].clone(), geometry);
            let plain = value_and_gradients(&inputs, reference);
            // Terms that cancel take digits with them, so the scale is that of the sums of their magnitudes.
            let magnitudes = value_and_weighted_gradients(&inputs.map(Tensor::abs), reference, |size| wave(size, 3.0).abs());
            for (part, ((fast, plain), magnitudes)) in fast.iter().zip(&plain).zip(&magnitudes).enumerate() {
                for ((fast, plain), magnitude) in fast.iter().zip(plain).zip(magnitudes) {
                    let name = || format!("{geometry:?} on {n}×{i}→{o}×{h}×{w}, part {part}");
                    assert!((fast - plain).abs() <= 3e-6 * magnitude, "{}: {fast}, {plain} of {magnitude}", name());
                }
            }
        }
    }
}

#[test]
fn convolution_takes_a_permuted_input() {
    let geometry = Conv3x3::same(Padding::Edge);
    let inputs = [wave([2, 20, 18, 3], 0.0), wave([4, 3, 3, 3], 1.0)];
    let fast = value_and_gradients(&inputs, |t| ops::conv::conv3x3(t[0].clone().permute([0, 3, 1, 2]), t[1].clone(), geometry));
    let plain =
        value_and_gradients(&inputs, |t| ops::conv::reference(t[0].clone().permute([0, 3, 1, 2]), t[1].clone(), geometry));
    assert_equal("permuted", &fast, &plain);
}

#[test]
fn bias_and_leaky_relu_equal_their_reference() {
    for (n, c, h, w) in [(1, 1, 1, 1), (2, 3, 5, 7), (3, 2, 17, 9)] {
        for rows in [1, n] {
            let inputs = [wave([n, c, h, w], 0.0), wave([rows, c, 1, 1], 1.0)];
            let bias = |t: &Tensor<4>| Some(t.clone().reshape([rows, c]));
            let fast = value_and_gradients(&inputs, |t| ops::activation::bias_leaky_relu(t[0].clone(), bias(&t[1]), 0.2));
            let plain = value_and_gradients(&inputs, |t| ops::activation::reference(t[0].clone(), bias(&t[1]), 0.2));
            assert_equal(&format!("bias rows {rows} on {n}×{c}×{h}×{w}"), &fast, &plain);
        }
    }
}

#[test]
fn normalised_filters_equal_their_reference() {
    for (outputs, inputs) in [(1, 1), (3, 5), (7, 40)] {
        // The second filter hardly has a norm.
        let weight = wave([outputs, inputs, 3, 3], 0.5);
        let faint = weight.clone().slice_fill(1.min(outputs - 1)..outputs.min(2), 1e-5);
        let inputs = [if outputs > 1 { faint } else { weight }];
        let fast = value_and_gradients(&inputs, |t| ops::filters::normalised_filters(t[0].clone(), 1.5));
        let plain = value_and_gradients(&inputs, |t| ops::filters::reference(t[0].clone(), 1.5));
        assert_equal(&format!("filters of {:?}", inputs[0].dims()), &fast, &plain);
    }
}

#[test]
fn cost_volume_equals_its_reference() {
    for (n, c, h, w, radius) in
        [(1, 1, 1, 1, 4), (2, 5, 7, 9, 4), (1, 18, 6, 19, 2), (2, 3, 12, 8, 1), (1, 9, 5, 17, 3), (2, 2, 3, 6, 5)]
    {
        let inputs = [wave([n, c, h, w], 0.0), wave([n, c, h, w], 1.0)];
        let fast = value_and_gradients(&inputs, |t| ops::cost_volume::cost_volume(t[0].clone(), t[1].clone(), radius));
        let plain = value_and_gradients(&inputs, |t| ops::cost_volume::reference(t[0].clone(), t[1].clone(), radius));
        assert_equal(&format!("cost volume {n}×{c}×{h}×{w} radius {radius}"), &fast, &plain);
    }
    let inputs = [wave([2, 12, 7, 5], 0.0), wave([2, 12, 7, 5], 1.0)];
    let turned = |t: &Tensor<4>| t.clone().permute([0, 3, 1, 2]);
    let fast = value_and_gradients(&inputs, |t| ops::cost_volume::cost_volume(turned(&t[0]), turned(&t[1]), 4));
    let plain = value_and_gradients(&inputs, |t| ops::cost_volume::reference(turned(&t[0]), turned(&t[1]), 4));
    assert_equal("permuted cost volume", &fast, &plain);
}

#[test]
fn warp_equals_its_reference() {
    for (n, c, h, w) in [(1, 1, 2, 2), (2, 5, 7, 9), (1, 3, 12, 31)] {
        let inputs = [wave([n, c, h, w], 0.0), wave([n, 2, h, w], 1.0).mul_scalar(3.0)];
        let fast = value_and_gradients(&inputs, |t| ops::warp::warp(t[0].clone(), t[1].clone()).values);
        let plain = value_and_gradients(&inputs, |t| ops::warp::reference_warp(t[0].clone(), t[1].clone()).values);
        assert_equal(&format!("warp {n}×{c}×{h}×{w}"), &fast, &plain);
        let valid = |w: ops::warp::Warped| values(w.valid);
        let (a, b) = (inputs[0].clone(), inputs[1].clone());
        assert_eq!(valid(ops::warp::warp(a.clone(), b.clone())), valid(ops::warp::reference_warp(a, b)));
    }
}

#[test]
fn masked_maximum_equals_its_reference_and_ignores_what_is_outside() {
    for (k, c, h, w) in [(1, 1, 1, 1), (1, 1, 2, 3), (3, 4, 7, 9), (5, 2, 20, 16), (2, 19, 70, 11)] {
        let inputs = [wave([1, c, h, w], 0.5), wave([k, c, h, w], 0.0)];
        let flow = wave([k, 2, h, w], 1.0).mul_scalar(4.0);
        let fast = value_and_gradients(&inputs, |t| ops::warp::warp_max(t[0].clone(), t[1].clone(), flow.clone()));
        let plain = value_and_gradients(&inputs, |t| ops::warp::reference_warp_max(t[0].clone(), t[1].clone(), flow.clone()));
        assert_equal(&format!("warp_max {k}×{c}×{h}×{w}"), &fast, &plain);
        let away = Tensor::full([k, 2, h, w], 1e4, &device());
        assert_eq!(values(ops::warp::warp_max(inputs[0].clone(), inputs[1].clone(), away)), values(inputs[0].clone()));
    }
}

#[test]
fn the_number_of_threads_changes_no_bit() {
    let flow = wave([3, 2, 40, 37], 1.0).mul_scalar(4.0);
    let all = || {
        let features = [wave([1, 21, 40, 37], 0.5), wave([3, 21, 40, 37], 0.0)];
        let maximum = value_and_gradients(&features, |t| ops::warp::warp_max(t[0].clone(), t[1].clone(), flow.clone()));
        let maps = [wave([2, 21, 20, 37], 0.0), wave([2, 21, 20, 37], 1.0)];
        let costs = value_and_gradients(&maps, |t| ops::cost_volume::cost_volume(t[0].clone(), t[1].clone(), 4));
        let images = [wave([1, 21, 40, 37], 0.0), wave([23, 21, 3, 3], 1.0)];
        let convolved = [1, 3].map(|dilation| {
            let geometry = Conv3x3 { dilation, ..Conv3x3::same(Padding::Zero) };
            value_and_gradients(&images, |t| ops::conv::conv3x3(t[0].clone(), t[1].clone(), geometry))
        });
        let [one, three] = convolved;
        [maximum, costs, one, three]
    };
    let with = |threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads start").install(all);
    assert!(with(1) == with(3));
}

#[test]
fn gradients_agree_with_central_differences() {
    let x: Vec<f32> = (0..2 * 3 * 4).map(|i| (i as f32 * 0.7).sin()).collect();
    let worst = ops::gradcheck::largest_relative_error(&x, [1, 2, 3, 4], 1e-2, |x: Tensor<4>| {
        let weight = wave([3, 2, 3, 3], 0.3);
        ops::conv::conv3x3(x, weight, Conv3x3::halving(Padding::Edge)).powi_scalar(2).sum().reshape([1])
    });
    assert!(worst < 1e-2, "{worst}");
    let nan = Tensor::<4>::full([1, 2, 2, 2], f32::NAN, &device());
    assert_eq!(values(ops::warp::warp(wave([1, 1, 2, 2], 0.0), nan).valid), vec![0.0; 4]);
}
