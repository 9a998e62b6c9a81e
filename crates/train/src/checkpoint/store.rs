//! The checkpoints folder: write, list, keep the last ones, load the newest.

use super::{Checkpoint, CheckpointError};
use burn::tensor::Device;
use std::path::{Path, PathBuf};

/// Checkpoints of a run.
pub struct Store {
    /// The folder.
    pub folder: PathBuf,
    /// How many of a stage stay.
    pub keep_last: usize,
    /// Digest of the config that a checkpoint must carry.
    pub fingerprint: String,
}

impl Store {
    /// Writes a checkpoint, whole or not at all, then removes the oldest beyond `keep_last`.
    ///
    /// # Errors
    /// The system's refusal; earlier checkpoints are untouched then.
    pub fn save(&self, checkpoint: &Checkpoint) -> Result<PathBuf, CheckpointError> {
        let path = self.folder.join(format!("{}-{:08}.safetensors", checkpoint.state.stage, checkpoint.state.step));
        let error = |source| CheckpointError::Io { path: path.clone(), source };
        let bytes = checkpoint.to_bytes().map_err(|reason| error(std::io::Error::other(reason)))?;
        crate::atomic::write(&path, &bytes).map_err(error)?;
        for (old, _) in self.list(&checkpoint.state.stage).into_iter().skip(self.keep_last) {
            std::fs::remove_file(&old).map_err(|source| CheckpointError::Io { path: old, source })?;
        }
        Ok(path)
    }

    /// The stage's checkpoints with their steps, newest first.
    pub fn list(&self, stage: &str) -> Vec<(PathBuf, u64)> {
        let Ok(entries) = std::fs::read_dir(&self.folder) else { return Vec::new() };
        let step_of = |path: &Path| {
            let step = path.file_name()?.to_str()?.strip_prefix(stage)?.strip_prefix('-')?.strip_suffix(".safetensors")?;
            step.parse().ok()
        };
        let mut found: Vec<(PathBuf, u64)> =
            entries.flatten().filter_map(|entry| step_of(&entry.path()).map(|step| (entry.path(), step))).collect();
        found.sort_by_key(|(_, step)| std::cmp::Reverse(*step));
        found
    }

    /// Reads one checkpoint and checks that it belongs to this run and stage.
    ///
    /// # Errors
    /// An unreadable, damaged or foreign file.
    pub fn load(&self, path: &Path, stage: &str, device: &Device) -> Result<Checkpoint, CheckpointError> {
        let bytes = std::fs::read(path).map_err(|source| CheckpointError::Io { path: path.into(), source })?;
        let checkpoint =
            Checkpoint::from_bytes(&bytes, device).map_err(|reason| CheckpointError::Damaged { path: path.into(), reason })?;
        let foreign = |reason| Err(CheckpointError::Foreign { path: path.into(), reason });
        if checkpoint.state.stage != stage {
            return foreign(format!("it is of the stage `{}`, the run stands in `{stage}`", checkpoint.state.stage));
        }
        if checkpoint.state.fingerprint != self.fingerprint {
            return foreign("it was written under another configuration or seed".into());
        }
        Ok(checkpoint)
    }

    /// The newest checkpoint of a stage, or `None` before the first one.
    ///
    /// # Errors
    /// [`CheckpointError::Refused`] when the newest is unusable: continuing from an older one loses work, so it is offered,
    /// not done.
    pub fn newest(&self, stage: &str, device: &Device) -> Result<Option<Checkpoint>, CheckpointError> {
        let mut all = self.list(stage).into_iter();
        let Some((path, _)) = all.next() else { return Ok(None) };
        match self.load(&path, stage, device) {
            Ok(checkpoint) => Ok(Some(checkpoint)),
            Err(refused) => {
                let previous = all.find(|(path, _)| self.load(path, stage, device).is_ok());
                Err(CheckpointError::Refused { refused: Box::new(refused), previous })
            }
        }
    }

