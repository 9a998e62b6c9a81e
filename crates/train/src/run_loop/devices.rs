//! Data-parallel training: the batches of a step on several devices.
//!
//! A step averages the gradients of `optimisation.accumulate` batches. With several devices the batches take turns on them: each
//! device gets a copy of the net at the beginning of the step, and the gradients are added up on the first one in the order of the
//! batches. So a step gives what it gives on one device of that kind, and a run may go on with more or fewer of them.
//!
//! # Source
//! burn-train 0.22.1, `ExecutionStrategy::MultiDevice` with `OptimMainDevice` (`learner/supervised/strategies/multi/epoch.rs`),
//! on the same pieces of burn: `Module::fork`, and gradients moved to the main device. departs: there one thread per device sends
//! its gradients when it has them, and they are added in the order of arrival (`MultiDevicesTrainStep::step` in
//! `learner/supervised/step/train.rs`), which differs from run to run, and with it the rounding. Here one thread gives every device
//! its work before it waits for any (a GPU computes what is in its queue meanwhile): burn has one random generator for all
//! devices of a kind, so that threads would draw from each other's numbers. `OptimSharded` begins each sum at a device that the
//! parameter's number picks (burn-optim, `MultiGradientsParams::select`), which is random and another in every process.

use crate::guard;
use crate::optimiser::Gradients;
use crate::stage::{Losses, StageError};
use burn::module::Module;
use burn::tensor::{Device, Tensor};

/// A batch on one of the devices, whose numbers may still be on their way.
pub(super) struct Launched<I> {
    pub batch: u64,
    pub item: I,
    pub losses: Losses,
    pub gradients: Gradients,
    /// What the loss was multiplied by before its gradients were found; they are divided by it already.
    pub factor: f64,
}

/// The net itself, and a copy with a graph of its own on every other device.
pub(super) fn copies<M: Module>(net: &M, others: &[Device]) -> Vec<M> {
    let copies = others.iter().map(|device| net.clone().fork(&device.clone().autodiff()));
    std::iter::once(net.clone()).chain(copies).collect()
}

/// Sends a device what is in its queue: it starts, and what is random in it is drawn before another device is seeded.
pub(super) fn begin(device: &Device) -> Result<(), StageError> {
    device.flush().map_err(|error| StageError(format!("a device can't compute: {error}")))
}

impl Losses {
    /// As numbers, the total first; waits for the device.
    pub(super) fn numbers(&self) -> Vec<(String, f64)> {
        let number = |tensor: &Tensor<1>| f64::from(tensor.clone().into_scalar::<f32>());
        let terms = self.terms.iter().map(|(name, term)| (name.clone(), number(term)));
        std::iter::once((guard::TOTAL.to_string(), number(&self.total))).chain(terms).collect()
    }
}

impl Gradients {
    /// The same on another device.
    pub(super) fn moved_to(self, device: &Device) -> Self {
        Self(self.0.into_iter().map(|(name, gradient)| (name, gradient.to_device(device))).collect())
    }
}
