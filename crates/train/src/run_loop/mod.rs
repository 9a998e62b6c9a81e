//! The training loop that all stages share.

mod devices;
mod stage_run;

use crate::checkpoint::{Checkpoint, CheckpointError, Store};
use crate::config::OnNan;
use crate::guard::Dump;
use crate::optimiser::ParameterError;
use crate::recorder::Recorder;
use crate::stage::{Stage, StageError};
use burn::tensor::Device;
use dataset::producer::ProducerError;
use ops::compute::Compute;
use stage_run::StageRun;
use std::io;
use std::path::Path;

/// A stage that could not be finished.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    /// The stage itself.
    #[error("{stage}, step {step}: {source}")]
    Stage {
        /// Stage of the run.
        stage: &'static str,
        /// Optimiser step.
        step: u64,
        /// The reason.
        source: StageError,
    },
    /// A loss or gradient that isn't a number.
    #[error(
        "{stage}, step {step}: the term `{term}` is {value}. The batch (number {batch}) is in {}, with pictures and ranges beside it (.png, .json). {}.{}{}",
        dump.path.display(), dump.verdict(), restored(*.restores), narrow(*.compute)
    )]
    NonFinite {
        /// Stage of the run.
        stage: &'static str,
        /// Optimiser step.
        step: u64,
        /// Loss term, gradient or weight.
        term: String,
        /// NaN or an infinity.
        value: f64,
        /// Number of the batch.
        batch: u64,
        /// The dumped batch.
        dump: Box<Dump>,
        /// How often the stage has gone back already.
        restores: usize,
        /// Format that convolutions computed in.
        compute: Compute,
    },
    /// A data worker.
    #[error(transparent)]
    Producer(#[from] ProducerError),
    /// A checkpoint.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// A checkpoint of another net.
    #[error("{stage}: the checkpoint doesn't fit the net: {source}")]
    Parameters {
        /// Stage of the run.
        stage: &'static str,
        /// What doesn't fit.
        source: ParameterError,
    },
    /// Metrics, pictures or dumps that can't be written.
    #[error("cannot write into the run folder: {0}")]
    Io(#[from] io::Error),
}

fn restored(times: usize) -> String {
    match times {
        0 => " Or set `run.on_nan = \"restore\"` to go back and leave such batches out".into(),
        times => format!(" The stage has gone back {times} times already, which doesn't help"),
    }
}

fn narrow(compute: Compute) -> &'static str {
    match compute {
        Compute::F16 => {
            ". Convolutions computed with `run.compute = \"f16\"`, whose numbers end at 65,504: a new run with `bf16` or `f32` has more room"
        }
        Compute::F32 | Compute::Bf16 => "",
    }
}

/// What surrounds a stage.
pub struct Surroundings<'a> {
    /// The device without gradients; net, optimiser, measurements and pictures are there.
    pub device: Device,
    /// More devices of its kind, which share the batches of a step (`optimisation.accumulate`) with it.
    pub others: Vec<Device>,
    /// Seed of the run.
    pub seed: u64,
    /// Format that convolutions compute in while a net learns.
    pub compute: Compute,
    /// Threads that make batches.
    pub data_workers: usize,
    /// What a non-finite loss leads to.
    pub on_nan: OnNan,
    /// Steps between two checkpoints.
    pub checkpoint_every: u64,
    /// Where checkpoints lie.
    pub store: &'a Store,
    /// Where dumps go.
    pub failures: &'a Path,
    /// Where numbers and pictures go.
    pub recorder: &'a mut dyn Recorder,
    /// Asked after every step, with the steps done: whether to stop with a checkpoint.
    pub stop: &'a dyn Fn(u64) -> bool,
    /// Training time of the run before this stage, in seconds.
    pub seconds_before: f64,
}

/// How a stage ended.
pub enum Outcome<N> {
    /// All steps are done.
    Finished(Box<Trained<N>>),
    /// A person or the system asked to stop; a checkpoint is written.
    Stopped {
        /// Steps done.
        step: u64,
    },
}

/// A trained net and what it is worth.
pub struct Trained<N> {
    /// The net without gradients, averaged when an average is kept.
    pub net: N,
    /// Measurements on held-out materials.
    pub measured: Vec<(String, f64)>,
    /// Batches skipped because a loss was not finite on them.
    pub skipped: Vec<u64>,
    /// Training time of the run so far, in seconds.
    pub seconds: f64,
    /// Share of the steps' time that went by waiting for data, since the last start.
    pub data_wait_share: f64,
}

/// Trains a stage from its start or from a checkpoint.
///
/// # Errors
/// See [`TrainError`]; everything written before stays whole.
pub fn train<S: Stage>(
    stage: &S,
    around: &mut Surroundings<'_>,
    from: Option<Checkpoint>,
) -> Result<Outcome<S::Net>, TrainError> {
    let steps = stage.steps() as u64;
    let mut run = StageRun::begin(stage, around, from)?;
    while run.steps_done() < steps {
        match run.step()? {
            Ok(row) => run.report(&row)?,
            Err(bad) => {
                run.recover(bad)?;
                continue;
            }
        }
        let done = run.steps_done();
        let stopping = (run.around.stop)(done) && done < steps;
        if stopping || run.is_among_best() || done.is_multiple_of(run.around.checkpoint_every) || done == steps {
            if let Err(bad) = run.check_weights()? {
                run.recover(bad)?;
                continue;
            }
            run.save()?;
        }
        if stopping {
            return Ok(Outcome::Stopped { step: run.steps_done() });
        }
    }
    run.finish()
}