    /// Sets checkpoints of a stage after a step aside (as `*.set-aside`), when a person chose to continue from an earlier one.
    ///
    /// # Errors
    /// The system's refusal.
    pub fn set_aside_after(&self, stage: &str, step: u64) -> Result<(), CheckpointError> {
        for (path, _) in self.list(stage).into_iter().filter(|(_, at)| *at > step) {
            let aside = path.with_extension("safetensors.set-aside");
            std::fs::rename(&path, aside).map_err(|source| CheckpointError::Io { path, source })?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::State;
    use super::*;
    use crate::optimiser::{NamedTensors, from_vec, to_vec};

    fn store(folder: &Path) -> Store {
        Store { folder: folder.into(), keep_last: 2, fingerprint: "f".into() }
    }

    fn checkpoint(step: u64) -> Checkpoint {
        let tensors = |x: f32| {
            NamedTensors::from([("a.0.weight".to_string(), from_vec(vec![x, -0.0, f32::MIN_POSITIVE], &Device::flex()))])
        };
        let state = State { stage: "adjacent".into(), step, seconds: 0.1 + 0.2, fingerprint: "f".into(), ..State::default() };
        Checkpoint {
            state,
            weights: tensors(1.0 / 3.0),
            average: NamedTensors::new(),
            first: tensors(2.0),
            second: tensors(3.0),
        }
    }

    fn saved() -> (tempfile::TempDir, Vec<PathBuf>) {
        let home = tempfile::tempdir().unwrap();
        let store = store(home.path());
        let paths = [100, 200, 300].map(|step| store.save(&checkpoint(step)).unwrap()).to_vec();
        (home, paths)
    }

    #[test]
    fn a_checkpoint_comes_back_to_the_last_bit() {
        let (home, _) = saved();
        let back = store(home.path()).newest("adjacent", &Device::flex()).unwrap().unwrap();
        let bits = |c: &Checkpoint| to_vec(&c.weights["a.0.weight"]).iter().map(|v| v.to_bits()).collect::<Vec<_>>();
        assert_eq!(bits(&back), bits(&checkpoint(300)));
        assert_eq!(back.state, checkpoint(300).state);
        assert!(back.average.is_empty());
    }

    #[test]
    fn only_the_last_ones_stay() {
        let (home, paths) = saved();
        assert!(!paths[0].exists() && paths[1].exists() && paths[2].exists());
        assert_eq!(std::fs::read_dir(home.path()).unwrap().count(), 2);
    }

    #[test]
    fn damage_of_any_kind_is_refused_and_the_previous_one_offered() {
        let (home, paths) = saved();
        let good = std::fs::read(&paths[2]).unwrap();
        let mut flipped = good.clone();
        *flipped.last_mut().unwrap() ^= 1;
        for bad in [&good[..good.len() - 1], &good[..40], &[][..], &flipped[..], b"not a checkpoint at all"] {
            std::fs::write(&paths[2], bad).unwrap();
            let Err(CheckpointError::Refused { refused, previous }) = store(home.path()).newest("adjacent", &Device::flex())
            else {
                panic!("{} bytes were accepted", bad.len());
            };
            assert!(matches!(*refused, CheckpointError::Damaged { .. }), "{refused}");
            assert_eq!(previous, Some((paths[1].clone(), 200)));
        }
    }

    #[test]
    fn another_runs_checkpoint_is_refused() {
        let (home, paths) = saved();
        let other = Store { fingerprint: "g".into(), ..store(home.path()) };
        let text = other.newest("adjacent", &Device::flex()).err().unwrap().to_string();
        assert!(text.contains("another configuration"), "{text}");
        let text = store(home.path()).load(&paths[2], "distant", &Device::flex()).err().unwrap().to_string();
        assert!(text.contains("`adjacent`") && text.contains("`distant`"), "{text}");
    }

    #[test]
    fn a_stage_without_checkpoints_starts_anew() {
        let (home, _) = saved();
        assert!(store(home.path()).newest("distant", &Device::flex()).unwrap().is_none());
    }

    #[test]
    fn later_ones_are_set_aside_not_removed() {
        let (home, paths) = saved();
        store(home.path()).set_aside_after("adjacent", 200).unwrap();
        assert_eq!(store(home.path()).list("adjacent"), [(paths[1].clone(), 200)]);
        assert_eq!(std::fs::read_dir(home.path()).unwrap().count(), 2);
    }
}
