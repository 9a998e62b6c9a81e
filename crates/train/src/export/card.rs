//! The model card: what a person needs to know of an export before using it.

use std::collections::BTreeMap;

use ops::weights::{DataSource, Manifest, NetRecord, Port};

use super::run::Facts;
use super::{EXAMPLES, Exported};

/// Names of data that a card lists; the manifest has all.
const LISTED: usize = 40;

/// Figures of a class of materials or of a baseline, by the start or end of their names.
const PARTIAL: [&str; 5] = ["_textured", "_low_texture", "_featureless", "constant_", "identity_"];

/// The card's text.
pub fn text(facts: &Facts, manifest: &Manifest, exported: &[Exported]) -> String {
    let mut card = String::from("---\ntags: [svbrdf, optical-flow, material-capture]\n---\n\n");
    card += &format!(
        "# Nets of the run `{}`\n\nNets of *Deep Reflectance Scanning in Rust*, after Ye, Dong, Peers, Guo: *Deep Reflectance\nScanning*, Computer Graphics Forum 40(6), 2021: flow between frames of a flash-lit scanning video (`pwc`), and from aligned frames to\ndiffuse, specular, roughness and normal maps (`svbrdf`).\n\n",
        facts.name
    );
    card += "| net | kind | weights | stored as | files |\n|---|---|---|---|---|\n";
    for Exported { net, record, .. } in exported {
        let files = files(net, record);
        card +=
            &format!("| `{net}` | `{}` | {} | {} | {} |\n", record.kind, record.parameters, record.precision, files.join(", "));
    }
    card += "\n`manifest.json` has the same for programs, with every architecture and SHA-256.\n\n## Use\n\nHere: `scan CLIP --out DIR --weights THIS_FOLDER`, and `evaluate` alike; a flow net starts another training by\n`[flow] init = \"THIS_FOLDER/NAME.safetensors\"`.\n\nPyTorch (`pip install torch safetensors numpy`), in this folder:\n\n```python\nfrom load import load\n\n";
    for Exported { net, record, .. } in exported {
        let inputs = record.inputs.iter().map(|port| port.name.as_str()).collect::<Vec<_>>().join(", ");
        let output = record.outputs.first().map_or("output", |port| port.name.as_str());
        card += &format!("{output} = load(\".\", \"{net}\")({inputs})\n");
    }
    card += &format!(
        "```\n\n`python load.py` runs every net on `{EXAMPLES}` and compares with what the program computed (1e-4).\n\n## Inputs and outputs\n"
    );
    let mut told = Vec::new();
    for Exported { record, .. } in exported {
        if !told.contains(&&record.kind) {
            told.push(&record.kind);
            card += &format!("\n`{}` nets:\n\n| | shape | meaning |\n|---|---|---|\n", record.kind);
            card += &rows("in", &record.inputs);
            card += &rows("out", &record.outputs);
        }
    }
    card += "\nTensors are named by the path of the parameter in the modules of `pwc.py` and `svbrdf.py`, the keys of their `state_dict`. Filters are\n[outputs, inputs, height, width], those of deconvolutions [inputs, outputs, height, width]; matrices of the global track [inputs, outputs].\n\n## Training\n\n";
    let revision = facts.revision.as_deref().unwrap_or("unknown");
    card += &format!(
        "Version {} of the program, revision {revision}, seed {}, on {}.\n\n",
        facts.version, facts.seed, facts.device
    );
    for Exported { net, record, .. } in exported {
        card += &format!("- `{net}`: {}\n", record.training);
    }
    card += "\nData:\n\n| what | licence | count | used by |\n|---|---|---|---|\n";
    for (data, nets) in by_source(exported) {
        card += &format!("| {} | {} | {} | {} |\n", data.source, data.licence, data.count, nets.join(", "));
    }
    for (data, _) in by_source(exported).into_iter().filter(|(data, _)| !data.names.is_empty()) {
        let shown = data.names.iter().take(LISTED).map(String::as_str).collect::<Vec<_>>().join(", ");
        let more = data.names.len().saturating_sub(LISTED);
        let rest = if more > 0 { format!(" and {more} more (manifest.json)") } else { String::new() };
        card += &format!("\n{} ({}): {shown}{rest}.\n", data.source, data.licence);
    }
    card += "\nThe licence of these weights is for whoever trained them to choose, within what the data's licences allow.\n\n## Figures\n\nOf each net on materials that it never saw, and what rounding its weights changes:\n\n";
    for Exported { net, record, rounding } in exported {
        card += &format!("`{net}`: {}.\n\n{}", rounding.words(record), table(&record.metrics));
    }
    if !manifest.evaluation.is_empty() {
        let mut whole = manifest.evaluation.clone();
        whole.retain(|name, _| !PARTIAL.iter().any(|part| name.starts_with(part) || name.ends_with(part)));
        card += &format!(
            "All nets together on scans of materials that they never saw (with and without texture apart, and the baselines: `manifest.json`):\n\n{}",
            table(&whole)
        );
    }
    card
}

fn files(net: &str, record: &NetRecord) -> Vec<String> {
    match record.shards.as_slice() {
        [] => vec![format!("{net}.safetensors")],
        shards => shards.iter().map(|shard| shard.file.clone()).collect(),
    }
}

fn rows(side: &str, ports: &[Port]) -> String {
    ports.iter().map(|port| format!("| {side}: {} | {} | {} |\n", port.name, port.shape, port.meaning)).collect()
}

fn table(figures: &BTreeMap<String, f64>) -> String {
    if figures.is_empty() {
        return String::new();
    }
    let number = |value: f64| match value.abs() {
        size if size.fract() == 0.0 => format!("{value}"),
        size if size < 1e-3 => format!("{value:.2e}"),
        _ => format!("{value:.4}"),
    };
    let rows: String = figures.iter().map(|(name, value)| format!("| `{name}` | {} |\n", number(*value))).collect();
    format!("| figure | value |\n|---|---|\n{rows}\n")
}

/// Every source of data once, with the nets that learned from it.
fn by_source(exported: &[Exported]) -> Vec<(&DataSource, Vec<String>)> {
    let mut found: Vec<(&DataSource, Vec<String>)> = Vec::new();
    for Exported { net, record, .. } in exported {
        for data in &record.data {
            match found.iter_mut().find(|(known, _)| *known == data) {
                Some((_, nets)) => nets.push(net.clone()),
                None => found.push((data, vec![net.clone()])),
            }
        }
    }
    found
}
