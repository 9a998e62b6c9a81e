//! The ablation without regularisation: flows composed as they are, all the way from the guidance image.

use ops::flow_field::warp_planes;
use ops::homography::Homography;

use super::FlowEstimator;
use super::compose::FlowField;
use super::config::AlignConfig;
use super::planar::{RobustFit, fit, pairs_of_flow};
use super::result::{Alignment, DropReason, KeyFrame, KeyFrameStatus};
use super::scan::{Scan, dropped, masked};
use super::size::{Size, resized};

/// Composes the neighbours' flows from the first frame on and, with a `distant` net, adds the flow that remains against the
/// guidance image. Nothing is checked or replaced: that is what this ablation shows.
pub(super) fn align(scan: &Scan, flows: &[FlowField], distant: Option<&dyn FlowEstimator>, config: &AlignConfig) -> Alignment {
    let Size { height, width } = scan.step_size;
    let guidance = scan.images[0].resize_area(height, width);
    let mut composed = FlowField::still(height, width);
    let mut key_frames = Vec::new();
    let mut reached = 0;
    for (i, &index) in scan.keys.iter().enumerate() {
        composed = flows[reached..index].iter().fold(composed, |whole, next| whole.then(next));
        reached = index;
        if let Some(net) = distant.filter(|_| config.distant) {
            let frame = scan.images[i + 1].resize_area(height, width);
            let (warped, shared) = warp_planes(&frame, &composed.flow);
            let shared = shared.and(&composed.valid);
            let remaining = net.flow(&masked(&guidance, &shared), &masked(&warped, &shared));
            composed = FlowField { valid: shared, ..FlowField::inside(remaining, height, width) }.then(&composed);
        }
        key_frames.push(key_frame(scan, i + 1, index, &composed, config.seed));
    }
    let warnings = dropped(&key_frames).collect();
    Alignment { key_frames, warnings }
}

fn key_frame(scan: &Scan, node: usize, index: usize, field: &FlowField, seed: u64) -> KeyFrame {
    let fitted = fit(&pairs_of_flow(&field.flow, &field.valid, 4), &RobustFit { seed, ..RobustFit::default() });
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
