//! `report.json`: what the run reached on materials it never saw, and what it cost.

use crate::config::Config;
use crate::finished::Finished;
use crate::pipeline::RunError;
use crate::run_folder::RunFolder;
use flow::weights::{ADJACENT, DISTANT};
use serde::Serialize;
use serde_json::{Map, Value, json};

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

/// Writes the report.
///
/// # Errors
/// The system's refusal.
pub fn write(folder: &RunFolder, config: &Config, finished: &Finished) -> Result<(), RunError> {
    let mut report = Map::new();
    report.insert("name".into(), json!(config.run.name));
    report.insert("minutes".into(), json!(finished.seconds() / 60.0));
    report.insert("peak_rss_mib".into(), json!(finished.peak_rss_mib));
    for (stage, measured, name) in FROM_STAGES {
        if let Some(value) = finished.measured(stage, measured) {
            report.insert(name.into(), json!(value));
        }
    }
    let skipped: usize = finished.stages.iter().map(|stage| stage.skipped.len()).sum();
    report.insert("skipped_batches".into(), json!(skipped));
    report.insert("stages".into(), json!(finished.stages));
    folder.write("report.json", &pretty(&Value::Object(report))?)?;
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
