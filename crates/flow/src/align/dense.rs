//! The paper's own chain, for comparison (§5): one key frame from the one before, regularised by a pose or not at all.

use ops::flow_field::warp_planes;
use ops::homography::Homography;

use super::FlowEstimator;
use super::compose::FlowField;
use super::config::{AlignConfig, Regularise};
use super::graph::Link;
use super::planar::{RobustFit, fit, pairs_of_flow};
use super::pose::fit_pose;
use super::result::{Alignment, DropReason, KeyFrame, KeyFrameStatus, Seconds, Warning};
use super::scan::{Scan, dropped, masked};
use super::size::{Size, resized};

/// Every this many pixels a flow vector enters a fit.
const STRIDE: usize = 4;

/// Composes the neighbours' flows from the last key frame on, regularises the warp and, with a `distant` net, superposes the
/// flow that remains against the guidance image; the next key frame starts from the result, regularised again. Nothing is
/// checked or replaced: that is what these rows show.
pub(super) fn align(scan: &Scan, flows: &[FlowField], distant: Option<&dyn FlowEstimator>, config: &AlignConfig) -> Alignment {
    let Size { height, width } = scan.step_size;
    let guidance = scan.images[0].resize_area(height, width);
    let (mut last, mut reached) = (FlowField::still(height, width), 0);
    let (mut key_frames, mut warnings) = (Vec::new(), Vec::new());
    for (i, &index) in scan.keys.iter().enumerate() {
        let composed = flows[reached..index].iter().fold(last, |whole, next| whole.then(next));
        let (mut warp, mut regular) = regularised(composed, config.regularise);
        if let Some(net) = distant.filter(|_| config.distant) {
            let frame = scan.images[i + 1].resize_area(height, width);
            let (warped, shared) = warp_planes(&frame, &warp.flow);
            let shared = shared.and(&warp.valid);
            let remaining = net.flow(&masked(&guidance, &shared), &masked(&warped, &shared));
            warp = FlowField { valid: shared, ..FlowField::inside(remaining, height, width) }.then(&warp);
        }
        key_frames.push(key_frame(scan, i + 1, index, &warp, config.seed));
        let (start, again) = regularised(warp, config.regularise);
        regular &= again;
        if !regular {
            warnings.push(Warning::NotRegularised { frame: index });
        }
        (last, reached) = (start, index);
    }
    warnings.extend(dropped(&key_frames));
    let link =
        |(i, k): (usize, &KeyFrame)| Link { target: 0, source: i + 1, homography: k.homography, error_px: k.residual_px };
    let links = key_frames.iter().enumerate().map(link).filter(|l| l.error_px.is_finite()).collect();
    Alignment { key_frames, warnings, links, guidance_filmed: scan.guidance_filmed(), seconds: Seconds::default() }
}

/// The warp of the camera pose that fits best, and whether there is one; where fewer than ten points are known, the warp as it is.
fn regularised(field: FlowField, how: Regularise) -> (FlowField, bool) {
    let size = Size::of(&field.flow);
    let pose = || fit_pose(&pairs_of_flow(&field.flow, &field.valid, STRIDE), size, size);
    match how {
        Regularise::Pnp => match pose() {
            Some(warp) => (FlowField::inside(warp.flow(size.height, size.width), size.height, size.width), true),
            None => (field, false),
        },
        Regularise::Homography | Regularise::None => (field, true),
    }
}

fn key_frame(scan: &Scan, node: usize, index: usize, field: &FlowField, seed: u64) -> KeyFrame {
    let pairs = pairs_of_flow(&field.flow, &field.valid, STRIDE);
    let fitted = fit(&pairs, &RobustFit { seed, ..RobustFit::default() });
    let homography = fitted.map_or(Homography::identity(), |f| f.homography);
    let residual_px =
        fitted.map_or(f64::INFINITY, |f| f.residual_px * scan.full[node].width as f64 / scan.step_size.width as f64);
    let valid_share = field.valid.share();
    KeyFrame {
        index,
        status: if valid_share > 0.0 { KeyFrameStatus::Aligned } else { KeyFrameStatus::Dropped(DropReason::NoOverlap) },
        homography: resized(&homography, (scan.step_size, scan.full[0]), (scan.step_size, scan.full[node])),
        residual_px,
        valid_share,
        zncc: 0.0,
        confidence: fitted.map_or(0.0, |f| f.inliers),
        dense: Some(field.clone()),
        frame_size: scan.full[node],
    }
}
