//! `status.json`: how a run is getting on, for whoever looks at it from outside.

use super::{Recorder, Row};
use image::RgbImage;
use serde::{Deserialize, Serialize};
use std::io;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// Between two writings.
const INTERVAL: Duration = Duration::from_secs(1);

/// What a person wants to know of a run after a step.
pub struct Status<'a> {
    /// Stage of the run.
    pub stage: &'a str,
    /// Steps done.
    pub step: u64,
    /// Steps of the stage.
    pub steps: u64,
    /// Losses of this step.
    pub losses: &'a [(String, f64)],
    /// The latest measurements on held-out materials, the most telling first (end-point error, map error …).
    pub measured: &'a [(String, f64)],
    /// Exemplars per second.
    pub samples_per_second: f64,
    /// Share of the step's time that went by waiting for data.
    pub waiting: f64,
    /// Memory that the process holds, where the system tells.
    pub memory_mib: Option<f64>,
    /// Time that the rest of the stage will take, as far as can be told.
    pub remaining: Option<Duration>,
}

/// A status as it is on disk: all but the numbers that `metrics.jsonl` has.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StoredStatus {
    /// Stage of the run.
    pub stage: String,
    /// Steps done.
    pub step: u64,
    /// Steps of the stage.
    pub steps: u64,
    /// Exemplars per second.
    pub samples_per_second: f64,
    /// Share of the step's time that went by waiting for data.
    pub data_wait_share: f64,
    /// Memory that the process holds, where the system tells.
    pub rss_mib: Option<f64>,
    /// Time that the rest of the stage will take, in seconds.
    pub remaining_seconds: Option<f64>,
    /// When this was written, in seconds since 1970.
    pub written_unix: u64,
}

impl StoredStatus {
    /// Reads the status of a run folder; `None` before the first step.
    ///
    /// # Errors
    /// A file that can't be read or is something else.
    pub fn of_run(run: &Path) -> io::Result<Option<Self>> {
        match std::fs::read(run.join(StatusFile::NAME)) {
            Ok(bytes) => Ok(Some(serde_json::from_slice(&bytes)?)),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// Time since it was written.
    pub fn age(&self) -> Duration {
        Duration::from_secs(unix_now().saturating_sub(self.written_unix))
    }
}

fn unix_now() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs())
}

/// Writes `status.json`, at most once a second, and after the last step of a stage.
pub struct StatusFile {
    path: PathBuf,
    written: Option<Instant>,
}

impl StatusFile {
    /// Name of the file in a run folder.
    pub const NAME: &'static str = "status.json";

    /// For a run folder.
    pub fn new(run: &Path) -> Self {
        Self { path: run.join(Self::NAME), written: None }
    }
}

impl Recorder for StatusFile {
    fn row(&mut self, _row: &Row<'_>) -> io::Result<()> {
        Ok(())
    }

    fn picture(&mut self, _stage: &str, _step: u64, _name: &str, _image: &RgbImage) -> io::Result<()> {
        Ok(())
    }

    fn status(&mut self, status: &Status<'_>) -> io::Result<()> {
        if status.step < status.steps && self.written.is_some_and(|at| at.elapsed() < INTERVAL) {
            return Ok(());
        }
        self.written = Some(Instant::now());
        let stored = StoredStatus {
            stage: status.stage.into(),
            step: status.step,
            steps: status.steps,
            samples_per_second: status.samples_per_second,
            data_wait_share: status.waiting,
            rss_mib: status.memory_mib,
            remaining_seconds: status.remaining.map(|remaining| remaining.as_secs_f64()),
            written_unix: unix_now(),
        };
        // Nothing depends on this file: a disk that is full for it shows where something does.
        let _ = crate::atomic::replace(&self.path, &serde_json::to_vec(&stored)?);
        Ok(())
    }

    fn rewind(&mut self, _stage: &str, _step: u64) -> io::Result<()> {
        Ok(())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn status(step: u64) -> Status<'static> {
        Status {
            stage: "adjacent",
            step,
            steps: 9,
            losses: &[],
            measured: &[],
            samples_per_second: 2.5,
            waiting: 0.25,
            memory_mib: Some(100.0),
            remaining: Some(Duration::from_millis(1500)),
        }
    }

    #[test]
    fn the_first_and_the_last_step_are_written_and_not_every_one_between() {
        let home = tempfile::tempdir().unwrap();
        assert_eq!(StoredStatus::of_run(home.path()).unwrap(), None);
        let mut file = StatusFile::new(home.path());
        let stored = |file: &mut StatusFile, step| {
            file.status(&status(step)).unwrap();
            StoredStatus::of_run(home.path()).unwrap().unwrap()
        };
        assert_eq!((stored(&mut file, 1).step, stored(&mut file, 2).step), (1, 1));
        let last = stored(&mut file, 9);
        assert_eq!((last.step, last.data_wait_share, last.remaining_seconds), (9, 0.25, Some(1.5)));
        assert!(last.age() < Duration::from_secs(60));
    }

    #[test]
    fn a_folder_that_is_gone_stops_no_run() {
        StatusFile::new(Path::new("no/such/folder")).status(&status(1)).unwrap();
    }
}
