//! From the reports of the runs to the table.

use super::Failures;
use super::plan::Run;
use crate::cli::Failure;
use crate::pipeline::RunError;
use crate::report::pretty;
use evaluate::comparison::{Comparison, Measured, Question, csv, markdown, svg};
use evaluate::report::{Figures, Row};
use serde::Deserialize;
use serde_json::{Value, json};
use std::path::Path;

/// What is read of `report/summary.json`.
#[derive(Deserialize)]
struct Materials {
    rows: Vec<Row>,
}

/// Reads what a finished run measured.
///
/// # Errors
/// A report that isn't one.
pub fn measured(out: &Path, run: &Run) -> Result<Measured, Failure> {
    let folder = out.join(&run.name);
    let read = |path: &Path| -> Result<String, Failure> {
        std::fs::read_to_string(path).map_err(|error| unreadable(path, &error.to_string()))
    };
    let path = folder.join("report.json");
    let report: Value = serde_json::from_str(&read(&path)?).map_err(|error| unreadable(&path, &error.to_string()))?;
    let number = |(name, value): (&String, &Value)| Some((name.clone(), value.as_f64()?));
    let figures: Figures = report.as_object().into_iter().flatten().filter_map(number).collect();
    // A run without an SVBRDF net has no materials to show.
    let path = folder.join("report/summary.json");
    let materials = if path.is_file() {
        let read: Materials = serde_json::from_str(&read(&path)?).map_err(|error| unreadable(&path, &error.to_string()))?;
        read.rows
    } else {
        Vec::new()
    };
    Ok(Measured { variant: run.row.clone(), seed: run.seed, figures, materials })
}

fn unreadable(path: &Path, reason: &str) -> Failure {
    Failure::Usage(format!(
        "{} can't be read as a run's report ({reason}): remove it and run the sweep again, which makes the report anew",
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
