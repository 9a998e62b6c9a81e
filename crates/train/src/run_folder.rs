//! The folder of a run: what lies where, who may write into it.

use std::fs::{self, File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};

/// Everything the program itself puts into a run folder; `--force` removes these and nothing else. `run.json` goes first: a
/// folder without it can't be resumed, so a kill in the middle leaves nothing that looks like a run.
const OWN: [&str; 14] = [
    "run.json",
    "config.toml",
    "materials.json",
    "progress.json",
    "status.json",
    "metrics.jsonl",
    "tb",
    "previews",
    "checkpoints",
    "weights",
    "failures",
    "report.json",
    "report.html",
    "report",
];
const LOCK: &str = "run.lock";

/// A run folder that can't be used.
#[derive(Debug, thiserror::Error)]
pub enum FolderError {
    /// There is something in it already.
    #[error(
        "the folder {} exists and is not empty: continue that run with `--resume {}`, choose another with `--out`, or replace it with `--force`",
        path.display(), path.display()
    )]
    Exists {
        /// The folder.
        path: PathBuf,
    },
    /// `--force` on a folder that no run has written.
    #[error("{} is not a run folder (it has neither run.json nor {LOCK}), so `--force` does not replace it: choose another with `--out`", path.display())]
    Foreign {
        /// The folder.
        path: PathBuf,
    },
    /// Nothing to resume.
    #[error(
        "there is no run to resume in {}: expected a folder with config.toml and run.json, as a run leaves it (one that was ended before it had begun leaves nothing: start it again with `--config`)",
        path.display()
    )]
    Absent {
        /// The folder.
        path: PathBuf,
    },
    /// Another process is training into it.
    #[error("the run folder {} is in use by another process: wait for it, or choose another folder with `--out`", path.display())]
    Locked {
        /// The folder.
        path: PathBuf,
    },
    /// The system refuses.
    #[error("cannot write into the run folder: {}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
}

/// A run folder that belongs to this process until it is dropped.
#[derive(Debug)]
pub struct RunFolder {
    path: PathBuf,
    _lock: File,
}

impl RunFolder {
    /// Makes a new run folder that `describe` fills with what the run is; `force` replaces an earlier run in it.
    ///
    /// A folder that isn't there yet appears whole or not at all, whenever the process ends.
    ///
    /// # Errors
    /// A folder that isn't empty (without `force`), that no run wrote, that is in use, or that can't be written; or what
    /// `describe` says.
    pub fn create<E: From<FolderError>>(
        path: &Path,
        force: bool,
        describe: impl FnOnce(&Self) -> Result<(), E>,
    ) -> Result<Self, E> {
        let occupied =
            fs::read_dir(path).is_ok_and(|mut entries| entries.any(|entry| entry.is_ok_and(|e| e.file_name() != LOCK)));
        if (occupied || path.is_file()) && !force {
            return Err(FolderError::Exists { path: path.into() }.into());
        }
        let begun = path.join("run.json").is_file() || path.join(LOCK).is_file();
        if path.is_file() || (occupied && !begun) {
            return Err(FolderError::Foreign { path: path.into() }.into());
        }
        // A folder that is there stays itself: it may be a mounted disk.
        let scratch = preparing(path).filter(|_| !path.exists());
        let mut folder = Self::claim(scratch.as_deref().unwrap_or(path), path)?;
        let described = describe(&folder);
        if let Some(scratch) = scratch {
            if described.is_err() {
                let _ = fs::remove_dir_all(&scratch);
            }
            described?;
            fs::rename(&scratch, path).map_err(|source| FolderError::Io { path: path.into(), source })?;
            folder.path = path.into();
        } else {
            described?;
        }
        Ok(folder)
    }

    /// Makes the folder `at`, which is or will be `path`, this process's own and empties it of an earlier run.
    fn claim(at: &Path, path: &Path) -> Result<Self, FolderError> {
        fs::create_dir_all(at).map_err(|source| FolderError::Io { path: path.into(), source })?;
        let folder = Self { path: at.into(), _lock: lock(at, path)? };
        for name in OWN {
            folder.remove(name)?;
        }
        folder.make_folders()?;
        Ok(folder)
    }

    /// Opens the folder of an earlier run.
    ///
    /// # Errors
    /// A folder that holds no run, is in use, or can't be written.
    pub fn open(path: &Path) -> Result<Self, FolderError> {
        if !path.join("config.toml").is_file() || !path.join("run.json").is_file() {
            return Err(FolderError::Absent { path: path.into() });
        }
        let folder = Self { path: path.into(), _lock: lock(path, path)? };
        folder.make_folders()?;
        for written in [path.into(), folder.failures()].into_iter().chain(folder.folders()) {
            crate::atomic::remove_unfinished(&written);
        }
        Ok(folder)
    }

    fn folders(&self) -> [PathBuf; 4] {
        [self.tensorboard(), self.previews(), self.checkpoints(), self.weights()]
    }

    fn make_folders(&self) -> Result<(), FolderError> {
        for path in self.folders() {
            fs::create_dir_all(&path).map_err(|source| FolderError::Io { path, source })?;
        }
        Ok(())
    }

    fn remove(&self, name: &str) -> Result<(), FolderError> {
        let path = self.path.join(name);
        let removed = if path.is_dir() { fs::remove_dir_all(&path) } else { fs::remove_file(&path) };
        match removed {
            Err(source) if source.kind() != io::ErrorKind::NotFound => Err(FolderError::Io { path, source }),
            _ => Ok(()),
        }
    }

    /// Writes one of the folder's small files, whole or not at all.
    ///
    /// # Errors
    /// The system's refusal, with the file's path.
    pub fn write(&self, name: &str, text: &str) -> Result<(), FolderError> {
        let path = self.path.join(name);
        crate::atomic::write(&path, text.as_bytes()).map_err(|source| FolderError::Io { path, source })
    }

