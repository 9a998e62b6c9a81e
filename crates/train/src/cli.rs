//! The command line: from arguments to a run and an exit code.

use crate::checkpoint::CheckpointError;
use crate::config::{Config, ConfigError, reference};
use crate::device::{self, DeviceError};
use crate::export::{self, ExportError};
use crate::fingerprint;
use crate::import::{self, ImportError};
use crate::interrupt;
use crate::pipeline::{self, Ending, Part, Pipeline, RunError, batches_of};
use crate::report::pretty;
use crate::run_folder::{FolderError, RunFolder};
use crate::stage::plan::{CHAIRS, no_released_weights, released_weights};
use crate::sweep::{self, SweepArguments};
use crate::taken::TakenError;
use crate::watch::{self, WatchArguments, WatchError};
use burn::tensor::Device;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use clap::{Args, Parser, Subcommand};
use dataset::material::MaterialLibrary;
use flow::pwc::PwcConfig;
use ops::weights::Precision;
use serde_json::json;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Trains the flow nets and the SVBRDF net on synthetic scanning videos.
///
/// Exit codes: 0 done, 1 failed, 2 bad usage or config, 130 stopped by Ctrl-C or SIGTERM with a checkpoint written.
#[derive(Debug, Parser)]
#[command(name = "train", version, args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub struct Arguments {
    /// Something else than training.
    #[command(subcommand)]
    task: Option<Task>,
    /// Config file: a path, or a name in configs/.
    #[arg(long, value_name = "NAME", required_unless_present = "resume", conflicts_with = "resume")]
    config: Option<String>,
    /// Set one value over the config, for example `--set svbrdf.steps=200`; may be repeated.
    #[arg(long = "set", value_name = "TABLE.KEY=VALUE")]
    assignments: Vec<String>,
    /// Print the resolved config and stop.
    #[arg(long)]
    dry_run: bool,
    /// Where the nets run: cpu, or vulkan, wgpu, cuda when built with that feature, with the number of a card if need be
    /// (cuda:1). Several cards (cuda:0,cuda:1) share the batches of a step, of which there must be as many
    /// (optimisation.accumulate) [default: cpu; with --resume the device of the run].
    #[arg(long)]
    device: Option<String>,
    /// Run folder [default: runs/NAME].
    #[arg(long, value_name = "DIR", conflicts_with = "resume")]
    out: Option<PathBuf>,
    /// Replace an earlier run in the run folder.
    #[arg(long, conflicts_with = "resume")]
    force: bool,
    /// Continue a run that was stopped.
    #[arg(long, value_name = "RUN")]
    resume: Option<PathBuf>,
    /// With --resume: continue from this checkpoint instead of the newest.
    #[arg(long, value_name = "FILE", requires = "resume")]
    checkpoint: Option<PathBuf>,
    /// Take over the nets that this run has trained and that would come out the same here, instead of training them again;
    /// may be repeated.
    #[arg(long, value_name = "RUN")]
    nets_of: Vec<PathBuf>,
}

/// What the program does besides one run.
#[derive(Debug, Subcommand)]
enum Task {
    /// Runs variants of one config with several seeds and compares them in one table.
    Sweep(SweepArguments),
    /// Writes the nets of a finished run for other programs: safetensors, manifest, model card, PyTorch loader.
    Export(ExportArguments),
    /// Shows how a run is getting on and its curves, in the terminal.
    Watch(WatchArguments),
    /// Prints the reference of all config keys as Markdown (docs/config.md).
    ConfigReference {
        /// As a JSON Schema, for editors that complete and check TOML.
        #[arg(long)]
        schema: bool,
    },
    /// Reads PWC-Net as Sun et al. published it from a PyTorch checkpoint into a folder of weights.
    Import(ImportArguments),
}

#[derive(Debug, Args)]
struct ExportArguments {
    /// Run folder.
    #[arg(long, value_name = "RUN")]
    run: PathBuf,
    /// Folder for the export; it must not exist yet.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Number type of the weights; f16 and bf16 halve the files and round.
    #[arg(long, default_value = "f32", value_parser = precision())]
    dtype: Precision,
    /// Nets whose weights are larger are cut into several files; many hosts refuse files of more than 100 MB.
    #[arg(long, value_name = "MIB", default_value_t = 95, value_parser = clap::value_parser!(u64).range(1..=1 << 20))]
    max_file: u64,
    /// Replace an earlier export.
    #[arg(long)]
    force: bool,
}

