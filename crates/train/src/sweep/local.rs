//! Runs here, one after the other or side by side, each in a process of its own: the end of one is not the end of the others.

use super::Failures;
use super::folders::State;
use super::plan::Run;
use crate::interrupt;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

/// Between two looks at the processes.
const INTERVAL: Duration = Duration::from_millis(100);

/// Where a sweep runs.
pub struct Local<'a> {
    /// The sweep's folder.
    pub out: &'a Path,
    /// Runs at a time.
    pub jobs: usize,
    /// Where the nets run; the runs take turns.
    pub devices: &'a [String],
}

/// A running process.
struct Working {
    run: usize,
    device: usize,
    child: Child,
    log: PathBuf,
    began: Instant,
    told: bool,
}

impl Local<'_> {
    /// Runs everything that isn't finished; tells what failed. `None`: it was stopped.
    ///
    /// # Errors
    /// The system's refusal to start a process.
    pub fn run(&self, runs: &[Run], states: &mut [State]) -> io::Result<Option<Failures>> {
        let mut failures = Failures::new();
        let mut working: Vec<Working> = Vec::new();
        let mut started = vec![false; runs.len()];
        let total = states.iter().filter(|state| **state != State::Finished).count();
        loop {
            for (index, run) in runs.iter().enumerate() {
                let due = !started[index] && states[index] != State::Finished && working.len() < self.jobs;
                if !due || interrupt::requested() {
                    continue;
                }
                if let Some(owner) = run.takes.iter().find(|owner| failures.contains_key(&runs[**owner].name)) {
                    started[index] = true;
                    self.note(&mut failures, run, format!("not run: it takes nets of {}, which failed", runs[*owner].name));
                } else if run.takes.iter().all(|owner| states[*owner] == State::Finished) {
                    started[index] = true;
                    eprintln!("start {} ({}/{total})", run.name, started.iter().filter(|started| **started).count());
                    let busy: Vec<usize> = working.iter().map(|process| process.device).collect();
                    let device = freest(self.devices.len(), &busy);
                    working.push(self.start(index, device, runs)?);
                }
            }
            if working.is_empty() {
                break;
            }
            std::thread::sleep(INTERVAL);
            let mut still = Vec::new();
            for mut process in working {
                if interrupt::requested() && !process.told {
                    process.told = true;
                    ask_to_stop(&mut process.child);
                }
                match process.child.try_wait()? {
                    None => still.push(process),
                    Some(status) => self.ended(&process, status, &runs[process.run], &mut states[process.run], &mut failures),
                }
            }
            working = still;
        }
        Ok(if interrupt::requested() { None } else { Some(failures) })
    }

    fn start(&self, index: usize, device: usize, runs: &[Run]) -> io::Result<Working> {
        let run = &runs[index];
        let logs = self.out.join("logs");
        std::fs::create_dir_all(&logs)?;
        let log = logs.join(format!("{}.log", run.name));
        let file = File::options().create(true).append(true).open(&log)?;
        let (program, arguments) = command(self.out, run, runs, &self.devices[device])?;
        let mut command = Command::new(program);
        command.args(arguments).stdin(Stdio::null()).stdout(file.try_clone()?).stderr(file);
        if self.jobs > 1 && std::env::var_os("RAYON_NUM_THREADS").is_none() {
            let cores = std::thread::available_parallelism().map_or(1, usize::from);
            command.env("RAYON_NUM_THREADS", (cores / self.jobs).max(1).to_string());
        }
        // A group of its own: Ctrl-C at the terminal reaches only the sweep, which then asks each run once.
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        Ok(Working { run: index, device, child: command.spawn()?, log, began: Instant::now(), told: false })
    }

    fn ended(&self, process: &Working, status: ExitStatus, run: &Run, state: &mut State, failures: &mut Failures) {
        let minutes = process.began.elapsed().as_secs_f64() / 60.0;
        if status.success() && self.out.join(&run.name).join("report.json").is_file() {
            *state = State::Finished;
            eprintln!("done {} in {minutes:.1} min", run.name);
        } else if interrupt::requested() {
            eprintln!("stopped {}", run.name);
        } else {
            let reason = match status.code() {
                Some(code) => format!("exit code {code}"),
                None => status.to_string(),
            };
            let said = last_line(&process.log).map(|line| format!(", \"{line}\"")).unwrap_or_default();
            self.note(failures, run, format!("{reason}{said}; see {}", process.log.display()));
        }
    }

    fn note(&self, failures: &mut Failures, run: &Run, reason: String) {
        eprintln!("FAILED {}: {reason}", run.name);
        failures.insert(run.name.clone(), reason);
    }
}

/// The command that starts, continues or finishes a run, with whole paths.
///
/// # Errors
/// The system doesn't know where this program or the folder is.
pub fn command(out: &Path, run: &Run, runs: &[Run], device: &str) -> io::Result<(PathBuf, Vec<String>)> {
    let folder = |name: &str| std::path::absolute(out.join(name)).map(|path| path.display().to_string());
    let mut arguments = vec!["--resume".to_string(), folder(&run.name)?];
    if device != "cpu" {
        arguments.extend(["--device".to_string(), device.to_string()]);
    }
    for owner in &run.takes {
        arguments.extend(["--nets-of".to_string(), folder(&runs[*owner].name)?]);
    }
    Ok((std::env::current_exe()?, arguments))
}

#[cfg(unix)]
fn ask_to_stop(child: &mut Child) {
    use nix::sys::signal::{Signal, kill};
    // The child has not been waited for, so the number is still its own; if it ended meanwhile there is nothing to stop.
    let _ = kill(nix::unistd::Pid::from_raw(child.id().cast_signed()), Signal::SIGTERM);
}

#[cfg(not(unix))]
fn ask_to_stop(child: &mut Child) {
    // No way to ask politely; the last checkpoint is whole.
    let _ = child.kill();
}

/// The last line of a log that says something, from its last few kilobytes; what is indented only adds to the line before it.
fn last_line(log: &Path) -> Option<String> {
    const TAIL: i64 = 4096;
    let mut file = File::open(log).ok()?;
    let length = file.metadata().ok()?.len().cast_signed();
    file.seek(SeekFrom::Start((length - TAIL).max(0).cast_unsigned())).ok()?;
    let mut bytes = Vec::new();
    file.read_to_end(&mut bytes).ok()?;
    let text = String::from_utf8_lossy(&bytes);
    text.lines().rev().find(|line| !line.is_empty() && !line.starts_with(' ')).map(str::to_string)
}

/// The device with the fewest runs, of so many; `busy` has one device per run.
fn freest(devices: usize, busy: &[usize]) -> usize {
    let runs = |device: &usize| busy.iter().filter(|other| *other == device).count();
    (0..devices).min_by_key(runs).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::freest;

    #[test]
    fn the_next_run_takes_the_device_with_the_fewest() {
        let busy: [&[usize]; 4] = [&[], &[0], &[1], &[1, 0, 0]];
        assert_eq!(busy.map(|busy| freest(2, busy)), [0, 1, 0, 1]);
    }
}
