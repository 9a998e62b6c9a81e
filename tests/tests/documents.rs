//! The documents name only what exists: their links, the paths of files, and the functions that the paper map leads to.

use std::path::{Path, PathBuf};

const DOCUMENTS: [&str; 7] = [
    "README.md",
    "ARCHITECTURE.md",
    "CHANGELOG.md",
    "docs/config.md",
    "docs/paper-map.md",
    "docs/results.md",
    "weights/README.md",
];

fn workspace() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

fn read(document: &str) -> String {
    std::fs::read_to_string(workspace().join(document)).unwrap()
}

/// The texts between two marks, none of them longer than a line.
fn between<'a>(text: &'a str, open: &'a str, close: &'a str) -> impl Iterator<Item = &'a str> {
    text.lines().flat_map(move |line| line.split(open).skip(1).filter_map(move |rest| rest.split_once(close).map(|(t, _)| t)))
}

/// The pieces of code in a document.
fn code(text: &str) -> impl Iterator<Item = &str> {
    text.lines().flat_map(|line| line.split('`').skip(1).step_by(2))
}

/// `a/{b,c}.rs` as `a/b.rs` and `a/c.rs`.
fn alternatives(path: &str) -> Vec<String> {
    let Some((before, rest)) = path.split_once('{') else { return vec![path.into()] };
    let (inside, after) = rest.split_once('}').unwrap();
    inside.split(',').map(|one| format!("{before}{one}{after}")).collect()
}

/// Whether a document has the heading that an anchor names: its words in small letters, joined by hyphens.
fn has_heading(path: &Path, anchor: &str) -> bool {
    let named = |line: &str| {
        let words = line.trim_start_matches('#').trim().to_lowercase().replace(' ', "-");
        line.starts_with('#') && words.chars().filter(|c| c.is_alphanumeric() || *c == '-').eq(anchor.chars())
    };
    std::fs::read_to_string(path).is_ok_and(|text| text.lines().any(named))
}

#[test]
fn links_and_paths_lead_somewhere() {
    let mut broken = Vec::new();
    for document in DOCUMENTS {
        let text = read(document);
        let folder = workspace().join(document).parent().unwrap().to_path_buf();
        let links = between(&text, "](", ")").filter(|link| !link.contains("://") && !link.starts_with('#'));
        let leads = |link: &&str| match link.split_once('#') {
            Some((file, heading)) => has_heading(&folder.join(file), heading),
            None => folder.join(link).exists(),
        };
        broken.extend(links.filter(|link| !leads(link)).map(|link| format!("{document}: {link}")));
        let paths = code(&text).filter(|c| c.starts_with("crates/") && !c.contains('*')).flat_map(alternatives);
        broken.extend(paths.filter(|path| !workspace().join(path).exists()).map(|path| format!("{document}: {path}")));
    }
    assert!(broken.is_empty(), "{broken:#?}");
}

#[test]
fn the_paper_map_leads_to_code() {
    let text = read("docs/paper-map.md");
    let mut missing = Vec::new();
    let mut checked = 0;
    for path in code(&text).filter(|c| c.contains("::")) {
        let mut parts = path.split("::");
        let folder = workspace().join("crates").join(parts.next().unwrap()).join("src");
        let source = sources(&folder);
        checked += 1;
        missing.extend(parts.filter(|part| !defines(&source, part)).map(|part| format!("{path}: no {part}")));
    }
    assert!(missing.is_empty() && checked > 40, "{checked} checked, {missing:#?}");
}

/// All source of a crate in one text.
fn sources(folder: &Path) -> String {
    let mut text = String::new();
    for entry in std::fs::read_dir(folder).unwrap_or_else(|e| panic!("{}: {e}", folder.display())) {
        let path = entry.unwrap().path();
        if path.is_dir() {
            text += &sources(&path);
        } else if path.extension().is_some_and(|e| e == "rs") {
            text += &std::fs::read_to_string(path).unwrap();
        }
    }
    text
}

/// Whether an item or an enum's variant of that name is defined.
fn defines(source: &str, name: &str) -> bool {
    let keywords = ["fn", "struct", "enum", "mod", "const", "trait", "type"];
    let ends = |rest: &str| !rest.starts_with(|c: char| c.is_alphanumeric() || c == '_');
    let item = |k: &str| source.match_indices(&format!("{k} {name}")).any(|(i, m)| ends(&source[i + m.len()..]));
    let variant = || source.lines().any(|line| line.trim().strip_prefix(name).is_some_and(|rest| rest == ","));
    keywords.into_iter().any(item) || variant()
}
