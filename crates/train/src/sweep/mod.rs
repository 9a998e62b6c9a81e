//! `train sweep FILE`: variants of one config under several seeds, compared in one table (paper §8.3, Table 2).
//!
//! Every run has a folder of its own, made ready before anything starts; what is finished there is never repeated, what is
//! half done goes on from its checkpoint. Runs that would train the same nets share them.

mod engine;
mod file;
mod folders;
mod local;
mod outcome;
mod plan;

pub use file::{Member, Sweep};
pub use plan::{Run, levels, plan};

use crate::cli::Failure;
use crate::device::{self, DeviceError};
use crate::interrupt;
use crate::pipeline::RunError;
use clap::{Args, ValueEnum};
use engine::Tasks;
use folders::State;
use local::Local;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Runs that failed, with the reason.
pub type Failures = BTreeMap<String, String>;

/// Who runs the runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Engine {
    /// Processes on this machine.
    Local,
    /// A HyperQueue server (`hq`).
    Hyperqueue,
    /// A SLURM cluster (`sbatch`).
    Slurm,
}

/// Arguments of `train sweep`.
#[derive(Debug, Args)]
pub struct SweepArguments {
    /// Sweep file: a path, or a name in configs/.
    #[arg(value_name = "FILE")]
    file: String,
    /// Folder of the sweep, with one run folder per row and seed [default: runs/NAME].
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Set one value over all runs, for example `--set svbrdf.steps=200`; may be repeated.
    #[arg(long = "set", value_name = "TABLE.KEY=VALUE")]
    assignments: Vec<String>,
    /// Runs at a time on this machine; they share its cores.
    #[arg(long, value_name = "N", default_value = "1", value_parser = clap::value_parser!(u16).range(1..=256))]
    jobs: u16,
    /// List the runs, what they train and how far they are, and stop.
    #[arg(long)]
    dry_run: bool,
    /// Only write the tables of the runs that are finished.
    #[arg(long, conflicts_with = "dry_run")]
    table: bool,
    /// Who runs the runs. HyperQueue and SLURM get what isn't finished; write the table afterwards with `--table`.
    #[arg(long, value_enum, default_value = "local")]
    engine: Engine,
    /// Cores of one task of an engine [default: this machine's].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    cores: Option<u16>,
    /// Where the nets run: cpu, or vulkan, wgpu, cuda when built with that feature. With several, cuda:0,cuda:1, each run on
    /// this machine takes the next free one; --jobs says how many run at a time.
    #[arg(long, default_value = "cpu")]
    device: String,
    /// Make runs anew whose folder holds a run with another config.
    #[arg(long)]
    force: bool,
}

/// Runs the subcommand.
///
/// # Errors
/// A sweep file that can't be used, folders of other runs, or files that can't be written. Runs that fail are no error here:
/// they are counted, named and end in exit code 1.
pub(crate) fn run(arguments: &SweepArguments) -> Result<ExitCode, Failure> {
    let sweep = Sweep::load(&arguments.file, &arguments.assignments)?;
    let runs = plan(&sweep.members);
    let out = arguments.out.clone().unwrap_or_else(|| Path::new("runs").join(&sweep.name));
    let devices = devices(arguments).map_err(|error| Failure::Usage(error.to_string()))?;
    let mut states = Vec::with_capacity(runs.len());
    let mut outdated = Vec::new();
    for run in &runs {
        states.push(match folders::state(&out.join(&run.name), run) {
            Err(Failure::Usage(_)) if arguments.force && out.join(&run.name).join("run.json").is_file() => {
                outdated.push(run.name.clone());
                State::New
            }
            state => state?,
        });
    }
    if arguments.dry_run {
        list(&runs, &states, &out);
        return Ok(ExitCode::SUCCESS);
    }
    if arguments.table {
        return table(&sweep, &runs, &states, &out, &Failures::new());
    }
    prepare(&devices[0], &runs, &mut states, &outdated, &out)?;
    if arguments.engine != Engine::Local {
        return hand_over(arguments, &sweep.name, &runs, &states, &out);
    }
    interrupt::install().map_err(|error| Failure::Usage(format!("cannot listen for Ctrl-C: {error}")))?;
    let local = Local { out: &out, jobs: arguments.jobs.into(), devices: &devices };
    let Some(failures) = local.run(&runs, &mut states).map_err(RunError::Io)? else {
        let left = states.iter().filter(|state| **state != State::Finished).count();
        eprintln!("stopped with {left} of {} runs left; the same command goes on", runs.len());
        return Ok(ExitCode::from(interrupt::EXIT_CODE));
    };
    table(&sweep, &runs, &states, &out, &failures)
}

