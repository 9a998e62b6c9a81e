//! The kernels read what isn't contiguous, and images of one pixel, row or column: values and gradients as of the references.

#[allow(dead_code, reason = "shared with `kernels`")]
mod comparison;

use burn::tensor::Tensor;
use comparison::{assert_equal, assert_near, device, value_and_gradients, value_and_weighted_gradients, wave};
use ops::conv::{Conv3x3, Padding};
use ops::planes::values;

/// How the values of `[N, C, H, W]` may lie in memory.
#[derive(Clone, Copy, Debug)]
enum Layout {
    /// Channels innermost.
    ChannelsLast,
    /// Rows and columns exchanged.
    Transposed,
    /// A part of a larger image: an offset, and gaps between rows.
    Part,
    /// Backwards along rows and columns.
    Flipped,
    /// One image for all of the batch.
    Repeated,
}

const LAYOUTS: [Layout; 5] = [Layout::ChannelsLast, Layout::Transposed, Layout::Part, Layout::Flipped, Layout::Repeated];

impl Layout {
    /// The shape of the contiguous tensor that [`Self::view`] makes `shape` of.
    fn stored(self, [n, c, h, w]: [usize; 4]) -> [usize; 4] {
        match self {
            Self::ChannelsLast => [n, h, w, c],
            Self::Transposed => [n, c, w, h],
            Self::Part => [n + 1, c + 2, h + 3, w + 2],
            Self::Flipped => [n, c, h, w],
            Self::Repeated => [1, c, h, w],
        }
    }

    fn view(self, stored: Tensor<4>, [n, c, h, w]: [usize; 4]) -> Tensor<4> {
        match self {
            Self::ChannelsLast => stored.permute([0, 3, 1, 2]),
            Self::Transposed => stored.swap_dims(2, 3),
            Self::Part => stored.slice([1..n + 1, 1..c + 1, 2..h + 2, 1..w + 1]),
            Self::Flipped => stored.flip([2, 3]),
            Self::Repeated => stored.expand([n, c, h, w]),
        }
    }
}

/// Compares two routes with inputs of every layout, and with gradients that arrive channels last and, for a plain sum, as one
/// value for all.
fn check(
    name: &str,
    shapes: &[[usize; 4]],
    fast: impl Fn(&[Tensor<4>]) -> Tensor<4>,
    plain: impl Fn(&[Tensor<4>]) -> Tensor<4>,
) {
    for layout in LAYOUTS {
        let stored: Vec<_> = shapes.iter().enumerate().map(|(i, s)| wave(layout.stored(*s), i as f32)).collect();
        let seen = |t: &[Tensor<4>]| -> Vec<Tensor<4>> {
            t.iter().zip(shapes).map(|(t, shape)| layout.view(t.clone(), *shape)).collect()
        };
        let turned = |t: Tensor<4>| t.permute([0, 2, 3, 1]);
        // Hundreds of terms cancel in some of the sums; a misread layout is off by the values themselves.
        let found = value_and_gradients(&stored, |t| turned(fast(&seen(t))));
        let expected = value_and_gradients(&stored, |t| turned(plain(&seen(t))));
        assert!(expected.iter().all(|part| part.iter().any(|v| *v != 0.0)), "{name}: a part of the comparison is empty");
        assert_near(&format!("{name}, {layout:?}"), &found, &expected, 2e-4);
        let sum = |out: Tensor<4>| out.sum().reshape([1, 1, 1, 1]);
        let found = value_and_gradients(&stored, |t| sum(fast(&seen(t))));
        let expected = value_and_gradients(&stored, |t| sum(plain(&seen(t))));
        assert_near(&format!("sum of {name}, {layout:?}"), &found[1..], &expected[1..], 2e-4);
    }
}

