//! Many frames, one set of features: warping into the guidance frame and pooling what is valid (paper §6).

use burn::tensor::{Device, Int, Tensor};
use ops::planes::Planes;
use ops::warp::{warp, warp_max};
use render::svbrdf::SvbrdfImage;

use super::pooling::{Both, Moments, Observed, Pooled, Pooling, State, WeightedMean, as_maps};
use super::{Features, Fusion, SvbrdfNet};

/// One frame of a scan with the way from the guidance frame into it.
#[derive(Clone, Debug)]
pub struct KeyFrame {
    /// Gamma-encoded RGB in [0, 1].
    pub frame: Planes,
    /// Backward flow, 2 planes of the guidance frame's size; NaN marks invalid pixels.
    pub flow: Planes,
    /// Pixels whose flow counts, one plane in [0, 1] (see [`Warps::new`]). All of them when absent.
    pub valid: Option<Planes>,
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

/// The ways from the guidance frame into key frames, and how sure they are.
#[derive(Clone, Debug)]
pub struct Warps {
    /// `[K, 2, H, W]`, backward; NaN where a frame takes no part.
    pub(super) flow: Tensor<4>,
    /// `[K, 1, H, W]`
    valid: Option<Tensor<4>>,
}

impl Warps {
    /// Leaves out the pixels that `pooling` can't use: those of a `valid` below ½, and with attention, which weighs the doubtful
    /// ones by their confidence, those of 0.
    ///
    /// # Shapes
    /// `flow [K, 2, H, W]` backward, NaN where invalid; `valid [K, 1, H, W]` in [0, 1], 1 everywhere when absent.
    pub fn new(flow: Tensor<4>, valid: Option<Tensor<4>>, pooling: Pooling) -> Self {
        let shape = flow.dims();
        let flow = match &valid {
            Some(valid) => flow.mask_fill(valid.clone().expand(shape).lower_elem(pooling.least_confidence()), f32::NAN),
            None => flow,
        };
        Self { flow, valid }
    }

    /// How sure the alignment is where a pixel is seen, else 0.
    ///
    /// # Shapes
    /// `[K, 1, H, W]`
    fn confidence(&self) -> Tensor<4> {
        let inside = inside(self.flow.clone());
        match &self.valid {
            Some(valid) => inside * valid.clone(),
            None => inside,
        }
    }

    /// 1 for every frame with at least one valid pixel.
    ///
    /// # Shapes
    /// `[K, 1]`
    fn seen(&self) -> Tensor<2> {
        let [k, _, h, w] = self.flow.dims();
        inside(self.flow.clone()).reshape([k, h * w]).max_dim(1)
    }
}

impl SvbrdfNet {
    /// Starts a pooling with the guidance frame.
    ///
    /// # Shapes
    /// `guidance`: features of one frame.
    pub fn begin(&self, guidance: Features) -> Pooled {
        Pooled(match self.config().pooling {
            Pooling::Max => State::Maximum(guidance),
            Pooling::Mean | Pooling::Attention => {
                let frames = Both::from(guidance);
                let scores = self.scores(&frames);
                State::Weighted(frames.zip(scores).map(|(frame, score)| WeightedMean::new(frame, score)))
            }
            Pooling::MaxMeanVariance => {
                State::Moments { maximum: guidance.clone(), moments: Both::from(guidance).map(Moments::new) }
            }
        })
    }

