//! CPU kernels behind the one extension of burn's back ends.
//!
//! Each kernel stands beside a composed reference (`reference*` in [`crate::conv`], [`crate::filters`],
//! [`crate::activation`], [`crate::cost_volume`], [`crate::warp`]), which every other device uses and which the tests compare it with. Results
//! don't depend on the number of threads: every output is summed by one task in one order.

mod autodiff;
mod bands;
mod columns;
pub mod conv;
mod correlate;
pub mod correlation;
mod enlarging;
pub mod peak;
mod phases;
pub mod pointwise;
mod rows;
pub mod sampling;
mod tile;
mod transposed;
pub mod vectorise;
mod weight_gradient;
mod winograd;

use std::cell::Cell;

use burn::backend::{
    Backend, Flex, backend_extension,
    tensor::{FloatTensor, IntTensor},
};
use burn::tensor::{Bytes, DType, Device, Shape, Tensor};
use burn_flex::{FlexTensor, Layout};

use crate::conv::Conv3x3;
use crate::filters::EPSILON;
use crate::setting::within;

/// The functions a back end must bring to run the fast route. The `*_backward` functions are used by autodiff only.
#[backend_extension(Autodiff, Flex)]
pub trait NetKernels: Backend {
    /// See [`crate::conv::conv3x3`].
    fn conv3x3(x: FloatTensor<Self>, w: FloatTensor<Self>, geometry: Conv3x3) -> FloatTensor<Self>;
    /// Gradient of the input of [`Self::conv3x3`], whose input has `size` rows and columns.
    fn conv3x3_backward_input(
        gradient: FloatTensor<Self>,
        w: FloatTensor<Self>,
        size: [usize; 2],
        geometry: Conv3x3,
    ) -> FloatTensor<Self>;
    /// Gradient of the weights of [`Self::conv3x3`].
    fn conv3x3_backward_weight(x: FloatTensor<Self>, gradient: FloatTensor<Self>, geometry: Conv3x3) -> FloatTensor<Self>;
    /// See [`crate::activation::bias_leaky_relu`].
    fn bias_leaky_relu(x: FloatTensor<Self>, bias: FloatTensor<Self>, slope: f32) -> FloatTensor<Self>;
    /// Gradients of input and bias of [`Self::bias_leaky_relu`]; the bias has `rows` rows.
    fn bias_leaky_relu_backward(
        output: FloatTensor<Self>,
        gradient: FloatTensor<Self>,
        rows: usize,
        slope: f32,
    ) -> (FloatTensor<Self>, FloatTensor<Self>);
    /// See [`crate::filters::normalised_filters`].
    fn normalised_filters(w: FloatTensor<Self>, gain: f32) -> FloatTensor<Self>;
    /// Gradient of the weights of [`Self::normalised_filters`].
    fn normalised_filters_backward(w: FloatTensor<Self>, gradient: FloatTensor<Self>, gain: f32) -> FloatTensor<Self>;
    /// See [`crate::cost_volume::cost_volume`].
    fn cost_volume(a: FloatTensor<Self>, b: FloatTensor<Self>, radius: usize) -> FloatTensor<Self>;
    /// Gradients of both inputs of [`Self::cost_volume`].
    fn cost_volume_backward(
        a: FloatTensor<Self>,
        b: FloatTensor<Self>,
        gradient: FloatTensor<Self>,
        radius: usize,
    ) -> (FloatTensor<Self>, FloatTensor<Self>);
    /// Values of [`crate::warp::warp`].
    fn warp(x: FloatTensor<Self>, flow: FloatTensor<Self>) -> FloatTensor<Self>;
    /// Validity of [`crate::warp::warp`].
    fn warp_valid(flow: FloatTensor<Self>) -> FloatTensor<Self>;
    /// Gradients of features and flow of [`Self::warp`].
    fn warp_backward(
        x: FloatTensor<Self>,
        flow: FloatTensor<Self>,
        gradient: FloatTensor<Self>,
    ) -> (FloatTensor<Self>, FloatTensor<Self>);
    /// See [`crate::warp::warp_max`]; with it which frame holds the maximum, for [`Self::warp_max_backward`].
    fn warp_max(
        guidance: FloatTensor<Self>,
        features: FloatTensor<Self>,
        flow: FloatTensor<Self>,
    ) -> (FloatTensor<Self>, IntTensor<Self>);
    /// Gradients of guidance and features of [`Self::warp_max`].
    fn warp_max_backward(
        winners: IntTensor<Self>,
        flow: FloatTensor<Self>,
        gradient: FloatTensor<Self>,
    ) -> (FloatTensor<Self>, FloatTensor<Self>);
}