#[test]
fn convolutions_take_any_layout() {
    for padding in [Padding::Edge, Padding::Zero] {
        let same = Conv3x3::same(padding);
        for geometry in [same, Conv3x3::halving(padding), Conv3x3 { dilation: 2, ..same }, Conv3x3::enlarging(padding)] {
            for shapes in [[[2, 3, 19, 7], [5, 3, 3, 3]], [[2, 21, 17, 34], [18, 21, 3, 3]]] {
                check(
                    &format!("{geometry:?} of {shapes:?}"),
                    &shapes,
                    |t| ops::conv::conv3x3(t[0].clone(), t[1].clone(), geometry),
                    |t| ops::conv::reference(t[0].clone(), t[1].clone(), geometry),
                );
            }
        }
    }
}

#[test]
fn bias_and_leaky_relu_take_any_layout() {
    let bias = |t: &Tensor<4>, rows: usize| Some(t.clone().reshape([rows, 3]));
    for rows in [1, 2] {
        check(
            &format!("bias of {rows} rows"),
            &[[2, 3, 5, 7], [rows, 3, 1, 1]],
            |t| ops::activation::bias_leaky_relu(t[0].clone(), bias(&t[1], rows), 0.2),
            |t| ops::activation::reference(t[0].clone(), bias(&t[1], rows), 0.2),
        );
    }
}

#[test]
fn cost_volumes_take_any_layout() {
    for shape in [[2, 5, 7, 9], [2, 17, 6, 20]] {
        check(
            &format!("cost volume of {shape:?}"),
            &[shape, shape],
            |t| ops::cost_volume::cost_volume(t[0].clone(), t[1].clone(), 3),
            |t| ops::cost_volume::reference(t[0].clone(), t[1].clone(), 3),
        );
    }
}

#[test]
fn warps_take_any_layout() {
    let flow = |t: &Tensor<4>| t.clone().mul_scalar(2.0);
    check(
        "warp",
        &[[2, 5, 7, 9], [2, 2, 7, 9]],
        |t| ops::warp::warp(t[0].clone(), flow(&t[1])).values,
        |t| ops::warp::reference_warp(t[0].clone(), flow(&t[1])).values,
    );
    for layout in LAYOUTS {
        let shape = [2, 2, 7, 9];
        let [x, flow] = [wave([2, 1, 7, 9], 0.0), layout.view(wave(layout.stored(shape), 1.0), shape)];
        let found = values(ops::warp::warp(x.clone(), flow.clone()).valid);
        assert!(found.contains(&0.0) && found.contains(&1.0));
        assert_eq!(found, values(ops::warp::reference_warp(x, flow).valid), "{layout:?}");
    }
}

#[test]
fn the_masked_maximum_takes_any_layout() {
    for layout in LAYOUTS {
        let shape = [3, 2, 9, 8];
        let flow = layout.view(wave(layout.stored(shape), 2.0).mul_scalar(3.0), shape);
        check(
            &format!("warped maximum, flow {layout:?}"),
            &[[1, 4, 9, 8], [3, 4, 9, 8]],
            |t| ops::warp::warp_max(t[0].clone(), t[1].clone(), flow.clone()),
            |t| ops::warp::reference_warp_max(t[0].clone(), t[1].clone(), flow.clone()),
        );
    }
}

/// Flows that end on pixels, the image's border and its corners included, and just outside.
fn whole_flows([k, h, w]: [usize; 3]) -> Tensor<4> {
    let steps = wave([k, 2, h, w], 1.0).mul_scalar(1.6).round();
    // Every second column stays where it is.
    let moves = Tensor::<1>::from_floats((0..w).map(|x| (x % 2) as f32).collect::<Vec<_>>().as_slice(), &device());
    steps * moves.reshape([1, 1, 1, w])
}

