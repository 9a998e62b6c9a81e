//! `evaluate`: the protocols as commands.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Context;
use clap::{Parser, Subcommand};
use dataset::image_io::Overwrite;
use dataset::material::library::{MaterialLibrary, PbrConfig, ProceduralConfig, SourceConfig};
use dataset::sequence::SequenceConfig;
use dataset::stream::Stream;
use evaluate::EvaluateError;
use evaluate::alignment::conditions;
use evaluate::alignment::store::{Common, Store};
use evaluate::alignment::{self, AlignmentConfig};
use evaluate::compare::ScannedMaps;
use evaluate::localisation::{self, LocalisationConfig};
use evaluate::synthetic::{self, SyntheticConfig};
use flow::weights::FlowNets;
use scan::nets::ScanNets;
use serde::Serialize;
use serde::de::DeserializeOwned;

/// Bytes of decoded materials kept in memory.
const CACHE_BYTES: usize = 1 << 30;

/// Measures trained weights on materials they never saw, beside baselines on identical frames.
#[derive(Parser)]
#[command(version)]
struct Arguments {
    #[command(subcommand)]
    protocol: Protocol,
}

#[derive(Subcommand)]
enum Protocol {
    /// Spiral scans of held-out materials: adjacent flow, automatic alignment and maps beside identity alignment, exact warps
    /// and constant maps. Writes summary.json, table.csv, table.md and a contact sheet per material.
    Synthetic(Synthetic),
    /// Scans of held-out materials under many conditions (frame rate, path, light, roll, sensor) and with single parts of the
    /// aligner off, against exact warps. Goes on where it was stopped. Writes summary.json, table.csv and table.md.
    Alignment(Alignment),
    /// Frame 0 of scans of held-out materials, looked for in photos of a larger area at other scales and under other light, and
    /// in photos of something else. Writes cases.json and table.md.
    Localisation(Measured),
    /// The maps of one scan against the truth, beside constant maps. Prints a table.
    Maps {
        /// Folder that `scan` wrote.
        maps: PathBuf,
        /// Folder with the true NormalGL.exr, Diffuse.exr, Roughness.exr and Specular.exr.
        #[arg(long)]
        truth: PathBuf,
        /// Where the constant maps come from: a folder of PBR material folders, or `procedural`.
        #[arg(long, default_value = "procedural")]
        materials: String,
    },
}

#[derive(clap::Args)]
struct Synthetic {
    /// Folder with adjacent, distant and svbrdf weights and their manifest.json.
    #[arg(long, default_value = concat!(env!("CARGO_MANIFEST_DIR"), "/../../weights"))]
    weights: PathBuf,
    #[command(flatten)]
    measured: Measured,
    /// Where the nets run; this build has `cpu`.
    #[arg(long, default_value = "cpu")]
    device: String,
}

/// What every protocol measures on, where its results go and how it is set.
#[derive(clap::Args)]
struct Measured {
    /// Folder of PBR material folders, or `procedural`.
    #[arg(long, default_value = "procedural")]
    materials: String,
    /// Folder for the results; it is made if it doesn't exist.
    #[arg(long)]
    out: PathBuf,
    /// Replace results that are there already.
    #[arg(long)]
    force: bool,
    /// A setting of the protocol, e.g. `--set cases=10 --set 'scales=[1, 4]'`; `--dry-run` names them all.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    settings: Vec<String>,
    /// Print the resolved settings and stop.
    #[arg(long)]
    dry_run: bool,
}

impl Measured {
    /// Fails where results of that name may not be replaced.
    fn fresh(&self, name: &str) -> Result<(), Failure> {
        if !self.force && self.out.join(name).exists() {
            let out = self.out.display();
            let error = anyhow::anyhow!("{out} holds results already: give another --out, or --force to replace them");
            return Err(Failure::Usage(error));
        }
        Ok(())
    }

    fn open_materials(&self, seed: u64) -> Result<MaterialLibrary, Failure> {
        open(&self.materials, seed)
    }

    fn make_folder(&self) -> Result<(), Failure> {
        Ok(std::fs::create_dir_all(&self.out).with_context(|| format!("making {}", self.out.display()))?)
    }
}

