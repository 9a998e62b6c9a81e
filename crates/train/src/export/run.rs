//! What a run folder says of its nets: which there should be, what they learned from, what they reached.

use std::{
    collections::BTreeMap,
    fs, io,
    path::{Path, PathBuf},
};

use dataset::material::Split;
use dataset::material::library::ManifestEntry;
use flow::weights::{ADJACENT, DISTANT};
use ops::weights::{DataSource, Manifest, NetRecord, WeightsError};
use serde::Deserialize;
use serde::de::DeserializeOwned;

use super::ExportError;
use crate::config::FlowInit;
use crate::import::NOT_STATED;
use crate::stage::plan::CHAIRS;

/// Figures of `report.json` that say what a run cost instead of what it reached.
const COSTS: [&str; 3] = ["minutes", "peak_rss_mib", "skipped_batches"];
/// Sources of materials that are generated, not brought.
const GENERATED: &str = "procedural";
/// Licence of what comes with the program.
const OWN_LICENCE: &str = "MIT OR Apache-2.0";

/// A run whose stages are all done.
pub struct FinishedRun {
    /// Its weights folder.
    pub weights: PathBuf,
    /// What lies there.
    pub manifest: Manifest,
    /// What the nets reached together.
    pub evaluation: BTreeMap<String, f64>,
    /// Who made it when.
    pub facts: Facts,
    stages: Stages,
    materials: Vec<DataSource>,
}

/// `run.json`, as far as a card needs it.
#[derive(Debug, Deserialize)]
pub struct Facts {
    /// Name of the run.
    pub name: String,
    /// Revision of the source.
    pub revision: Option<String>,
    /// Version of the program.
    #[serde(default)]
    pub version: String,
    /// Seed.
    pub seed: u64,
    /// What the nets were trained on.
    #[serde(default)]
    pub device: String,
}

