//! A sweep file: a base config, named variants and grids over it, seeds, and what is compared.

use crate::config::diagnosis::{Diagnosis, nearest};
use crate::config::layers::{self, Layer, span_of};
use crate::config::{Config, ConfigError, find};
use crate::pipeline::{Part, steps_of};
use evaluate::comparison::{FIGURES, Published, Question, TABLE_2};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::ops::Range;
use toml::de::{DeTable, DeValue};

/// Keys that a sweep sets itself.
const RESERVED: [(&str, &str); 3] = [
    ("extends", "a sweep has one base for all its runs: name it with `base`"),
    ("run.seed", "every row runs with the same seeds: list them in `seeds`"),
    ("run.name", "runs are named after their row and seed"),
];

/// The file as it is written; every key of the tables of config keys is checked while it is read.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Text {
    base: String,
    #[serde(default = "one_seed")]
    seeds: Vec<u64>,
    reference: Option<String>,
    figures: Option<Vec<String>>,
    #[serde(default)]
    titles: BTreeMap<String, String>,
    #[serde(default, rename = "settings")]
    _settings: Config,
    #[serde(default)]
    variants: BTreeMap<String, Config>,
    #[serde(default, rename = "grid")]
    _grid: toml::Table,
    published: Option<Published>,
}

fn one_seed() -> Vec<u64> {
    vec![1]
}

/// One run of a sweep: a row of the table under one seed.
#[derive(Debug, Clone)]
pub struct Member {
    /// The row.
    pub row: String,
    /// The seed.
    pub seed: u64,
    /// The resolved config, named after both.
    pub config: Config,
}

/// A sweep, resolved and checked.
#[derive(Debug)]
pub struct Sweep {
    /// The file's name without ending.
    pub name: String,
    /// What is compared.
    pub question: Question,
    /// All runs, row by row.
    pub members: Vec<Member>,
}

impl Sweep {
    /// Reads a sweep file, named like a config, and resolves every run; the `--set` assignments lie over all of them.
    ///
    /// # Errors
    /// As [`Config::load`]; and rows that differ in their steps, clash in their names or can't be compared.
    pub fn load(name: &str, assignments: &[String]) -> Result<Self, ConfigError> {
        let path = find(name)?;
        let text = std::fs::read_to_string(&path).map_err(|source| ConfigError::Read { path: path.clone(), source })?;
        let source = Source { origin: path.display().to_string(), text };
        let file: Text = toml::from_str(&source.text).map_err(|error| source.unreadable(&error))?;
        let root: toml::Table = source.text.parse().map_err(|error| source.unreadable(&error))?;
        let spans = DeTable::parse(&source.text).map_err(|error| source.unreadable(&error))?;
        source.check_reserved(&file)?;

        let mut below = layers::read(&layers::beside(&path, &file.base)?)?;
        below.push(source.table(&["settings"], &root));
        let mut above = Vec::new();
        for assignment in assignments {
            above.push(layers::from_assignment(assignment)?);
        }
        let rows = source.rows(&root, spans.get_ref())?;
        let question = source.question(&file, &rows)?;
        let mut members = Vec::new();
        for row in &rows {
            for seed in &file.seeds {
                let name = format!("{}-seed{seed}", row.name);
                let own = Layer::of_table("sweep", "", &[], toml::toml! { run = { name = name, seed = (seed.cast_signed()) } });
                let layers: Vec<Layer> = below.iter().chain(&row.layers).chain(&above).chain([&own]).cloned().collect();
                let config = Config::from_layers(&layers)?;
                members.push(Member { row: row.name.clone(), seed: *seed, config });
            }
        }
        let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let sweep = Self { name, question, members };
        sweep.check_budgets(&source, &rows)?;
        Ok(sweep)
    }

    /// Rows are compared at equal steps.
    fn check_budgets(&self, source: &Source, rows: &[Row]) -> Result<(), ConfigError> {
        let first = &self.members[0];
        for member in &self.members {
            for stage in Part::ALL.iter().flat_map(|part| part.stages()) {
                let (expected, found) = (steps_of(&first.config, stage), steps_of(&member.config, stage));
                if found != expected {
                    let key = format!("{stage}.steps");
                    let row = rows.iter().find(|row| row.name == member.row);
                    let span = row.and_then(|row| row.layers.iter().rev().find_map(|layer| layer.span(&key)));
                    let message = format!("`{key}` is {found} in row `{}` and {expected} in row `{}`", member.row, first.row);
                    let help = "the rows of a sweep are compared at equal steps: set them for all under [settings]";
                    return Err(source.wrong(span, message, help));
                }
            }
        }
        Ok(())
    }
}

