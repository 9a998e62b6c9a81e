//! The rows as JSON, CSV and Markdown.

use std::collections::BTreeSet;
use std::path::Path;

use dataset::image_io::{Overwrite, write_bytes};

use crate::EvaluateError;

use super::summary::Row;

/// Columns of the Markdown table: figure, heading, digits, whether with its interval.
const COLUMNS: [(&str, &str, usize, bool); 14] = [
    ("valid_rate", "valid rate", 3, false),
    ("pixel_error", "pixel error", 2, true),
    ("pixel_error_median", "median", 2, false),
    ("pixel_error_p95", "p95", 2, false),
    ("penalised_error", "penalised", 2, true),
    ("within_20px", "within 20 px", 3, false),
    ("wrong", "accepted, > 10 px off", 3, false),
    ("wrong_frames", "… key frames", 3, false),
    ("refused", "refused", 3, false),
    ("spearman_expected", "Spearman", 2, false),
    ("focal_error", "focal error", 3, false),
    ("height_error", "height error", 3, false),
    ("focal_unknown", "focal not observable", 2, false),
    ("seconds", "seconds", 1, false),
];

/// Writes `table.csv`, `table.md` and `summary.json`, replacing those of fewer cases.
///
/// # Errors
/// If a file can't be written.
pub fn write(rows: &[Row], folder: &Path) -> Result<(), EvaluateError> {
    write_bytes(&folder.join("table.csv"), csv(rows).as_bytes(), Overwrite::Allow)?;
    write_bytes(&folder.join("table.md"), markdown(rows).as_bytes(), Overwrite::Allow)?;
    let json = serde_json::to_vec_pretty(rows).expect("figures are plain numbers");
    // The summary comes last: where it is, the rest is whole.
    Ok(write_bytes(&folder.join("summary.json"), &json, Overwrite::Allow)?)
}

/// All figures of all rows.
pub fn csv(rows: &[Row]) -> String {
    let names: BTreeSet<&String> = rows.iter().flat_map(|r| r.figures.keys()).collect();
    let mut text = String::from("condition,class,sequences");
    names.iter().for_each(|n| text += &format!(",{n}"));
    text.push('\n');
    for row in rows {
        text += &format!("{},{},{}", row.condition, row.class, row.sequences);
        names.iter().for_each(|n| text += &row.figures.get(*n).map_or_else(|| ",".into(), |v| format!(",{v:.6e}")));
        text.push('\n');
    }
    text
}

/// The main figures, one table per class of materials.
pub fn markdown(rows: &[Row]) -> String {
    let mut classes: Vec<&str> = rows.iter().map(|r| r.class).collect();
    classes.dedup();
    let mut seen = BTreeSet::new();
    classes.retain(|c| seen.insert(*c));
    let mut text = String::new();
    for class in classes {
        text += &format!("**{class}**\n\n| condition | scans |");
        COLUMNS.iter().for_each(|(_, heading, ..)| text += &format!(" {heading} |"));
        text += &format!("\n|---|---|{}\n", "---|".repeat(COLUMNS.len()));
        for row in rows.iter().filter(|r| r.class == class) {
            text += &format!("| {} | {} |{}\n", row.title, row.sequences, cells(row));
        }
        text.push('\n');
    }
    text + "Means over scans ± 95 % interval; distances in pixels at a width of 1024.\n"
}

fn cells(row: &Row) -> String {
    let cell = |&(name, _, digits, with_interval): &(&str, &str, usize, bool)| {
        let number = |name: &str| row.figures.get(name).map(|v| format!("{v:.digits$}"));
        let value = number(name).unwrap_or_else(|| "–".into());
        match number(&format!("{name}_interval")).filter(|_| with_interval) {
            Some(interval) => format!(" {value} ± {interval} |"),
            None => format!(" {value} |"),
        }
    };
    COLUMNS.iter().map(cell).collect()
}
