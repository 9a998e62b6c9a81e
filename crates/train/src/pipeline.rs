//! A run from its first stage to its report.

use crate::checkpoint::{CheckpointError, Store};
use crate::config::Config;
use crate::fingerprint;
use crate::finished::{Finished, FinishedStage};
use crate::recorder::{Metrics, Previews, Recorder, StatusFile, TensorBoard};
use crate::report;
use crate::run_folder::{FolderError, RunFolder};
use crate::run_loop::{Outcome, Surroundings, TrainError, Trained, train};
use crate::stage::plan::{CHAIRS, Plan};
use crate::stage::{Stage, StageError};
use crate::taken::TakenError;
use burn::tensor::Device;
use dataset::material::{LibraryError, MaterialLibrary};
use evaluate::EvaluateError;
use flow::weights::{ADJACENT, DISTANT};
use ops::weights::{Precision, WeightsError};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

/// A run that could not be finished.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// Training.
    #[error(transparent)]
    Train(#[from] TrainError),
    /// What a stage needs before it starts.
    #[error("{stage}: {source}")]
    Prepare {
        /// Stage of the run.
        stage: &'static str,
        /// The reason.
        source: StageError,
    },
    /// A checkpoint.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// Weights that can't be written.
    #[error(transparent)]
    Weights(#[from] WeightsError),
    /// The run folder.
    #[error(transparent)]
    Folder(#[from] FolderError),
    /// The evaluation at the end.
    #[error(transparent)]
    Evaluate(#[from] EvaluateError),
    /// Flow nets for the evaluation.
    #[error(transparent)]
    FlowNets(#[from] report::NoFlowNets),
    /// Nets of another run.
    #[error(transparent)]
    Taken(#[from] TakenError),
    /// The record of finished stages.
    #[error("{} can't be read as the record of finished stages: {reason}", path.display())]
    Finished {
        /// The file.
        path: PathBuf,
        /// What doesn't fit.
        reason: String,
    },
    /// Files of the run folder.
    #[error("cannot write into the run folder: {0}")]
    Io(#[from] std::io::Error),
}

/// How a run ended.
#[derive(Debug, PartialEq, Eq)]
pub enum Ending {
    /// All stages are done.
    Done,
    /// It was stopped; a checkpoint is written.
    Stopped {
        /// Stage of the run.
        stage: &'static str,
        /// Steps done.
        step: u64,
    },
}

/// A run and what it works with.
pub struct Pipeline<'a> {
    /// The config.
    pub config: &'a Config,
    /// Where everything goes.
    pub folder: &'a RunFolder,
    /// The device, without gradients.
    pub device: Device,
    /// More devices of its kind for the batches of a step.
    pub others: Vec<Device>,
    /// All materials.
    pub materials: Arc<MaterialLibrary>,
    /// Revision of the source tree when the process started: files may change while it runs.
    pub revision: Option<String>,
    /// A checkpoint that a person chose instead of the newest.
    pub checkpoint: Option<PathBuf>,
    /// Asked after every step whether to stop.
    pub stop: &'a dyn Fn(u64) -> bool,
}

/// Opens the materials of a config: before anything is written, so that a wrong path costs nothing.
///
/// # Errors
/// A source that can't be used.
pub fn open_library(config: &Config) -> Result<Arc<MaterialLibrary>, LibraryError> {
    MaterialLibrary::open(&config.materials, config.run.seed, config.run.material_cache_mib << 20).map(Arc::new)
}

/// Stages that depend on each other, and on no stage of the other part.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    /// `chairs`, `adjacent` and `distant`.
    Flow,
    /// `svbrdf`.
    Svbrdf,
}

impl Part {
    /// Both.
    pub const ALL: [Self; 2] = [Self::Flow, Self::Svbrdf];

    /// Its stages in the order in which they run.
    pub fn stages(self) -> &'static [&'static str] {
        match self {
            Self::Flow => &[CHAIRS, ADJACENT, DISTANT],
            Self::Svbrdf => &[svbrdf::weights::NAME],
        }
    }

    /// Those of its stages that a config trains.
    pub fn trained(self, config: &Config) -> Vec<&'static str> {
        self.stages().iter().copied().filter(|stage| steps_of(config, stage) > 0).collect()
    }
}

/// Steps of a stage.
pub fn steps_of(config: &Config, stage: &str) -> usize {
    match stage {
        CHAIRS => config.chairs.steps,
        ADJACENT => config.adjacent.steps,
        DISTANT => config.distant.steps,
        _ => config.svbrdf.steps,
    }
}

/// Batches in a step of a stage.
pub fn batches_of(config: &Config, stage: &str) -> usize {
    let plan = match stage {
        CHAIRS => &config.chairs.optimisation,
        ADJACENT => &config.adjacent.optimisation,
        DISTANT => &config.distant.optimisation,
        _ => &config.svbrdf.optimisation,
    };
    plan.accumulate
}

impl Pipeline<'_> {
    /// Runs every stage that isn't finished, then the report.
    ///
    /// # Errors
    /// See [`RunError`]; what is written by then stays whole and can be resumed.
    pub fn run(&mut self) -> Result<Ending, RunError> {
        let plan = Plan { config: self.config, materials: Arc::clone(&self.materials), weights: self.folder.weights() };
        let mut finished = Finished::read(self.folder)?;
        let mut recorder: Vec<Box<dyn Recorder>> = vec![
            Box::new(Metrics::open(&self.folder.metrics())?),
            Box::new(Previews { folder: self.folder.previews() }),
            Box::new(TensorBoard::new(&self.folder.tensorboard())),
            Box::new(StatusFile::new(self.folder.path())),
        ];
        for name in Part::Flow.trained(self.config) {
            if finished.has(name) {
                continue;
            }
            let stage = match name {
                CHAIRS => plan.chairs().map_err(|source| RunError::Prepare { stage: CHAIRS, source })?,
                ADJACENT => plan.adjacent(),
                _ => plan.distant(),
            };
            let save = |net: &_, training, metrics| {
                flow::weights::save(&self.folder.weights(), name, net, training, metrics, Precision::F32)
            };
            if let Some(stopped) = self.stage(&stage, &mut recorder, &mut finished, save)? {
                return Ok(stopped);
            }
        }
        if self.config.svbrdf.steps > 0 && !finished.has(svbrdf::weights::NAME) {
            let save = |net: &_, training, metrics| {
                svbrdf::weights::save(&self.folder.weights(), net, training, metrics, Precision::F32)
            };
            if let Some(stopped) = self.stage(&plan.svbrdf(), &mut recorder, &mut finished, save)? {
                return Ok(stopped);
            }
        }
        let began = Instant::now();
        let figures = match report::evaluate_nets(self.folder, self.config, &self.materials, &self.device, self.stop) {
            Err(RunError::Evaluate(EvaluateError::Stopped)) => return Ok(Ending::Stopped { stage: "report", step: 0 }),
            figures => figures?,
        };
        let seconds = finished.seconds() + began.elapsed().as_secs_f64();
        report::write(self.folder, self.config, &finished, figures, seconds)?;
        Ok(Ending::Done)
    }

    /// Trains a stage and saves its net; tells where it stopped if it did.
    fn stage<S: Stage>(
        &mut self,
        stage: &S,
        recorder: &mut dyn Recorder,
        finished: &mut Finished,
        save: impl Fn(&S::Net, String, BTreeMap<String, f64>) -> Result<(), WeightsError>,
    ) -> Result<Option<Ending>, RunError> {
        let store = Store {
            folder: self.folder.checkpoints(),
            keep_last: self.config.checkpoint.keep_last,
            keep_best: self.config.checkpoint.keep_best,
            fingerprint: fingerprint::of_run(self.config),
        };
        // A chosen checkpoint is of the stage the run stands in; later stages have none yet.
        let from = match self.checkpoint.take() {
            Some(path) => Some(store.chosen(&path, stage.name(), &self.device)?),
            None => store.newest(stage.name(), &self.device)?,
        };
        let mut around = Surroundings {
            device: self.device.clone(),
            others: self.others.clone(),
            seed: self.config.run.seed,
            compute: self.config.run.compute,
            data_workers: self.config.run.data_workers,
            on_nan: self.config.run.on_nan,
            checkpoint_every: self.config.checkpoint.every_steps as u64,
            store: &store,
            failures: &self.folder.failures(),
            recorder,
            stop: self.stop,
            seconds_before: finished.seconds(),
        };
        match train(stage, &mut around, from)? {
            Outcome::Stopped { step } => Ok(Some(Ending::Stopped { stage: stage.name(), step })),
            Outcome::Finished(trained) => {
                let Trained { net, measured, skipped, seconds, data_wait_share } = *trained;
                let measured: BTreeMap<String, f64> = measured.into_iter().collect();
                save(&net, self.training(stage), measured.clone())?;
                let (stage, steps) = (stage.name().into(), stage.steps());
                let done = FinishedStage { stage, steps, seconds, data_wait_share, measured, skipped };
                finished.add(self.folder, done)?;
                Ok(None)
            }
        }
    }

    /// How a net was trained, for the manifest of its weights.
    fn training(&self, stage: &impl Stage) -> String {
        let sources = self.materials.manifest().len();
        format!(
            "stage {} of run {}: {} steps of {} exemplars, seed {}, {sources} materials (materials.json), revision {}",
            stage.name(),
            self.config.run.name,
            stage.steps(),
            stage.batch() * stage.plan().accumulate,
            self.config.run.seed,
            self.revision.as_deref().unwrap_or("unknown")
        )
    }
}
