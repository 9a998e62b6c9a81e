//! The stages that teach flow: chairs, adjacent and distant differ in their pairs only.

use super::picture::{flow_error, to_rgb};
use super::{Losses, Make, Moment, Picture, Stage, StageError};
use crate::config::{Optimisation, Teaching};
use crate::guard::Array;
use burn::tensor::Device;
use dataset::pair::FlowPair;
use flow::align::planar::planar_flow;
use flow::loss::FlowLossConfig;
use flow::metrics::EndPointErrors;
use flow::pwc::{Pwc, PwcConfig};
use flow::target::FlowTarget;
use flow::visual::{full_length_px, legend, picture};
use ops::planes::{Mask, Planes};
use rand_chacha::ChaCha8Rng;
use render::visual::{below, beside};
use std::sync::{Arc, OnceLock};

/// Pairs shown in a preview.
const SHOWN: usize = 3;

/// Makes a pair from its number.
pub type MakePair = Arc<dyn Fn(u64) -> Result<FlowPair, String> + Send + Sync>;
/// Makes the net before the first step.
pub type StartNet = Box<dyn Fn(&Device, &mut ChaCha8Rng) -> Result<Pwc, StageError>>;

/// A stage that trains a flow net on pairs.
pub struct FlowStage {
    /// `chairs`, `adjacent` or `distant`.
    pub name: &'static str,
    /// Optimiser steps.
    pub steps: usize,
    /// Pairs in a batch.
    pub batch: usize,
    /// Optimiser and intervals.
    pub plan: Optimisation,
    /// The loss.
    pub loss: FlowLossConfig,
    /// Teacher forcing.
    pub teaching: Teaching,
    /// The net before the first step.
    pub start: StartNet,
    /// Training pairs.
    pub pairs: MakePair,
    /// Pairs of held-out materials.
    pub held_out: MakePair,
    /// How many of them a measurement uses.
    pub measured_pairs: usize,
    /// Whether a pair shows one plane, so that a homography tells the truth.
    pub planar: bool,
    /// The held-out pairs, made once.
    pub cache: OnceLock<Result<Vec<FlowPair>, String>>,
}

impl FlowStage {
    fn held_out(&self) -> Result<&[FlowPair], StageError> {
        let made = self.cache.get_or_init(|| (0..self.measured_pairs as u64).map(|index| (self.held_out)(index)).collect());
        made.as_deref().map_err(|reason| StageError(reason.clone()))
    }
}

fn estimate(net: &Pwc, pair: &FlowPair, device: &Device) -> Planes {
    let flow = net.flow(pair.first.to_tensor(device), pair.second.to_tensor(device));
    Planes::from_tensor(flow).remove(0)
}

impl Stage for FlowStage {
    type Net = Pwc;
    type Item = Vec<FlowPair>;

    fn name(&self) -> &'static str {
        self.name
    }

    fn steps(&self) -> usize {
        self.steps
    }

    fn batch(&self) -> usize {
        self.batch
    }

    fn plan(&self) -> &Optimisation {
        &self.plan
    }

    fn start(&self, device: &Device, rng: &mut ChaCha8Rng) -> Result<Pwc, StageError> {
        (self.start)(device, rng)
    }

    fn make(&self) -> Make<Vec<FlowPair>> {
        let (pairs, batch) = (Arc::clone(&self.pairs), self.batch as u64);
        Arc::new(move |index| (index * batch..(index + 1) * batch).map(|pair| pairs(pair)).collect())
    }

    fn losses(&self, net: &Pwc, pairs: &Vec<FlowPair>, mut moment: Moment, device: &Device) -> Result<Losses, StageError> {
        let stack = |plane: fn(&FlowPair) -> &Planes| Planes::batch(&pairs.iter().map(plane).collect::<Vec<_>>(), device);
        let flows: Vec<&Planes> = pairs.iter().map(|pair| &pair.flow).collect();
        let valid: Vec<&Mask> = pairs.iter().map(|pair| &pair.valid).collect();
        let target = FlowTarget::batch(&flows, &valid, device);
        let share = self.teaching.share(moment.done);
        let output =
            net.forward_teaching(stack(|pair| &pair.first), stack(|pair| &pair.second), &target, share, &mut moment.rng);
        let loss = self.loss.forward(&output, &target);
        let mut terms: Vec<_> =
            loss.levels.into_iter().enumerate().map(|(level, term)| (format!("level_{level}"), term)).collect();
        terms.extend(loss.matching.map(|term| ("matching".to_string(), term)));
        Ok(Losses { total: loss.total, terms })
    }

    fn measure(&self, net: &Pwc, device: &Device) -> Result<Vec<(String, f64)>, StageError> {
        let (mut errors, mut planar_errors) = (EndPointErrors::default(), EndPointErrors::default());
        for pair in self.held_out()? {
            let found = estimate(net, pair, device);
            errors.add(&found, &pair.flow, &pair.valid);
            if self.planar {
                let everywhere = Mask::new(found.height, found.width, true);
                planar_errors.add(&planar_flow(&found, &everywhere), &pair.flow, &pair.valid);
            }
        }
        let Some(errors) = errors.finish() else { return Ok(Vec::new()) };
        let mut measured = vec![
            ("epe_ratio".to_string(), errors.ratio),
            ("epe_px".to_string(), errors.mean_px),
            ("epe_median_px".to_string(), errors.median_px),
            ("over_3_px".to_string(), errors.over_3_px),
        ];
        measured.extend(planar_errors.finish().map(|planar| ("homography_ratio".to_string(), planar.ratio)));
        Ok(measured)
    }

    /// A row per pair: target, source, true flow, estimated flow, their distance, the wheel of the flows' colours.
    fn preview(&self, net: &Pwc, device: &Device) -> Result<Vec<Picture>, StageError> {
        let pairs = self.held_out()?.iter().take(SHOWN);
        Ok(pairs
            .enumerate()
            .map(|(index, pair)| {
                let found = estimate(net, pair, device);
                let full = full_length_px(&pair.flow, Some(&pair.valid));
                let truth = picture(&pair.flow, Some(&pair.valid), full);
                let error = flow_error(&found, &pair.flow, &pair.valid, full);
                let wheel = legend(pair.first.height);
                let row = beside(&[&pair.first, &pair.second, &truth, &picture(&found, None, full), &error, &wheel]);
                Picture { name: format!("pair{index}"), image: to_rgb(&below(&[&row])) }
            })
            .collect())
    }

    fn arrays(&self, pairs: &Vec<FlowPair>) -> Vec<Array> {
        let parts = pairs.iter().enumerate().flat_map(|(i, pair)| {
            [
                ("first", pair.first.clone()),
                ("second", pair.second.clone()),
                ("flow", pair.flow.clone()),
                ("valid", pair.valid.to_planes()),
            ]
            .map(|(name, planes)| array(format!("{i}.{name}"), planes))
        });
        parts.collect()
    }
}

/// Planes as an array `[channels, height, width]`.
pub(super) fn array(name: String, planes: Planes) -> Array {
    Array { name, shape: vec![planes.channels, planes.height, planes.width], values: planes.data }
}

/// Builds the net with random weights.
pub fn random_start(architecture: PwcConfig) -> StartNet {
    Box::new(move |device, rng| Ok(architecture.init(device, rng)))
}