#[derive(clap::Args)]
struct Alignment {
    /// Folder with adjacent and distant weights and their manifest.json.
    #[arg(long, default_value = concat!(env!("CARGO_MANIFEST_DIR"), "/../../weights"))]
    weights: PathBuf,
    /// Folder of PBR material folders, or `procedural`.
    #[arg(long, default_value = "procedural")]
    materials: String,
    /// Folder for cases and tables; what it holds of the same settings is not measured again.
    #[arg(long)]
    out: PathBuf,
    /// Scans per condition.
    #[arg(long, default_value_t = AlignmentConfig::default().sequences)]
    sequences: usize,
    /// Side of the frames in pixels.
    #[arg(long, default_value_t = AlignmentConfig::default().resolution)]
    resolution: usize,
    /// Conditions or groups of them, separated by commas: base, scans, ablation, all, or names of rows, e.g. `base,roll`.
    /// The row h264 (in scans and all) needs ffmpeg with libx264, which is looked for before anything is measured.
    #[arg(long, default_value = "base")]
    conditions: String,
    /// Write frames and exact warps too, for other programs.
    #[arg(long)]
    keep_frames: bool,
    /// Remove cases of other settings.
    #[arg(long)]
    force: bool,
    /// A setting for all conditions, e.g. `--set align.size=384`; `--set 'scans=[3, 10]'` measures single scans.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    settings: Vec<String>,
    /// Print the resolved settings and the conditions' changes, and stop.
    #[arg(long)]
    dry_run: bool,
}

fn main() -> ExitCode {
    ops::process::keep_memory();
    let arguments = Arguments::parse();
    match run(arguments) {
        Ok(()) => ExitCode::SUCCESS,
        Err(Failure::Usage(error)) => report(&error, 2),
        Err(Failure::Run(error)) => report(&error, 1),
    }
}

enum Failure {
    Usage(anyhow::Error),
    Run(anyhow::Error),
}

impl From<anyhow::Error> for Failure {
    fn from(error: anyhow::Error) -> Self {
        Self::Run(error)
    }
}

fn report(error: &anyhow::Error, code: u8) -> ExitCode {
    eprintln!("error: {error:#}");
    ExitCode::from(code)
}

fn run(Arguments { protocol }: Arguments) -> Result<(), Failure> {
    match protocol {
        Protocol::Synthetic(arguments) => synthetic_protocol(arguments),
        Protocol::Alignment(arguments) => alignment_protocol(arguments),
        Protocol::Localisation(arguments) => localisation_protocol(arguments),
        Protocol::Maps { maps, truth, materials } => compare(&maps, &truth, &materials),
    }
}

fn synthetic_protocol(arguments: Synthetic) -> Result<(), Failure> {
    let Synthetic { weights, measured, device } = arguments;
    let config: SyntheticConfig = overlay(&SyntheticConfig::default(), &measured.settings)?;
    config.validate().map_err(|e| Failure::Usage(e.into()))?;
    if device != "cpu" {
        let error = anyhow::anyhow!("--device {device}: this build has cpu only; train and evaluate run there");
        return Err(Failure::Usage(error));
    }
    if measured.dry_run {
        print!("{}", toml::to_string(&config).context("printing the settings")?);
        return Ok(());
    }
    measured.fresh("summary.json")?;
    let overwrite = if measured.force { Overwrite::Allow } else { Overwrite::Refuse };
    let library = measured.open_materials(config.seed)?;
    let method = ScanNets::load(&weights, &burn::tensor::Device::flex()).context("loading the weights")?;
    measured.make_folder()?;
    let results = synthetic::run(&library, &method, &config, |r| {
        let a = flow::align::metrics::summarise(std::slice::from_ref(&r.alignment));
        println!(
            "{}: valid {:.3}, pixel error {:.2}, within 20 px {:.2}, map errors {:.4} (constant {:.4})",
            r.material,
            a.valid_rate,
            a.pixel_error,
            a.within_20px,
            r.automatic.maps.sum_l1(),
            r.constant.maps.sum_l1()
        );
        true
    })
    .context("running the protocol")?;
    evaluate::output::write(&results, &measured.out, overwrite).context("writing the results")?;
    println!("{}", std::fs::read_to_string(measured.out.join("table.md")).context("reading the table back")?);
    Ok(())
}

