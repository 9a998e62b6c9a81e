//! `scan`: a clip of a flat material in, maps out.

use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

use anyhow::Context;
use burn::tensor::Device;
use clap::Parser;
use dataset::capture::{self, CaptureConfig, Crop};
use indicatif::ProgressBar;
use ops::planes::Planes;
use scan::guidance::GuidancePhoto;
use scan::nets::ScanNets;
use scan::output::{Staging, check};
use scan::reconstruct::{ReconstructError, ScanConfig, reconstruct};
use scan::settings;

/// Turns a flash-lit phone video of a flat material into diffuse, specular, roughness and normal maps.
#[derive(Parser)]
#[command(
    version,
    after_help = "Exit codes: 0 done, 1 failed, 2 bad usage or config, 3 alignment failed, 4 done but the capture is poor."
)]
struct Arguments {
    /// A video (read through ffmpeg), a folder of frames, or a .npy array [frames, height, width, 3].
    clip: PathBuf,
    /// Folder for the maps; it must not exist yet.
    #[arg(long)]
    out: PathBuf,
    /// Folder with adjacent, distant and svbrdf weights and their manifest.json.
    #[arg(long, default_value = concat!(env!("CARGO_MANIFEST_DIR"), "/../../weights"))]
    weights: PathBuf,
    /// Side of the square frames and of the maps in pixels; a smaller clip keeps its own size.
    #[arg(long)]
    resolution: Option<usize>,
    /// Key frames that reflectance is gathered from, the first frame among them.
    #[arg(long)]
    key_frames: Option<usize>,
    /// A photo of a larger area, in any light, in whose axes the maps shall be; frame 0 is looked for in it.
    #[arg(long, value_name = "PHOTO")]
    guidance: Option<PathBuf>,
    /// Where frame 0 lies in the guidance photo, where it isn't to be looked for: rows and columns of the photo.
    #[arg(long, value_name = "Y0,Y1,X0,X1", requires = "guidance")]
    start: Option<String>,
    /// Any other setting, e.g. `--set align.photometric.enabled=false`.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    settings: Vec<String>,
    /// Replace an existing output folder.
    #[arg(long)]
    force: bool,
    /// Print the resolved settings and stop.
    #[arg(long)]
    dry_run: bool,
    /// Where the nets run; this build has `cpu`.
    #[arg(long, default_value = "cpu")]
    device: String,
}

/// What ends the program, by exit code.
enum Failure {
    Failed(anyhow::Error),
    Usage(anyhow::Error),
    Alignment(anyhow::Error),
}

impl From<anyhow::Error> for Failure {
    fn from(error: anyhow::Error) -> Self {
        Self::Failed(error)
    }
}

fn main() -> ExitCode {
    ops::process::keep_memory();
    let (error, code) = match run(Arguments::parse()) {
        Ok(shortcomings) if shortcomings.is_empty() => return ExitCode::SUCCESS,
        Ok(shortcomings) => {
            eprintln!("warning: the maps were written, but the capture is poor: {}", shortcomings.join("; "));
            return ExitCode::from(4);
        }
        Err(Failure::Failed(error)) => (error, 1),
        Err(Failure::Usage(error)) => (error, 2),
        Err(Failure::Alignment(error)) => (error, 3),
    };
    eprintln!("error: {error:#}");
    ExitCode::from(code)
}