#[derive(Debug, Args)]
struct ImportArguments {
    /// Checkpoint: .pth, .pt or .pth.tar of any PyTorch since 2017, or .safetensors.
    file: PathBuf,
    /// Folder of weights to add the net to; made if need be.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Name of the net in the folder, for example adjacent; may be repeated.
    #[arg(long = "net", value_name = "NAME", default_value = CHAIRS)]
    nets: Vec<String>,
    /// Licence of the checkpoint, for the manifest.
    #[arg(long, value_name = "TEXT")]
    licence: Option<String>,
    /// Replace nets of the same name.
    #[arg(long)]
    force: bool,
}

fn precision() -> impl TypedValueParser<Value = Precision> {
    PossibleValuesParser::new(Precision::ALL.map(Precision::name))
        .map(|name| Precision::ALL.into_iter().find(|p| p.name() == name).unwrap_or_default())
}

/// Why the program ends without a finished run.
#[derive(Debug, thiserror::Error)]
pub(crate) enum Failure {
    #[error("{0}")]
    Usage(String),
    #[error(transparent)]
    Run(#[from] RunError),
    /// A run that ended in the middle, with what it had reached on the disk.
    #[error("{error}\n  = what was trained until the last checkpoint is kept; once that is mended, `--resume {}` goes on", run.display())]
    Interrupted { error: Box<RunError>, run: PathBuf },
    #[error(transparent)]
    Export(ExportError),
    #[error(transparent)]
    Import(ImportError),
    #[error(transparent)]
    Watch(WatchError),
    /// A sweep that ends without a table, or an engine that doesn't take it.
    #[error("{0}")]
    Sweep(String),
}

impl From<ExportError> for Failure {
    fn from(error: ExportError) -> Self {
        if error.is_usage() { Self::Usage(error.to_string()) } else { Self::Export(error) }
    }
}

impl From<ImportError> for Failure {
    fn from(error: ImportError) -> Self {
        if error.is_usage() { Self::Usage(error.to_string()) } else { Self::Import(error) }
    }
}

impl From<WatchError> for Failure {
    fn from(error: WatchError) -> Self {
        match error {
            WatchError::Absent { .. } | WatchError::NoStage { .. } => Self::Usage(error.to_string()),
            WatchError::Io { .. } => Self::Watch(error),
        }
    }
}

impl From<ConfigError> for Failure {
    fn from(error: ConfigError) -> Self {
        Self::Usage(error.to_string())
    }
}

impl From<FolderError> for Failure {
    fn from(error: FolderError) -> Self {
        match error {
            FolderError::Exists { .. } | FolderError::Foreign { .. } | FolderError::Absent { .. } => {
                Self::Usage(error.to_string())
            }
            FolderError::Locked { .. } | FolderError::Io { .. } => Self::Run(RunError::Folder(error)),
        }
    }
}

/// Nets of a run that don't fit are bad usage; files that fail are not.
fn take(folder: &RunFolder, config: &Config, run: &Path) -> Result<(), Failure> {
    match crate::taken::take(folder, config, run) {
        Ok(stages) => {
            eprintln!("taken from {}: {}", run.display(), stages.join(", "));
            Ok(())
        }
        Err(RunError::Folder(error)) => Err(error.into()),
        Err(error @ RunError::Taken(TakenError::Different { .. } | TakenError::Config(_))) => {
            Err(Failure::Usage(error.to_string()))
        }
        Err(error) => Err(error.into()),
    }
}

/// Runs the program.
pub fn main() -> ExitCode {
    ops::process::keep_memory();
    // clap itself exits with 2 on bad usage, 0 on --help.
    match run(&Arguments::parse()) {
        Ok(code) => code,
        Err(failure) => {
            eprintln!("error: {failure}");
            ExitCode::from(if matches!(failure, Failure::Usage(_)) { 2 } else { 1 })
        }
    }
}

fn run(arguments: &Arguments) -> Result<ExitCode, Failure> {
    match &arguments.task {
        Some(Task::Export(arguments)) => export(arguments),
        Some(Task::Import(arguments)) => import(arguments),
        Some(Task::Sweep(arguments)) => sweep::run(arguments),
        Some(Task::Watch(arguments)) => Ok(watch::run(arguments).map(|()| ExitCode::SUCCESS)?),
        Some(Task::ConfigReference { schema }) => print_reference(*schema),
        None => train(arguments),
    }
}

fn print_reference(schema: bool) -> Result<ExitCode, Failure> {
    let text = if schema { pretty(&reference::schema()).map_err(RunError::Io)? } else { reference::markdown() };
    print!("{text}");
    Ok(ExitCode::SUCCESS)
}

fn export(arguments: &ExportArguments) -> Result<ExitCode, Failure> {
    let ExportArguments { run, out, dtype, max_file, force } = arguments;
    let request =
        export::Request { run: run.clone(), out: out.clone(), precision: *dtype, largest_file: max_file << 20, force: *force };
    for export::Exported { net, record, rounding } in export::export(&request)? {
        println!("{net}: {} weights as {}; {}", record.parameters, record.precision, rounding.words(&record));
    }
    println!("{}: read README.md first", out.display());
    Ok(ExitCode::SUCCESS)
}

fn import(arguments: &ImportArguments) -> Result<ExitCode, Failure> {
    let ImportArguments { file, out, nets, licence, force } = arguments;
    let request =
        import::Request { file: file.clone(), out: out.clone(), nets: nets.clone(), licence: licence.clone(), force: *force };
    let import::Imported { architecture, files } = import::import(&request)?;
    for path in &files {
        println!("{}: PWC-Net as published, {} weights", path.display(), architecture.parameters());
    }
    if licence.is_none() {
        eprintln!(
            "note: the manifest doesn't say under which licence these weights are; those that NVIDIA released are CC BY-NC-SA 4.0 (no commercial use). State it with --licence TEXT and --force"
        );
    }
    let size = if architecture == PwcConfig::published() {
        "size = \"published\"".to_string()
    } else {
        format!("architecture = {}", inline(&architecture))
    };
    if let Some(first) = files.first() {
        println!("to train on from there:\n\n[flow]\n{size}\ninit = \"{}\"", first.display());
    }
    Ok(ExitCode::SUCCESS)
}

/// An architecture on one line of TOML.
fn inline(architecture: &PwcConfig) -> String {
    match toml::Value::try_from(architecture) {
        Ok(value) => value.to_string(),
        Err(error) => format!("# {error}"),
    }
}

fn train(arguments: &Arguments) -> Result<ExitCode, Failure> {
    let config = match (&arguments.config, &arguments.resume) {
        (Some(name), _) => Config::load(name, &arguments.assignments)?,
        (None, Some(run)) => resumed_config(run, &arguments.assignments)?,
        (None, None) => return Err(Failure::Usage("give `--config NAME` or `--resume RUN`".into())),
    };
    if arguments.dry_run {
        print!("{}", config.to_toml());
        return Ok(ExitCode::SUCCESS);
    }
    check_start(&config)?;
    let name = device_name(arguments);
    let (device, others) = open_devices(&name, &config).map_err(|error| Failure::Usage(error.to_string()))?;
    // Before the folder: a wrong path to the materials leaves nothing behind.
    let materials = pipeline::open_library(&config).map_err(|error| Failure::Usage(error.to_string()))?;
    let folder = match &arguments.resume {
        Some(run) => RunFolder::open(run)?,
        None => {
            let path = arguments.out.clone().unwrap_or_else(|| Path::new("runs").join(&config.run.name));
            RunFolder::create(&path, arguments.force, |folder| describe_run(folder, &config, &name, &materials))?
        }
    };
    for other in &arguments.nets_of {
        take(&folder, &config, other)?;
    }
    interrupt::install().map_err(|error| Failure::Usage(format!("cannot listen for Ctrl-C: {error}")))?;
    let stop = |_| interrupt::requested();
    let checkpoint = arguments.checkpoint.clone();
    let revision = crate::revision::revision();
    let mut pipeline =
        Pipeline { config: &config, folder: &folder, device, others, materials, revision, checkpoint, stop: &stop };
    match pipeline.run().map_err(|error| interrupted(error, &folder))? {
        Ending::Done => {
            eprintln!("done: {}", folder.path().display());
            Ok(ExitCode::SUCCESS)
        }
        Ending::Stopped { stage, step } => {
            let path = folder.path().display();
            eprintln!("stopped in {stage} after step {step}; continue with `--resume {path}`");
            Ok(ExitCode::from(interrupt::EXIT_CODE))
        }
    }
}

/// The devices of a run, the main one apart.
fn open_devices(names: &str, config: &Config) -> Result<(Device, Vec<Device>), DeviceError> {
    let names = device::of_one_run(names)?;
    let trained = Part::ALL.into_iter().flat_map(|part| part.trained(config));
    device::check_batches(&names, &trained.map(|stage| (stage, batches_of(config, stage))).collect::<Vec<_>>())?;
    let main = device::open(&names[0])?;
    device::check_format(&main, &names[0], config.run.compute)?;
    let others = names[1..].iter().map(|name| device::open(name)).collect::<Result<_, _>>()?;
    Ok((main, others))
}

/// The device of the command line, else the one that a resumed run began on.
fn device_name(arguments: &Arguments) -> String {
    let began = arguments.resume.as_ref().and_then(|run| {
        let text = std::fs::read(run.join("run.json")).ok()?;
        Some(serde_json::from_slice::<serde_json::Value>(&text).ok()?["device"].as_str()?.to_string())
    });
    if let (Some(began), Some(now)) = (&began, &arguments.device)
        && device::kind(began) != device::kind(now)
    {
        eprintln!("note: this run began on {began} and goes on on {now}: its numbers will differ in their last digits");
    }
    arguments.device.clone().or(began).unwrap_or_else(|| "cpu".into())
}

/// A refused checkpoint says itself how to go on.
fn interrupted(error: RunError, folder: &RunFolder) -> Failure {
    match error {
        RunError::Checkpoint(CheckpointError::Refused { .. }) => Failure::Run(error),
        error => Failure::Interrupted { error: Box::new(error), run: folder.path().into() },
    }
}

/// A resumed run continues as it began: only what doesn't change the results may be set anew.
fn resumed_config(run: &Path, assignments: &[String]) -> Result<Config, Failure> {
    let path = run.join("config.toml");
    if !path.is_file() {
        return Err(FolderError::Absent { path: run.into() }.into());
    }
    let (before, now) = (Config::from_file(&path, &[])?, Config::from_file(&path, assignments)?);
    if fingerprint::of_run(&before) != fingerprint::of_run(&now) {
        let message = "a resumed run continues as it began: of the config only run.data_workers, run.on_nan, run.material_cache_mib, histogram_every, checkpoint.* and report.* may be set anew; start a new run with `--config` for other values";
        return Err(Failure::Usage(message.into()));
    }
    Ok(now)
}

/// Finds missing starting weights before any work.
pub(crate) fn check_start(config: &Config) -> Result<(), Failure> {
    use crate::config::FlowInit;
    if config.svbrdf.steps > 0 && config.report.evaluate {
        crate::report::flow_nets(config).map_err(|error| Failure::Usage(error.to_string()))?;
    }
    let needed = config.chairs.steps == 0 && config.adjacent.steps + config.distant.steps > 0;
    match &config.flow.init {
        FlowInit::Weights if needed && released_weights().is_none() => Err(Failure::Usage(no_released_weights())),
        FlowInit::File(path) if !path.is_file() => Err(Failure::Usage(format!(
            "`flow.init` names {}, which is not there: expected a .safetensors file",
            path.display()
        ))),
        _ => Ok(()),
    }
}

/// Writes what a person needs to repeat the run, before any work.
pub(crate) fn describe_run(
    folder: &RunFolder,
    config: &Config,
    device: &str,
    materials: &MaterialLibrary,
) -> Result<(), Failure> {
    let started = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).map_or(0, |since| since.as_secs());
    let run = json!({
        "name": config.run.name,
        "command": std::env::args().collect::<Vec<_>>(),
        "revision": crate::revision::revision(),
        "version": env!("CARGO_PKG_VERSION"),
        "burn": "0.22.1",
        "device": device,
        "seed": config.run.seed,
        "cores": std::thread::available_parallelism().map_or(0, usize::from),
        "system": std::env::consts::OS,
        "started_unix": started,
    });
    folder.write("config.toml", &config.to_toml())?;
    folder.write("run.json", &pretty(&run).map_err(RunError::Io)?)?;
    folder.write("materials.json", &pretty(&materials.manifest()).map_err(RunError::Io)?)?;
    Ok(())
}
