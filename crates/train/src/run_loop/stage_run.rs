//! One stage while it trains: net, optimiser, data and what they report.

use super::devices::{Launched, begin, copies};
use super::{Outcome, Surroundings, TrainError, Trained};
use crate::checkpoint::{Checkpoint, Measured, State};
use crate::config::OnNan;
use crate::guard::{self, Dump, NonFinite};
use crate::optimiser::{AdamOptimiser, Average, Gradients, NamedTensors, assign, gradients, rate, values};
use crate::progress::Progress;
use crate::recorder::{Histogram, Kind, Quantity, Row, Status};
use crate::stage::{Losses, Moment, Stage, StageError};
use burn::module::Module;
use burn::tensor::Device;
use dataset::producer::{Producer, ProducerError};
use dataset::stream::Stream;
use ops::compute::Compute;
use rand_chacha::rand_core::Rng;
use std::time::{Duration, Instant};

/// A run gives up after going back this often in one stage: then the weights, not one exemplar, are at fault.
const MOST_RESTORES: usize = 5;
/// Batches that are made ahead of their use, per worker: enough for the second that a new material takes.
const AHEAD_PER_WORKER: usize = 4;

/// The numbers of a good step.
pub(super) struct StepRow {
    values: Vec<(String, f64)>,
    samples_per_second: f64,
    waiting: f64,
}

/// A step whose numbers were not finite: what, on which batch, and where the batch was dumped.
pub(super) struct BadStep {
    found: NonFinite,
    batch: u64,
    dump: Dump,
}

pub(super) struct StageRun<'s, 'b, S: Stage> {
    stage: &'s S,
    pub(super) around: &'s mut Surroundings<'b>,
    net: S::Net,
    adam: AdamOptimiser,
    average: Option<Average>,
    producer: Producer<Result<S::Item, String>>,
    streams: Stream,
    state: State,
    /// The batch of the latest step, to blame for weights that went bad.
    latest: Option<(u64, S::Item)>,
    progress: Progress,
    /// Time in the steps of this process, and how much of it went by waiting for data.
    stepping: Duration,
    waiting: Duration,
    /// When this process began, less the training time before.
    began: Instant,
    seconds_before: f64,
}

impl<'s, 'b, S: Stage> StageRun<'s, 'b, S> {
    pub(super) fn begin(stage: &'s S, around: &'s mut Surroundings<'b>, from: Option<Checkpoint>) -> Result<Self, TrainError> {
        let streams = Stream::new(around.seed).child(stage.name(), 0);
        let fresh = Checkpoint::default();
        let checkpoint = from.as_ref().unwrap_or(&fresh);
        let mut state = checkpoint.state.clone();
        if from.is_none() {
            state.stage = stage.name().into();
            state.seconds = around.seconds_before;
            state.fingerprint = around.store.fingerprint.clone();
        }
        let fail = |source| TrainError::Stage { stage: stage.name(), step: 0, source };
        around.device.seed(streams.rng("device, start", 0).next_u64());
        let mut net = stage.start(&around.device.clone().autodiff(), &mut streams.rng("weights", 0)).map_err(fail)?;
        if from.is_some() {
            net = assign(net, &checkpoint.weights).map_err(|source| TrainError::Parameters { stage: stage.name(), source })?;
        }
        let plan = stage.plan();
        let mut adam = AdamOptimiser::new(plan.adam, plan.weight_decay);
        adam.time = state.adam_time;
        adam.first = checkpoint.first.clone();
        adam.second = checkpoint.second.clone();
        let start = if checkpoint.average.is_empty() { values(&net) } else { checkpoint.average.clone() };
        let average = Average::new(plan.ema, start);
        around.recorder.rewind(stage.name(), state.step)?;
        let producer = Self::producer(stage, around.data_workers, state.cursor)?;
        let progress = Progress::new(stage.name(), state.step, stage.steps() as u64);
        let seconds_before = state.seconds;
        Ok(Self {
            stage,
            around,
            net,
            adam,
            average,
            producer,
            streams,
            state,
            latest: None,
            progress,
            stepping: Duration::ZERO,
            waiting: Duration::ZERO,
            began: Instant::now(),
            seconds_before,
        })
    }

    pub(super) fn steps_done(&self) -> u64 {
        self.state.step
    }

    fn producer(stage: &S, workers: usize, cursor: u64) -> Result<Producer<Result<S::Item, String>>, ProducerError> {
        let make = stage.make();
        Producer::new(workers, workers * AHEAD_PER_WORKER, cursor, move |index| make(index))
    }

