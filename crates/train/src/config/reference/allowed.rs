//! What a key may be, in the words with which the program refuses what it may not be: nothing that could grow apart from them.

use super::Path;
use crate::config::Config;
use serde::Deserialize;
use serde_json::Value;

/// Values that hardly any key takes.
fn probes(schema: &Value) -> Vec<toml::Value> {
    let integers = [-1, 0, 1, i64::MAX].map(toml::Value::from);
    let numbers = [-1.0, 0.0, 1e300, f64::NAN, 1.0, -1e300].map(toml::Value::from);
    let kind = |schema: &Value, name: &str| {
        schema["type"] == name || schema["type"].as_array().is_some_and(|kinds| kinds.iter().any(|kind| *kind == *name))
    };
    if kind(schema, "integer") {
        return integers.into();
    }
    if kind(schema, "number") {
        return numbers.into();
    }
    if !kind(schema, "array") {
        return Vec::new();
    }
    // Ranges must not fall; lists of names must be known.
    let texts = [toml::Value::from("?")];
    let count = schema["minItems"].as_u64().unwrap_or(1) as usize;
    let falling = [[2, 1].map(toml::Value::from).to_vec(), [2.0, 1.0].map(toml::Value::from).to_vec()];
    let same = integers.iter().chain(&numbers).chain(&texts).map(|value| vec![value.clone(); count]);
    falling.into_iter().chain(same).map(toml::Value::Array).collect()
}

/// What the validation says to the first impossible value of a key; `None` where it lets everything pass.
pub(super) fn allowed(path: &Path, key: &str, schema: &Value) -> Option<String> {
    probes(schema).into_iter().find_map(|probe| {
        let config = Config::deserialize(with(path, key, probe)).ok()?;
        config.validate().into_iter().find_map(|problem| {
            let (found, expected) = match problem.expected {
                Some(expected) => (problem.found, expected),
                // `KEY is VALUE; EXPECTED`, `KEY is VALUE, expected EXPECTED` or `KEY = VALUE: EXPECTED`.
                None => {
                    let mut marks = ["; ", ", expected "].into_iter();
                    let equal =
                        || problem.found.split_once(" = ").and_then(|(name, rest)| Some((name, rest.split_once(": ")?.1)));
                    let (found, rest) = marks.find_map(|mark| problem.found.split_once(mark)).or_else(equal)?;
                    (found.to_string(), rest.to_string())
                }
            };
            let names = found.split(|c: char| !(c.is_alphanumeric() || c == '_'));
            let about = names.into_iter().any(|name| name == key);
            (about).then(|| expected.strip_prefix("expected ").unwrap_or(&expected).to_string())
        })
    })
}

/// The default config, with something to do, and one key set.
fn with(path: &Path, key: &str, value: toml::Value) -> toml::Table {
    let mut table = toml::Table::from_iter([(key.to_string(), value)]);
    let mut parts = path.parts.as_slice();
    if let (Some(source), Some((last, above))) = (&path.source, parts.split_last()) {
        let mut entry = source.clone();
        entry.extend(table);
        table = toml::Table::from_iter([(last.clone(), toml::Value::Array(vec![entry.into()]))]);
        parts = above;
    }
    for part in parts.iter().rev() {
        table = toml::Table::from_iter([(part.clone(), table.into())]);
    }
    let steps = table.entry("svbrdf").or_insert_with(|| toml::Table::new().into());
    if let Some(svbrdf) = steps.as_table_mut() {
        svbrdf.entry("steps").or_insert(1.into());
    }
    table
}
