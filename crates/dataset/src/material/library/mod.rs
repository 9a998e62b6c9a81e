//! All materials of a run: several sources mixed by weight, split into training and test, cached within a byte budget.

mod cache;
mod config;

use std::sync::Arc;

use rand::RngExt;
use serde::{Deserialize, Serialize};

pub use config::{InriaConfig, NpyConfig, PbrConfig, ProceduralConfig, SourceConfig};

use super::error::MaterialError;
use super::files::{MaterialFile, find_files};
use super::pbr::{PbrFolder, find_folders};
use super::procedural::{Family, generate};
use super::split::{Split, split_of};
use super::stored::{GRID, Material, MaterialInfo, Wrap};
use super::{inria, npy};
use crate::stream::Stream;
use cache::MaterialCache;

/// Licence of procedural materials: whatever is made with this program belongs to its user.
const PROCEDURAL_LICENCE: &str = "CC0-1.0 (generated)";
/// Side of a procedural tile, in texels of the [`GRID`]: what the generators' units are made for.
const PROCEDURAL_TILE: usize = 1024;

/// Why a library can't be opened or a material can't be had.
#[derive(Debug, thiserror::Error)]
pub enum LibraryError {
    /// A value of a source's config.
    #[error("materials, source {source_index} ({kind}): {key} is {found}; expected {expected}")]
    Config {
        /// Position of the source, from 1.
        source_index: usize,
        /// `procedural`, `pbr`, `inria` or `npy`.
        kind: &'static str,
        /// Name of the value.
        key: &'static str,
        /// What it is.
        found: String,
        /// What it may be.
        expected: String,
    },
    /// No source at all.
    #[error("no material source is configured; add one, for example `[[materials]]` with `type = \"procedural\"`")]
    NoSource,
    /// A side of the split without materials.
    #[error(
        "none of the {total} materials falls on the {split} side of the frozen split (20 % are for tests); add more materials"
    )]
    EmptySplit {
        /// The side.
        split: Split,
        /// How many materials there are on both sides.
        total: usize,
    },
    /// An index beyond the materials of a side.
    #[error("material {index} of the {split} side was asked for; there are {count}")]
    Index {
        /// The side.
        split: Split,
        /// What was asked for.
        index: usize,
        /// How many there are.
        count: usize,
    },
    /// A source's files.
    #[error(transparent)]
    Material(#[from] MaterialError),
}

#[derive(Clone, Debug)]
enum Origin {
    Procedural { family: Family, seed: u64, size: usize },
    Pbr { folder: Box<PbrFolder>, config: PbrConfig },
    Inria { file: Box<MaterialFile>, config: InriaConfig },
    Npy { file: Box<MaterialFile>, config: NpyConfig },
}

#[derive(Clone, Debug)]
struct Entry {
    name: String,
    split: Split,
    source: usize,
    origin: Origin,
}

/// One line of a run's record of its materials.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ManifestEntry {
    /// Name of the material.
    pub name: String,
    /// Its side.
    pub split: Split,
    /// What the side was decided by.
    pub identity: String,
    /// Where it comes from.
    pub source: String,
    /// Its licence.
    pub licence: String,
}

/// The materials of a run.
#[derive(Debug)]
pub struct MaterialLibrary {
    entries: Vec<Entry>,
    /// Weight and, per side, the entries of each source.
    sources: Vec<(f64, [Vec<usize>; 2])>,
    stream: Stream,
    cache: MaterialCache,
}