    fn failure(&self, source: StageError) -> TrainError {
        TrainError::Stage { stage: self.stage.name(), step: self.state.step, source }
    }

    /// The next batch that isn't to be skipped, with its number.
    fn take(&mut self) -> Result<(u64, S::Item), TrainError> {
        loop {
            let batch = self.state.cursor;
            let item = self.producer.take()?;
            self.state.cursor += 1;
            if !self.state.skipped.contains(&batch) {
                return item.map(|item| (batch, item)).map_err(|reason| self.failure(StageError(reason)));
            }
        }
    }

    pub(super) fn step(&mut self) -> Result<Result<StepRow, BadStep>, TrainError> {
        let (began, waited) = (Instant::now(), self.producer.wait_seconds());
        let plan = self.stage.plan().clone();
        let mut sum = Gradients::default();
        let mut row: Vec<(String, f64)> = Vec::new();
        let mut norm = 0.0;
        let nets = copies(&self.net, &self.around.others);
        let mut due = plan.accumulate;
        while due > 0 {
            let round = self.launch(&nets, due)?;
            due -= round.len();
            for Launched { batch, item, losses, gradients, mut factor } in round {
                let losses = losses.numbers();
                let mut gradients = gradients.moved_to(&self.around.device);
                norm = gradients.norm();
                while self.again(&losses, norm, factor) {
                    let main = self.around.device.clone();
                    factor = self.state.loss_scale.factor;
                    gradients = self.backward(&nets[0], &main, batch, &item)?.1;
                    norm = gradients.norm();
                }
                // Batch by batch, so that the one at fault is known.
                if let Err(found) = guard::check_losses(&losses).and_then(|()| guard::check_gradients(norm, &gradients)) {
                    return self.bad(found, batch, &item).map(Err);
                }
                sum.add(gradients);
                add(&mut row, losses, plan.accumulate);
                self.latest = Some((batch, item));
            }
        }
        if plan.accumulate > 1 {
            sum.scale(1.0 / plan.accumulate as f64);
            norm = sum.norm();
        }
        row.push(("gradient_norm".into(), f64::from(norm)));
        let learning_rate = rate(&plan, self.state.step as usize, self.stage.steps());
        let every = plan.histogram_every as u64;
        let spread = every > 0 && (self.state.step + 1).is_multiple_of(every);
        if spread {
            self.histograms(Quantity::Gradients, self.state.step + 1, &sum.0)?;
        }
        sum.clip(norm, plan.clip);
        self.update(sum, learning_rate)?;
        if spread {
            self.histograms(Quantity::Weights, self.state.step, &values(&self.net))?;
        }
        row.push(("learning_rate".into(), learning_rate));
        let (stepped, waited) = (began.elapsed(), Duration::from_secs_f64(self.producer.wait_seconds() - waited));
        self.stepping += stepped;
        self.waiting += waited;
        let seconds = stepped.as_secs_f64().max(1e-9);
        let waiting = waited.as_secs_f64() / seconds;
        let samples_per_second = (self.stage.batch() * plan.accumulate) as f64 / seconds;
        Ok(Ok(StepRow { values: row, samples_per_second, waiting }))
    }

    /// Hands a batch to every net, at most `due` of them, and waits for none.
    fn launch(&mut self, nets: &[S::Net], due: usize) -> Result<Vec<Launched<S::Item>>, TrainError> {
        let devices: Vec<Device> = std::iter::once(&self.around.device).chain(&self.around.others).cloned().collect();
        let mut round = Vec::with_capacity(nets.len());
        for (net, device) in nets.iter().zip(devices).take(due) {
            let (batch, item) = self.take()?;
            let factor = self.state.loss_scale.factor;
            let (losses, gradients) = self.backward(net, &device, batch, &item)?;
            if nets.len() > 1 {
                begin(&device).map_err(|source| self.failure(source))?;
            }
            round.push(Launched { batch, item, losses, gradients, factor });
        }
        Ok(round)
    }

