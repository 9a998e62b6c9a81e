//! From cases to rows: means over scans with their intervals.

use std::collections::BTreeMap;

use dataset::material::texture::Texture;
use serde::Serialize;

use crate::statistics::{Mean, signed_rank, spearman};

use super::case::Case;
use super::conditions::{CONDITIONS, Condition};

/// Materials that a row is measured on.
pub const CLASSES: [(&str, &[Texture]); 4] = [
    ("textured or low", &[Texture::Rich, Texture::Faint]),
    ("textured", &[Texture::Rich]),
    ("low texture", &[Texture::Faint]),
    ("featureless", &[Texture::Absent]),
];

/// A condition on a class of materials. Distances are in pixels at a width of 1024.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Name of the condition.
    pub condition: &'static str,
    /// Its title.
    #[serde(skip)]
    pub title: &'static str,
    /// The class of materials.
    pub class: &'static str,
    /// Scans.
    pub sequences: usize,
    /// Mean of every figure over the scans that have it; `NAME_interval` is half the width of its 95 % interval.
    #[serde(flatten)]
    pub figures: BTreeMap<String, f64>,
}

impl Row {
    fn new(condition: &Condition, class: &'static str, cases: &[&Case], base: &[&Case]) -> Self {
        let mut figures = BTreeMap::new();
        let names: std::collections::BTreeSet<&String> = cases.iter().flat_map(|c| c.figures.keys()).collect();
        for name in names {
            let values: Vec<f64> = cases.iter().filter_map(|c| c.figures.get(name).copied()).collect();
            insert(&mut figures, name, &values);
        }
        insert(&mut figures, "seconds", &cases.iter().map(|c| c.seconds.aligning()).collect::<Vec<_>>());
        let accepted = || cases.iter().flat_map(|c| &c.key_frames).filter_map(|k| Some((k, k.error_px?)));
        let expected: Vec<(f64, f64)> = accepted().filter_map(|(k, error)| Some((k.expected_px?, error))).collect();
        let alike: Vec<(f64, f64)> = accepted().map(|(k, error)| (-k.zncc, error)).collect();
        let predicted = [("spearman_expected", spearman(&expected)), ("spearman_zncc", spearman(&alike))];
        figures.extend(predicted.into_iter().filter_map(|(name, value)| Some((name.to_string(), value?))));
        let penalised = |c: &Case| c.figures.get("penalised_error").copied();
        let pairs = cases.iter().filter_map(|c| {
            let same = base.iter().find(|b| b.sequence == c.sequence && condition.name != b.condition)?;
            Some(penalised(c)? - penalised(same)?)
        });
        let differences: Vec<f64> = pairs.collect();
        figures.extend(signed_rank(&differences).map(|p| ("penalised_error_p".to_string(), p)));
        Self { condition: condition.name, title: condition.title, class, sequences: cases.len(), figures }
    }
}

fn insert(figures: &mut BTreeMap<String, f64>, name: &str, values: &[f64]) {
    let Some(mean) = Mean::of(values) else { return };
    figures.insert(name.into(), mean.value);
    figures.extend(mean.half_width.map(|half| (format!("{name}_interval"), half)));
}

/// The rows of all conditions and classes that have cases. `penalised_error_p` is the signed-rank probability of the paired
/// differences to the base.
pub fn rows(cases: &[Case]) -> Vec<Row> {
    let of = |name: &str, textures: &[Texture]| -> Vec<&Case> {
        cases.iter().filter(|c| c.condition == name && textures.contains(&c.texture)).collect()
    };
    let mut rows = Vec::new();
    for condition in &CONDITIONS {
        for (class, textures) in CLASSES {
            let group = of(condition.name, textures);
            if !group.is_empty() {
                rows.push(Row::new(condition, class, &group, &of("base", textures)));
            }
        }
    }
    rows
}