/// A row of the table.
struct Row {
    name: String,
    layers: Vec<Layer>,
}

/// The file's text, for messages.
struct Source {
    origin: String,
    text: String,
}

impl Source {
    fn unreadable(&self, error: &toml::de::Error) -> ConfigError {
        ConfigError::Text(Box::new(Diagnosis::from_toml(&self.origin, &self.text, error)))
    }

    fn wrong(&self, span: Option<Range<usize>>, message: String, help: impl Into<String>) -> ConfigError {
        ConfigError::Text(Box::new(Diagnosis::at(&self.origin, &self.text, span, message, vec![help.into()])))
    }

    fn span(&self, key: &[&str]) -> Option<Range<usize>> {
        span_of(&self.text, key.iter().copied())
    }

    /// A table of config keys as a layer; an empty one where it isn't written.
    fn table(&self, path: &[&str], root: &toml::Table) -> Layer {
        let mut table = Some(root);
        for part in path {
            table = table.and_then(|table| table.get(*part)?.as_table());
        }
        Layer::of_table(&self.origin, &self.text, path, table.cloned().unwrap_or_default())
    }

    fn check_reserved(&self, file: &Text) -> Result<(), ConfigError> {
        let tables = file.variants.keys().map(|name| vec!["variants", name]).chain([vec!["settings"], vec!["grid"]]);
        for mut path in tables {
            for (key, help) in RESERVED {
                let depth = path.len();
                path.extend(key.split('.'));
                if let Some(span) = self.span(&path) {
                    return Err(self.wrong(Some(span), format!("`{key}` can't be set here"), help));
                }
                path.truncate(depth);
            }
        }
        let repeated = |seed: &u64| file.seeds.iter().filter(|other| *other == seed).count() > 1;
        if file.seeds.is_empty() || file.seeds.iter().any(repeated) || file.seeds.iter().any(|seed| *seed > i64::MAX as u64) {
            let message = format!("`seeds` is {:?}", file.seeds);
            return Err(self.wrong(self.span(&["seeds"]), message, "expected different whole numbers, for example [1, 2, 3]"));
        }
        Ok(())
    }

    /// Every variant at every point of the grid, in the order of the file.
    fn rows(&self, root: &toml::Table, spans: &DeTable<'_>) -> Result<Vec<Row>, ConfigError> {
        let mut rows: Vec<Row> = table_of(spans, "variants")
            .map(|variants| in_order(variants))
            .unwrap_or_default()
            .into_iter()
            .map(|name| Row { layers: vec![self.table(&["variants", &name], root)], name })
            .collect();
        if let Some(unfit) = rows.iter().find(|row| !is_folder(&row.name)) {
            let message = format!("\"{}\" is no name for a variant", unfit.name);
            let help = "expected letters, digits, `-`, `_` and `.`, because its run folders are named after it";
            return Err(self.wrong(self.span(&["variants", &unfit.name]), message, help));
        }
        let mut axes = Vec::new();
        if let (Some(spans), Some(table)) = (table_of(spans, "grid"), root.get("grid").and_then(toml::Value::as_table)) {
            self.axes(spans, table, &mut Vec::new(), &mut axes)?;
        }
        if rows.is_empty() && axes.is_empty() {
            let help = "write a table `[variants.NAME]` for each row, or a `[grid]` with lists of values";
            return Err(self.wrong(None, "there is nothing to compare in this sweep".into(), help));
        }
        if rows.is_empty() {
            rows.push(Row { name: String::new(), layers: Vec::new() });
        }
        for axis in axes {
            let at = |row: &Row, (label, layer): &(String, Layer)| Row {
                name: [row.name.as_str(), label].into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join("-"),
                layers: row.layers.iter().chain([layer]).cloned().collect(),
            };
            rows = rows.iter().flat_map(|row| axis.iter().map(move |point| at(row, point))).collect();
        }
        let mut names: Vec<&str> = rows.iter().map(|row| row.name.as_str()).collect();
        names.sort_unstable();
        if let Some(pair) = names.windows(2).find(|pair| pair[0] == pair[1]) {
            let help = "rename a variant, or leave out equal values of the grid";
            return Err(self.wrong(self.span(&["grid"]), format!("two rows are named `{}`", pair[0]), help));
        }
        Ok(rows)
    }