/// `config.toml`, as far as it concerns weights: other keys may be those of another version.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct Stages {
    flow: FlowKeys,
    chairs: StageKeys,
    adjacent: StageKeys,
    distant: StageKeys,
    svbrdf: StageKeys,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct FlowKeys {
    init: FlowInit,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct StageKeys {
    steps: usize,
    videos: VideoKeys,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct VideoKeys {
    light: LightKeys,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct LightKeys {
    environments: PathBuf,
}

impl Stages {
    fn all(&self) -> [(&'static str, &StageKeys); 4] {
        let Self { chairs, adjacent, distant, svbrdf, .. } = self;
        [(CHAIRS, chairs), (ADJACENT, adjacent), (DISTANT, distant), (svbrdf::weights::NAME, svbrdf)]
    }
}

impl FinishedRun {
    /// Reads the records of a run folder.
    ///
    /// # Errors
    /// No run, a run that isn't finished, records that can't be read.
    pub fn read(run: &Path) -> Result<Self, ExportError> {
        let (config, facts) = (run.join("config.toml"), run.join("run.json"));
        if !config.is_file() || !facts.is_file() {
            return Err(ExportError::NoRun { path: run.into() });
        }
        let unreadable = |path: &Path, reason: String| ExportError::Record { path: path.into(), reason };
        let text = fs::read_to_string(&config).map_err(|e| unreadable(&config, e.to_string()))?;
        let stages: Stages = toml::from_str(&text).map_err(|e| unreadable(&config, e.to_string()))?;
        let facts = json(&facts)?.ok_or_else(|| ExportError::NoRun { path: run.into() })?;

        let weights = run.join("weights");
        let manifest = match Manifest::read(&weights) {
            Err(WeightsError::Missing { .. }) => Manifest::default(),
            manifest => manifest?,
        };
        let trained = stages.all().into_iter().filter(|(_, stage)| stage.steps > 0).map(|(name, _)| name);
        let missing: Vec<_> = trained.filter(|name| !manifest.nets.contains_key(*name)).map(String::from).collect();
        if !missing.is_empty() || manifest.nets.is_empty() {
            return Err(ExportError::Unfinished { path: run.into(), nets: missing });
        }
        let report: BTreeMap<String, serde_json::Value> = json(&run.join("report.json"))?.unwrap_or_default();
        let reached = |(name, value): (String, serde_json::Value)| {
            let cost = COSTS.contains(&name.as_str()) || name.ends_with("_data_wait_share");
            value.as_f64().filter(|_| !cost).map(|value| (name, value))
        };
        let evaluation = report.into_iter().filter_map(reached).collect();
        let materials = match json(&run.join("materials.json"))? {
            Some(entries) => sources(entries),
            None => vec![source("materials that the run has no record of", NOT_STATED)],
        };
        Ok(Self { weights, manifest, evaluation, facts, stages, materials })
    }

    /// What a net learned from: the materials, and what its stage adds to them.
    pub fn data(&self, net: &str, record: &NetRecord) -> Vec<DataSource> {
        let mut data = self.materials.clone();
        let stage = self.stages.all().into_iter().find(|(name, _)| *name == net).map(|(_, stage)| stage);
        let environments = stage.map(|stage| &stage.videos.light.environments).filter(|path| !path.as_os_str().is_empty());
        data.extend(environments.map(|path| source(&format!("environment light from {}", name_of(path)), NOT_STATED)));
        let fresh = net == CHAIRS || self.stages.chairs.steps == 0;
        if record.kind == flow::weights::KIND && fresh {
            data.extend(self.start(net));
        }
        data
    }

    /// The weights that a flow net started from.
    fn start(&self, net: &str) -> Vec<DataSource> {
        match &self.stages.flow.init {
            FlowInit::File(path) => {
                let folder = path.parent().unwrap_or(Path::new("."));
                let name = path.file_stem().unwrap_or_default().to_string_lossy();
                // Its own manifest may say what it was made from; by now it may be gone.
                let known = Manifest::read(folder).ok().and_then(|mut manifest| manifest.nets.remove(&*name));
                let mut data = vec![source(&format!("starting weights {}", name_of(path)), NOT_STATED)];
                if let Some(known) = known.filter(|known| !known.data.is_empty()) {
                    data = known.data;
                }
                data
            }
            FlowInit::Weights if net != CHAIRS => {
                vec![source("starting weights that come with the program (net `chairs`)", OWN_LICENCE)]
            }
            FlowInit::Weights | FlowInit::None => Vec::new(),
        }
    }
}

/// A file's contents; nothing when there is none.
fn json<T: DeserializeOwned>(path: &Path) -> Result<Option<T>, ExportError> {
    let unreadable = |reason: String| ExportError::Record { path: path.into(), reason };
    match fs::read(path) {
        Ok(bytes) => serde_json::from_slice(&bytes).map(Some).map_err(|e| unreadable(e.to_string())),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(unreadable(error.to_string())),
    }
}

fn source(name: &str, licence: &str) -> DataSource {
    DataSource { source: name.into(), licence: licence.into(), count: 1, names: Vec::new() }
}

/// The last part of a path: the rest is nobody's business.
fn name_of(path: &Path) -> String {
    path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
}

/// Training materials by kind of source and licence. Those that were brought are named: many licences ask for it.
fn sources(entries: Vec<ManifestEntry>) -> Vec<DataSource> {
    let mut groups: BTreeMap<(String, String), Vec<String>> = BTreeMap::new();
    for entry in entries.into_iter().filter(|entry| entry.split == Split::Train) {
        let kind = entry.source.split(' ').next().unwrap_or_default().to_string();
        groups.entry((kind, entry.licence)).or_default().push(entry.name);
    }
    let group = |((kind, licence), names): ((String, String), Vec<String>)| {
        let generated = kind == GENERATED;
        let source =
            if generated { "materials generated by the program".into() } else { format!("materials read as `{kind}`") };
        DataSource { source, licence, count: names.len(), names: if generated { Vec::new() } else { names } }
    };
    groups.into_iter().map(group).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entry(name: &str, split: Split, source: &str, licence: &str) -> ManifestEntry {
        let text = |t: &str| t.to_string();
        ManifestEntry { name: text(name), split, identity: text(name), source: text(source), licence: text(licence) }
    }

    #[test]
    fn materials_are_counted_by_licence_and_named_where_they_were_brought() {
        let found = sources(vec![
            entry("bricks-0", Split::Train, "procedural bricks", "CC0"),
            entry("pavers-0", Split::Test, "procedural pavers", "CC0"),
            entry("sand-0", Split::Train, "procedural sand", "CC0"),
            entry("Wood", Split::Train, "pbr /home/me/Wood", "CC-BY-4.0"),
            entry("Gold", Split::Train, "pbr /home/me/Gold", "not stated"),
        ]);
        let rows: Vec<_> = found.iter().map(|d| (d.count, d.licence.as_str(), d.names.join(","))).collect();
        assert_eq!(rows, [(1, "CC-BY-4.0", "Wood".into()), (1, "not stated", "Gold".into()), (2, "CC0", String::new())]);
        assert!(!serde_json::to_string(&found).unwrap().contains("/home"));
    }
}