    /// Losses and gradients of one batch.
    fn backward(&self, net: &S::Net, device: &Device, batch: u64, item: &S::Item) -> Result<(Losses, Gradients), TrainError> {
        // Layers that draw by themselves (dropout) draw from the generator of the device's kind.
        device.seed(self.streams.rng("device", batch).next_u64());
        let done = self.state.step as f64 / self.stage.steps().max(1) as f64;
        let moment = Moment { step: self.state.step, done, rng: self.streams.rng("losses", batch) };
        let compute = self.around.compute;
        let losses = compute.within(|| self.stage.losses(net, item, moment, &device.clone().autodiff()));
        let losses = losses.map_err(|source| self.failure(source))?;
        if compute != Compute::F16 {
            let found = gradients(net, losses.total.backward());
            return Ok((losses, found));
        }
        let factor = self.state.loss_scale.factor;
        let mut found = gradients(net, (losses.total.clone() * factor).backward());
        found.scale(1.0 / factor);
        Ok((losses, found))
    }

    /// Whether a batch is to be computed again with the factor on the loss that holds now, after one with `factor` gave a gradient
    /// of `norm`: half precision has overflowed in it, or in a batch before it that another device had at the same time. One
    /// device would have begun this one with the smaller factor.
    fn again(&mut self, losses: &[(String, f64)], norm: f32, factor: f64) -> bool {
        if self.around.compute != Compute::F16 || guard::check_losses(losses).is_err() {
            return false;
        }
        let scale = self.state.loss_scale;
        if factor == scale.factor && !norm.is_finite() {
            self.state.loss_scale = scale.halved().unwrap_or(scale);
        }
        factor != self.state.loss_scale.factor
    }

    fn update(&mut self, gradients: Gradients, learning_rate: f64) -> Result<(), TrainError> {
        let new = self.adam.step(values(&self.net), gradients, learning_rate);
        self.state.step += 1;
        if self.around.compute == Compute::F16 {
            self.state.loss_scale = self.state.loss_scale.stepped();
        }
        self.state.adam_time = self.adam.time;
        if let Some(average) = &mut self.average {
            average.update(&new, self.state.step);
        }
        self.net = self.assign(self.net.clone(), &new)?;
        Ok(())
    }

    fn histograms(&mut self, of: Quantity, step: u64, tensors: &NamedTensors) -> Result<(), TrainError> {
        for (layer, found) in Histogram::of_all(tensors) {
            self.around.recorder.histogram(self.stage.name(), step, of, layer, &found)?;
        }
        Ok(())
    }

    fn assign(&self, net: S::Net, values: &NamedTensors) -> Result<S::Net, TrainError> {
        assign(net, values).map_err(|source| TrainError::Parameters { stage: self.stage.name(), source })
    }

    fn bad(&self, found: NonFinite, batch: u64, item: &S::Item) -> Result<BadStep, TrainError> {
        let arrays = self.stage.arrays(item);
        let dump = guard::dump(self.around.failures, self.stage.name(), self.state.step, batch, &found, &arrays)?;
        Ok(BadStep { found, batch, dump })
    }

    /// Looks at the weights before they become a checkpoint: from bad ones no run could go on.
    pub(super) fn check_weights(&self) -> Result<Result<(), BadStep>, TrainError> {
        match (guard::check_weights(&values(&self.net)), &self.latest) {
            (Err(found), Some((batch, item))) => self.bad(found, *batch, item).map(Err),
            _ => Ok(Ok(())),
        }
    }

    /// Ends the run, or goes back to the last checkpoint without the batch.
    pub(super) fn recover(&mut self, bad: BadStep) -> Result<(), TrainError> {
        let name = self.stage.name();
        let BadStep { found: NonFinite { term, value }, batch, dump } = bad;
        let mut skipped = self.state.skipped.clone();
        if self.around.on_nan == OnNan::Stop || skipped.len() >= MOST_RESTORES {
            let (step, restores, dump, compute) = (self.state.step, skipped.len(), Box::new(dump), self.around.compute);
            return Err(TrainError::NonFinite { stage: name, step, term, value, batch, dump, restores, compute });
        }
        skipped.push(batch);
        let from = self.around.store.newest(name, &self.around.device)?;
        self.progress.say(&format!(
            "{name}, step {}: the term `{term}` is {value}; going back to step {} and skipping batch {batch} ({})",
            self.state.step,
            from.as_ref().map_or(0, |checkpoint| checkpoint.state.step),
            dump.path.display()
        ));
        self.restore(from, skipped)
    }

    fn restore(&mut self, from: Option<Checkpoint>, skipped: Vec<u64>) -> Result<(), TrainError> {
        let before = StageRun::begin(self.stage, self.around, from)?;
        let StageRun { net, adam, average, producer, state, .. } = before;
        (self.net, self.adam, self.average, self.producer, self.state) = (net, adam, average, producer, state);
        self.state.skipped = skipped;
        Ok(())
    }