fn alignment_protocol(arguments: Alignment) -> Result<(), Failure> {
    let usage = |error: EvaluateError| Failure::Usage(error.into());
    let base =
        AlignmentConfig { sequences: arguments.sequences, resolution: arguments.resolution, ..AlignmentConfig::default() };
    let config: AlignmentConfig = overlay(&base, &arguments.settings)?;
    config.validate().map_err(usage)?;
    let conditions = conditions::chosen(&arguments.conditions).map_err(usage)?;
    if arguments.dry_run {
        print!("{}", toml::to_string(&config).context("printing the settings")?);
        conditions.iter().for_each(|c| println!("# {}: {}", c.name, c.settings.join(", ")));
        return Ok(());
    }
    let (weights, out) = (&arguments.weights, &arguments.out);
    let device = burn::tensor::Device::flex();
    let net = |name| flow::weights::load(weights, name, &device).context("loading the weights");
    let ((adjacent, first), (distant, second)) = (net(flow::weights::ADJACENT)?, net(flow::weights::DISTANT)?);
    let checksums =
        [first, second].into_iter().flat_map(|r| r.sha256.into_iter().chain(r.shards.into_iter().map(|s| s.sha256)));
    let library = open(&arguments.materials, config.seed)?;
    let overwrite = if arguments.force { Overwrite::Allow } else { Overwrite::Refuse };
    let common = Common::new(&config, &arguments.materials, checksums.collect());
    let store = Store::open(out, &common, overwrite).map_err(|error| match error {
        EvaluateError::OtherSettings { .. } => usage(error),
        error => Failure::Run(error.into()),
    })?;
    let nets = FlowNets { adjacent, distant };
    let cases = alignment::run(&library, &nets, (&config, &conditions), &store, |case| {
        let figure = |name: &str| case.figures.get(name).map_or_else(|| "–".into(), |v| format!("{v:.3}"));
        println!(
            "{} {:04} {}: valid {}, pixel error {}, within 20 px {}, {:.1} s",
            case.condition,
            case.sequence,
            case.material,
            figure("valid_rate"),
            figure("pixel_error"),
            figure("within_20px"),
            case.seconds.aligning()
        );
        true
    })
    .context("running the protocol")?;
    alignment::table::write(&alignment::summary::rows(&cases), out).context("writing the results")?;
    if arguments.keep_frames {
        alignment::export::frames(&library, &config, &conditions, out).context("writing the frames")?;
    }
    println!("{}", std::fs::read_to_string(out.join("table.md")).context("reading the table back")?);
    Ok(())
}

fn localisation_protocol(arguments: Measured) -> Result<(), Failure> {
    let config: LocalisationConfig = overlay(&LocalisationConfig::default(), &arguments.settings)?;
    config.validate().map_err(|e| Failure::Usage(e.into()))?;
    if arguments.dry_run {
        print!("{}", toml::to_string(&config).context("printing the settings")?);
        return Ok(());
    }
    arguments.fresh("cases.json")?;
    let library = arguments.open_materials(config.seed)?;
    arguments.make_folder()?;
    let cases = localisation::run(&library, &config, |c| {
        let error = c.error_px.map_or_else(|| "–".into(), |e| format!("{e:.1} px"));
        let photo = if c.foreign { "photo of something else" } else { "own photo" };
        let (outcome, light) = (format!("{:?}", c.outcome).to_lowercase(), format!("{:?}", c.light).to_lowercase());
        println!(
            "{:04} {}, {photo}, scale {}, {light}: {outcome}, {error}, {:.1} s: {}",
            c.scan, c.material, c.scale, c.seconds, c.answer
        );
    })
    .context("running the protocol")?;
    localisation::write(&cases, &arguments.out, Overwrite::Allow).context("writing the results")?;
    println!("{}", localisation::markdown(&cases));
    Ok(())
}

fn compare(maps: &Path, truth: &Path, materials: &str) -> Result<(), Failure> {
    // Before the constant maps, which take seconds.
    let scanned = ScannedMaps::read(maps, truth).context("comparing the maps")?;
    let config = SyntheticConfig::default();
    let library = open(materials, config.seed)?;
    let (scans, streams) = (SequenceConfig::svbrdf(), Stream::new(config.seed));
    let constants = evaluate::baseline::constant_maps(&library, &scans, &streams, config.constant_videos)
        .context("making the constant maps")?;
    print!("{}", scanned.compare(&constants).markdown());
    Ok(())
}

fn overlay<T: Serialize + DeserializeOwned>(base: &T, settings: &[String]) -> Result<T, Failure> {
    scan::settings::overlay(base, settings).map_err(|e| Failure::Usage(e.into()))
}

fn open(materials: &str, seed: u64) -> Result<MaterialLibrary, Failure> {
    Ok(MaterialLibrary::open(&[source(materials)?], seed, CACHE_BYTES).context("opening the materials")?)
}

fn source(materials: &str) -> Result<SourceConfig, Failure> {
    if materials == "procedural" {
        return Ok(SourceConfig::Procedural(ProceduralConfig::default()));
    }
    let path = Path::new(materials);
    if !path.is_dir() {
        let error =
            anyhow::anyhow!("--materials {materials}: expected `procedural` or a folder of material folders, found neither");
        return Err(Failure::Usage(error));
    }
    let config = format!("path = {:?}", path);
    let config: PbrConfig = toml::from_str(&config).context("--materials")?;
    Ok(SourceConfig::Pbr(config))
}
