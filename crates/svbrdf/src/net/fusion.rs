//! Many frames, one set of features: warping into the guidance frame and the masked maximum (paper §6).

use burn::tensor::{Device, Int, Tensor};
use ops::planes::{Mask, Planes};
use ops::warp::{warp, warp_max};
use render::svbrdf::SvbrdfImage;

use super::{Features, Fusion, SvbrdfNet};

/// One frame of a scan with the way from the guidance frame into it.
#[derive(Clone, Debug)]
pub struct KeyFrame {
    /// Gamma-encoded RGB in [0, 1].
    pub frame: Planes,
    /// Backward flow, 2 planes of the guidance frame's size; NaN marks invalid pixels.
    pub flow: Planes,
    /// Pixels whose flow counts; all of them when absent.
    pub valid: Option<Mask>,
}

/// Frames that can't be fused.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
pub enum FusionError {
    /// A frame, flow or mask of the wrong size.
    #[error("{what} of key frame {index} is {found}, but the guidance frame is {expected}; resize all frames to one size")]
    Size {
        /// "frame", "flow" or "mask".
        what: &'static str,
        /// Position among the key frames.
        index: usize,
        /// Size found, channels × rows × columns.
        found: String,
        /// Size expected.
        expected: String,
    },
}

impl SvbrdfNet {
    /// Merges frames that share the guidance frame's pixels into running features.
    ///
    /// A frame without a single valid pixel changes nothing, its global vector included.
    ///
    /// # Shapes
    /// `guidance`: features of one frame (or what was pooled so far); `key`: features of K frames; `flow [K, 2, H, W]`, NaN where invalid.
    pub fn pool(&self, guidance: Features, key: Features, flow: Tensor<4>) -> Features {
        let [k, _] = key.global.dims();
        if k == 0 {
            return guidance;
        }
        match self.config().fusion {
            Fusion::Features => {
                let seen = seen_frames(flow.clone());
                Features {
                    maps: warp_max(guidance.maps, key.maps, flow),
                    global: maximum_of_seen(guidance.global, key.global, seen),
                }
            }
            Fusion::Frames => {
                let seen = seen_frames(flow);
                Features { maps: maximum(guidance.maps, key.maps), global: maximum_of_seen(guidance.global, key.global, seen) }
            }
            Fusion::None => {
                Features { maps: maximum(guidance.maps, key.maps), global: guidance.global.max_pair(key.global.max_dim(0)) }
            }
        }
    }

    /// Maps from a guidance frame and any number of key frames, one at a time: memory doesn't grow with their number.
    ///
    /// Equal to [`SvbrdfNet::forward`] on all of them at once.
    ///
    /// # Errors
    /// If a key frame's size differs from the guidance frame's.
    pub fn reconstruct(
        &self,
        guidance: &Planes,
        key_frames: impl IntoIterator<Item = KeyFrame>,
        device: &Device,
    ) -> Result<SvbrdfImage, FusionError> {
        let (h, w) = (guidance.height, guidance.width);
        let identity = Tensor::zeros([1, 2, h, w], device);
        let mut pooled = self.features(self.frame_inputs(guidance.to_tensor(device), identity));
        for (index, key) in key_frames.into_iter().enumerate() {
            check(&key, guidance, index)?;
            let valid = key.valid.map(|m| m.to_tensor(device));
            let flow = masked_flow(key.flow.to_tensor(device), valid);
            let features = self.features(self.frame_inputs(key.frame.to_tensor(device), flow.clone()));
            pooled = self.pool(pooled, features, flow);
        }
        let maps = self.decode(pooled).maps;
        Ok(maps.to_images().into_iter().next().expect("one batch entry was decoded"))
    }
}

