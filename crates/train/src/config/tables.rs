//! The tables of a config file. Every key has a default; an unknown one is an error.

use super::optimisation::{Adam, Optimisation, Schedule, Teaching};
use dataset::chairs::ChairsConfig;
use dataset::exemplar::ExemplarConfig;
use dataset::material::library::{ProceduralConfig, SourceConfig};
use dataset::pair::PairConfig;
use dataset::sequence::SequenceConfig;
use evaluate::synthetic::SyntheticConfig;
use flow::loss::FlowLossConfig;
use flow::pwc::PwcConfig;
use ops::compute::Compute;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use svbrdf::loss::LossConfig;
use svbrdf::net::SvbrdfNetConfig;

/// Everything a run is made of.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// The config below this one, by name or path; gone once the layers are merged.
    #[serde(skip_serializing)]
    pub extends: Option<String>,
    /// Name, seed, workers.
    pub run: Run,
    /// Where materials come from, one `[[materials]]` table per source.
    pub materials: Vec<SourceConfig>,
    /// The flow net and what it starts from.
    pub flow: FlowTable,
    /// Pre-training of the flow net on image pairs without a material (FlyingChairs style).
    pub chairs: ChairsStage,
    /// Flow between neighbouring frames.
    pub adjacent: PairStage,
    /// Flow that remains between the guidance image and an aligned key frame.
    pub distant: PairStage,
    /// Maps from frames.
    pub svbrdf: SvbrdfStage,
    /// Evaluation on held-out materials at the end.
    pub report: Report,
    /// When checkpoints are written and how many stay.
    pub checkpoint: Checkpointing,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            extends: None,
            run: Run::default(),
            materials: vec![SourceConfig::Procedural(ProceduralConfig::default())],
            flow: FlowTable::default(),
            chairs: ChairsStage::default(),
            adjacent: PairStage::default(),
            // §5: the distant net sees what is left over inside the overlap of two far frames.
            distant: PairStage { pairs: PairConfig { crop: 128, ..PairStage::default().pairs }, ..PairStage::default() },
            svbrdf: SvbrdfStage::default(),
            report: Report::default(),
            checkpoint: Checkpointing::default(),
        }
    }
}

/// What a non-finite loss leads to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum OnNan {
    /// The run ends with the step, the term and the dumped exemplar.
    #[default]
    Stop,
    /// The run goes back to the last checkpoint, skips the exemplar and counts it.
    Restore,
}

/// `[run]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Run {
    /// Name of the run folder below `runs/`; the config's file name when empty.
    pub name: String,
    /// The one seed that every random stream is derived from.
    pub seed: u64,
    /// Threads that prepare batches; the results don't depend on it.
    #[schemars(extend("unit" = "threads"))]
    pub data_workers: usize,
    /// Format of the numbers that enter convolutions while a net learns: `f32`, or `bf16` or `f16` where a GPU gains by it.
    /// Weights, losses, optimiser and everything else stay in single precision, and so does evaluation.
    pub compute: Compute,
    /// What a non-finite loss leads to.
    pub on_nan: OnNan,
    /// Memory for decoded materials, in MiB.
    #[schemars(extend("unit" = "MiB"))]
    pub material_cache_mib: usize,
}

impl Default for Run {
    fn default() -> Self {
        Self {
            name: String::new(),
            seed: 1,
            data_workers: 1,
            compute: Compute::F32,
            on_nan: OnNan::Stop,
            material_cache_mib: 1024,
        }
    }
}

/// Size of the flow nets.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum FlowSize {
    /// Half width, four levels, no context net: learns in minutes on a CPU.
    #[default]
    Slim,
    /// PWC-Net as in the paper: six levels, context net, 5 M parameters.
    Paper,
    /// PWC-Net as Sun et al. published it: dense connections, learned upsampling, 9 M parameters.
    Published,
}

