//! `report.json`: what the run reached on materials it never saw, and what it cost; `report.html` shows it.

use crate::config::{Config, ReportFlow};
use crate::finished::Finished;
use crate::pipeline::RunError;
use crate::run_folder::RunFolder;
use crate::stage::plan::released_weights;
use burn::tensor::Device;
use dataset::image_io::Overwrite;
use dataset::material::MaterialLibrary;
use evaluate::report::Figures;
use evaluate::synthetic;
use flow::weights::{ADJACENT, DISTANT, Manifest};
use scan::nets::ScanNets;
use serde::Serialize;
use serde_json::{Map, Value, json};
use std::path::PathBuf;

/// Figures that stages measured, as (stage, its name there, its name in the report).
const FROM_STAGES: [(&str, &str, &str); 8] = [
    (ADJACENT, "epe_ratio", "adjacent_epe_ratio"),
    (ADJACENT, "epe_px", "adjacent_epe_px"),
    (ADJACENT, "homography_ratio", "adjacent_homography_ratio"),
    (DISTANT, "epe_ratio", "distant_epe_ratio"),
    (DISTANT, "epe_px", "distant_epe_px"),
    (DISTANT, "homography_ratio", "distant_homography_ratio"),
    (svbrdf::weights::NAME, "maps_l1_ratio", "maps_l1_ratio"),
    (svbrdf::weights::NAME, "render_l1_ratio", "render_l1_ratio"),
];

/// The trained nets together on scans of held-out materials, with tables and contact sheets in `report/`.
///
/// `None` when the run has no SVBRDF net to evaluate; the flow nets may be absent.
///
/// # Errors
/// A net that can't be read, a material that can't be had, or a stop.
pub fn evaluate_nets(
    folder: &RunFolder,
    config: &Config,
    library: &MaterialLibrary,
    device: &Device,
    stop: &dyn Fn(u64) -> bool,
) -> Result<Option<Figures>, RunError> {
    if !config.report.evaluate || config.svbrdf.steps == 0 {
        return Ok(None);
    }
    let weights = folder.weights();
    let others = flow_nets(config)?;
    let flow = |name, steps| {
        let nets = if steps > 0 { Some(&weights) } else { others.as_ref() };
        nets.map(|folder| flow::weights::load(folder, name, device).map(|(net, _)| net)).transpose()
    };
    let method = ScanNets {
        adjacent: flow(ADJACENT, config.adjacent.steps)?,
        distant: flow(DISTANT, config.distant.steps)?,
        svbrdf: svbrdf::weights::load(&weights, device)?.0,
        device: device.clone(),
    };
    let protocol = &config.report.synthetic;
    let (total, mut done) = (protocol.textured + protocol.low_texture + protocol.featureless, 0);
    let results = synthetic::run(library, &method, protocol, |result| {
        done += 1;
        eprintln!("report {done}/{total} {}", result.material);
        !stop(done as u64)
    })?;
    let tables = folder.path().join("report");
    std::fs::create_dir_all(&tables)?;
    Ok(Some(evaluate::output::write(&results, &tables, Overwrite::Allow)?))
}

/// The folder of flow nets that align the report's scans where the run trains none of its own.
///
/// # Errors
/// A folder that lacks one of them, in words for a person.
pub fn flow_nets(config: &Config) -> Result<Option<PathBuf>, NoFlowNets> {
    let folder = match &config.report.flow_nets {
        ReportFlow::None => return Ok(None),
        ReportFlow::Weights => released_weights().ok_or_else(|| NoFlowNets { found: "weights".into() })?,
        ReportFlow::Folder(folder) => folder.clone(),
    };
    let holds =
        Manifest::read(&folder).is_ok_and(|manifest| [ADJACENT, DISTANT].iter().all(|net| manifest.nets.contains_key(*net)));
    if holds { Ok(Some(folder)) } else { Err(NoFlowNets { found: folder.display().to_string() }) }
}

/// `report.flow_nets` leads nowhere.
#[derive(Debug, thiserror::Error)]
#[error(
    "`report.flow_nets` is \"{found}\", but there is no manifest.json with the nets {ADJACENT} and {DISTANT} in that folder: expected `none`, `weights` (those that ship, here or in the workspace) or a folder of weights as a run leaves it"
)]
pub struct NoFlowNets {
    found: String,
}

/// Writes `report.json` and `report.html`; the figures of the evaluation stand above those that single stages measured.
///
/// # Errors
/// The system's refusal.
pub fn write(
    folder: &RunFolder,
    config: &Config,
    finished: &Finished,
    figures: Option<Figures>,
    seconds: f64,
) -> Result<(), RunError> {
    let mut report = Map::new();
    report.insert("name".into(), json!(config.run.name));
    report.insert("minutes".into(), json!(seconds / 60.0));
    let peak = finished.peak_rss_mib.into_iter().chain(ops::process::peak_rss_mib()).reduce(f64::max);
    report.insert("peak_rss_mib".into(), json!(peak));
    for (stage, measured, name) in FROM_STAGES {
        if let Some(value) = finished.measured(stage, measured) {
            report.insert(name.into(), json!(value));
        }
    }
    for done in &finished.stages {
        report.insert(format!("{}_data_wait_share", done.stage), json!(done.data_wait_share));
    }
    report.extend(figures.into_iter().flatten().map(|(name, value)| (name, json!(value))));
    let skipped: usize = finished.stages.iter().map(|stage| stage.skipped.len()).sum();
    report.insert("skipped_batches".into(), json!(skipped));
    report.insert("stages".into(), json!(finished.stages));
    let page = crate::page::html(folder.path(), config, finished, &report)?;
    folder.write("report.json", &pretty(&Value::Object(report))?)?;
    folder.write("report.html", &page)?;
    Ok(())
}

/// JSON for people.
///
/// # Errors
/// Only a fault of the program.
pub fn pretty(value: &impl Serialize) -> Result<String, std::io::Error> {
    let mut text = serde_json::to_string_pretty(value)?;
    text.push('\n');
    Ok(text)
}