    /// Merges key frames into what was pooled so far.
    ///
    /// Where features are warped, a frame without a single valid pixel changes nothing, its global vector included.
    ///
    /// # Shapes
    /// `key`: features of K frames; `warps` of as many.
    pub fn pool(&self, pooled: Pooled, key: Features, warps: &Warps) -> Pooled {
        let [k, _] = key.global.dims();
        if k == 0 {
            return pooled;
        }
        Pooled(match pooled.0 {
            State::Maximum(maximum) => State::Maximum(self.maximum(maximum, key, warps)),
            State::Weighted(means) => {
                let frames = self.observed(key, warps);
                let scores = self.scores(&frames);
                let merge = |(mean, (frames, score)): (WeightedMean, _)| mean.add(frames, score);
                State::Weighted(means.zip(frames.zip(scores)).map(merge))
            }
            State::Moments { maximum, moments } => {
                let frames = self.observed(key.clone(), warps);
                State::Moments {
                    maximum: self.maximum(maximum, key, warps),
                    moments: moments.zip(frames).map(|(moments, frames)| moments.add(frames)),
                }
            }
        })
    }

    /// Scores by which frames are weighted: equal ones without attention.
    fn scores(&self, frames: &Both<Observed>) -> Both<Tensor<4>> {
        match &self.attention {
            Some(attention) => attention.scores(frames),
            None => Both { maps: frames.maps.part.zeros_like(), global: frames.global.part.zeros_like() },
        }
    }

    /// The maximum of the features so far and those of K more frames.
    fn maximum(&self, pooled: Features, key: Features, warps: &Warps) -> Features {
        match self.config().fusion {
            Fusion::Features => Features {
                maps: warp_max(pooled.maps, key.maps, warps.flow.clone()),
                global: maximum_of_seen(pooled.global, key.global, warps.seen()),
            },
            Fusion::Frames => Features {
                maps: maximum(pooled.maps, key.maps),
                global: maximum_of_seen(pooled.global, key.global, warps.seen()),
            },
            Fusion::None => {
                Features { maps: maximum(pooled.maps, key.maps), global: pooled.global.max_pair(key.global.max_dim(0)) }
            }
        }
    }

    /// Key frames in the guidance frame's pixels.
    fn observed(&self, key: Features, warps: &Warps) -> Both<Observed> {
        let fusion = self.config().fusion;
        if fusion == Fusion::None {
            return key.into();
        }
        let [k, _, h, w] = key.maps.dims();
        let confidence = warps.confidence();
        let global = Observed {
            values: as_maps(key.global),
            part: as_maps(warps.seen()),
            confidence: as_maps(confidence.clone().reshape([k, h * w]).mean_dim(1)),
        };
        let maps = if fusion == Fusion::Features {
            let warped = warp(key.maps, warps.flow.clone());
            Observed { values: warped.values, part: warped.valid, confidence }
        } else {
            Observed { confidence, ..Observed::whole(key.maps) }
        };
        Both { maps, global }
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
        let mut pooled = self.begin(self.features(self.frame_inputs(guidance.to_tensor(device), identity)));
        for (index, key) in key_frames.into_iter().enumerate() {
            check(&key, guidance, index)?;
            let valid = key.valid.map(|m| m.to_tensor(device));
            let warps = Warps::new(key.flow.to_tensor(device), valid, self.config().pooling);
            let features = self.features(self.frame_inputs(key.frame.to_tensor(device), warps.flow.clone()));
            pooled = self.pool(pooled, features, &warps);
        }
        let maps = self.decode(pooled).maps;
        Ok(maps.to_images().into_iter().next().expect("one batch entry was decoded"))
    }
}

fn check(key: &KeyFrame, guidance: &Planes, index: usize) -> Result<(), FusionError> {
    let (h, w) = (guidance.height, guidance.width);
    let size = |c: usize, h: usize, w: usize| format!("{c}×{h}×{w}");
    let mask = key.valid.iter().map(|mask| ("mask", mask, 1));
    for (what, p, channels) in [("frame", &key.frame, guidance.channels), ("flow", &key.flow, 2)].into_iter().chain(mask) {
        if (p.channels, p.height, p.width) != (channels, h, w) {
            let (found, expected) = (size(p.channels, p.height, p.width), size(channels, h, w));
            return Err(FusionError::Size { what, index, found, expected });
        }
    }
    Ok(())
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
