//! The reference of all config keys, made from the config types themselves: names, types and meanings from their doc comments
//! (through their JSON schema), defaults from their `Default`, allowed values from what the validation answers.

mod allowed;
mod page;

use super::Config;
use super::layers::span_of;
use serde_json::Value;
use std::collections::BTreeMap;

pub use page::markdown;

/// A table of the config, or several of the same kind.
pub(crate) struct Table {
    /// Name of its type: tables of one type have the same keys.
    kind: String,
    /// What it is.
    meaning: String,
    /// Dotted paths of the tables of this kind.
    paths: Vec<Path>,
    /// Its keys in the order in which a resolved config has them.
    keys: Vec<Key>,
}

/// Where a table stands.
#[derive(Clone)]
pub(crate) struct Path {
    parts: Vec<String>,
    /// What else a source of materials must say: its type, and keys without defaults.
    source: Option<toml::Table>,
}

/// A key.
pub(crate) struct Key {
    name: String,
    /// Its type in words.
    kind: String,
    /// The kind of table that it is, if it is one.
    table: Option<String>,
    unit: Option<String>,
    /// The values of a choice, with their meanings.
    choices: Vec<(String, String)>,
    /// By path of its table; `None` where it is off, or must be written.
    defaults: Vec<Option<toml::Value>>,
    required: bool,
    allowed: Option<String>,
    meaning: String,
}

impl Path {
    fn root() -> Self {
        Self { parts: Vec::new(), source: None }
    }

    fn below(&self, name: &str) -> Self {
        let mut path = self.clone();
        path.parts.push(name.into());
        path
    }

    /// As it is written in a config and after `--set`.
    fn dotted(&self) -> String {
        match self.source.as_ref().and_then(|source| source.get("type")) {
            Some(kind) => format!("[[materials]] type = {kind}"),
            None => self.parts.join("."),
        }
    }
}

/// The JSON schema of a config file, for editors that complete and check TOML.
pub fn schema() -> Value {
    schemars::schema_for!(Config).to_value()
}

/// Every table of the config, outer ones first.
pub(crate) fn tables() -> Vec<Table> {
    let schema = schema();
    let text = Config::default().to_toml();
    let defaults = text.parse().unwrap_or_default();
    let mut reader = Reader { schema: &schema, text, defaults, tables: Vec::new(), places: BTreeMap::new() };
    reader.table(&schema, "Config", &Path::root());
    reader.tables
}

struct Reader<'a> {
    schema: &'a Value,
    /// The default config, whose order the reference follows.
    text: String,
    defaults: toml::Table,
    tables: Vec<Table>,
    /// Where in `tables` a kind of table is.
    places: BTreeMap<String, usize>,
}

impl<'a> Reader<'a> {
    fn table(&mut self, schema: &'a Value, kind: &str, path: &Path) {
        let known = self.places.get(kind).copied();
        let place = known.unwrap_or(self.tables.len());
        if known.is_none() {
            self.places.insert(kind.into(), place);
            let (kind, meaning) = (kind.into(), description(schema));
            self.tables.push(Table { kind, meaning, paths: Vec::new(), keys: Vec::new() });
        }
        self.tables[place].paths.push(path.clone());
        let mut properties: Vec<(&String, &Value)> = schema["properties"].as_object().into_iter().flatten().collect();
        let order = |name: &str| span_of(&self.text, path.below(name).parts.iter().map(String::as_str)).map(|span| span.start);
        properties.sort_by_key(|(name, _)| order(name).unwrap_or(usize::MAX));
        properties.retain(|(name, _)| path.source.is_none() || *name != "type");
        for (index, (name, property)) in properties.iter().enumerate() {
            let default = self.default_of(path, name, property);
            if known.is_none() {
                let key = self.key(schema, name, property, path);
                self.tables[place].keys.push(key);
            }
            self.tables[place].keys[index].defaults.push(default);
        }
        for (name, property) in properties {
            let below = path.below(name);
            match self.resolved(property) {
                (Some(kind), target) if target["properties"].is_object() => self.table(target, kind, &below),
                _ => self.sources(property, &below),
            }
        }
    }

