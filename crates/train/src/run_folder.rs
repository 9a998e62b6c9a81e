//! The folder of a run: what lies where, who may write into it.

use std::fs::{self, File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};

/// Everything the program itself puts into a run folder; `--force` removes these and nothing else.
const OWN: [&str; 14] = [
    "config.toml",
    "run.json",
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
    #[error("{} is not a run folder (it has no run.json), so `--force` does not replace it: choose another with `--out`", path.display())]
    Foreign {
        /// The folder.
        path: PathBuf,
    },
    /// Nothing to resume.
    #[error("there is no run to resume in {}: expected a folder with config.toml and run.json, as a run leaves it", path.display())]
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
    /// Makes a new run folder; `force` replaces an earlier run in it.
    ///
    /// # Errors
    /// A folder that isn't empty (without `force`), that no run wrote, that is in use, or that can't be written.
    pub fn create(path: &Path, force: bool) -> Result<Self, FolderError> {
        let occupied =
            fs::read_dir(path).is_ok_and(|mut entries| entries.any(|entry| entry.is_ok_and(|e| e.file_name() != LOCK)));
        if (occupied || path.is_file()) && !force {
            return Err(FolderError::Exists { path: path.into() });
        }
        if path.is_file() || (occupied && !path.join("run.json").is_file()) {
            return Err(FolderError::Foreign { path: path.into() });
        }
        fs::create_dir_all(path).map_err(|source| FolderError::Io { path: path.into(), source })?;
        let folder = Self { path: path.into(), _lock: lock(path)? };
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
        let folder = Self { path: path.into(), _lock: lock(path)? };
        folder.make_folders()?;
        Ok(folder)
    }

    fn make_folders(&self) -> Result<(), FolderError> {
        for path in [self.tensorboard(), self.previews(), self.checkpoints(), self.weights()] {
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

/// The system releases the lock when the process ends, however it ends.
fn lock(folder: &Path) -> Result<File, FolderError> {
    let path = folder.join(LOCK);
    let file = File::create(&path).map_err(|source| FolderError::Io { path: path.clone(), source })?;
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(TryLockError::WouldBlock) => Err(FolderError::Locked { path: folder.into() }),
        Err(TryLockError::Error(source)) => Err(FolderError::Io { path, source }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_existing_run_is_refused_and_force_replaces_only_what_a_run_writes() {
        let home = tempfile::tempdir().unwrap();
        let path = home.path().join("run");
        drop(RunFolder::create(&path, false).unwrap().write("run.json", "{}"));
        fs::write(path.join("notes.txt"), "mine").unwrap();
        assert!(matches!(RunFolder::create(&path, false), Err(FolderError::Exists { .. })));
        RunFolder::create(&path, true).unwrap();
        assert!(!path.join("run.json").exists());
        assert_eq!(fs::read_to_string(path.join("notes.txt")).unwrap(), "mine");
    }

    #[test]
    fn force_does_not_touch_a_folder_that_no_run_wrote() {
        let home = tempfile::tempdir().unwrap();
        fs::create_dir(home.path().join("weights")).unwrap();
        fs::write(home.path().join("weights/precious"), "").unwrap();
        assert!(matches!(RunFolder::create(home.path(), true), Err(FolderError::Foreign { .. })));
        assert!(home.path().join("weights/precious").exists());
    }

    #[test]
    fn two_runs_cannot_share_a_folder() {
        let home = tempfile::tempdir().unwrap();
        let path = home.path().join("run");
        let first = RunFolder::create(&path, false).unwrap();
        first.write("run.json", "{}").unwrap();
        first.write("config.toml", "").unwrap();
        assert!(matches!(RunFolder::open(&path), Err(FolderError::Locked { .. })));
        assert!(matches!(RunFolder::create(&path, true), Err(FolderError::Locked { .. })));
        drop(first);
        assert!(RunFolder::open(&path).is_ok());
    }

    #[test]
    fn only_a_run_can_be_resumed() {
        let home = tempfile::tempdir().unwrap();
        assert!(matches!(RunFolder::open(home.path()), Err(FolderError::Absent { .. })));
    }
}