fn check(key: &KeyFrame, guidance: &Planes, index: usize) -> Result<(), FusionError> {
    let (h, w) = (guidance.height, guidance.width);
    let size = |c: usize, h: usize, w: usize| format!("{c}×{h}×{w}");
    let wrong = |what, found: String, expected: String| Err(FusionError::Size { what, index, found, expected });
    let planes = [("frame", &key.frame, guidance.channels), ("flow", &key.flow, 2)];
    for (what, p, channels) in planes {
        if (p.channels, p.height, p.width) != (channels, h, w) {
            return wrong(what, size(p.channels, p.height, p.width), size(channels, h, w));
        }
    }
    match &key.valid {
        Some(m) if (m.height, m.width) != (h, w) => wrong("mask", size(1, m.height, m.width), size(1, h, w)),
        _ => Ok(()),
    }
}

/// The flow with NaN wherever the mask is 0.
///
/// # Shapes
/// `flow [K, 2, H, W]`, `valid [K, 1, H, W]`
pub fn masked_flow(flow: Tensor<4>, valid: Option<Tensor<4>>) -> Tensor<4> {
    let shape = flow.dims();
    match valid {
        Some(valid) => flow.mask_fill(valid.expand(shape).lower_elem(0.5), f32::NAN),
        None => flow,
    }
}

/// Which pixels of the target have all their bilinear taps inside the source.
///
/// # Shapes
/// `flow [K, 2, H, W]` → `[K, 1, H, W]` of 0 and 1
pub(super) fn inside(flow: Tensor<4>) -> Tensor<4> {
    let [k, _, h, w] = flow.dims();
    let device = flow.device();
    let ramp = |n: usize, shape: [usize; 4]| Tensor::<1, Int>::arange(0..n as i64, &device).float().reshape(shape);
    let part = |i: usize| flow.clone().slice([0..k, i..i + 1, 0..h, 0..w]);
    let within = |p: Tensor<4>, n: usize| p.clone().greater_equal_elem(0.0).bool_and(p.lower_equal_elem((n - 1) as f32));
    let x = within(part(0) + ramp(w, [1, 1, 1, w]), w);
    let y = within(part(1) + ramp(h, [1, 1, h, 1]), h);
    x.bool_and(y).float()
}

/// 1 for every frame with at least one valid pixel.
///
/// # Shapes
/// `[K, 2, H, W]` → `[K, 1]`
fn seen_frames(flow: Tensor<4>) -> Tensor<2> {
    let [k, _, h, w] = flow.dims();
    inside(flow).reshape([k, h * w]).max_dim(1)
}

/// Maximum over the batch, `[1, C, H, W]` and `[K, C, H, W]` → `[1, C, H, W]`.
fn maximum(guidance: Tensor<4>, key: Tensor<4>) -> Tensor<4> {
    let [k, c, h, w] = key.dims();
    (0..k).fold(guidance, |pooled, i| pooled.max_pair(key.clone().slice([i..i + 1, 0..c, 0..h, 0..w])))
}

/// `[1, G]`, `[K, G]`, `seen [K, 1]` → `[1, G]`: an unseen frame takes the guidance frame's vector.
fn maximum_of_seen(guidance: Tensor<2>, key: Tensor<2>, seen: Tensor<2>) -> Tensor<2> {
    let shape = key.dims();
    let unseen = seen.expand(shape).lower_elem(0.5);
    key.mask_where(unseen, guidance.clone().expand(shape)).max_dim(0).max_pair(guidance)
}

/// Frames warped into the guidance frame, invalid pixels −1, with their mask as a channel (the paper's ablation, Table 2).
///
/// # Shapes
/// `linear [K, 3, H, W]` in [−1, 1] → `[K, 4, H, W]`
pub(super) fn warped_frames(linear: Tensor<4>, flow: Tensor<4>) -> Tensor<4> {
    let warped = warp(linear, flow);
    let shape = warped.values.dims();
    // Invalid values are 0 after the warp.
    let values = warped.values + warped.valid.clone().expand(shape) - 1.0;
    Tensor::cat(vec![values, warped.valid], 1)
}
