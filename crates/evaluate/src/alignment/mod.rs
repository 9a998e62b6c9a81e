//! The alignment protocol (spec 3.2, 6.2; the paper's Table 5 and the alignment columns of its Table 2): scans of held-out
//! materials under many conditions, aligned by the aligner as it is and with one switch off, against exact warps.
//!
//! A *case* is one scan under one condition. Cases are kept one by one ([`store`]), so that an evaluation that was stopped goes
//! on where it was, and more conditions or scans can be added later. Frames are rendered while they are read: memory doesn't
//! grow with the resolution of the frames, and hardly with their number.

pub mod camera;
pub mod case;
pub mod conditions;
pub mod export;
pub mod film;
pub mod footage;
pub mod store;
pub mod summary;
pub mod table;

use dataset::material::augment::AugmentConfig;
use dataset::material::library::MaterialLibrary;
use dataset::material::split::Split;
use dataset::sequence::{Sequence, SequenceConfig};
use dataset::stream::Stream;
use flow::align::AlignConfig;
use flow::weights::FlowNets;
use serde::{Deserialize, Serialize};

use crate::EvaluateError;
use case::Case;
use conditions::Condition;
use film::Encoding;
use store::Store;

/// Settings of the protocol before a condition changes them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AlignmentConfig {
    /// Scans per condition: scan i shows held-out material i, and when there are no more, the first one again on another path.
    pub sequences: usize,
    /// The numbers of the scans to measure, where it isn't the first `sequences`.
    pub scans: Vec<usize>,
    /// Side of the frames in pixels.
    pub resolution: usize,
    /// The alignment.
    pub align: AlignConfig,
    /// The scans. Materials are shown as they are.
    pub videos: SequenceConfig,
    /// The encoder that stores the scans.
    pub encoding: Encoding,
    /// Seed of paths, lights and noise.
    pub seed: u64,
}

impl Default for AlignmentConfig {
    fn default() -> Self {
        Self {
            sequences: 100,
            scans: Vec::new(),
            resolution: 1024,
            align: AlignConfig::default(),
            videos: SequenceConfig { augment: AugmentConfig::none(), ..crate::synthetic::spirals() },
            encoding: Encoding::default(),
            seed: 7001,
        }
    }
}

impl AlignmentConfig {
    /// Checks the values before any work.
    ///
    /// # Errors
    /// Names the first value that can't work.
    pub fn validate(&self) -> Result<(), EvaluateError> {
        let error = |name, found: usize, expected| Err(EvaluateError::Config { name, found: found.to_string(), expected });
        match self {
            Self { sequences: 0, scans, .. } if scans.is_empty() => error("sequences", 0, "at least one scan"),
            Self { resolution: r, .. } if !(64..=4096).contains(r) => error("resolution", *r, "64 to 4096 pixels"),
            Self { resolution: r, encoding, .. } if encoding.encodes() && r % 2 == 1 => {
                error("resolution", *r, "an even number of pixels: videos have half as many for colour (encoding.codec)")
            }
            _ => {
                self.encoding.validate()?;
                self.videos.validate().map_err(EvaluateError::Videos)
            }
        }
    }

    /// The numbers of the scans.
    pub fn numbers(&self) -> Vec<usize> {
        if self.scans.is_empty() { (0..self.sequences).collect() } else { self.scans.clone() }
    }

    /// Scan `index`: the same for every condition but for what the condition changes.
    ///
    /// # Errors
    /// If there is no held-out material, or it can't be loaded.
    pub fn sequence(&self, library: &MaterialLibrary, index: usize) -> Result<Sequence, EvaluateError> {
        let held_out = library.len(Split::Test);
        // Says that there is no test material and what to do.
        let material =
            if held_out == 0 { library.material(Split::Test, 0)? } else { library.nth(Split::Test, index % held_out)? };
        Ok(Sequence::new(material, &self.videos, &Stream::new(self.seed), index as u64))
    }
}

/// Measures every condition on every scan that isn't in the store yet, and returns all cases. `progress` hears of every case
/// and says whether to go on.
///
/// # Errors
/// See [`EvaluateError`].
pub fn run(
    library: &MaterialLibrary,
    nets: &FlowNets,
    (config, conditions): (&AlignmentConfig, &[Condition]),
    store: &Store,
    mut progress: impl FnMut(&Case) -> bool,
) -> Result<Vec<Case>, EvaluateError> {
    config.validate()?;
    let settings = conditions.iter().map(|c| Ok((c, c.settings(config)?)));
    let settings: Vec<(&Condition, AlignmentConfig)> = settings.collect::<Result<_, EvaluateError>>()?;
    for (_, changed) in &settings {
        changed.validate()?;
    }
    find_encoders(&settings, store)?;
    let mut cases = Vec::new();
    // Scan by scan, so that what there is after a while covers all conditions.
    for index in config.numbers() {
        for (condition, changed) in &settings {
            let case = match store.read(condition, index)? {
                Some(case) => case,
                None => store.write(&Case::measure(condition, index, &changed.sequence(library, index)?, nets, changed)?)?,
            };
            let go_on = progress(&case);
            cases.push(case);
            if !go_on {
                return Err(EvaluateError::Stopped);
            }
        }
    }
    Ok(cases)
}

/// Whether all encoders are there that scans still to be measured need: said before hours of other conditions, not after.
fn find_encoders(settings: &[(&Condition, AlignmentConfig)], store: &Store) -> Result<(), EvaluateError> {
    let mut found: Vec<&Encoding> = Vec::new();
    for (condition, changed) in settings {
        let encoding = &changed.encoding;
        if !encoding.encodes() || found.contains(&encoding) {
            continue;
        }
        let cases = changed.numbers().into_iter().map(|index| store.read(condition, index));
        if cases.collect::<Result<Vec<_>, EvaluateError>>()?.iter().any(Option::is_none) {
            encoding.probe()?;
            found.push(encoding);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests;