fn run(arguments: Arguments) -> Result<Vec<String>, Failure> {
    let config = configure(&arguments).map_err(Failure::Usage)?;
    if arguments.dry_run {
        print!("{}", toml::to_string(&config).context("printing the settings")?);
        return Ok(Vec::new());
    }
    check(&arguments.out, arguments.force).map_err(|e| Failure::Usage(e.into()))?;
    let device = Device::flex();
    let nets = ScanNets::load(&arguments.weights, &device).context("loading the weights")?;

    let bar = spinner();
    bar.set_message(format!("reading {}", arguments.clip.display()));
    let capture = CaptureConfig { resolution: Some(config.resolution), ..CaptureConfig::default() };
    let clip = capture::read(&arguments.clip, &capture).context("reading the clip")?;
    clip.notes.iter().for_each(|note| say(&bar, &format!("note: {note}")));

    let guidance = arguments.guidance.as_deref().map(|path| read_guidance(path, arguments.start.as_deref())).transpose()?;

    bar.set_message(format!("aligning {} frames and reconstructing", clip.frames.len()));
    let result = reconstruct(&clip.frames, clip.fov_deg, guidance.as_ref(), &nets, &config).map_err(|error| match error {
        ReconstructError::NothingAligned { .. } | ReconstructError::Align(_) | ReconstructError::Guidance(_) => {
            Failure::Alignment(error.into())
        }
        other => Failure::Failed(other.into()),
    })?;
    if let Some(view) = &result.view {
        let found = &view.located;
        let (x, y) = view.to_photo.apply(0.0, 0.0).unwrap_or_default();
        say(
            &bar,
            &format!(
                "note: found in the guidance photo: its pixels are {:.2} video pixels wide; the maps begin at row {y:.0}, column {x:.0} of it",
                found.scale
            ),
        );
    }
    result.alignment.warnings.iter().for_each(|warning| say(&bar, &format!("note: {warning}")));

    bar.set_message(format!("writing {}", arguments.out.display()));
    let staging = Staging::new(&arguments.out).context("making the output folder")?;
    scan::report::write(staging.folder(), (&clip.frames, &clip.indices), &result, &config.camera)
        .context("writing the report")?;
    let source = clip.source.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
    scan::export::maps::write(staging.folder(), &source, &result).context("writing the maps")?;
    staging.finish().context("finishing the output folder")?;
    bar.finish_and_clear();
    let keys = &result.alignment.key_frames;
    println!(
        "{}: maps of {}×{} pixels from {} of {} key frames",
        arguments.out.display(),
        result.maps.width(),
        result.maps.height(),
        keys.iter().filter(|k| k.aligned()).count(),
        keys.len()
    );
    Ok(scan::report::shortcomings(&result))
}

fn configure(arguments: &Arguments) -> anyhow::Result<ScanConfig> {
    anyhow::ensure!(
        arguments.device == "cpu",
        "--device {}: this build has cpu only; build with a GPU feature to use another",
        arguments.device
    );
    let mut config: ScanConfig = settings::overlay(&ScanConfig::default(), &arguments.settings)?;
    config.resolution = arguments.resolution.unwrap_or(config.resolution);
    config.key_frames = arguments.key_frames.unwrap_or(config.key_frames);
    config.validate()?;
    Ok(config)
}

fn read_guidance(path: &Path, start: Option<&str>) -> Result<GuidancePhoto, Failure> {
    let whole = CaptureConfig { crop: Crop::None, ..CaptureConfig::default() };
    let photo = capture::read_photo(path, &whole).context("reading the guidance photo")?;
    let start = start.map(|text| parse_start(text, &photo)).transpose().map_err(Failure::Usage)?;
    Ok(GuidancePhoto { photo, start })
}

/// `y0,y1,x0,x1` within the photo.
fn parse_start(text: &str, photo: &Planes) -> anyhow::Result<[f64; 4]> {
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|v| v.trim().parse::<f64>()).collect();
    let (height, width) = (photo.height as f64, photo.width as f64);
    match numbers.as_deref() {
        Ok(&[y0, y1, x0, x1]) if 0.0 <= y0 && y0 + 8.0 <= y1 && y1 <= height && 0.0 <= x0 && x0 + 8.0 <= x1 && x1 <= width => {
            Ok([y0, y1, x0, x1])
        }
        _ => anyhow::bail!(
            "--start {text}: expected Y0,Y1,X0,X1, two rows and two columns of the photo ({width}×{height}) at least 8 pixels apart, \
             e.g. --start 400,700,850,1150"
        ),
    }
}

fn spinner() -> ProgressBar {
    if !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let bar = ProgressBar::new_spinner();
    bar.enable_steady_tick(Duration::from_millis(100));
    bar
}

fn say(bar: &ProgressBar, line: &str) {
    bar.suspend(|| eprintln!("{line}"));
}
