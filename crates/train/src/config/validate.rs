//! Values that parse but that no run can work with.

use super::optimisation::{Optimisation, Teaching};
use super::tables::Config;
use dataset::mixing::MOST_MIXED;
use std::fmt::Display;
use svbrdf::loss::LossWeights;

/// A value the program can't work with.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Invalid {
    /// Dotted key of the value, or of the table it stands in.
    pub key: String,
    /// What was found.
    pub found: String,
    /// What is possible.
    pub expected: Option<String>,
}

/// Collects problems, so that a person sees all of them at once.
struct Findings {
    table: &'static str,
    found: Vec<Invalid>,
}

impl Findings {
    /// Notes a value that is not what it must be.
    fn require(&mut self, holds: bool, key: &str, found: impl Display, expected: &str) {
        if !holds {
            let key = format!("{}.{key}", self.table);
            self.found.push(Invalid {
                found: format!("`{key}` is {found}"),
                key,
                expected: Some(format!("expected {expected}")),
            });
        }
    }

    /// Notes what the owner of a sub-table says about it.
    fn ask<E: Display>(&mut self, key: &str, verdict: Result<(), E>) {
        if let Err(error) = verdict {
            self.found.push(Invalid { key: format!("{}.{key}", self.table), found: error.to_string(), expected: None });
        }
    }
}

impl Config {
    /// Every value the program can't work with; empty for a good config.
    pub fn validate(&self) -> Vec<Invalid> {
        let mut findings = Findings { table: "run", found: Vec::new() };
        self.check_run(&mut findings);
        self.check_flow(&mut findings);
        self.check_svbrdf(&mut findings);
        for (index, source) in self.materials.iter().enumerate() {
            if let Err(error) = source.validate(index + 1) {
                findings.found.push(Invalid { key: "materials".into(), found: error.to_string(), expected: None });
            }
        }
        if self.materials.is_empty() {
            let expected =
                Some("expected at least one source, for example `[[materials]]` with `type = \"procedural\"`".into());
            findings.found.push(Invalid {
                key: "materials".into(),
                found: "no material source is configured".into(),
                expected,
            });
        }
        findings.found
    }

    fn check_run(&self, findings: &mut Findings) {
        let plain = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
        let name = &self.run.name;
        let is_folder = name.chars().all(plain) && !name.starts_with('.');
        findings.require(is_folder, "name", format!("\"{name}\""), "a folder name of letters, digits, `-`, `_` and `.`");
        findings.require((1..=256).contains(&self.run.data_workers), "data_workers", self.run.data_workers, "1 to 256 threads");
        let cache = self.run.material_cache_mib;
        findings.require((64..=1 << 20).contains(&cache), "material_cache_mib", cache, "at least 64 MiB");
        let steps = [self.chairs.steps, self.adjacent.steps, self.distant.steps, self.svbrdf.steps];
        findings.table = "svbrdf";
        findings.require(
            steps.iter().any(|steps| *steps > 0),
            "steps",
            0,
            "steps in at least one of the stages chairs, adjacent, distant, svbrdf",
        );
        findings.table = "checkpoint";
        let Self { checkpoint, .. } = self;
        findings.require(checkpoint.every_steps >= 1, "every_steps", checkpoint.every_steps, "at least 1 step");
        let expected = "at least 2, so that a damaged one has a predecessor";
        findings.require(checkpoint.keep_last >= 2, "keep_last", checkpoint.keep_last, expected);
        findings.table = "report";
        findings.ask("synthetic", self.report.synthetic.validate());
    }

