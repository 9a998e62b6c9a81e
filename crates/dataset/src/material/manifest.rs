//! An optional table beside the material folders or files: `manifest.tsv` (or `MANIFEST.tsv`), columns found by their header.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use super::error::MaterialError;

/// Whether a material without a metalness map is a metal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Metallic {
    /// `0`: metalness is 0 everywhere.
    No,
    /// `1`: metalness is 1 everywhere.
    Yes,
    /// `map`: there is a metalness map.
    Map,
}

/// Licence of a material whose manifest names none.
const UNKNOWN_LICENCE: &str = "not stated";

/// What a manifest says of one material.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ManifestRow {
    /// Column `licence` (or `license`).
    pub licence: Option<String>,
    /// Column `metallic`: 0, 1 or map; more words may follow the digit.
    pub metallic: Option<Metallic>,
    /// Column `category`.
    pub category: Option<String>,
    /// Column `used`: 0, no or false leave the material out.
    pub used: bool,
}

impl Default for ManifestRow {
    fn default() -> Self {
        Self { licence: None, metallic: None, category: None, used: true }
    }
}

impl ManifestRow {
    /// The licence, or that none is stated.
    pub fn licence_or_unknown(&self) -> String {
        self.licence.clone().unwrap_or_else(|| UNKNOWN_LICENCE.into())
    }
}

/// The rows of a manifest by material name; empty when there is no manifest.
#[derive(Clone, Debug, Default)]
pub struct Manifest {
    rows: HashMap<String, ManifestRow>,
}

impl Manifest {
    /// Reads the manifest of a folder, if it has one.
    ///
    /// # Errors
    /// [`MaterialError::Read`] when it can't be read, [`MaterialError::Line`] with the line that can't be understood.
    pub fn beside(folder: &Path) -> Result<Self, MaterialError> {
        for name in ["manifest.tsv", "MANIFEST.tsv"] {
            let path = folder.join(name);
            match std::fs::read(&path) {
                Ok(bytes) => return Self::parse(&path, &String::from_utf8_lossy(&bytes)),
                Err(e) if e.kind() == std::io::ErrorKind::NotFound => {}
                Err(source) => return Err(MaterialError::Read { path, source }),
            }
        }
        Ok(Self::default())
    }

    /// Parses a table of tab-separated columns.
    ///
    /// # Errors
    /// [`MaterialError::Line`] with the line that can't be understood.
    pub fn parse(path: &Path, text: &str) -> Result<Self, MaterialError> {
        let fail = |line: usize, reason: String| MaterialError::Line { path: PathBuf::from(path), line, reason };
        let mut lines = text.trim_start_matches('\u{feff}').lines().enumerate().filter(|(_, l)| !l.trim().is_empty());
        let Some((_, header)) = lines.next() else { return Ok(Self::default()) };
        let header: Vec<String> = header.split('\t').map(|h| h.trim().to_lowercase()).collect();
        let column = |names: &[&str]| header.iter().position(|h| names.contains(&h.as_str()));
        let Some(name) = column(&["name"]) else {
            return Err(fail(1, format!("no column `name` among {}", header.join(", "))));
        };
        let (licence, metallic) = (column(&["licence", "license"]), column(&["metallic"]));
        let (category, used) = (column(&["category"]), column(&["used"]));
        let mut rows = HashMap::new();
        for (line, text) in lines {
            let cells: Vec<&str> = text.split('\t').map(str::trim).collect();
            let cell = |c: Option<usize>| c.and_then(|c| cells.get(c)).copied().filter(|v| !v.is_empty());
            let key = cell(Some(name)).ok_or_else(|| fail(line + 1, "no name".into()))?;
            let metallic = match cell(metallic) {
                None => None,
                Some(v) => {
                    Some(parse_metallic(v).ok_or_else(|| fail(line + 1, format!("metallic is `{v}`; expected 0, 1 or map")))?)
                }
            };
            let row = ManifestRow {
                licence: cell(licence).map(str::to_owned),
                metallic,
                category: cell(category).map(str::to_owned),
                used: !cell(used).is_some_and(|v| ["0", "no", "false"].contains(&v.to_lowercase().as_str())),
            };
            if rows.insert(key.to_owned(), row).is_some() {
                return Err(fail(line + 1, format!("{key} is listed twice")));
            }
        }
        Ok(Self { rows })
    }

    /// What the manifest says of a material; nothing when it isn't listed.
    pub fn row(&self, name: &str) -> ManifestRow {
        self.rows.get(name).cloned().unwrap_or_default()
    }
}

fn parse_metallic(text: &str) -> Option<Metallic> {
    let word = text.split(|c: char| !c.is_alphanumeric()).next().unwrap_or_default();
    match word.to_lowercase().as_str() {
        "0" | "no" => Some(Metallic::No),
        "1" | "yes" => Some(Metallic::Yes),
        "map" => Some(Metallic::Map),
        _ => None,
    }
}