impl MaterialLibrary {
    /// Lists the materials of all sources; nothing is decoded or generated yet.
    ///
    /// # Units
    /// `cache_bytes`: how many bytes of decoded materials are kept for the next request.
    ///
    /// # Errors
    /// A source's config out of range, a folder that lacks a map, no material at all.
    pub fn open(sources: &[SourceConfig], seed: u64, cache_bytes: usize) -> Result<Self, LibraryError> {
        if sources.is_empty() {
            return Err(LibraryError::NoSource);
        }
        let mut entries = Vec::new();
        for (source, config) in sources.iter().enumerate() {
            config.validate(source + 1)?;
            entries.extend(entries_of(config, source)?);
        }
        let of = |source, split| {
            let mine = |(i, e): (usize, &Entry)| (e.source == source && e.split == split).then_some(i);
            entries.iter().enumerate().filter_map(mine).collect::<Vec<_>>()
        };
        let sources = sources.iter().enumerate();
        let sources = sources.map(|(s, c)| (c.weight(), [of(s, Split::Train), of(s, Split::Test)])).collect();
        let cache = MaterialCache::new(entries.len(), cache_bytes);
        Ok(Self { entries, sources, stream: Stream::new(seed), cache })
    }

    /// How many materials a side has.
    pub fn len(&self, split: Split) -> usize {
        self.entries.iter().filter(|e| e.split == split).count()
    }

    /// Whether a side has none.
    pub fn is_empty(&self, split: Split) -> bool {
        self.len(split) == 0
    }

    /// The material of a video: a pure function of the library's seed, the side and the video's number.
    ///
    /// A source is drawn by weight (among those with materials on this side), then one of its materials uniformly.
    ///
    /// # Errors
    /// [`LibraryError::EmptySplit`], or what loading the material says.
    pub fn material(&self, split: Split, video: u64) -> Result<Arc<Material>, LibraryError> {
        self.load(self.draw(split, video)?)
    }

    /// Name of the material of a video, without loading it.
    ///
    /// # Errors
    /// [`LibraryError::EmptySplit`].
    pub fn name(&self, split: Split, video: u64) -> Result<&str, LibraryError> {
        Ok(&self.entries[self.draw(split, video)?].name)
    }

    /// The `index`-th material of a side, in the order of the manifest: for going through all of them.
    ///
    /// # Errors
    /// [`LibraryError::Index`], or what loading the material says.
    pub fn nth(&self, split: Split, index: usize) -> Result<Arc<Material>, LibraryError> {
        let mut side = self.entries.iter().enumerate().filter(|(_, e)| e.split == split);
        match side.nth(index) {
            Some((entry, _)) => self.load(entry),
            None => Err(LibraryError::Index { split, index, count: self.len(split) }),
        }
    }

    /// Every material with its side, source and licence.
    pub fn manifest(&self) -> Vec<ManifestEntry> {
        self.entries.iter().map(Entry::manifest).collect()
    }

    /// Bytes of decoded materials in the cache.
    pub fn cached_bytes(&self) -> usize {
        self.cache.bytes()
    }

    fn draw(&self, split: Split, video: u64) -> Result<usize, LibraryError> {
        let mut rng = self.stream.rng(if split == Split::Train { "train material" } else { "test material" }, video);
        let sides =
            || self.sources.iter().map(|(weight, sides)| (*weight, &sides[split as usize])).filter(|(_, s)| !s.is_empty());
        let mut ticket = rng.random_range(0.0..1.0) * sides().map(|(weight, _)| weight).sum::<f64>();
        let mut chosen = None;
        for (weight, side) in sides() {
            chosen = Some(side);
            ticket -= weight;
            if ticket < 0.0 {
                break;
            }
        }
        let side = chosen.ok_or(LibraryError::EmptySplit { split, total: self.entries.len() })?;
        Ok(side[rng.random_range(0..side.len())])
    }

    fn load(&self, entry: usize) -> Result<Arc<Material>, LibraryError> {
        Ok(self.cache.get(entry, || self.entries[entry].load())?)
    }
}

impl Entry {
    fn new(name: String, identity: &str, source: usize, origin: Origin) -> Self {
        Self { name, split: split_of(identity), source, origin }
    }

