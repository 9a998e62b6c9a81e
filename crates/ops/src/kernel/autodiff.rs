//! How gradients flow through the kernels.

use burn::backend::autodiff::{
    NodeId,
    checkpoint::{base::Checkpointer, strategy::CheckpointStrategy},
    grads::Gradients,
    ops::{Backward, Ops, OpsKind},
};
use burn::backend::{
    Autodiff, TensorMetadata,
    tensor::{FloatTensor, IntTensor},
};

use super::NetKernels;
use crate::conv::Conv3x3;

/// Gradient functions and masks are never differentiated: they run on the inner back end.
macro_rules! inner_only {
    () => {
        panic!("this kernel has no derivative: call it on the inner back end")
    };
}

impl<B: NetKernels, C: CheckpointStrategy> NetKernels for Autodiff<B, C> {
    fn conv3x3(x: FloatTensor<Self>, w: FloatTensor<Self>, geometry: Conv3x3) -> FloatTensor<Self> {
        #[derive(Debug)]
        struct Conv;
        impl<B: NetKernels> Backward<B, 2> for Conv {
            type State = (NodeId, NodeId, Conv3x3);
            fn backward(self, ops: Ops<Self::State, 2>, grads: &mut Gradients, saved: &mut Checkpointer) {
                let [node_x, node_w] = ops.parents;
                let gradient = grads.consume::<B>(&ops.node);
                let (x, w, geometry) = ops.state;
                let x: FloatTensor<B> = saved.retrieve_node_output(x);
                let w: FloatTensor<B> = saved.retrieve_node_output(w);
                if let Some(node) = node_x {
                    let size = [x.shape()[2], x.shape()[3]];
                    grads.register::<B>(node.id, B::conv3x3_backward_input(gradient.clone(), w, size, geometry));
                }
                if let Some(node) = node_w {
                    grads.register::<B>(node.id, B::conv3x3_backward_weight(x, gradient, geometry));
                }
            }
        }
        match Conv.prepare::<C>([x.node(), w.node()]).compute_bound().stateful() {
            OpsKind::Tracked(mut prep) => {
                let state = (prep.checkpoint(&x), prep.checkpoint(&w), geometry);
                prep.finish(state, B::conv3x3(x.into_primitive(), w.into_primitive(), geometry))
            }
            OpsKind::UnTracked(prep) => prep.finish(B::conv3x3(x.into_primitive(), w.into_primitive(), geometry)),
        }
    }

    fn conv3x3_backward_input(_: FloatTensor<Self>, _: FloatTensor<Self>, _: [usize; 2], _: Conv3x3) -> FloatTensor<Self> {
        inner_only!()
    }

    fn conv3x3_backward_weight(_: FloatTensor<Self>, _: FloatTensor<Self>, _: Conv3x3) -> FloatTensor<Self> {
        inner_only!()
    }

    fn bias_leaky_relu(x: FloatTensor<Self>, bias: FloatTensor<Self>, slope: f32) -> FloatTensor<Self> {
        #[derive(Debug)]
        struct BiasLeaky;
        impl<B: NetKernels> Backward<B, 2> for BiasLeaky {
            type State = (FloatTensor<B>, usize, f32);
            fn backward(self, ops: Ops<Self::State, 2>, grads: &mut Gradients, _: &mut Checkpointer) {
                let [node_x, node_bias] = ops.parents;
                let gradient = grads.consume::<B>(&ops.node);
                let (output, rows, slope) = ops.state;
                let (gx, gbias) = B::bias_leaky_relu_backward(output, gradient, rows, slope);
                if let Some(node) = node_x {
                    grads.register::<B>(node.id, gx);
                }
                if let Some(node) = node_bias {
                    grads.register::<B>(node.id, gbias);
                }
            }
        }
        let rows = bias.shape()[0];
        match BiasLeaky.prepare::<C>([x.node(), bias.node()]).compute_bound().stateful() {
            OpsKind::Tracked(prep) => {
                // The output alone tells the slope of every pixel, so the input needn't be kept.
                let output = B::bias_leaky_relu(x.into_primitive(), bias.into_primitive(), slope);
                prep.finish((output.clone(), rows, slope), output)
            }
            OpsKind::UnTracked(prep) => prep.finish(B::bias_leaky_relu(x.into_primitive(), bias.into_primitive(), slope)),
        }
    }

    fn bias_leaky_relu_backward(
        _: FloatTensor<Self>,
        _: FloatTensor<Self>,
        _: usize,
        _: f32,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        inner_only!()
    }

    fn normalised_filters(w: FloatTensor<Self>, gain: f32) -> FloatTensor<Self> {
        #[derive(Debug)]
        struct Normalised;
        impl<B: NetKernels> Backward<B, 1> for Normalised {
            type State = (NodeId, f32);
            fn backward(self, ops: Ops<Self::State, 1>, grads: &mut Gradients, saved: &mut Checkpointer) {
                let [node] = ops.parents;
                let gradient = grads.consume::<B>(&ops.node);
                let (w, gain) = ops.state;
                let w: FloatTensor<B> = saved.retrieve_node_output(w);
                if let Some(node) = node {
                    grads.register::<B>(node.id, B::normalised_filters_backward(w, gradient, gain));
                }
            }
        }
        match Normalised.prepare::<C>([w.node()]).compute_bound().stateful() {
            OpsKind::Tracked(mut prep) => {
                let state = (prep.checkpoint(&w), gain);
                prep.finish(state, B::normalised_filters(w.into_primitive(), gain))
            }
            OpsKind::UnTracked(prep) => prep.finish(B::normalised_filters(w.into_primitive(), gain)),
        }
    }