/// The devices that runs take turns on, each of them tried; one at least.
fn devices(arguments: &SweepArguments) -> Result<Vec<String>, DeviceError> {
    let devices = device::list(&arguments.device)?;
    match arguments.engine {
        Engine::Local => devices.iter().try_for_each(|name| device::open(name).map(drop))?,
        // The machines of an engine may have what this one lacks, and each task sees its own devices only.
        _ if devices.len() > 1 => return Err(DeviceError::Tasks { found: arguments.device.clone() }),
        _ => {}
    }
    Ok(devices)
}

fn prepare(device: &str, runs: &[Run], states: &mut [State], outdated: &[String], out: &Path) -> Result<(), Failure> {
    std::fs::create_dir_all(out).map_err(RunError::Io)?;
    for (run, state) in runs.iter().zip(states) {
        if *state == State::New {
            folders::prepare(&out.join(&run.name), run, device, outdated.contains(&run.name))?;
            *state = State::Begun;
        }
    }
    Ok(())
}

fn list(runs: &[Run], states: &[State], out: &Path) {
    for (run, state) in runs.iter().zip(states) {
        let state = match state {
            State::New => "new",
            State::Begun => "begun",
            State::Finished => "finished",
        };
        let takes: Vec<&str> = run.takes.iter().map(|&other| runs[other].name.as_str()).collect();
        let takes = if takes.is_empty() { String::new() } else { format!(", nets of {}", takes.join(" and ")) };
        println!("{state:>8}  {}: trains {}{takes}", out.join(&run.name).display(), run.trains(runs));
    }
}

/// Writes what the engine needs and submits it.
fn hand_over(arguments: &SweepArguments, name: &str, runs: &[Run], states: &[State], out: &Path) -> Result<ExitCode, Failure> {
    let due: Vec<usize> = (0..runs.len()).filter(|&index| states[index] != State::Finished).collect();
    let again = format!("train sweep {} --out {} --table", arguments.file, out.display());
    if due.is_empty() {
        eprintln!("all {} runs are finished; write the table with `{again}`", runs.len());
        return Ok(ExitCode::SUCCESS);
    }
    let cores = arguments.cores.map_or_else(|| std::thread::available_parallelism().map_or(1, usize::from), usize::from);
    let tasks = Tasks { out, name, runs, due: &due, device: &arguments.device, cores };
    let submissions = if arguments.engine == Engine::Slurm { tasks.slurm() } else { tasks.hyperqueue() };
    let said = engine::submit(&submissions.map_err(RunError::Io)?).map_err(Failure::Sweep)?;
    said.iter().for_each(|text| println!("{text}"));
    eprintln!("{} of {} runs submitted; when they are finished write the table with `{again}`", due.len(), runs.len());
    Ok(ExitCode::SUCCESS)
}

/// Writes and prints the tables of what is finished.
fn table(sweep: &Sweep, runs: &[Run], states: &[State], out: &Path, failures: &Failures) -> Result<ExitCode, Failure> {
    let finished = runs.iter().zip(states).filter(|(_, state)| **state == State::Finished);
    let finished = finished.map(|(run, _)| outcome::measured(out, run)).collect::<Result<Vec<_>, _>>()?;
    if finished.is_empty() {
        let reason = match failures.len() {
            0 => "none of the runs is finished".to_string(),
            failed => format!("none of the runs is finished, {failed} failed"),
        };
        return Err(Failure::Sweep(format!("there is no table to write in {}: {reason}", out.display())));
    }
    println!("{}", outcome::write(out, sweep.question.clone(), runs, &finished, failures)?);
    eprintln!("{} of {} runs in {}", finished.len(), runs.len(), out.join("table.md").display());
    Ok(if failures.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}
