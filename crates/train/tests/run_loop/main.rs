//! Laws of the training loop, on a net of four numbers.

mod slope;
mod toy;

use ops::compute::Compute;
use slope::Slope;
use std::path::Path;
use std::sync::Mutex;
use toy::Toy;
use train::checkpoint::Store;
use train::config::OnNan;
use train::optimiser::LossScale;
use train::recorder::{Kind, Metrics, Previews, Recorder, read_steps};
use train::run_folder::{FolderError, RunFolder};
use train::run_loop::{Outcome, Surroundings, TrainError, Trained, train};
use train::stage::Stage;

/// burn's CPU generator is one per process: two trainings at once would draw from each other's.
static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());

struct Options {
    workers: usize,
    compute: Compute,
    on_nan: OnNan,
    every: u64,
    stop_at: Option<u64>,
    keep_best: usize,
    devices: usize,
}

impl Default for Options {
    fn default() -> Self {
        Self { workers: 1, compute: Compute::F32, on_nan: OnNan::Stop, every: 10, stop_at: None, keep_best: 0, devices: 1 }
    }
}

fn run<S: Stage>(folder: &Path, stage: &S, options: &Options) -> Result<Outcome<S::Net>, TrainError> {
    let _alone = ONE_AT_A_TIME.lock().unwrap_or_else(|poison| poison.into_inner());
    let describe = |folder: &RunFolder| -> Result<(), FolderError> {
        folder.write("run.json", "{}")?;
        folder.write("config.toml", "")
    };
    let folder = if folder.exists() { RunFolder::open(folder) } else { RunFolder::create(folder, false, describe) }.unwrap();
    let store = Store { folder: folder.checkpoints(), keep_last: 2, keep_best: options.keep_best, fingerprint: "toy".into() };
    let mut recorders: Vec<Box<dyn Recorder>> =
        vec![Box::new(Metrics::open(&folder.metrics()).unwrap()), Box::new(Previews { folder: folder.previews() })];
    let device = burn::tensor::Device::flex();
    let from = store.newest("toy", &device)?;
    let mut around = Surroundings {
        others: vec![device.clone(); options.devices - 1],
        device,
        seed: 5,
        compute: options.compute,
        data_workers: options.workers,
        on_nan: options.on_nan,
        checkpoint_every: options.every,
        store: &store,
        failures: &folder.failures(),
        recorder: &mut recorders,
        stop: &|step| options.stop_at == Some(step),
        seconds_before: 0.0,
    };
    train(stage, &mut around, from)
}

fn finished<N>(outcome: Result<Outcome<N>, TrainError>) -> Box<Trained<N>> {
    match outcome.unwrap() {
        Outcome::Finished(trained) => trained,
        Outcome::Stopped { step } => panic!("stopped at step {step}"),
    }
}

/// Losses and gradient norms by step, as bits.
fn curve(folder: &Path) -> Vec<(u64, u64, u64)> {
    let read = |name| read_steps(&folder.join("metrics.jsonl"), Kind::Train, name).unwrap();
    read("loss")
        .iter()
        .zip(read("gradient_norm"))
        .map(|((_, step, loss), (_, _, norm))| (*step, loss.to_bits(), norm.to_bits()))
        .collect()
}

fn new_run(name: &str) -> (tempfile::TempDir, std::path::PathBuf) {
    let home = tempfile::tempdir().unwrap();
    let path = home.path().join(name);
    (home, path)
}

#[test]
fn the_line_is_found_and_the_run_leaves_curves_pictures_and_checkpoints() {
    let (_home, folder) = new_run("run");
    let trained = finished(run(&folder, &Toy::new(150), &Options::default()));
    assert!(trained.measured[0].1 < 0.3, "{:?}", trained.measured);
    assert_eq!(curve(&folder).len(), 150);
    assert_eq!(read_steps(&folder.join("metrics.jsonl"), Kind::Validate, "slope_error").unwrap().len(), 30);
    assert!(folder.join("previews/toy-000001-line.png").is_file());
    assert_eq!(std::fs::read_dir(folder.join("checkpoints")).unwrap().count(), 2);
}

#[test]
fn a_stop_and_resume_equals_no_stop_to_the_last_bit_whatever_the_workers() {
    for accumulate in [1, 3] {
        let mut stage = Toy::new(20);
        stage.plan.accumulate = accumulate;
        let (_home, whole) = new_run("whole");
        let straight = finished(run(&whole, &stage, &Options::default()));
        let (_home, parts) = new_run("parts");
        for (stop_at, workers) in [(7, 2), (8, 4)] {
            let options = Options { workers, stop_at: Some(stop_at), ..Options::default() };
            assert!(matches!(run(&parts, &stage, &options).unwrap(), Outcome::Stopped { step } if step == stop_at));
        }
        let resumed = finished(run(&parts, &stage, &Options { workers: 3, ..Options::default() }));
        assert_eq!(curve(&whole), curve(&parts));
        assert_eq!(straight.measured[0].1.to_bits(), resumed.measured[0].1.to_bits());
    }
}