/// What the flow nets start from.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(try_from = "String", into = "String")]
pub enum FlowInit {
    /// The pre-trained net that ships in `weights/`.
    #[default]
    Weights,
    /// Random weights; the chairs stage trains them first when it has steps.
    None,
    /// A safetensors file.
    File(std::path::PathBuf),
}

impl TryFrom<String> for FlowInit {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        match text.as_str() {
            "weights" => Ok(Self::Weights),
            "none" => Ok(Self::None),
            path if path.ends_with(".safetensors") => Ok(Self::File(path.into())),
            other => Err(format!(
                "`{other}` is no start for the flow nets: expected `weights`, `none` or the path of a .safetensors file"
            )),
        }
    }
}

impl From<FlowInit> for String {
    fn from(init: FlowInit) -> Self {
        match init {
            FlowInit::Weights => "weights".into(),
            FlowInit::None => "none".into(),
            FlowInit::File(path) => path.display().to_string(),
        }
    }
}

/// `[flow]`
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct FlowTable {
    /// Size of the nets.
    pub size: FlowSize,
    /// A whole architecture of one's own instead of `size`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub architecture: Option<PwcConfig>,
    /// What they start from: `weights` (the pre-trained net that ships), `none` (random weights; the chairs stage trains them
    /// first when it has steps) or the path of a safetensors file.
    pub init: FlowInit,
}

impl FlowTable {
    /// The nets' architecture.
    pub fn architecture(&self) -> PwcConfig {
        self.architecture.clone().unwrap_or_else(|| match self.size {
            FlowSize::Slim => PwcConfig::slim(),
            FlowSize::Paper => PwcConfig::paper(),
            FlowSize::Published => PwcConfig::published(),
        })
    }
}

fn flow_optimisation() -> Optimisation {
    Optimisation {
        learning_rate: 1e-3,
        schedule: Schedule::OneCycle,
        warm_up: 50,
        weight_decay: 4e-4,
        clip: 0.0,
        ..Optimisation::default()
    }
}

/// `[chairs]`: pre-training of the flow net.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ChairsStage {
    /// Optimiser steps; 0 leaves the stage out.
    #[schemars(extend("unit" = "steps"))]
    pub steps: usize,
    /// Pairs in a batch.
    pub batch: usize,
    /// The pairs.
    pub pairs: ChairsConfig,
    /// Share of the training pairs that are neighbouring frames of rendered scans (`adjacent.videos`) instead of moving shapes:
    /// shapes teach matching at any displacement, scans teach that highlights move but texture doesn't.
    #[schemars(extend("unit" = "share of the pairs"))]
    pub rendered_share: f64,
    /// The loss.
    pub loss: FlowLossConfig,
    /// Teacher forcing.
    pub teaching: Teaching,
    /// Pairs that a measurement on held-out materials uses.
    pub validation_pairs: usize,
    /// Optimiser and intervals.
    pub optimisation: Optimisation,
}

impl Default for ChairsStage {
    fn default() -> Self {
        Self {
            steps: 0,
            batch: 2,
            pairs: ChairsConfig { resolution: 192, ..ChairsConfig::default() },
            rendered_share: 0.0,
            loss: FlowLossConfig::teaching(),
            teaching: Teaching::default(),
            validation_pairs: 16,
            optimisation: flow_optimisation(),
        }
    }
}

/// `[adjacent]`, `[distant]`: a stage that learns flow from frames of scanning videos.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct PairStage {
    /// Optimiser steps; 0 leaves the stage out.
    #[schemars(extend("unit" = "steps"))]
    pub steps: usize,
    /// Pairs in a batch.
    pub batch: usize,
    /// How pairs are cut from frames.
    pub pairs: PairConfig,
    /// The videos.
    pub videos: SequenceConfig,
    /// Videos whose pairs are mixed, 20 pairs each.
    pub mixed_videos: u64,
    /// The loss.
    pub loss: FlowLossConfig,
    /// Teacher forcing.
    pub teaching: Teaching,
    /// Pairs that a measurement on held-out materials uses.
    pub validation_pairs: usize,
    /// Optimiser and intervals.
    pub optimisation: Optimisation,
}

