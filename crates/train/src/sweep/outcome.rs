//! From the reports of the runs to the table.

use super::Failures;
use super::plan::Run;
use crate::cli::Failure;
use crate::pipeline::RunError;
use crate::report::pretty;
use evaluate::comparison::{Comparison, Measured, Question, csv, markdown, svg};
use evaluate::report::{Figures, Row};
use serde_json::{Value, json};
use std::path::Path;

/// Reads what a finished run measured.
///
/// # Errors
/// A report that isn't one.
pub fn measured(out: &Path, run: &Run) -> Result<Measured, Failure> {
    let folder = out.join(&run.name);
    let report = read(&folder.join("report.json"))?;
    // A run without an SVBRDF net has no materials to show.
    let path = folder.join("report/summary.json");
    let rows = if path.is_file() { read(&path)?["rows"].take() } else { Value::Null };
    let row = |row: &Value| {
        let texture = serde_json::from_value(row["texture"].clone()).ok()?;
        Some(Row { material: row["material"].as_str()?.into(), texture, figures: figures(row) })
    };
    let materials = rows.as_array().into_iter().flatten().filter_map(row).collect();
    Ok(Measured { variant: run.row.clone(), seed: run.seed, figures: figures(&report), materials })
}

/// All numbers of an object. A figure that is not finite (the pixel error of a scan without a valid pixel) is `null` there, and
/// absent here.
fn figures(object: &Value) -> Figures {
    let number = |(name, value): (&String, &Value)| Some((name.clone(), value.as_f64()?));
    object.as_object().into_iter().flatten().filter_map(number).collect()
}

fn read(path: &Path) -> Result<Value, Failure> {
    let text = std::fs::read_to_string(path).map_err(|error| unreadable(path, &error.to_string()))?;
    serde_json::from_str(&text).map_err(|error| unreadable(path, &error.to_string()))
}

fn unreadable(path: &Path, reason: &str) -> Failure {
    Failure::Usage(format!(
        "{} can't be read as a run's report ({reason}): remove the run's report.json and run the sweep again, which makes the report anew",
        path.display()
    ))
}

/// Writes `table.md`, `table.csv`, `table.svg` and, last, `sweep.json` into the sweep's folder; returns the Markdown.
///
/// # Errors
/// The system's refusal.
pub fn write(
    out: &Path,
    question: Question,
    runs: &[Run],
    finished: &[Measured],
    failures: &Failures,
) -> Result<String, Failure> {
    let comparison = Comparison::new(question, finished);
    let mut text = markdown(&comparison);
    let missing = runs.len() - finished.len();
    if missing > 0 {
        text += &format!("\n{missing} of {} runs are not in these tables", runs.len());
        text += &match failures.len() {
            0 => ": they are not finished.\n".to_string(),
            failed => format!(", {failed} of them failed:\n\n"),
        };
        failures.iter().for_each(|(name, reason)| text += &format!("- {name}: {reason}\n"));
    }
    let list: Vec<Value> = runs
        .iter()
        .map(|run| {
            let done = finished.iter().any(|measured| measured.variant == run.row && measured.seed == run.seed);
            let takes: Vec<&str> = run.takes.iter().map(|&other| runs[other].name.as_str()).collect();
            json!({ "run": run.name, "row": run.row, "seed": run.seed, "finished": done, "takes_nets_of": takes, "failure": failures.get(&run.name) })
        })
        .collect();
    let summary = json!({ "revision": crate::revision::revision(), "reference": comparison.question.reference, "runs": list });
    let files = [
        ("table.csv", csv(&comparison)),
        ("table.svg", svg(&comparison)),
        ("table.md", text.clone()),
        ("sweep.json", pretty(&summary).map_err(RunError::Io)?),
    ];
    for (name, text) in files {
        crate::atomic::write(&out.join(name), text.as_bytes()).map_err(RunError::Io)?;
    }
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_that_are_not_finite_are_absent() {
        let found = figures(&json!({ "material": "a", "dssim": 0.5, "alignment_pixel_error": null }));
        assert_eq!(found, Figures::from([("dssim".into(), 0.5)]));
    }
}