    /// The lists of a grid, each as labelled layers.
    fn axes(
        &self,
        spans: &DeTable<'_>,
        table: &toml::Table,
        path: &mut Vec<String>,
        axes: &mut Vec<Vec<(String, Layer)>>,
    ) -> Result<(), ConfigError> {
        for name in in_order(spans) {
            let (_, spanned) = spans.iter().find(|(key, _)| key.get_ref() == name.as_str()).expect("a key of this table");
            path.push(name.clone());
            match (&table[&name], spanned.get_ref()) {
                (toml::Value::Table(inner), DeValue::Table(spans)) => self.axes(spans, inner, path, axes)?,
                (toml::Value::Array(values), _) if !values.is_empty() => {
                    let point = |(index, value): (usize, &toml::Value)| {
                        let layer = Layer::of_value(&self.origin, &self.text, spanned.span(), path, value.clone())?;
                        Ok((label(&name, index, value), layer))
                    };
                    axes.push(values.iter().enumerate().map(point).collect::<Result<_, ConfigError>>()?);
                }
                (found, _) => {
                    let help = "expected a list of at least one value, for example `[1e-4, 5e-4]`";
                    return Err(self.wrong(Some(spanned.span()), format!("`{}` is {found}", path.join(".")), help));
                }
            }
            path.pop();
        }
        Ok(())
    }

    /// What is compared with what.
    fn question(&self, file: &Text, rows: &[Row]) -> Result<Question, ConfigError> {
        let names = || rows.iter().map(|row| row.name.as_str());
        let known = |name: &str, key: &[&str]| {
            if names().any(|row| row == name) {
                return Ok(());
            }
            let guess = nearest(name, names()).map(|name| format!("did you mean `{name}`? ")).unwrap_or_default();
            let help = format!("{guess}rows are: {}", names().collect::<Vec<_>>().join(", "));
            Err(self.wrong(self.span(key), format!("there is no row `{name}`"), help))
        };
        if let Some(reference) = &file.reference {
            known(reference, &["reference"])?;
        }
        for name in file.titles.keys() {
            known(name, &["titles", name])?;
        }
        let published = file.published.iter().flat_map(|published| &published.figures);
        for (name, _) in published.clone() {
            known(name, &["published", "figures", name])?;
        }
        let asked = file.figures.iter().flatten().map(|figure| (figure, vec!["figures"]));
        let stated = published.flat_map(|(name, row)| row.keys().map(move |f| (f, vec!["published", "figures", name, f])));
        for (figure, key) in asked.chain(stated) {
            if !FIGURES.iter().any(|(name, _)| name == figure) {
                let names = FIGURES.iter().map(|(name, _)| *name);
                let guess = nearest(figure, names.clone()).map(|name| format!("did you mean `{name}`? ")).unwrap_or_default();
                let help = format!("{guess}known: {}", names.collect::<Vec<_>>().join(", "));
                return Err(self.wrong(self.span(&key), format!("there is no figure `{figure}`"), help));
            }
        }
        let title = |row: &Row| file.titles.get(&row.name).unwrap_or(&row.name).clone();
        Ok(Question {
            variants: rows.iter().map(|row| (row.name.clone(), title(row))).collect(),
            reference: file.reference.clone().unwrap_or_else(|| rows[0].name.clone()),
            figures: file.figures.clone().unwrap_or_else(|| TABLE_2.map(String::from).into()),
            published: file.published.clone(),
        })
    }
}

fn table_of<'a, 'i>(table: &'a DeTable<'i>, key: &str) -> Option<&'a DeTable<'i>> {
    let (_, value) = table.iter().find(|(name, _)| name.get_ref() == key)?;
    match value.get_ref() {
        DeValue::Table(table) => Some(table),
        _ => None,
    }
}

/// The keys of a table as they follow each other in the file.
fn in_order(table: &DeTable<'_>) -> Vec<String> {
    let mut keys: Vec<(usize, String)> = table.iter().map(|(key, _)| (key.span().start, key.get_ref().to_string())).collect();
    keys.sort();
    keys.into_iter().map(|(_, key)| key).collect()
}

fn is_folder(name: &str) -> bool {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
    !name.is_empty() && name.chars().all(plain) && !name.starts_with('.')
}

