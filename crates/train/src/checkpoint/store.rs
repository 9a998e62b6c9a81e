//! The checkpoints folder: write, list, keep the last ones, load the newest.

use super::{Checkpoint, CheckpointError, Unreadable};
use burn::tensor::Device;
use std::path::{Path, PathBuf};

/// Checkpoints of a run.
pub struct Store {
    /// The folder.
    pub folder: PathBuf,
    /// How many of a stage stay, the newest.
    pub keep_last: usize,
    /// How many more stay, those that were measured as the best.
    pub keep_best: usize,
    /// Digest of the config that a checkpoint must carry.
    pub fingerprint: String,
}

impl Store {
    /// Writes a checkpoint, whole or not at all, then removes those that are neither among the newest nor among the best.
    ///
    /// # Errors
    /// The system's refusal; earlier checkpoints are untouched then.
    pub fn save(&self, checkpoint: &Checkpoint) -> Result<PathBuf, CheckpointError> {
        let path = self.folder.join(format!("{}-{:08}.safetensors", checkpoint.state.stage, checkpoint.state.step));
        let error = |source| CheckpointError::Io { path: path.clone(), source };
        let bytes = checkpoint.to_bytes().map_err(|reason| error(std::io::Error::other(reason)))?;
        crate::atomic::write(&path, &bytes).map_err(error)?;
        let best: Vec<u64> = checkpoint.state.best.iter().take(self.keep_best).map(|measured| measured.step).collect();
        let older = self.list(&checkpoint.state.stage).into_iter().skip(self.keep_last);
        for (old, _) in older.filter(|(_, step)| !best.contains(step)) {
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
        let checkpoint = Checkpoint::from_bytes(&bytes, device).map_err(|unreadable| match unreadable {
            Unreadable::Version(found) => CheckpointError::Version { path: path.into(), found },
            Unreadable::Damaged(reason) => CheckpointError::Damaged { path: path.into(), reason },
        })?;
        let foreign = |reason| Err(CheckpointError::Foreign { path: path.into(), reason });
        if checkpoint.state.stage != stage {
            return foreign(format!("it is of the stage `{}`, the run stands in `{stage}`", checkpoint.state.stage));
        }
        if checkpoint.state.fingerprint != self.fingerprint {
            return foreign("it was written under another configuration or seed".into());
        }
        Ok(checkpoint)
    }

    /// Reads a checkpoint of [`Self::list`], which must be what its name says.
    fn load_listed(&self, path: &Path, step: u64, stage: &str, device: &Device) -> Result<Checkpoint, CheckpointError> {
        let checkpoint = self.load(path, stage, device)?;
        if checkpoint.state.step != step {
            let reason =
                format!("it is of step {} and its name says {step}: it was renamed or exchanged", checkpoint.state.step);
            return Err(CheckpointError::Foreign { path: path.into(), reason });
        }
        Ok(checkpoint)
    }

    /// The newest checkpoint of a stage, or `None` before the first one.
    ///
    /// # Errors
    /// [`CheckpointError::Refused`] when the newest is unusable: continuing from an older one loses work, so it is offered,
    /// not done.
    pub fn newest(&self, stage: &str, device: &Device) -> Result<Option<Checkpoint>, CheckpointError> {
        let Some((path, step)) = self.list(stage).into_iter().next() else { return Ok(None) };
        let loaded = self.load_listed(&path, step, stage, device);
        loaded.map(Some).map_err(|refused| self.refused(refused, &path, stage, device))
    }

    /// A checkpoint that a person chose. Newer ones of the stage are set aside.
    ///
    /// # Errors
    /// [`CheckpointError::Refused`] when it is unusable.
    pub fn chosen(&self, path: &Path, stage: &str, device: &Device) -> Result<Checkpoint, CheckpointError> {
        let checkpoint = self.load(path, stage, device).map_err(|refused| self.refused(refused, path, stage, device))?;
        self.set_aside_after(stage, checkpoint.state.step)?;
        Ok(checkpoint)
    }

    /// Looks for another checkpoint to offer.
    fn refused(&self, refused: CheckpointError, path: &Path, stage: &str, device: &Device) -> CheckpointError {
        let others = self.list(stage).into_iter().filter(|(other, _)| other != path);
        let usable = others.into_iter().find(|(other, step)| self.load_listed(other, *step, stage, device).is_ok());
        let run = self.folder.parent().unwrap_or(&self.folder).to_path_buf();
        CheckpointError::Refused { refused: Box::new(refused), run, usable }
    }

    /// Sets checkpoints of a stage after a step aside, as `*.set-aside`.
    fn set_aside_after(&self, stage: &str, step: u64) -> Result<(), CheckpointError> {
        for (path, _) in self.list(stage).into_iter().filter(|(_, at)| *at > step) {
            let aside = path.with_extension("safetensors.set-aside");
            std::fs::rename(&path, aside).map_err(|source| CheckpointError::Io { path, source })?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::{FORMAT, Measured, State};
    use super::*;
    use crate::optimiser::{NamedTensors, from_vec, to_vec};

    fn store(folder: &Path) -> Store {
        Store { folder: folder.join("checkpoints"), keep_last: 2, keep_best: 0, fingerprint: "f".into() }
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
        std::fs::create_dir(&store.folder).unwrap();
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
    fn a_checkpoint_from_before_half_precision_begins_with_the_first_factor() {
        let mut old = serde_json::to_value(&checkpoint(5).state).unwrap();
        old.as_object_mut().unwrap().remove("loss_scale").unwrap();
        assert_eq!(serde_json::from_value::<State>(old).unwrap(), checkpoint(5).state);
    }

    #[test]
    fn only_the_last_ones_stay() {
        let (home, paths) = saved();
        assert!(!paths[0].exists() && paths[1].exists() && paths[2].exists());
        assert_eq!(std::fs::read_dir(store(home.path()).folder).unwrap().count(), 2);
    }

    #[test]
    fn damage_of_any_kind_is_refused_and_the_previous_one_offered() {
        let (home, paths) = saved();
        let good = std::fs::read(&paths[2]).unwrap();
        let mut flipped = good.clone();
        *flipped.last_mut().unwrap() ^= 1;
        for bad in [&good[..good.len() - 1], &good[..40], &[][..], &flipped[..], b"not a checkpoint at all"] {
            std::fs::write(&paths[2], bad).unwrap();
            let (refused, usable) = refused(&store(home.path()));
            assert!(matches!(refused, CheckpointError::Damaged { .. }), "{refused}");
            assert_eq!(usable, Some((paths[1].clone(), 200)));
        }
    }

    /// Why the newest is refused, and what is offered.
    fn refused(store: &Store) -> (CheckpointError, Option<(PathBuf, u64)>) {
        match store.newest("adjacent", &Device::flex()).map(drop) {
            Err(CheckpointError::Refused { refused, usable, .. }) => (*refused, usable),
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn the_offer_is_a_command() {
        let (home, paths) = saved();
        std::fs::write(&paths[2], "").unwrap();
        let text = store(home.path()).newest("adjacent", &Device::flex()).err().unwrap().to_string();
        let command = format!("`--resume {} --checkpoint {}`", home.path().display(), paths[1].display());
        assert!(text.contains(&command), "{text}");
        std::fs::write(&paths[1], "").unwrap();
        let text = store(home.path()).newest("adjacent", &Device::flex()).err().unwrap().to_string();
        assert!(text.contains("no other usable checkpoint"), "{text}");
    }

    #[test]
    fn files_that_were_exchanged_or_mixed_are_refused() {
        let (home, paths) = saved();
        let (older, newer) = (std::fs::read(&paths[1]).unwrap(), std::fs::read(&paths[2]).unwrap());
        std::fs::write(&paths[2], &older).unwrap();
        let (reason, usable) = refused(&store(home.path()));
        assert!(reason.to_string().contains("of step 200 and its name says 300"), "{reason}");
        assert_eq!(usable, Some((paths[1].clone(), 200)));
        // The header of one with the values of the other.
        let header = 8 + u64::from_le_bytes(newer[..8].try_into().unwrap()) as usize;
        let values = checkpoint(200).to_bytes().unwrap().len() - header;
        let mut other = checkpoint(200);
        other.weights.insert("a.0.weight".into(), from_vec(vec![7.0, 8.0, 9.0], &Device::flex()));
        let other = other.to_bytes().unwrap();
        std::fs::write(&paths[2], [&newer[..header], &other[other.len() - values..]].concat()).unwrap();
        let (reason, _) = refused(&store(home.path()));
        assert!(reason.to_string().contains("put together from several files"), "{reason}");
    }

    #[test]
    fn a_checkpoint_of_another_version_is_refused_as_such() {
        let (home, paths) = saved();
        let mut bytes = std::fs::read(&paths[2]).unwrap();
        let at = bytes.windows(FORMAT.len()).position(|window| window == FORMAT.as_bytes()).unwrap();
        bytes[at + FORMAT.len() - 1] = b'0';
        std::fs::write(&paths[2], &bytes).unwrap();
        let (reason, usable) = refused(&store(home.path()));
        assert!(matches!(&reason, CheckpointError::Version { found, .. } if found.ends_with("-0")), "{reason}");
        assert_eq!(usable, Some((paths[1].clone(), 200)));
    }

    #[test]
    fn a_chosen_checkpoint_that_is_unusable_leaves_the_others_in_place() {
        let (home, paths) = saved();
        let store = store(home.path());
        let chosen = home.path().join("mine.safetensors");
        std::fs::write(&chosen, "").unwrap();
        let error = store.chosen(&chosen, "adjacent", &Device::flex()).err().unwrap();
        assert!(matches!(error, CheckpointError::Refused { usable: Some((path, 300)), .. } if path == paths[2]));
        assert_eq!(store.list("adjacent").len(), 2);
    }

    #[test]
    fn the_best_stay_beside_the_last() {
        let home = tempfile::tempdir().unwrap();
        let store = Store { keep_best: 1, ..store(home.path()) };
        std::fs::create_dir(&store.folder).unwrap();
        let best = [(100, 5.0), (200, 3.0), (200, 3.0), (200, 3.0), (500, 2.0), (500, 2.0), (500, 2.0)];
        for (step, (at, figure)) in (1..).zip(best) {
            let mut checkpoint = checkpoint(100 * step);
            checkpoint.state.best = vec![Measured { step: at, figure }, Measured { step: 100, figure: 5.0 }];
            store.save(&checkpoint).unwrap();
        }
        let steps: Vec<u64> = store.list("adjacent").into_iter().map(|(_, step)| step).collect();
        assert_eq!(steps, [700, 600, 500]);
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
        let chosen = store(home.path()).chosen(&paths[1], "adjacent", &Device::flex()).unwrap();
        assert_eq!(chosen.state.step, 200);
        assert_eq!(store(home.path()).list("adjacent"), [(paths[1].clone(), 200)]);
        assert_eq!(std::fs::read_dir(store(home.path()).folder).unwrap().count(), 2);
    }
}