    fn check_flow(&self, findings: &mut Findings) {
        let architecture = self.flow.architecture();
        findings.table = "flow";
        findings.ask("architecture", architecture.validate());
        let levels = architecture.channels.len().saturating_sub(1);

        findings.table = "chairs";
        let chairs = &self.chairs;
        findings.ask("pairs", chairs.pairs.validate());
        findings.require((0.0..=1.0).contains(&chairs.rendered_share), "rendered_share", chairs.rendered_share, "0 to 1");
        findings.ask("loss", chairs.loss.validate(levels));
        check_teaching(findings, chairs.batch, &chairs.teaching, chairs.validation_pairs, &chairs.optimisation);

        for (table, stage) in [("adjacent", &self.adjacent), ("distant", &self.distant)] {
            findings.table = table;
            findings.ask("pairs", stage.pairs.validate());
            let cut = stage.pairs.crop > 0 || stage.batch == 1 || table == "adjacent";
            findings.require(cut, "pairs.crop", "0 (no crop)", "a crop, because overlaps of different sizes can't be batched");
            findings.ask("videos", stage.videos.validate());
            findings.ask("loss", stage.loss.validate(levels));
            let mixed = (1..=MOST_MIXED).contains(&stage.mixed_videos);
            findings.require(mixed, "mixed_videos", stage.mixed_videos, "1 to 100000");
            check_teaching(findings, stage.batch, &stage.teaching, stage.validation_pairs, &stage.optimisation);
        }
    }

    fn check_svbrdf(&self, findings: &mut Findings) {
        findings.table = "svbrdf";
        let stage = &self.svbrdf;
        let LossWeights { maps, rendering, top, excess } = stage.loss.weights;
        for (key, weight) in [("maps", maps), ("rendering", rendering), ("top", top), ("excess", excess)] {
            let fits = weight.is_finite() && weight >= 0.0;
            findings.require(fits, &format!("loss.weights.{key}"), weight, "a finite weight of at least 0");
        }
        findings.ask("net", stage.net.validate());
        findings.ask("exemplars", stage.exemplars.validate());
        findings.ask("videos", stage.videos.validate());
        findings.require(stage.median_exemplars >= 1, "median_exemplars", stage.median_exemplars, "at least 1");
        findings.require(stage.validation_exemplars >= 1, "validation_exemplars", stage.validation_exemplars, "at least 1");
        check_optimisation(findings, &stage.optimisation);
    }
}

fn check_teaching(findings: &mut Findings, batch: usize, teaching: &Teaching, pairs: usize, plan: &Optimisation) {
    findings.require((1..=1024).contains(&batch), "batch", batch, "1 to 1024 pairs");
    findings.require(
        (0.0..=1.0).contains(&teaching.forcing),
        "teaching.forcing",
        teaching.forcing,
        "a probability from 0 to 1",
    );
    findings.require((0.0..=1.0).contains(&teaching.until), "teaching.until", teaching.until, "a share from 0 to 1");
    findings.require(pairs >= 1, "validation_pairs", pairs, "at least 1 pair");
    check_optimisation(findings, plan);
}

fn check_optimisation(findings: &mut Findings, plan: &Optimisation) {
    let rate = plan.learning_rate > 0.0 && plan.learning_rate <= 1.0;
    findings.require(rate, "optimisation.learning_rate", plan.learning_rate, "a rate above 0 and up to 1");
    for (key, value) in [
        ("optimisation.adam.beta1", plan.adam.beta1),
        ("optimisation.adam.beta2", plan.adam.beta2),
        ("optimisation.ema", plan.ema),
    ] {
        findings.require((0.0..1.0).contains(&value), key, value, "a decay from 0 up to, not including, 1");
    }
    let epsilon = plan.adam.epsilon;
    findings.require(epsilon > 0.0 && epsilon.is_finite(), "optimisation.adam.epsilon", epsilon, "a positive number");
    for (key, value) in [("optimisation.weight_decay", plan.weight_decay), ("optimisation.clip", plan.clip)] {
        findings.require(value >= 0.0 && value.is_finite(), key, value, "0 (off) or a positive number");
    }
    findings.require((1..=1024).contains(&plan.accumulate), "optimisation.accumulate", plan.accumulate, "1 to 1024 batches");
    findings.require(plan.preview_every >= 1, "optimisation.preview_every", plan.preview_every, "at least 1 step");
}