/// A value of a grid in the name of a run folder; values that make no name are numbered.
fn label(key: &str, index: usize, value: &toml::Value) -> String {
    let text = match value {
        toml::Value::String(text) => text.clone(),
        toml::Value::Table(_) | toml::Value::Datetime(_) => String::new(),
        toml::Value::Array(values) => values.iter().map(ToString::to_string).collect::<Vec<_>>().join("_"),
        other => other.to_string(),
    };
    if is_folder(&text) { format!("{key}-{text}") } else { format!("{key}-{}", index + 1) }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FILE: &str = r#"
base = "smoke.toml"
seeds = [1, 2]

[settings]
adjacent.steps = 0
distant.steps = 0
svbrdf.steps = 7

[variants.full]

[variants.bare]
svbrdf.loss.weights.top = 0.0
[variants.bare.svbrdf.net]
normalisation = "instance"
"#;

    fn load(text: &str, assignments: &[&str]) -> Result<Sweep, String> {
        let home = tempfile::tempdir().unwrap();
        let path = home.path().join("some.toml");
        std::fs::write(&path, text).unwrap();
        let assignments: Vec<String> = assignments.iter().map(ToString::to_string).collect();
        Sweep::load(path.to_str().unwrap(), &assignments).map_err(|error| error.to_string())
    }

    #[test]
    fn rows_are_variants_in_the_order_of_the_file_under_every_seed() {
        let sweep = load(FILE, &["svbrdf.exemplars.resolution=32"]).unwrap();
        let names: Vec<&str> = sweep.members.iter().map(|member| member.config.run.name.as_str()).collect();
        assert_eq!(names, ["full-seed1", "full-seed2", "bare-seed1", "bare-seed2"]);
        let [full, _, _, bare] = &sweep.members[..] else { panic!() };
        assert_eq!((bare.config.run.seed, bare.config.svbrdf.exemplars.resolution), (2, 32));
        assert_eq!(bare.config.svbrdf.loss.weights.top, 0.0);
        assert_eq!(bare.config.svbrdf.net.normalisation, svbrdf::net::Normalisation::Instance);
        assert_eq!((full.config.svbrdf.loss.weights.top, full.config.svbrdf.steps), (1.0, 7));
        assert_eq!((sweep.name.as_str(), sweep.question.reference.as_str()), ("some", "full"));
    }

    #[test]
    fn a_grid_multiplies_the_variants() {
        let grid = "[grid]\nsvbrdf.optimisation.learning_rate = [1e-4, 5e-4]\nsvbrdf.exemplars.key_frames = [[1, 2], [3, 4]]\n";
        let sweep = load(&format!("{FILE}\n{grid}"), &[]).unwrap();
        assert_eq!(sweep.members.len(), 16);
        assert_eq!(sweep.question.variants[1].0, "full-learning_rate-0.0001-key_frames-3_4");
        assert_eq!(sweep.members[2].config.svbrdf.exemplars.key_frames, [3, 4]);
        let only = load(&format!("base = \"smoke\"\n{grid}"), &[]).unwrap();
        assert_eq!((only.members.len(), only.question.reference.as_str()), (4, "learning_rate-0.0001-key_frames-1_2"));
    }

    #[test]
    fn mistakes_are_shown_where_they_are_written() {
        for (wrong, parts) in [
            (
                FILE.replace("loss.weights.top", "loss.weights.tip"),
                ["some.toml:13", "unknown key `tip`", "did you mean `top`?"],
            ),
            (
                FILE.replace("weights.top = 0.0", "weights.top = -1.0"),
                ["some.toml:13", "`svbrdf.loss.weights.top` is -1", "^^^^"],
            ),
            (
                FILE.replace("[variants.bare]", "[variants.bare]\nsvbrdf.steps = 8"),
                ["some.toml:13", "is 8 in row `bare`", "equal steps"],
            ),
            (
                FILE.replace("[variants.bare]", "[variants.bare]\nrun.seed = 8"),
                ["some.toml:13", "`run.seed` can't be set here", "`seeds`"],
            ),
            (FILE.replace("[1, 2]", "[1, 1]"), ["some.toml:3", "[1, 1]", "different whole numbers"]),
            (
                FILE.replace("smoke.toml", "smok.toml"),
                ["no config file `smok.toml`", "did you mean `smoke.toml`?", "looked for"],
            ),
            (format!("reference = \"ful\"\n{FILE}"), ["some.toml:1", "no row `ful`", "did you mean `full`?"]),
            (format!("figures = [\"dsim\"]\n{FILE}"), ["some.toml:1", "no figure `dsim`", "did you mean `dssim`?"]),
            (format!("{FILE}\n[grid]\nsvbrdf.stepz = [1]\n"), ["some.toml:18", "unknown key `stepz`", "did you mean `steps`?"]),
            (format!("{FILE}\n[grid]\nsvbrdf.optimisation.clip = [0.0, -2.0]\n"), ["some.toml:18", "is -2", "positive number"]),
            (format!("{FILE}\n[grid]\nsvbrdf.optimisation.clip = 2.0\n"), ["some.toml:18", "is 2.0", "expected a list"]),
            ("base = \"smoke\"\n".into(), ["nothing to compare", "[variants.NAME]", "[grid]"]),
        ] {
            let text = load(&wrong, &[]).err().unwrap_or_else(|| panic!("accepted:\n{wrong}"));
            assert!(parts.iter().all(|part| text.contains(part)), "{parts:?} are not in:\n{text}");
        }
    }
}
