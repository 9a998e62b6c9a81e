//! Ground-truth flow of a batch, and its meaning at the nets' coarser levels.

use burn::tensor::{Device, Tensor, ops::PadMode};
use ops::{
    planes::{Mask, Planes},
    resample::area_downsample,
};

/// Pixels per unit of flow inside the nets.
///
/// # Source
/// Sun et al. 2018 (PWC-Net); spec 3.1.
pub const FLOW_UNIT_PX: f32 = 20.0;

/// True flow and where it is known.
#[derive(Clone, Debug)]
pub struct FlowTarget {
    flow: Tensor<4>,
    valid: Tensor<4>,
}

/// The target at one level of a net.
#[derive(Clone, Debug)]
pub(crate) struct LevelTarget {
    /// `[N, 2, h, w]` in units of 20 px of full resolution; 0 where unknown.
    pub(crate) flow: Tensor<4>,
    /// `[N, 1, h, w]`; 1 where known.
    pub(crate) valid: Tensor<4>,
}

impl FlowTarget {
    /// A target from tensors. What the flow says where it isn't valid doesn't matter, be it NaN.
    ///
    /// # Shapes
    /// `flow [N, 2, H, W]` in pixels, `valid [N, 1, H, W]` of 0 and 1.
    pub fn new(flow: Tensor<4>, valid: Tensor<4>) -> Self {
        let shape = flow.dims();
        let unknown = valid.clone().lower_elem(0.5).expand(shape);
        Self { flow: flow.mask_fill(unknown, 0.0), valid }
    }

    /// A batch of targets.
    ///
    /// # Panics
    /// If there is none or the sizes differ.
    pub fn batch(flows: &[&Planes], valid: &[&Mask], device: &Device) -> Self {
        let masks: Vec<Planes> = valid.iter().map(|mask| mask.to_planes()).collect();
        let masks: Vec<&Planes> = masks.iter().collect();
        Self::new(Planes::batch(flows, device), Planes::batch(&masks, device))
    }

    /// Mean over the known pixels of each block of `factor`² pixels; a block is known when more than half of it is.
    ///
    /// `height` and `width` are the level's; beyond the target's own size nothing is known.
    pub(crate) fn at_level(&self, factor: usize, height: usize, width: usize) -> LevelTarget {
        let [.., h, w] = self.flow.dims();
        let (bottom, right) = ((height * factor).saturating_sub(h), (width * factor).saturating_sub(w));
        let reduce = |t: Tensor<4>| area_downsample(t.pad((0, right, 0, bottom), PadMode::Constant(0.0)), factor);
        let share = reduce(self.valid.clone());
        let valid = share.clone().greater_elem(0.5).float();
        let flow = reduce(self.flow.clone()) * valid.clone() / (share.clamp_min(0.5) * FLOW_UNIT_PX);
        LevelTarget { flow, valid }
    }
}