/// Whether a tensor's device runs these kernels.
pub fn available<const D: usize>(tensor: &Tensor<D>) -> bool {
    tensor.device() == Device::flex() && tensor.dtype() == DType::F32 && !REFERENCES_ONLY.get()
}

thread_local! {
    static REFERENCES_ONLY: Cell<bool> = const { Cell::new(false) };
}

/// Runs `f` by the composed references alone, as devices without these kernels do: whole nets are compared so.
pub fn without<T>(f: impl FnOnce() -> T) -> T {
    within(&REFERENCES_ONLY, true, f)
}

fn dims(t: &FlexTensor) -> [usize; 4] {
    let s = t.layout().shape();
    [s[0], s[1], s[2], s[3]]
}

/// A contiguous view of a tensor's values; copies only what isn't contiguous already.
struct Values {
    tensor: FlexTensor,
    start: usize,
    count: usize,
}

impl Values {
    fn new(t: FlexTensor) -> Self {
        let tensor = t.to_contiguous();
        let (start, count) = (tensor.layout().start_offset(), tensor.layout().num_elements());
        Self { tensor, start, count }
    }
    fn get(&self) -> &[f32] {
        &self.tensor.storage::<f32>()[self.start..self.start + self.count]
    }
}

fn tensor<const D: usize>(values: Vec<f32>, shape: [usize; D]) -> FlexTensor {
    FlexTensor::new(Bytes::from_elems(values), Layout::contiguous(Shape::new(shape)), DType::F32)
}

impl NetKernels for Flex {
    fn conv3x3(x: FlexTensor, w: FlexTensor, geometry: Conv3x3) -> FlexTensor {
        let ([n, inputs, h, width], outputs) = (dims(&x), dims(&w)[0]);
        let s = conv::Sizes { n, inputs, outputs, h, w: width, geometry };
        let out = conv::forward(Values::new(x).get(), Values::new(w).get(), &s);
        tensor(out, [n, outputs, geometry.output(h), geometry.output(width)])
    }

    fn conv3x3_backward_input(gradient: FlexTensor, w: FlexTensor, size: [usize; 2], geometry: Conv3x3) -> FlexTensor {
        let ([n, outputs, _, _], inputs) = (dims(&gradient), dims(&w)[1]);
        let s = conv::Sizes { n, inputs, outputs, h: size[0], w: size[1], geometry };
        let out = conv::backward_input(Values::new(gradient).get(), Values::new(w).get(), &s);
        tensor(out, [n, inputs, size[0], size[1]])
    }

    fn conv3x3_backward_weight(x: FlexTensor, gradient: FlexTensor, geometry: Conv3x3) -> FlexTensor {
        let ([n, inputs, h, width], outputs) = (dims(&x), dims(&gradient)[1]);
        let s = conv::Sizes { n, inputs, outputs, h, w: width, geometry };
        let out = conv::backward_weight(Values::new(x).get(), Values::new(gradient).get(), &s);
        tensor(out, [outputs, inputs, 3, 3])
    }

    fn bias_leaky_relu(x: FlexTensor, bias: FlexTensor, slope: f32) -> FlexTensor {
        let [n, c, h, w] = dims(&x);
        tensor(pointwise::bias_leaky(Values::new(x).get(), Values::new(bias).get(), h * w, slope), [n, c, h, w])
    }

