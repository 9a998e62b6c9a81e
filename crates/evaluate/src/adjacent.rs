//! The `adjacent` net by itself: end-point error over zero-flow error, before and after the robust homography.

use flow::align::FlowEstimator;
use flow::align::planar::planar_flow;
use flow::metrics::EndPointErrors;
use ops::homography::Homography;
use ops::planes::Planes;
use serde::{Deserialize, Serialize};

/// Mean errors over the pairs of one material, in pixels of the net's input.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct AdjacentErrors {
    /// End-point error of the flow.
    pub epe: f64,
    /// End-point error of a flow of zero.
    pub zero_flow: f64,
    /// End-point error of the robust homography of the flow.
    pub homography: f64,
}

/// Errors over neighbouring frames; each pair is two frames and the exact homography from the first to the second.
///
/// `None` without a pair that overlaps. Where no homography can be fitted, the flow of zero counts in its place.
pub fn adjacent_errors(net: &dyn FlowEstimator, pairs: &[(&Planes, &Planes, Homography)]) -> Option<AdjacentErrors> {
    let (mut flow_errors, mut planar_errors) = (EndPointErrors::default(), EndPointErrors::default());
    let images: Vec<_> = pairs.iter().map(|(first, second, _)| (*first, *second)).collect();
    for (flow, (first, second, exact)) in net.flows(&images).iter().zip(pairs) {
        let (height, width) = (first.height, first.width);
        let target = exact.flow(height, width);
        let valid = exact.valid(height, width, second.height, second.width);
        flow_errors.add(flow, &target, &valid);
        let inside = flow_inside(flow, second);
        planar_errors.add(&planar_flow(flow, &inside), &target, &valid);
    }
    let (flow, planar) = (flow_errors.finish()?, planar_errors.finish()?);
    Some(AdjacentErrors { epe: flow.mean_px, zero_flow: flow.zero_flow_px, homography: planar.mean_px })
}

fn flow_inside(flow: &Planes, source: &Planes) -> ops::planes::Mask {
    ops::planes::Mask::from_fn(flow.height, flow.width, |y, x| {
        let (sx, sy) = (x as f32 + flow.at(0, y, x), y as f32 + flow.at(1, y, x));
        sx >= 0.0 && sy >= 0.0 && sx <= (source.width - 1) as f32 && sy <= (source.height - 1) as f32
    })
}