    /// The folder itself.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The resolved config.
    pub fn config(&self) -> PathBuf {
        self.path.join("config.toml")
    }

    /// One JSON object per line: losses, measurements.
    pub fn metrics(&self) -> PathBuf {
        self.path.join("metrics.jsonl")
    }

    /// TensorBoard event files.
    pub fn tensorboard(&self) -> PathBuf {
        self.path.join("tb")
    }

    /// Pictures of frames, flows and maps, by stage and step.
    pub fn previews(&self) -> PathBuf {
        self.path.join("previews")
    }

    /// Checkpoints of the running stage.
    pub fn checkpoints(&self) -> PathBuf {
        self.path.join("checkpoints")
    }

    /// Weights of finished stages.
    pub fn weights(&self) -> PathBuf {
        self.path.join("weights")
    }

    /// Exemplars on which a loss was not finite.
    pub fn failures(&self) -> PathBuf {
        self.path.join("failures")
    }
}

/// Where a folder is made ready before it appears; none for a path that doesn't end in a name.
fn preparing(path: &Path) -> Option<PathBuf> {
    let name = path.file_name()?.to_string_lossy();
    Some(path.with_file_name(format!(".preparing-{name}")))
}

/// The system releases the lock when the process ends, however it ends. `path` is what a person calls the folder.
fn lock(folder: &Path, path: &Path) -> Result<File, FolderError> {
    let lock = folder.join(LOCK);
    let file = File::create(&lock).map_err(|source| FolderError::Io { path: lock.clone(), source })?;
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(TryLockError::WouldBlock) => Err(FolderError::Locked { path: path.into() }),
        Err(TryLockError::Error(source)) => Err(FolderError::Io { path: lock, source }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Begins a run as the program does, with the least that makes it one.
    fn begin(path: &Path, force: bool) -> Result<RunFolder, FolderError> {
        RunFolder::create(path, force, |folder| {
            folder.write("config.toml", "")?;
            folder.write("run.json", "{}")
        })
    }

    #[test]
    fn an_existing_run_is_refused_and_force_replaces_only_what_a_run_writes() {
        let home = tempfile::tempdir().unwrap();
        let path = home.path().join("run");
        begin(&path, false).unwrap().write("report.json", "{}").unwrap();
        fs::write(path.join("notes.txt"), "mine").unwrap();
        assert!(matches!(begin(&path, false), Err(FolderError::Exists { .. })));
        begin(&path, true).unwrap();
        assert!(!path.join("report.json").exists());
        assert_eq!(fs::read_to_string(path.join("notes.txt")).unwrap(), "mine");
    }

    #[test]
    fn force_does_not_touch_a_folder_that_no_run_wrote() {
        let home = tempfile::tempdir().unwrap();
        fs::create_dir(home.path().join("weights")).unwrap();
        fs::write(home.path().join("weights/precious"), "").unwrap();
        assert!(matches!(begin(home.path(), true), Err(FolderError::Foreign { .. })));
        assert!(home.path().join("weights/precious").exists());
    }

    #[test]
    fn a_run_appears_whole_or_not_at_all() {
        let home = tempfile::tempdir().unwrap();
        let path = home.path().join("run");
        let seen = std::cell::Cell::new(true);
        let refused = RunFolder::create(&path, false, |_| {
            seen.set(path.exists());
            Err(FolderError::Absent { path: path.clone() })
        });
        assert!(refused.is_err() && !seen.get());
        assert_eq!(fs::read_dir(home.path()).unwrap().count(), 0);
        // What a kill leaves is neither in the way of the next start nor does it last.
        fs::create_dir_all(home.path().join(".preparing-run/tb")).unwrap();
        begin(&path, false).unwrap();
        assert_eq!(fs::read_dir(home.path()).unwrap().count(), 1);
    }

    #[test]
    fn a_start_that_was_killed_in_an_existing_folder_can_be_forced() {
        let home = tempfile::tempdir().unwrap();
        let path = home.path().join("run");
        begin(&path, false).unwrap();
        fs::remove_file(path.join("run.json")).unwrap();
        assert!(matches!(RunFolder::open(&path), Err(FolderError::Absent { .. })));
        assert!(begin(&path, true).is_ok());
    }

    #[test]
    fn two_runs_cannot_share_a_folder() {
        let home = tempfile::tempdir().unwrap();
        let path = home.path().join("run");
        let first = begin(&path, false).unwrap();
        assert!(matches!(RunFolder::open(&path), Err(FolderError::Locked { .. })));
        assert!(matches!(begin(&path, true), Err(FolderError::Locked { .. })));
        drop(first);
        assert!(RunFolder::open(&path).is_ok());
    }

    #[test]
    fn two_runs_cannot_begin_in_one_folder() {
        let home = tempfile::tempdir().unwrap();
        let path = home.path().join("run");
        RunFolder::create(&path, false, |_| {
            assert!(matches!(begin(&path, false), Err(FolderError::Locked { path: told }) if told == path));
            Ok::<_, FolderError>(())
        })
        .unwrap();
    }

    #[test]
    fn what_killed_processes_left_half_written_is_removed() {
        let home = tempfile::tempdir().unwrap();
        let path = home.path().join("run");
        let half = begin(&path, false).unwrap().checkpoints().join(".writing-a1b2");
        fs::write(&half, "half").unwrap();
        RunFolder::open(&path).unwrap();
        assert!(!half.exists());
    }

    #[test]
    fn only_a_run_can_be_resumed() {
        let home = tempfile::tempdir().unwrap();
        assert!(matches!(RunFolder::open(home.path()), Err(FolderError::Absent { .. })));
    }
}