/// The CPU stands in for every one of the cards: it is the same code that shares the batches.
#[test]
fn several_devices_give_the_steps_of_one_to_the_last_bit_also_over_a_stop() {
    for (accumulate, counts) in [(4, [2, 3, 4]), (5, [2, 4, 5])] {
        let mut stage = Toy::new(20);
        stage.plan.accumulate = accumulate;
        let (_home, one) = new_run("one");
        let alone = finished(run(&one, &stage, &Options::default()));
        for devices in counts {
            let (_home, several) = new_run("several");
            let stopped = run(&several, &stage, &Options { devices, stop_at: Some(7), ..Options::default() });
            assert!(matches!(stopped.unwrap(), Outcome::Stopped { step: 7 }));
            let together = finished(run(&several, &stage, &Options { devices: devices - 1, ..Options::default() }));
            assert_eq!(curve(&one), curve(&several), "{accumulate} batches on {devices} devices");
            assert_eq!(alone.measured[0].1.to_bits(), together.measured[0].1.to_bits());
        }
    }
}

#[test]
fn a_bad_batch_is_blamed_on_whichever_device_it_was() {
    for poisoned in [13, 14] {
        let (_home, folder) = new_run("run");
        let mut stage = Toy::new(10);
        stage.plan.accumulate = 4;
        stage.poisoned = vec![poisoned];
        let Err(error) = run(&folder, &stage, &Options { devices: 3, ..Options::default() }) else { panic!("it went on") };
        let TrainError::NonFinite { step, batch, .. } = &error else { panic!("{error}") };
        assert_eq!((*step, *batch), (3, poisoned));
        let options = Options { on_nan: OnNan::Restore, devices: 2, ..Options::default() };
        assert_eq!(finished(run(&folder, &stage, &options)).skipped, [poisoned]);
    }
}

#[test]
fn a_kill_between_checkpoints_costs_only_the_steps_since() {
    let options = Options { every: 6, ..Options::default() };
    let (_home, whole) = new_run("whole");
    finished(run(&whole, &Toy::new(20), &options));
    // What a kill after step 20 leaves when the checkpoint of step 20 didn't get written: later rows, a torn last line.
    let (_home, killed) = new_run("killed");
    finished(run(&killed, &Toy::new(20), &options));
    std::fs::remove_file(killed.join("checkpoints/toy-00000020.safetensors")).unwrap();
    let metrics = killed.join("metrics.jsonl");
    let text = std::fs::read_to_string(&metrics).unwrap();
    std::fs::write(&metrics, &text[..text.len() - 5]).unwrap();
    finished(run(&killed, &Toy::new(20), &options));
    assert_eq!(curve(&whole), curve(&killed));
}

#[test]
fn another_seed_of_the_data_gives_another_curve() {
    let (_home, clean) = new_run("a");
    finished(run(&clean, &Toy::new(6), &Options::default()));
    let (_home, other) = new_run("b");
    let mut stage = Toy::new(6);
    stage.plan.accumulate = 2;
    finished(run(&other, &stage, &Options::default()));
    assert_ne!(curve(&clean), curve(&other));
}

#[test]
fn accumulated_gradients_and_losses_are_means_over_the_batches_of_a_step() {
    let (_home, folder) = new_run("run");
    let stage = Slope { steps: 3, plan: Slope::plan(0.01, 4, 0.0) };
    let trained = finished(run(&folder, &stage, &Options::default()));
    // Means of 1 … 4, 5 … 8 and 9 … 12, each with the weight of its step.
    let (means, mut weight) = ([2.5, 6.5, 10.5], 1.0);
    let read = |name| read_steps(&folder.join("metrics.jsonl"), Kind::Train, name).unwrap();
    for (step, mean) in means.into_iter().enumerate() {
        assert!((read("gradient_norm")[step].2 - mean).abs() < 1e-5);
        assert!((read("loss")[step].2 - mean * weight).abs() < 1e-5);
        weight -= 0.01 * mean;
    }
    assert!((trained.measured[0].1 - weight).abs() < 1e-5, "{:?} instead of {weight}", trained.measured);
}

