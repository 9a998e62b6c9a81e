//! `train watch`: how a run is getting on and its curves, in the terminal.

mod chart;
mod screen;

use crate::curves::Curves;
use crate::recorder::StoredStatus;
use clap::Args;
use console::Term;
use screen::{Run, screen};
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Between two looks at the run.
const INTERVAL: Duration = Duration::from_secs(1);
/// Size of the screen where there is no terminal, as (columns, rows).
const USUAL: (usize, usize) = (100, 60);

/// Arguments of `train watch`.
#[derive(Debug, Args)]
pub struct WatchArguments {
    /// Run folder.
    run: PathBuf,
    /// The stage whose curves are shown [default: the latest].
    #[arg(long, value_name = "NAME")]
    stage: Option<String>,
    /// Show the present state and end; so it is too where the output is no terminal.
    #[arg(long)]
    once: bool,
}

/// What keeps a run from being watched.
#[derive(Debug, thiserror::Error)]
pub enum WatchError {
    /// No run there.
    #[error("there is no run in {}: expected a folder with metrics.jsonl, as a run leaves it", path.display())]
    Absent {
        /// The folder.
        path: PathBuf,
    },
    /// The run has no such stage.
    #[error("the run has no stage `{stage}` so far; it has {}", if known.is_empty() { "none".into() } else { known.join(", ") })]
    NoStage {
        /// What was asked for.
        stage: String,
        /// The stages that have begun.
        known: Vec<String>,
    },
    /// The system refuses.
    #[error("cannot read the run {}: {source}", path.display())]
    Io {
        /// The folder.
        path: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
}

/// Shows a run once, or until a person ends it with Ctrl-C.
///
/// # Errors
/// See [`WatchError`].
pub fn run(arguments: &WatchArguments) -> Result<(), WatchError> {
    let WatchArguments { run: path, stage, once } = arguments;
    let terminal = Term::stdout();
    let mut curves = Curves::new(&path.join("metrics.jsonl"));
    if *once || !terminal.is_term() {
        let text = look(path, &mut curves, stage.as_deref(), USUAL)?;
        let text = if terminal.features().colors_supported() { text } else { console::strip_ansi_codes(&text).into_owned() };
        print!("{text}");
        return Ok(());
    }
    let fail = |source| WatchError::Io { path: path.clone(), source };
    loop {
        let (rows, columns) = terminal.size();
        let text = look(path, &mut curves, stage.as_deref(), (usize::from(columns), usize::from(rows)))?;
        // What is too long for the terminal would scroll the head away.
        let text: String = text.split_inclusive('\n').take(usize::from(rows).saturating_sub(1)).collect();
        terminal.clear_screen().and_then(|()| terminal.write_str(&text)).map_err(fail)?;
        std::thread::sleep(INTERVAL);
    }
}

/// The screen of this moment.
fn look(path: &Path, curves: &mut Curves, stage: Option<&str>, size: (usize, usize)) -> Result<String, WatchError> {
    let fail = |source| WatchError::Io { path: path.into(), source };
    match curves.follow() {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Err(WatchError::Absent { path: path.into() }),
        followed => followed.map_err(fail)?,
    }
    let known = || curves.stages.iter().map(|stage| stage.name.clone()).collect();
    let shown = match stage {
        Some(name) => Some(
            curves
                .stages
                .iter()
                .find(|stage| stage.name == name)
                .ok_or_else(|| WatchError::NoStage { stage: name.into(), known: known() })?,
        ),
        None => curves.stages.last(),
    };
    let status = StoredStatus::of_run(path).map_err(fail)?;
    let name = path.file_name().map_or_else(|| path.display().to_string(), |name| name.to_string_lossy().into_owned());
    Ok(screen(&Run { name: &name, done: path.join("report.json").is_file(), status, stage: shown }, size))
}