    fn bias_leaky_relu_backward(output: FlexTensor, gradient: FlexTensor, rows: usize, slope: f32) -> (FlexTensor, FlexTensor) {
        let [n, c, h, w] = dims(&gradient);
        let gx = pointwise::leaky_backward(Values::new(output).get(), Values::new(gradient).get(), slope);
        let mut sums = pointwise::plane_sums(&gx, h * w);
        if rows == 1 {
            sums = (0..c).map(|c_| (0..n).map(|i| sums[i * c + c_]).sum()).collect();
        }
        (tensor(gx, [n, c, h, w]), tensor(sums, [rows, c]))
    }

    fn normalised_filters(w: FlexTensor, gain: f32) -> FlexTensor {
        let shape = dims(&w);
        let length = shape[1..].iter().product();
        tensor(pointwise::normalised(Values::new(w).get(), length, gain, EPSILON), shape)
    }

    fn normalised_filters_backward(w: FlexTensor, gradient: FlexTensor, gain: f32) -> FlexTensor {
        let shape = dims(&w);
        let length = shape[1..].iter().product();
        let (w, gradient) = (Values::new(w), Values::new(gradient));
        tensor(pointwise::normalised_backward(w.get(), gradient.get(), length, gain, EPSILON), shape)
    }

    fn cost_volume(a: FlexTensor, b: FlexTensor, radius: usize) -> FlexTensor {
        let [n, c, h, w] = dims(&a);
        let out = correlation::forward(Values::new(a).get(), Values::new(b).get(), &correlation::Sizes { n, c, h, w, radius });
        tensor(out, [n, (2 * radius + 1) * (2 * radius + 1), h, w])
    }

    fn cost_volume_backward(a: FlexTensor, b: FlexTensor, gradient: FlexTensor, radius: usize) -> (FlexTensor, FlexTensor) {
        let [n, c, h, w] = dims(&a);
        let s = correlation::Sizes { n, c, h, w, radius };
        let (ga, gb) = correlation::backward(Values::new(a).get(), Values::new(b).get(), Values::new(gradient).get(), &s);
        (tensor(ga, [n, c, h, w]), tensor(gb, [n, c, h, w]))
    }

    fn warp(x: FlexTensor, flow: FlexTensor) -> FlexTensor {
        let [n, c, h, w] = dims(&x);
        tensor(sampling::warp(Values::new(x).get(), Values::new(flow).get(), &sampling::Sizes { n, c, h, w }), [n, c, h, w])
    }

    fn warp_valid(flow: FlexTensor) -> FlexTensor {
        let [n, _, h, w] = dims(&flow);
        tensor(sampling::valid(Values::new(flow).get(), &sampling::Sizes { n, c: 1, h, w }), [n, 1, h, w])
    }

    fn warp_backward(x: FlexTensor, flow: FlexTensor, gradient: FlexTensor) -> (FlexTensor, FlexTensor) {
        let [n, c, h, w] = dims(&x);
        let s = sampling::Sizes { n, c, h, w };
        let (gx, gflow) =
            sampling::warp_backward(Values::new(x).get(), Values::new(flow).get(), Values::new(gradient).get(), &s);
        (tensor(gx, [n, c, h, w]), tensor(gflow, [n, 2, h, w]))
    }

    fn warp_max(guidance: FlexTensor, features: FlexTensor, flow: FlexTensor) -> (FlexTensor, FlexTensor) {
        let [n, c, h, w] = dims(&features);
        let s = sampling::Sizes { n, c, h, w };
        let (out, winners) =
            sampling::warp_max(Values::new(guidance).get(), Values::new(features).get(), Values::new(flow).get(), &s);
        let winners = FlexTensor::new(Bytes::from_elems(winners), Layout::contiguous(Shape::new([c, h, w])), DType::U16);
        (tensor(out, [1, c, h, w]), winners)
    }

    fn warp_max_backward(winners: FlexTensor, flow: FlexTensor, gradient: FlexTensor) -> (FlexTensor, FlexTensor) {
        let ([n, ..], [_, c, h, w]) = (dims(&flow), dims(&gradient));
        let s = sampling::Sizes { n, c, h, w };
        let (gg, gx) = sampling::warp_max_backward(winners.storage(), Values::new(flow).get(), Values::new(gradient).get(), &s);
        (tensor(gg, [1, c, h, w]), tensor(gx, [n, c, h, w]))
    }
}