#[test]
fn the_moving_average_is_what_is_measured_and_kept() {
    let (_home, folder) = new_run("run");
    let stage = Slope { steps: 30, plan: Slope::plan(1e-3, 1, 0.5) };
    let trained = finished(run(&folder, &stage, &Options::default()));
    let (mut weight, mut average) = (1.0_f64, 1.0);
    for step in 1..=30 {
        weight -= 1e-3 * f64::from(step);
        let decay = 0.5_f64.min((1.0 + f64::from(step)) / (10.0 + f64::from(step)));
        average = decay * average + (1.0 - decay) * weight;
    }
    assert!((average - weight).abs() > 0.01);
    assert!((trained.measured[0].1 - average).abs() < 1e-5, "{:?} instead of {average}", trained.measured);
    assert!((f64::from(trained.net.weight.val().into_scalar::<f32>()) - average).abs() < 1e-5);
}

/// The factor on the loss that a run's newest checkpoint holds.
fn loss_scale(folder: &Path) -> LossScale {
    let store = Store { folder: folder.join("checkpoints"), keep_last: 2, keep_best: 0, fingerprint: "toy".into() };
    store.newest("toy", &burn::tensor::Device::flex()).unwrap().unwrap().state.loss_scale
}

#[test]
fn half_precision_finds_the_factor_that_its_gradients_bear() {
    let gradients = |compute| {
        let (_home, folder) = new_run("run");
        let stage = Slope { steps: 12, plan: Slope::plan(1e-4, 1, 0.0) };
        finished(run(&folder, &stage, &Options { compute, ..Options::default() }));
        let norms = read_steps(&folder.join("metrics.jsonl"), Kind::Train, "gradient_norm").unwrap();
        (norms.into_iter().map(|row| row.2).collect::<Vec<_>>(), loss_scale(&folder))
    };
    let slopes: Vec<f64> = (1..=12).map(f64::from).collect();
    for compute in [Compute::F32, Compute::Bf16] {
        assert_eq!(gradients(compute), (slopes.clone(), LossScale::default()), "{compute:?}");
    }
    // A gradient of 9 was the first that 8,192 took beyond 65,504; four good steps since. No batch was lost.
    assert_eq!(gradients(Compute::F16), (slopes, LossScale { factor: 4096.0, steps: 5 }));
}

#[test]
fn a_run_in_half_precision_goes_on_to_the_last_bit_and_with_its_factor() {
    let stage = Slope { steps: 12, plan: Slope::plan(1e-4, 1, 0.0) };
    for compute in [Compute::F16, Compute::Bf16] {
        let (_home, whole) = new_run("whole");
        let straight = finished(run(&whole, &stage, &Options { compute, ..Options::default() }));
        let (_home, parts) = new_run("parts");
        let stopped = run(&parts, &stage, &Options { compute, stop_at: Some(7), ..Options::default() });
        assert!(matches!(stopped.unwrap(), Outcome::Stopped { step: 7 }));
        let resumed = finished(run(&parts, &stage, &Options { compute, ..Options::default() }));
        assert_eq!((curve(&whole), loss_scale(&whole)), (curve(&parts), loss_scale(&parts)), "{compute:?}");
        assert_eq!(straight.measured[0].1.to_bits(), resumed.measured[0].1.to_bits());
    }
}

/// Four batches of a step are begun at once with the same factor, which the first of them halves.
#[test]
fn half_precision_finds_the_same_factor_on_several_devices_as_on_one() {
    let stage = Slope { steps: 3, plan: Slope::plan(1e-4, 4, 0.0) };
    let result = |devices| {
        let (_home, folder) = new_run("run");
        let trained = finished(run(&folder, &stage, &Options { compute: Compute::F16, devices, ..Options::default() }));
        (curve(&folder), loss_scale(&folder), trained.measured[0].1.to_bits())
    };
    let alone = result(1);
    // The gradient of 8, the last of the second step, was the first that 8,192 took beyond 65,504.
    assert_eq!(alone.1, LossScale { factor: 4096.0, steps: 2 });
    for devices in [2, 3, 4] {
        assert_eq!(result(devices), alone, "{devices} devices");
    }
}

#[test]
fn numbers_that_go_bad_in_half_precision_point_at_the_format() {
    for (poisoned, steep) in [(vec![12], vec![]), (vec![], vec![12])] {
        for (compute, named) in [(Compute::F16, true), (Compute::F32, false)] {
            let (_home, folder) = new_run("run");
            let mut stage = Toy::new(20);
            (stage.poisoned, stage.steep) = (poisoned.clone(), steep.clone());
            let Err(error) = run(&folder, &stage, &Options { compute, ..Options::default() }) else { panic!("it went on") };
            assert!(matches!(error, TrainError::NonFinite { batch: 12, .. }), "{error}");
            assert_eq!(error.to_string().contains("run.compute"), named, "{error}");
        }
    }
}