    /// A list of tables of several types, told apart by their key `type`.
    fn sources(&mut self, property: &'a Value, path: &Path) {
        let (_, item) = self.resolved(&property["items"]);
        for variant in item["oneOf"].as_array().into_iter().flatten() {
            let Some(name) = variant["properties"]["type"]["const"].as_str() else { continue };
            let mut source = toml::Table::new();
            for required in variant["required"].as_array().into_iter().flatten().filter_map(Value::as_str) {
                let (_, schema) = self.resolved(&variant["properties"][required]);
                source.insert(required.into(), something(schema));
            }
            source.insert("type".into(), name.into());
            self.table(variant, &format!("materials-{name}"), &Path { source: Some(source), ..path.clone() });
        }
    }

    fn key(&self, table: &Value, name: &str, property: &'a Value, path: &Path) -> Key {
        let (kind, target) = self.resolved(property);
        let is_table = target["properties"].is_object();
        let own = description(property);
        Key {
            name: name.into(),
            kind: self.words(target),
            table: kind.filter(|_| is_table).map(str::to_string),
            unit: property["unit"].as_str().map(str::to_string),
            choices: choices(target),
            defaults: Vec::new(),
            required: table["required"].as_array().is_some_and(|names| names.iter().any(|required| *required == *name)),
            allowed: (!is_table).then(|| allowed::allowed(path, name, target)).flatten(),
            meaning: if own.is_empty() { description(target) } else { own },
        }
    }

    /// The schema that a property leads to, with its name; of an optional one, that of its value.
    fn resolved(&self, property: &'a Value) -> (Option<&'a str>, &'a Value) {
        let value =
            property["anyOf"].as_array().and_then(|any| any.iter().find(|one| one["type"] != "null")).unwrap_or(property);
        match value["$ref"].as_str().and_then(|reference| reference.strip_prefix("#/$defs/")) {
            Some(name) => (Some(name), &self.schema["$defs"][name]),
            None => (None, value),
        }
    }

    /// A type in words.
    fn words(&self, schema: &'a Value) -> String {
        let kind = match &schema["type"] {
            // An optional value.
            Value::Array(kinds) => kinds.iter().filter_map(Value::as_str).find(|kind| *kind != "null"),
            kind => kind.as_str(),
        };
        match kind {
            Some("integer") => "integer".into(),
            Some("number") => "number".into(),
            Some("boolean") => "true or false".into(),
            Some("array") => {
                let items = self.words(self.resolved(&schema["items"]).1);
                match schema["minItems"].as_u64().filter(|count| schema["maxItems"].as_u64() == Some(*count)) {
                    Some(count) => format!("{count} × {items}"),
                    None => format!("list of {items}"),
                }
            }
            Some("object") => "table".into(),
            Some("string") if choices(schema).is_empty() => "text".into(),
            _ if schema["oneOf"].as_array().is_some_and(|of| of.iter().all(|one| one["properties"].is_object())) => {
                "table".into()
            }
            _ => "choice".into(),
        }
    }

    fn default_of(&self, path: &Path, name: &str, property: &Value) -> Option<toml::Value> {
        let written = || {
            let mut table = &self.defaults;
            for part in &path.parts {
                table = table.get(part)?.as_table()?;
            }
            table.get(name).cloned()
        };
        let stated = || toml::Value::try_from(property.get("default").filter(|default| !default.is_null())?).ok();
        if path.source.is_some() { stated() } else { written().or_else(stated) }
    }
}

/// The doc comment of a type or key.
fn description(schema: &Value) -> String {
    schema["description"].as_str().unwrap_or_default().to_string()
}

/// The values of a choice, with their meanings.
fn choices(schema: &Value) -> Vec<(String, String)> {
    let described = schema["oneOf"].as_array().into_iter().flatten().flat_map(|one| {
        let several = one["enum"].as_array().into_iter().flatten();
        several.chain(one.get("const")).filter_map(Value::as_str).map(|value| (value.to_string(), description(one)))
    });
    let plain = schema["enum"].as_array().into_iter().flatten().filter_map(Value::as_str);
    described.chain(plain.map(|value| (value.to_string(), String::new()))).collect()
}

/// A value for a key without a default, so that others beside it can be tried.
fn something(schema: &Value) -> toml::Value {
    match schema["type"].as_str() {
        Some("boolean") => false.into(),
        Some("integer") => 1.into(),
        _ => choices(schema).first().map_or_else(|| ".".into(), |(choice, _)| choice.as_str().into()),
    }
}