    pub(super) fn report(&mut self, row: &StepRow) -> Result<(), TrainError> {
        let (name, step, plan) = (self.stage.name(), self.state.step, self.stage.plan());
        self.around.recorder.row(&Row { stage: name, step, kind: Kind::Train, values: &row.values })?;
        let (preview, validate) = (plan.preview_every as u64, plan.validate_every as u64);
        let last = step == self.stage.steps() as u64;
        // One picture at once, so that a person sees within a minute what the run works on.
        if step == 1 || step.is_multiple_of(preview) || last {
            self.preview()?;
        }
        if (validate > 0 && step.is_multiple_of(validate)) || last {
            self.measure()?;
        }
        let StepRow { values, samples_per_second, waiting } = row;
        let status = Status {
            stage: name,
            step,
            steps: self.stage.steps() as u64,
            // The last two are the gradient's norm and the learning rate.
            losses: &values[..values.len().saturating_sub(2)],
            measured: &self.state.measured,
            samples_per_second: *samples_per_second,
            waiting: *waiting,
            memory_mib: ops::process::rss_mib(),
            remaining: self.progress.remaining(step),
        };
        self.progress.show(&status);
        Ok(self.around.recorder.status(&status)?)
    }

    /// The net as evaluation uses it: without gradients and dropout, averaged when an average is kept.
    fn evaluated(&self) -> Result<S::Net, TrainError> {
        let net = self.net.valid();
        match &self.average {
            Some(average) => self.assign(net, &average.values),
            None => Ok(net),
        }
    }

    fn preview(&mut self) -> Result<(), TrainError> {
        let pictures = self.stage.preview(&self.evaluated()?, &self.around.device).map_err(|source| self.failure(source))?;
        for picture in pictures {
            self.around.recorder.picture(self.stage.name(), self.state.step, &picture.name, &picture.image)?;
        }
        Ok(self.around.recorder.flush()?)
    }

    fn measure(&mut self) -> Result<(), TrainError> {
        let measured = self.stage.measure(&self.evaluated()?, &self.around.device).map_err(|source| self.failure(source))?;
        let row = Row { stage: self.stage.name(), step: self.state.step, kind: Kind::Validate, values: &measured };
        self.around.recorder.row(&row)?;
        self.around.recorder.flush()?;
        if let Some((_, figure)) = measured.first().filter(|(_, figure)| figure.is_finite()) {
            self.state.best.push(Measured { step: self.state.step, figure: *figure });
            self.state.best.sort_by(|a, b| a.figure.total_cmp(&b.figure));
        }
        self.state.best.truncate(self.around.store.keep_best);
        self.state.measured = measured;
        Ok(())
    }

    /// Whether the weights of this step belong to the best that were measured, so that their checkpoint is kept.
    pub(super) fn is_among_best(&self) -> bool {
        self.state.best.iter().any(|measured| measured.step == self.state.step)
    }

    pub(super) fn save(&mut self) -> Result<(), TrainError> {
        // Numbers first: after a resume the metrics reach at least as far as the checkpoint.
        self.around.recorder.flush()?;
        self.state.seconds = self.seconds_before + self.began.elapsed().as_secs_f64();
        let average = self.average.as_ref().map(|average| average.values.clone()).unwrap_or_default();
        let (first, second) = (self.adam.first.clone(), self.adam.second.clone());
        let checkpoint = Checkpoint { state: self.state.clone(), weights: values(&self.net), average, first, second };
        self.around.store.save(&checkpoint)?;
        Ok(())
    }

    pub(super) fn finish(self) -> Result<Outcome<S::Net>, TrainError> {
        let seconds = self.seconds_before + self.began.elapsed().as_secs_f64();
        let data_wait_share = self.waiting.as_secs_f64() / self.stepping.as_secs_f64().max(1e-9);
        let (net, State { measured, skipped, .. }) = (self.evaluated()?, self.state);
        let trained = Trained { net, measured, skipped, seconds, data_wait_share };
        Ok(Outcome::Finished(Box::new(trained)))
    }
}

/// Adds a batch's share of the losses to the row of its step.
fn add(row: &mut Vec<(String, f64)>, losses: Vec<(String, f64)>, batches: usize) {
    if batches == 1 {
        *row = losses;
        return;
    }
    for (name, value) in losses {
        let share = value / batches as f64;
        match row.iter_mut().find(|(known, _)| *known == name) {
            Some((_, sum)) => *sum += share,
            None => row.push((name, share)),
        }
    }
}
