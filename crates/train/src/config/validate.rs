//! Values that parse but that no run can work with.

use super::tables::{Config, Optimisation, PairStage};
use std::fmt::Display;

/// A value the program can't work with.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Invalid {
    /// Dotted key.
    pub key: &'static str,
    /// The value that was found.
    pub found: String,
    /// What is possible.
    pub expected: &'static str,
}

/// Collects problems, so that a person sees all of them at once.
#[derive(Default)]
struct Findings(Vec<Invalid>);

impl Findings {
    fn require(&mut self, holds: bool, key: &'static str, found: impl Display, expected: &'static str) {
        if !holds {
            self.0.push(Invalid { key, found: found.to_string(), expected });
        }
    }
}

/// Spells a stage's keys, which must be static to be compared with the source text.
macro_rules! keys {
    ($table:literal) => {
        OptimisationKeys {
            learning_rate: concat!($table, ".optimisation.learning_rate"),
            beta1: concat!($table, ".optimisation.adam.beta1"),
            beta2: concat!($table, ".optimisation.adam.beta2"),
            epsilon: concat!($table, ".optimisation.adam.epsilon"),
            weight_decay: concat!($table, ".optimisation.weight_decay"),
            clip: concat!($table, ".optimisation.clip"),
            accumulate: concat!($table, ".optimisation.accumulate"),
            ema: concat!($table, ".optimisation.ema"),
            preview_every: concat!($table, ".optimisation.preview_every"),
        }
    };
}

struct OptimisationKeys {
    learning_rate: &'static str,
    beta1: &'static str,
    beta2: &'static str,
    epsilon: &'static str,
    weight_decay: &'static str,
    clip: &'static str,
    accumulate: &'static str,
    ema: &'static str,
    preview_every: &'static str,
}

struct PairKeys {
    batch: &'static str,
    crop: &'static str,
    resolution: &'static str,
    teacher_forcing: &'static str,
    matching: &'static str,
    validation_pairs: &'static str,
}

macro_rules! pair_keys {
    ($table:literal) => {
        PairKeys {
            batch: concat!($table, ".batch"),
            crop: concat!($table, ".crop"),
            resolution: concat!($table, ".resolution"),
            teacher_forcing: concat!($table, ".teacher_forcing"),
            matching: concat!($table, ".matching"),
            validation_pairs: concat!($table, ".validation_pairs"),
        }
    };
}

impl Config {
    /// Every value the program can't work with; empty for a good config.
    pub fn validate(&self) -> Vec<Invalid> {
        let mut findings = Findings::default();
        let plain = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
        let name = &self.run.name;
        let is_folder = name.chars().all(plain) && !name.starts_with('.');
        findings.require(is_folder, "run.name", format!("\"{name}\""), "a folder name of letters, digits, `-`, `_` and `.`");
        findings.require(
            (1..=256).contains(&self.run.data_workers),
            "run.data_workers",
            self.run.data_workers,
            "1 to 256 threads",
        );
        findings.require(
            self.checkpoint.every_steps >= 1,
            "checkpoint.every_steps",
            self.checkpoint.every_steps,
            "at least 1 step",
        );
        // One alone could be the truncated one.
        findings.require(
            self.checkpoint.keep_last >= 2,
            "checkpoint.keep_last",
            self.checkpoint.keep_last,
            "at least 2, so that a damaged one has a predecessor",
        );
        check_pairs(&mut findings, &self.chairs, &pair_keys!("chairs"), &keys!("chairs"));
        check_pairs(&mut findings, &self.adjacent, &pair_keys!("adjacent"), &keys!("adjacent"));
        check_pairs(&mut findings, &self.distant, &pair_keys!("distant"), &keys!("distant"));
        self.check_svbrdf(&mut findings);
        findings.0
    }

    fn check_svbrdf(&self, findings: &mut Findings) {
        let stage = &self.svbrdf;
        let [fewest, most] = stage.key_frames;
        findings.require((1..=256).contains(&stage.width), "svbrdf.width", stage.width, "1 to 256 channels (64 in the paper)");
        let halvings = stage.resolution.is_power_of_two() && (32..=2048).contains(&stage.resolution);
        findings.require(halvings, "svbrdf.resolution", stage.resolution, "a power of two from 32 to 2048 pixels");
        let range = format!("[{fewest}, {most}]");
        findings.require(fewest <= most && most <= 28, "svbrdf.key_frames", range, "[fewest, most] with fewest ≤ most ≤ 28");
        findings.require(
            stage.validation_exemplars >= 1,
            "svbrdf.validation_exemplars",
            stage.validation_exemplars,
            "at least 1",
        );
        check_optimisation(findings, &stage.optimisation, &keys!("svbrdf"));
    }
}

fn check_pairs(findings: &mut Findings, stage: &PairStage, keys: &PairKeys, optimisation: &OptimisationKeys) {
    findings.require((1..=1024).contains(&stage.batch), keys.batch, stage.batch, "1 to 1024 pairs");
    let fits = (32..=stage.resolution).contains(&stage.crop);
    findings.require(fits, keys.crop, stage.crop, "at least 32 pixels and no more than the stage's `resolution`");
    findings.require((32..=4096).contains(&stage.resolution), keys.resolution, stage.resolution, "32 to 4096 pixels");
    let share = (0.0..=1.0).contains(&stage.teacher_forcing);
    findings.require(share, keys.teacher_forcing, stage.teacher_forcing, "a share from 0 to 1");
    let weight = stage.matching >= 0.0 && stage.matching.is_finite();
    findings.require(weight, keys.matching, stage.matching, "a weight of 0 or more");
    findings.require(stage.validation_pairs >= 1, keys.validation_pairs, stage.validation_pairs, "at least 1 pair");
    check_optimisation(findings, &stage.optimisation, optimisation);
}

fn check_optimisation(findings: &mut Findings, plan: &Optimisation, keys: &OptimisationKeys) {
    let rate = plan.learning_rate > 0.0 && plan.learning_rate <= 1.0;
    findings.require(rate, keys.learning_rate, plan.learning_rate, "a rate above 0 and up to 1");
    findings.require(
        (0.0..1.0).contains(&plan.adam.beta1),
        keys.beta1,
        plan.adam.beta1,
        "a decay from 0 up to, not including, 1",
    );
    findings.require(
        (0.0..1.0).contains(&plan.adam.beta2),
        keys.beta2,
        plan.adam.beta2,
        "a decay from 0 up to, not including, 1",
    );
    findings.require(plan.adam.epsilon > 0.0, keys.epsilon, plan.adam.epsilon, "more than 0");
    findings.require(plan.weight_decay >= 0.0, keys.weight_decay, plan.weight_decay, "0 or more");
    findings.require(plan.clip >= 0.0, keys.clip, plan.clip, "0 (off) or a positive norm");
    findings.require((1..=1024).contains(&plan.accumulate), keys.accumulate, plan.accumulate, "1 to 1024 batches");
    findings.require((0.0..1.0).contains(&plan.ema), keys.ema, plan.ema, "0 (off) or a decay below 1");
    findings.require(plan.preview_every >= 1, keys.preview_every, plan.preview_every, "at least 1 step");
}