#[test]
fn a_loss_that_is_not_a_number_stops_with_step_term_and_dump() {
    let (_home, folder) = new_run("run");
    let mut stage = Toy::new(20);
    stage.poisoned = vec![12];
    let Err(error) = run(&folder, &stage, &Options::default()) else { panic!("it went on") };
    let TrainError::NonFinite { step, term, batch, dump, .. } = &error else { panic!("{error}") };
    assert_eq!((*step, term.as_str(), *batch), (12, "distance", 12));
    assert_eq!(dump.bad, Some(("y".into(), 6)));
    let dumped = std::fs::read(&dump.path).unwrap();
    assert_eq!(safetensors::SafeTensors::deserialize(&dumped).unwrap().tensor("x").unwrap().shape(), [6]);
    assert!(error.to_string().contains("on_nan"), "{error}");
}

#[test]
fn restore_goes_back_skips_the_batch_and_counts_it() {
    for poisoned in [vec![12], vec![2], vec![2, 12, 13]] {
        let (_home, folder) = new_run("run");
        let mut stage = Toy::new(20);
        stage.poisoned = poisoned.clone();
        let trained = finished(run(&folder, &stage, &Options { on_nan: OnNan::Restore, ..Options::default() }));
        assert_eq!(trained.skipped, poisoned);
        let steps: Vec<u64> = curve(&folder).iter().map(|row| row.0).collect();
        assert_eq!(steps, (1..=20).collect::<Vec<_>>());
    }
}

#[test]
fn a_gradient_that_is_not_a_number_is_traced_to_its_batch_and_parameter() {
    for accumulate in [1, 3] {
        let (_home, folder) = new_run("run");
        let mut stage = Toy::new(20);
        stage.plan.accumulate = accumulate;
        stage.steep = vec![12];
        let Err(error) = run(&folder, &stage, &Options::default()) else { panic!("it went on") };
        let TrainError::NonFinite { step, term, batch, dump, .. } = &error else { panic!("{error}") };
        assert_eq!((*step, *batch), (12 / accumulate as u64, 12));
        assert!(term.starts_with("gradient of layers.0."), "{term}");
        assert_eq!(dump.bad, None);
        // The run that skips it goes back no further than it must, and blames no other batch of the step.
        let restored = finished(run(&folder, &stage, &Options { on_nan: OnNan::Restore, ..Options::default() }));
        assert_eq!(restored.skipped, [12]);
    }
}

#[test]
fn weights_that_are_not_numbers_never_become_a_checkpoint() {
    let (_home, folder) = new_run("run");
    let mut stage = Toy::new(20);
    stage.plan.adam.epsilon = 1e-320;
    stage.plan.weight_decay = 0.0;
    stage.plan.clip = 1e-30;
    let Err(error) = run(&folder, &stage, &Options { every: 1, ..Options::default() }) else { panic!("it went on") };
    let TrainError::NonFinite { term, .. } = &error else { panic!("{error}") };
    assert!(term.starts_with("weight layers."), "{term}");
    assert_eq!(std::fs::read_dir(folder.join("checkpoints")).unwrap().count(), 0);
}

#[test]
fn the_best_measured_checkpoints_stay_also_over_a_stop() {
    let (_home, folder) = new_run("run");
    let options = |stop_at| Options { every: 7, keep_best: 2, stop_at, ..Options::default() };
    assert!(matches!(run(&folder, &Toy::new(60), &options(Some(33))).unwrap(), Outcome::Stopped { .. }));
    finished(run(&folder, &Toy::new(60), &options(None)));
    let mut measured = read_steps(&folder.join("metrics.jsonl"), Kind::Validate, "slope_error").unwrap();
    measured.sort_by(|a, b| a.2.total_cmp(&b.2));
    let mut expected: Vec<u64> = [60, 56].into_iter().chain(measured[..2].iter().map(|(_, step, _)| *step)).collect();
    expected.sort_unstable();
    expected.dedup();
    let name = |step: u64| format!("toy-{step:08}.safetensors");
    let mut files: Vec<_> = std::fs::read_dir(folder.join("checkpoints"))
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    files.sort();
    assert_eq!(files, expected.into_iter().map(name).collect::<Vec<_>>());
}

#[test]
fn restore_gives_up_when_everything_is_bad() {
    let (_home, folder) = new_run("run");
    let mut stage = Toy::new(20);
    stage.poisoned = (0..100).collect();
    let outcome = run(&folder, &stage, &Options { on_nan: OnNan::Restore, ..Options::default() });
    assert!(matches!(outcome, Err(TrainError::NonFinite { .. })));
}