impl Default for PairStage {
    fn default() -> Self {
        Self {
            steps: 0,
            batch: 2,
            pairs: PairConfig { resolution: 256, crop: 192, augment: true },
            videos: SequenceConfig::flow(),
            mixed_videos: 50,
            loss: FlowLossConfig::teaching(),
            teaching: Teaching::default(),
            validation_pairs: 16,
            optimisation: flow_optimisation(),
        }
    }
}

/// `[svbrdf]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SvbrdfStage {
    /// Optimiser steps; 0 leaves the stage out.
    #[schemars(extend("unit" = "steps"))]
    pub steps: usize,
    /// The net.
    pub net: SvbrdfNetConfig,
    /// What an exemplar is.
    pub exemplars: ExemplarConfig,
    /// The videos.
    pub videos: SequenceConfig,
    /// The loss.
    pub loss: LossConfig,
    /// Training exemplars from whose medians the outputs start and the constant-map baseline is taken.
    pub median_exemplars: usize,
    /// Exemplars that a measurement on held-out materials uses.
    pub validation_exemplars: usize,
    /// Optimiser and intervals.
    pub optimisation: Optimisation,
}

impl Default for SvbrdfStage {
    fn default() -> Self {
        Self {
            steps: 0,
            net: SvbrdfNetConfig::default(),
            exemplars: ExemplarConfig::default(),
            videos: SequenceConfig::svbrdf(),
            loss: LossConfig::default(),
            median_exemplars: 32,
            validation_exemplars: 8,
            optimisation: Optimisation {
                learning_rate: 2e-5,
                warm_up: 2000,
                // Spec 4.3: β₁ 0.5, ε 1e-4.
                adam: Adam { beta1: 0.5, beta2: 0.999, epsilon: 1e-4 },
                ema: 0.99,
                ..Optimisation::default()
            },
        }
    }
}

/// Which flow nets the report aligns with where the run trained none of its own.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(from = "String", into = "String")]
pub enum ReportFlow {
    /// None: the alignment works with its classical candidates alone.
    #[default]
    None,
    /// Those that ship in `weights/`.
    Weights,
    /// Those of a folder of weights.
    Folder(std::path::PathBuf),
}

impl From<String> for ReportFlow {
    fn from(text: String) -> Self {
        match text.as_str() {
            "none" => Self::None,
            "weights" => Self::Weights,
            _ => Self::Folder(text.into()),
        }
    }
}

impl From<ReportFlow> for String {
    fn from(nets: ReportFlow) -> Self {
        match nets {
            ReportFlow::None => "none".into(),
            ReportFlow::Weights => "weights".into(),
            ReportFlow::Folder(path) => path.display().to_string(),
        }
    }
}

/// `[report]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Report {
    /// Whether the trained nets are evaluated together on scans of held-out materials at the end.
    pub evaluate: bool,
    /// Which flow nets align the scans where this run trains none: `none`, `weights` (those that ship) or a folder of weights.
    pub flow_nets: ReportFlow,
    /// The protocol.
    pub synthetic: SyntheticConfig,
}

impl Default for Report {
    fn default() -> Self {
        Self { evaluate: true, flow_nets: ReportFlow::None, synthetic: SyntheticConfig::default() }
    }
}

/// `[checkpoint]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Checkpointing {
    /// Steps between two checkpoints: what a `kill -9` can cost.
    #[schemars(extend("unit" = "steps"))]
    pub every_steps: usize,
    /// Checkpoints of each stage that stay, the newest.
    pub keep_last: usize,
    /// Checkpoints of each stage that stay besides: those that measured best on held-out materials (by `epe_ratio` or
    /// `maps_l1_ratio`). Every measurement that is among the best so far then writes one.
    pub keep_best: usize,
}

impl Default for Checkpointing {
    fn default() -> Self {
        Self { every_steps: 100, keep_last: 2, keep_best: 0 }
    }
}
