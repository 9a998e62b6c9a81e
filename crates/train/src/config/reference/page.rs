//! The reference as a page: `docs/config.md`.

use super::{Key, Path, Table, tables};

const HEAD: &str = "# Config reference

Every key of a config of `train`. This page is made by `cargo run -p train -- config-reference > docs/config.md` from the program itself;
`train config-reference --schema` prints the same as a JSON Schema for editors that complete and check TOML.

A config file holds only its differences from these defaults. `extends = \"other.toml\"` names the file below it (beside it, or in `configs/`), `--set
table.key=value` lies on top of all files, and `--dry-run` prints every key as it stands then. An unknown key, a wrong type or an impossible value is an
error that shows file, line and the nearest name. Tables of one kind have the same keys and are described once; where their defaults differ, each is given.
The run folder's `config.toml` has every key written out: with it as `--config` the run is repeated.

Under *allowed* stands what the program itself answers to an impossible value; where nothing stands, every value of the type works.
";

/// The whole page.
pub fn markdown() -> String {
    let tables = tables();
    let mut text = HEAD.to_string();
    for table in &tables {
        text += &section(table);
    }
    text
}

fn section(table: &Table) -> String {
    let names: Vec<String> = table.paths.iter().map(|path| format!("`{}`", path.dotted())).collect();
    let title = if table.paths.iter().any(|path| path.parts.is_empty()) { "The file".into() } else { names.join(", ") };
    let anchor = format!("<a id=\"{}\"></a>", table.kind.to_lowercase());
    let mut text = format!("\n{anchor}\n\n## {title}\n\n");
    // The first paragraph; what follows speaks of the code.
    let meaning = prose(table.meaning.split("\n\n").next().unwrap_or_default());
    if !meaning.starts_with('`') {
        text += &format!("{meaning}\n\n");
    }
    text += "| key | type | default | unit | allowed | meaning |\n|---|---|---|---|---|---|\n";
    for key in &table.keys {
        text += &row(key, &table.paths);
    }
    text
}

fn row(key: &Key, paths: &[Path]) -> String {
    let kind = match &key.table {
        Some(kind) => format!("[table](#{})", kind.to_lowercase()),
        None => key.kind.clone(),
    };
    let mut meaning = prose(&key.meaning);
    for (choice, what) in &key.choices {
        let what = prose(what);
        meaning += &if what.is_empty() { format!(" `{choice}`") } else { format!("<br>`{choice}`: {what}") };
    }
    let cells = [
        format!("`{}`", key.name),
        kind,
        default(key, paths),
        key.unit.clone().unwrap_or_default(),
        key.allowed.clone().unwrap_or_default(),
        meaning,
    ];
    format!("| {} |\n", cells.map(|cell| cell.replace('|', "\\|")).join(" | "))
}

/// The default that most tables have, then the others'.
fn default(key: &Key, paths: &[Path]) -> String {
    if key.table.is_some() && key.defaults.iter().all(Option::is_some) {
        return String::new();
    }
    let mut groups: Vec<(String, Vec<String>)> = Vec::new();
    for (value, path) in key.defaults.iter().zip(paths) {
        let value = match value {
            _ if key.required => "must be written".into(),
            None if key.table.is_some() => "off".into(),
            None => "none".into(),
            Some(toml::Value::Array(list)) if list.iter().any(toml::Value::is_table) => "see below".into(),
            Some(_) if key.table.is_some() => "on".into(),
            Some(value) => format!("`{value}`"),
        };
        match groups.iter_mut().find(|(known, _)| *known == value) {
            Some((_, paths)) => paths.push(path.dotted()),
            None => groups.push((value, vec![path.dotted()])),
        }
    }
    groups.sort_by_key(|(_, paths)| std::cmp::Reverse(paths.len()));
    let others = groups.iter().skip(1).map(|(value, paths)| {
        let paths: Vec<String> = paths.iter().map(|path| format!("`{path}`")).collect();
        format!("<br>{value} in {}", paths.join(", "))
    });
    groups.first().map_or(String::new(), |(value, _)| value.clone()) + &others.collect::<String>()
}

/// A doc comment for people who read no code: one line, links to items as their names.
fn prose(comment: &str) -> String {
    let line = comment.split_whitespace().collect::<Vec<_>>().join(" ").replace("\\[", "[").replace("\\]", "]");
    let mut text = String::new();
    let mut rest = line.as_str();
    while let Some((before, linked)) = rest.split_once("[`") {
        let Some((name, after)) = linked.split_once("`]") else { break };
        text += before;
        text += &format!("`{}`", name.trim_start_matches("super::").trim_start_matches("crate::"));
        // The target of a link with a text of its own.
        rest = match after.strip_prefix('(').and_then(|target| target.split_once(')')) {
            Some((_, after)) => after,
            None => after,
        };
    }
    text + rest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn comments_become_prose() {
        let comment = "Range of k1 of [`render::lens::RadialDistortion`], in\n\\[0, 1\\]: see [`a`](super::a).";
        assert_eq!(prose(comment), "Range of k1 of `render::lens::RadialDistortion`, in [0, 1]: see `a`.");
    }

    #[test]
    fn every_key_has_a_meaning() {
        for table in tables() {
            let place = table.paths[0].dotted();
            for key in &table.keys {
                assert!(!key.meaning.is_empty(), "{place}.{} has no doc comment", key.name);
            }
        }
    }

    #[test]
    fn what_is_allowed_is_what_the_program_says() {
        let tables = tables();
        let row = |kind: &str, name: &str| {
            let table = tables.iter().find(|table| table.kind == kind).unwrap();
            row(table.keys.iter().find(|key| key.name == name).unwrap(), &table.paths)
        };
        let cases = [
            ("Run", "data_workers", vec!["| integer | `1` |", "1 to 256 threads"]),
            ("Run", "on_nan", vec!["`\"stop\"`", "<br>`restore`: The run goes back"]),
            ("Optimisation", "learning_rate", vec!["`0.00002` in `svbrdf.optimisation`", "a rate above 0"]),
            ("VignettingConfig", "corner_loss", vec!["2 × number", "0 ≤ low ≤ high ≤ 0.9"]),
            ("materials-npy", "roughness_squared", vec!["must be written"]),
            ("SensorConfig", "vignetting", vec!["[table](#vignettingconfig) | off"]),
        ];
        for (kind, name, parts) in cases {
            let row = row(kind, name);
            assert!(parts.iter().all(|part| row.contains(part)), "{row}");
        }
    }
}