    fn normalised_filters_backward(_: FloatTensor<Self>, _: FloatTensor<Self>, _: f32) -> FloatTensor<Self> {
        inner_only!()
    }

    fn cost_volume(a: FloatTensor<Self>, b: FloatTensor<Self>, radius: usize) -> FloatTensor<Self> {
        #[derive(Debug)]
        struct CostVolume;
        impl<B: NetKernels> Backward<B, 2> for CostVolume {
            type State = (NodeId, NodeId, usize);
            fn backward(self, ops: Ops<Self::State, 2>, grads: &mut Gradients, saved: &mut Checkpointer) {
                let [node_a, node_b] = ops.parents;
                let gradient = grads.consume::<B>(&ops.node);
                let (a, b, radius) = ops.state;
                let a: FloatTensor<B> = saved.retrieve_node_output(a);
                let b: FloatTensor<B> = saved.retrieve_node_output(b);
                let (ga, gb) = B::cost_volume_backward(a, b, gradient, radius);
                if let Some(node) = node_a {
                    grads.register::<B>(node.id, ga);
                }
                if let Some(node) = node_b {
                    grads.register::<B>(node.id, gb);
                }
            }
        }
        match CostVolume.prepare::<C>([a.node(), b.node()]).compute_bound().stateful() {
            OpsKind::Tracked(mut prep) => {
                let state = (prep.checkpoint(&a), prep.checkpoint(&b), radius);
                prep.finish(state, B::cost_volume(a.into_primitive(), b.into_primitive(), radius))
            }
            OpsKind::UnTracked(prep) => prep.finish(B::cost_volume(a.into_primitive(), b.into_primitive(), radius)),
        }
    }

    fn cost_volume_backward(
        _: FloatTensor<Self>,
        _: FloatTensor<Self>,
        _: FloatTensor<Self>,
        _: usize,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        inner_only!()
    }

    fn warp(x: FloatTensor<Self>, flow: FloatTensor<Self>) -> FloatTensor<Self> {
        #[derive(Debug)]
        struct Warp;
        impl<B: NetKernels> Backward<B, 2> for Warp {
            type State = (NodeId, NodeId);
            fn backward(self, ops: Ops<Self::State, 2>, grads: &mut Gradients, saved: &mut Checkpointer) {
                let [node_x, node_flow] = ops.parents;
                let gradient = grads.consume::<B>(&ops.node);
                let x: FloatTensor<B> = saved.retrieve_node_output(ops.state.0);
                let flow: FloatTensor<B> = saved.retrieve_node_output(ops.state.1);
                let (gx, gflow) = B::warp_backward(x, flow, gradient);
                if let Some(node) = node_x {
                    grads.register::<B>(node.id, gx);
                }
                if let Some(node) = node_flow {
                    grads.register::<B>(node.id, gflow);
                }
            }
        }
        match Warp.prepare::<C>([x.node(), flow.node()]).compute_bound().stateful() {
            OpsKind::Tracked(mut prep) => {
                let state = (prep.checkpoint(&x), prep.checkpoint(&flow));
                prep.finish(state, B::warp(x.into_primitive(), flow.into_primitive()))
            }
            OpsKind::UnTracked(prep) => prep.finish(B::warp(x.into_primitive(), flow.into_primitive())),
        }
    }

    fn warp_valid(_: FloatTensor<Self>) -> FloatTensor<Self> {
        inner_only!()
    }

    fn warp_backward(
        _: FloatTensor<Self>,
        _: FloatTensor<Self>,
        _: FloatTensor<Self>,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        inner_only!()
    }

    fn warp_max(
        guidance: FloatTensor<Self>,
        features: FloatTensor<Self>,
        flow: FloatTensor<Self>,
    ) -> (FloatTensor<Self>, IntTensor<Self>) {
        #[derive(Debug)]
        struct WarpMax;
        impl<B: NetKernels> Backward<B, 2> for WarpMax {
            type State = (IntTensor<B>, FloatTensor<B>);
            fn backward(self, ops: Ops<Self::State, 2>, grads: &mut Gradients, _: &mut Checkpointer) {
                let [node_guidance, node_features] = ops.parents;
                let gradient = grads.consume::<B>(&ops.node);
                let (winners, flow) = ops.state;
                let (gg, gx) = B::warp_max_backward(winners, flow, gradient);
                if let Some(node) = node_guidance {
                    grads.register::<B>(node.id, gg);
                }
                if let Some(node) = node_features {
                    grads.register::<B>(node.id, gx);
                }
            }
        }
        let flow = flow.into_primitive();
        let prep = WarpMax.prepare::<C>([guidance.node(), features.node()]).compute_bound().stateful();
        let (maximum, winners) = B::warp_max(guidance.into_primitive(), features.into_primitive(), flow.clone());
        match prep {
            OpsKind::Tracked(prep) => (prep.finish((winners.clone(), flow), maximum), winners),
            OpsKind::UnTracked(prep) => (prep.finish(maximum), winners),
        }
    }

    fn warp_max_backward(
        _: IntTensor<Self>,
        _: FloatTensor<Self>,
        _: FloatTensor<Self>,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        inner_only!()
    }
}
