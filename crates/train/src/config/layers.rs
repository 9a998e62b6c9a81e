//! The layers of a configuration: the extended files from the bottom up, then the `--set` assignments.

use super::{Config, ConfigError, Diagnosis, Invalid, lookup};
use serde::Deserialize;
use std::ops::Range;
use std::path::{Path, PathBuf};
use toml::de::{DeTable, DeValue};

/// One source of settings, with its text for error messages.
#[derive(Clone)]
pub struct Layer {
    origin: String,
    text: String,
    table: toml::Table,
    place: Place,
}

/// Where in its text a layer's keys stand.
#[derive(Clone)]
enum Place {
    /// From the top.
    Whole,
    /// In the table of this path.
    Under(Vec<String>),
    /// All at one place.
    Span(Range<usize>),
}

impl Layer {
    /// Parses and checks a text by itself: unknown keys and wrong types are found here, where their place is known.
    fn new(origin: String, text: String) -> Result<(Self, Option<String>), ConfigError> {
        let config: Config =
            toml::from_str(&text).map_err(|error| ConfigError::Text(Box::new(Diagnosis::from_toml(&origin, &text, &error))))?;
        let mut table: toml::Table =
            text.parse().map_err(|error| ConfigError::Text(Box::new(Diagnosis::from_toml(&origin, &text, &error))))?;
        table.remove("extends");
        Ok((Self { origin, text, table, place: Place::Whole }, config.extends))
    }

    /// A table inside a larger text, whose keys were checked when that text was read.
    pub fn of_table(origin: &str, text: &str, path: &[&str], table: toml::Table) -> Self {
        let place = Place::Under(path.iter().map(ToString::to_string).collect());
        Self { origin: origin.into(), text: text.into(), table, place }
    }

    /// One value for a dotted key, written at `span` of a larger text; checked here.
    ///
    /// # Errors
    /// No such key, or a value of the wrong type.
    pub fn of_value(
        origin: &str,
        text: &str,
        span: Range<usize>,
        key: &[String],
        value: toml::Value,
    ) -> Result<Self, ConfigError> {
        let nest = |value, name: &String| toml::Value::Table(toml::Table::from_iter([(name.clone(), value)]));
        let toml::Value::Table(table) = key.iter().rev().fold(value, nest) else {
            unreachable!("a key has at least one part");
        };
        if let Err(error) = Config::deserialize(table.clone()) {
            let shown = Diagnosis::of_toml_message(origin, text, Some(span), error.message());
            return Err(ConfigError::Text(Box::new(shown)));
        }
        Ok(Self { origin: origin.into(), text: text.into(), table, place: Place::Span(span) })
    }

    /// Where a key is written in this layer.
    pub fn span(&self, key: &str) -> Option<Range<usize>> {
        let parts = key.split('.');
        match &self.place {
            Place::Whole => span_of(&self.text, parts),
            Place::Under(path) => span_of(&self.text, path.iter().map(String::as_str).chain(parts)),
            Place::Span(span) => {
                let mut table = &self.table;
                for part in parts {
                    match table.get(part)? {
                        toml::Value::Table(inner) => table = inner,
                        _ => break,
                    }
                }
                Some(span.clone())
            }
        }
    }
}

/// Reads a file and everything it extends, base first.
pub fn read(path: &Path) -> Result<Vec<Layer>, ConfigError> {
    let mut layers = Vec::new();
    let mut chain: Vec<PathBuf> = Vec::new();
    let mut next = Some(path.to_path_buf());
    while let Some(path) = next {
        let identity = path.canonicalize().unwrap_or_else(|_| path.clone());
        let repeated = chain.contains(&identity);
        chain.push(identity);
        if repeated {
            return Err(ConfigError::Circle { chain });
        }
        let text = std::fs::read_to_string(&path).map_err(|source| ConfigError::Read { path: path.clone(), source })?;
        let (layer, extends) = Layer::new(path.display().to_string(), text)?;
        layers.push(layer);
        next = match extends {
            Some(name) => Some(beside(&path, &name)?),
            None => None,
        };
    }
    layers.reverse();
    Ok(layers)
}

/// `extends` names a file beside the one that extends it, or one that `--config` would find.
pub fn beside(path: &Path, name: &str) -> Result<PathBuf, ConfigError> {
    let sibling = path.parent().unwrap_or(Path::new("")).join(name);
    if sibling.is_file() { Ok(sibling) } else { lookup::find(name) }
}

/// A `--set table.key=value` as a layer; a value that isn't TOML is taken as a string.
pub fn from_assignment(assignment: &str) -> Result<Layer, ConfigError> {
    let origin = "--set".to_string();
    let Some((key, value)) = assignment.split_once('=') else {
        let help = vec!["write it as `--set table.key=value`, for example `--set svbrdf.steps=200`".to_string()];
        let shown =
            Diagnosis::at(&origin, assignment, Some(0..assignment.len()), "there is no `=` in this assignment".into(), help);
        return Err(ConfigError::Text(Box::new(shown)));
    };
    let is_toml = format!("value = {value}").parse::<toml::Table>().is_ok_and(|table| table.len() == 1);
    let text = if is_toml { format!("{key}={value}") } else { format!("{key}={}", toml::Value::String(value.into())) };
    Layer::new(origin, text).map(|(layer, _)| layer)
}

/// Lays the layers over each other: tables are merged, every other value is replaced.
pub fn merge(layers: &[Layer]) -> Result<Config, ConfigError> {
    // The defaults lie below: a table that is given in part keeps this program's defaults, not those of its type.
    let mut merged = toml::Table::try_from(Config::default()).map_err(|error| ConfigError::Merge(error.to_string()))?;
    for layer in layers {
        overlay(&mut merged, &layer.table);
    }
    Config::deserialize(merged).map_err(|error| ConfigError::Merge(error.to_string()))
}

fn overlay(base: &mut toml::Table, top: &toml::Table) {
    for (key, value) in top {
        match (base.get_mut(key), value) {
            (Some(toml::Value::Table(below)), toml::Value::Table(above)) => overlay(below, above),
            _ => {
                base.insert(key.clone(), value.clone());
            }
        }
    }
}

/// Shows an impossible value at the place of the topmost layer that wrote it (or the table it stands in).
pub fn locate(layers: &[Layer], problem: &Invalid) -> Diagnosis {
    let help = Vec::from_iter(problem.expected.clone());
    // What the owner of a table says about it names the key inside.
    let words = problem.found.split(|c: char| !(c.is_alphanumeric() || "_.".contains(c))).filter(|word| !word.is_empty());
    for key in words.map(|word| format!("{}.{word}", problem.key)).chain([problem.key.clone()]) {
        for layer in layers.iter().rev() {
            if let Some(span) = layer.span(&key) {
                return Diagnosis::at(&layer.origin, &layer.text, Some(span), problem.found.clone(), help);
            }
        }
    }
    Diagnosis::at("default", "", None, problem.found.clone(), help)
}

/// Where the value of a key stands in a text, or the nearest value that holds it.
pub fn span_of<'a>(text: &str, key: impl Iterator<Item = &'a str>) -> Option<Range<usize>> {
    let root = DeTable::parse(text).ok()?;
    let mut table = root.get_ref();
    let mut span = None;
    for part in key {
        let (_, value) = table.iter().find(|(name, _)| name.get_ref() == part)?;
        span = Some(value.span());
        match value.get_ref() {
            DeValue::Table(inner) => table = inner,
            _ => break,
        }
    }
    span
}