#[test]
fn images_of_one_pixel_row_or_column_warp_like_the_references() {
    for (k, c, h, w) in [(1, 1, 1, 1), (3, 2, 1, 1), (2, 3, 1, 9), (2, 3, 8, 1), (2, 17, 5, 2)] {
        let flow = whole_flows([k, h, w]);
        let name = format!("{k}×{c}×{h}×{w}");
        let features = wave([k, c, h, w], 0.7);
        let inputs = [features.clone(), flow.clone()];
        let found = value_and_gradients(&inputs, |t| ops::warp::warp(t[0].clone(), t[1].clone()).values);
        let expected = value_and_gradients(&inputs, |t| ops::warp::reference_warp(t[0].clone(), t[1].clone()).values);
        assert!(expected[0].iter().any(|v| *v != 0.0), "{name}: nothing is valid");
        assert_equal(&format!("warp {name}"), &found, &expected);
        let [fast, plain] =
            [ops::warp::warp, ops::warp::reference_warp].map(|f| values(f(features.clone(), flow.clone()).valid));
        assert_eq!(fast, plain, "{name}");
        let inputs = [wave([1, c, h, w], 0.5), wave([k, c, h, w], 0.0)];
        let found = value_and_gradients(&inputs, |t| ops::warp::warp_max(t[0].clone(), t[1].clone(), flow.clone()));
        let expected =
            value_and_gradients(&inputs, |t| ops::warp::reference_warp_max(t[0].clone(), t[1].clone(), flow.clone()));
        assert_equal(&format!("warped maximum {name}"), &found, &expected);
    }
}

#[test]
fn on_whole_pixels_the_flow_has_the_gradient_of_the_right_and_lower_side() {
    // Sides of x² + 10 y² have different slopes, whole numbers all of them.
    let slope = |at: usize, length: usize| match length {
        1 => 0.0,
        _ => 2.0 * at as f32 + if at + 1 < length { 1.0 } else { -1.0 },
    };
    for (h, w) in [(5, 7), (23, 50), (1, 9), (8, 1)] {
        let pixels = |f: &dyn Fn(usize, usize) -> f32| {
            let all: Vec<f32> = (0..h * w).map(|i| f(i % w, i / w)).collect();
            Tensor::<1>::from_floats(all.as_slice(), &device()).reshape([1, 1, h, w])
        };
        // To every pixel, in another order.
        let (to_x, to_y) = (|x: usize| (x * 3 + 1) % w, |y: usize| (y * 3 + 2) % h);
        let steps = [pixels(&|x, _| to_x(x) as f32 - x as f32), pixels(&|_, y| to_y(y) as f32 - y as f32)];
        let inputs = [pixels(&|x, y| (x * x + 10 * y * y) as f32), Tensor::cat(steps.to_vec(), 1)];
        let slopes_x = (0..h * w).map(|i| slope(to_x(i % w), w));
        let slopes: Vec<f32> = slopes_x.chain((0..h * w).map(|i| 10.0 * slope(to_y(i / w), h))).collect();
        for route in [ops::warp::warp, ops::warp::reference_warp] {
            let sum = |t: &[Tensor<4>]| route(t[0].clone(), t[1].clone()).values;
            let found = value_and_weighted_gradients(&inputs, sum, |shape| Tensor::ones(shape, &device()));
            assert_eq!(found[2], slopes, "{h}×{w}");
        }
    }
}

#[test]
fn images_of_one_row_or_column_convolve_and_correlate_like_the_references() {
    for (n, c, h, w) in [(2, 3, 1, 1), (2, 3, 1, 9), (1, 18, 8, 1)] {
        let name = format!("{n}×{c}×{h}×{w}");
        let inputs = [wave([n, c, h, w], 0.0), wave([n, c, h, w], 1.0)];
        let found = value_and_gradients(&inputs, |t| ops::cost_volume::cost_volume(t[0].clone(), t[1].clone(), 4));
        let expected = value_and_gradients(&inputs, |t| ops::cost_volume::reference(t[0].clone(), t[1].clone(), 4));
        assert_equal(&format!("cost volume {name}"), &found, &expected);
        for padding in [Padding::Edge, Padding::Zero] {
            let same = Conv3x3::same(padding);
            for geometry in [same, Conv3x3::halving(padding), Conv3x3 { dilation: 4, ..same }, Conv3x3::enlarging(padding)] {
                let inputs = [wave([n, c, h, w], 0.0), wave([5, c, 3, 3], 1.0)];
                let found = value_and_gradients(&inputs, |t| ops::conv::conv3x3(t[0].clone(), t[1].clone(), geometry));
                let expected = value_and_gradients(&inputs, |t| ops::conv::reference(t[0].clone(), t[1].clone(), geometry));
                assert_equal(&format!("{geometry:?} of {name}"), &found, &expected);
            }
        }
    }
}
