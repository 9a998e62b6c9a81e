//! The files a protocol leaves: `summary.json`, `table.csv`, `table.md` and a contact sheet per material.

use std::path::Path;

use dataset::image_io::{Overwrite, write_bytes, write_png8};
use serde::Serialize;

use crate::EvaluateError;
use crate::report::{Figures, Row, rows, summary};
use crate::sheet::contact_sheet;
use crate::synthetic::MaterialResult;
use crate::table::{csv, markdown};

#[derive(Serialize)]
struct Summary<'a> {
    summary: &'a Figures,
    rows: &'a [Row],
}

/// Writes everything into an existing folder and returns the summary.
///
/// # Errors
/// If a file can't be written, or exists and may not be replaced.
pub fn write(results: &[MaterialResult], folder: &Path, overwrite: Overwrite) -> Result<Figures, EvaluateError> {
    let (figures, rows) = (summary(results), rows(results));
    for result in results {
        let name: String =
            result.material.chars().map(|c| if c.is_ascii_alphanumeric() || "-_.".contains(c) { c } else { '_' }).collect();
        write_png8(&folder.join(format!("sheet-{name}.png")), &contact_sheet(&result.pictures), overwrite)?;
    }
    write_bytes(&folder.join("table.csv"), csv(&rows).as_bytes(), overwrite)?;
    write_bytes(&folder.join("table.md"), markdown(&rows, &figures).as_bytes(), overwrite)?;
    let json = serde_json::to_string_pretty(&Summary { summary: &figures, rows: &rows }).expect("figures are plain numbers");
    // The summary comes last: where it is, the rest is whole.
    write_bytes(&folder.join("summary.json"), json.as_bytes(), overwrite)?;
    Ok(figures)
}
