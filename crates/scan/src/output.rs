//! The output folder: everything or nothing.

use std::path::{Path, PathBuf};

/// Why an output folder can't be had.
#[derive(Debug, thiserror::Error)]
pub enum OutputError {
    /// There is something already.
    #[error("{path} exists already: give another --out, or --force to replace it")]
    Exists {
        /// Where.
        path: PathBuf,
    },
    /// It can't be written.
    #[error("can't write {path}: {source}; check that the folder exists, may be written to and that the disk isn't full")]
    Write {
        /// Where.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
}

/// Refuses an output that exists unless it may be replaced.
///
/// # Errors
/// [`OutputError::Exists`].
pub fn check(out: &Path, force: bool) -> Result<(), OutputError> {
    if out.exists() && !force { Err(OutputError::Exists { path: out.into() }) } else { Ok(()) }
}

/// A folder beside the output that becomes the output when it is whole, and disappears if it never gets there.
#[derive(Debug)]
pub struct Staging {
    folder: PathBuf,
    out: PathBuf,
}

impl Staging {
    /// Makes the folder.
    ///
    /// # Errors
    /// [`OutputError::Write`].
    pub fn new(out: &Path) -> Result<Self, OutputError> {
        let name = out.file_name().map_or_else(|| "scan".into(), |n| n.to_string_lossy().into_owned());
        let parent = out.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let folder = parent.join(format!(".{name}.partial-{}", std::process::id()));
        std::fs::create_dir_all(&folder).map_err(|source| OutputError::Write { path: folder.clone(), source })?;
        Ok(Self { folder, out: out.into() })
    }

    /// Where to write.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Puts the finished folder in its place; an old one goes.
    ///
    /// # Errors
    /// [`OutputError::Write`].
    pub fn finish(self) -> Result<(), OutputError> {
        let wrap = |source| OutputError::Write { path: self.out.clone(), source };
        if self.out.is_dir() {
            // The old result is moved aside first, so that there is a whole one at every moment.
            let old = self.folder.with_extension("old");
            std::fs::rename(&self.out, &old).map_err(wrap)?;
            std::fs::rename(&self.folder, &self.out).map_err(wrap)?;
            return std::fs::remove_dir_all(&old).map_err(wrap);
        }
        if self.out.exists() {
            std::fs::remove_file(&self.out).map_err(wrap)?;
        }
        std::fs::rename(&self.folder, &self.out).map_err(wrap)
    }
}

impl Drop for Staging {
    fn drop(&mut self) {
        // After `finish` there is nothing left here; otherwise a failed scan leaves nothing behind.
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_output_appears_whole_or_not_at_all() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("result");
        let staging = Staging::new(&out).unwrap();
        std::fs::write(staging.folder().join("a"), "1").unwrap();
        drop(staging);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
        for text in ["1", "2"] {
            let staging = Staging::new(&out).unwrap();
            std::fs::write(staging.folder().join("a"), text).unwrap();
            staging.finish().unwrap();
            assert_eq!(std::fs::read_to_string(out.join("a")).unwrap(), text);
        }
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
        assert!(matches!(check(&out, false), Err(OutputError::Exists { .. })));
        assert!(check(&out, true).is_ok());
    }
}