    fn load(&self) -> Result<Material, MaterialError> {
        match &self.origin {
            Origin::Pbr { folder, config } => folder.load(config.texels, config.wrap),
            Origin::Inria { file, config } => {
                inria::load(&file.path, config.albedo_encoding, self.info(None, config.wrap, config.texels))
            }
            Origin::Npy { file, config } => {
                let info = self.info(None, config.wrap, config.texels);
                npy::load(&file.path, config.albedo_encoding, config.roughness_squared, info)
            }
            Origin::Procedural { family, seed, size } => {
                // A tile of another size shows the same ground at another density.
                let texels = GRID / PROCEDURAL_TILE * size;
                let info = self.info(Some(family.textured()), Wrap::Repeat, texels);
                Material::from_maps(info, &generate(*family, *seed, *size))
            }
        }
    }

    fn info(&self, textured: Option<bool>, wrap: Wrap, texels: usize) -> MaterialInfo {
        let ManifestEntry { name, identity, source, licence, .. } = self.manifest();
        MaterialInfo { name, identity, source, licence, textured, wrap, texels }
    }

    fn manifest(&self) -> ManifestEntry {
        let of_file = |kind: &str, file: &MaterialFile| {
            (file.identity(), format!("{kind} {}", file.path.display()), file.manifest.licence_or_unknown())
        };
        let (identity, source, licence) = match &self.origin {
            Origin::Pbr { folder, .. } => (folder.identity(), format!("pbr {}", folder.path.display()), folder.licence()),
            Origin::Inria { file, .. } => of_file("inria", file),
            Origin::Npy { file, .. } => of_file("npy", file),
            Origin::Procedural { family, seed, .. } => {
                (procedural_identity(*family, *seed), format!("procedural {}", family.name()), PROCEDURAL_LICENCE.into())
            }
        };
        ManifestEntry { name: self.name.clone(), split: self.split, identity, source, licence }
    }
}

/// The materials of a source, unread.
fn entries_of(config: &SourceConfig, source: usize) -> Result<Vec<Entry>, MaterialError> {
    Ok(match config {
        SourceConfig::Procedural(config) => procedural_entries(config, source),
        SourceConfig::Pbr(config) => {
            let entry = |folder: PbrFolder| {
                let (name, identity) = (folder.name.clone(), folder.identity());
                Entry::new(name, &identity, source, Origin::Pbr { folder: Box::new(folder), config: config.clone() })
            };
            find_folders(&config.path)?.into_iter().map(entry).collect()
        }
        SourceConfig::Inria(config) => {
            let origin = |file| Origin::Inria { file, config: config.clone() };
            file_entries(find_files(&config.path, inria::EXTENSION)?, source, origin)
        }
        SourceConfig::Npy(config) => {
            let origin = |file| Origin::Npy { file, config: config.clone() };
            file_entries(find_files(&config.path, npy::EXTENSION)?, source, origin)
        }
    })
}

fn file_entries(files: Vec<MaterialFile>, source: usize, origin: impl Fn(Box<MaterialFile>) -> Origin) -> Vec<Entry> {
    let entry = |file: MaterialFile| Entry::new(file.name.clone(), &file.identity(), source, origin(Box::new(file)));
    files.into_iter().map(entry).collect()
}

fn procedural_identity(family: Family, seed: u64) -> String {
    format!("procedural/{}/{seed}", family.name())
}

/// Material `i` is number `i / families` of family `i mod families`, so that every count shows all families evenly and a
/// larger count keeps the materials of a smaller one.
fn procedural_entries(config: &ProceduralConfig, source: usize) -> Vec<Entry> {
    let families = config.families();
    let entry = |i: usize| {
        let (family, number) = (families[i % families.len()], (i / families.len()) as u64);
        let seed = config.seed.wrapping_shl(32) | number;
        let name = match config.seed {
            0 => format!("{}-{number}", family.name()),
            config_seed => format!("{}-{config_seed}-{number}", family.name()),
        };
        let origin = Origin::Procedural { family, seed, size: config.size };
        Entry::new(name, &procedural_identity(family, seed), source, origin)
    };
    (0..config.count).map(entry).collect()
}

#[cfg(test)]
mod tests;
