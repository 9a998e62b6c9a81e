//! `metrics.jsonl`: one JSON object per line.

use super::{Recorder, Row};
use image::RgbImage;
use serde_json::{Map, Value, json};
use std::fs::{File, OpenOptions};
use std::io::{self, BufRead, BufReader, BufWriter, Write};
use std::path::{Path, PathBuf};

/// Writes `metrics.jsonl`.
pub struct Metrics {
    path: PathBuf,
    file: BufWriter<File>,
}

impl Metrics {
    /// Appends to the file, or starts it.
    ///
    /// # Errors
    /// The system's refusal.
    pub fn open(path: &Path) -> io::Result<Self> {
        Ok(Self { path: path.into(), file: append(path)? })
    }
}

fn append(path: &Path) -> io::Result<BufWriter<File>> {
    Ok(BufWriter::new(OpenOptions::new().create(true).append(true).open(path)?))
}

impl Recorder for Metrics {
    fn row(&mut self, row: &Row<'_>) -> io::Result<()> {
        let mut object = Map::new();
        object.insert("stage".into(), json!(row.stage));
        object.insert("step".into(), json!(row.step));
        object.insert("kind".into(), json!(row.kind.name()));
        // JSON has no NaN; null keeps the name in sight.
        object.extend(row.values.iter().map(|(name, value)| (name.clone(), json!(value))));
        serde_json::to_writer(&mut self.file, &Value::Object(object))?;
        self.file.write_all(b"\n")
    }

    fn picture(&mut self, _stage: &str, _step: u64, _name: &str, _image: &RgbImage) -> io::Result<()> {
        Ok(())
    }

    /// A half-written last line, as a kill leaves it, goes too.
    fn rewind(&mut self, stage: &str, step: u64) -> io::Result<()> {
        self.file.flush()?;
        let before = BufReader::new(File::open(&self.path)?);
        crate::atomic::write_with(&self.path, |kept| {
            for line in before.lines() {
                let line = line?;
                let Ok(row) = serde_json::from_str::<Value>(&line) else { continue };
                if row["stage"] != stage || row["step"].as_u64().is_some_and(|at| at <= step) {
                    writeln!(kept, "{line}")?;
                }
            }
            Ok(())
        })?;
        self.file = append(&self.path)?;
        Ok(())
    }

    /// To the disk itself: a checkpoint must not outlive the numbers before it.
    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()?;
        self.file.get_ref().sync_data()
    }
}

/// Reads one value of every row of a kind back, as (stage, step, value).
///
/// # Errors
/// A file that isn't there or isn't JSON lines.
pub fn read_steps(path: &Path, kind: super::Kind, name: &str) -> io::Result<Vec<(String, u64, f64)>> {
    let mut values = Vec::new();
    for line in BufReader::new(File::open(path)?).lines() {
        let row: Value = serde_json::from_str(&line?)?;
        if row["kind"] == kind.name()
            && let (Some(stage), Some(step), Some(value)) = (row["stage"].as_str(), row["step"].as_u64(), row[name].as_f64())
        {
            values.push((stage.to_string(), step, value));
        }
    }
    Ok(values)
}

#[cfg(test)]
mod tests {
    use super::super::Kind;
    use super::*;

    #[test]
    fn rows_come_back_and_rewinding_drops_later_ones_of_the_stage_only() {
        let home = tempfile::tempdir().unwrap();
        let path = home.path().join("metrics.jsonl");
        let mut metrics = Metrics::open(&path).unwrap();
        for (stage, step) in [("adjacent", 1), ("adjacent", 9), ("distant", 1), ("distant", 2), ("distant", 3)] {
            let values = [("loss".to_string(), step as f64 / 3.0)];
            metrics.row(&Row { stage, step, kind: Kind::Train, values: &values }).unwrap();
        }
        metrics.flush().unwrap();
        drop(metrics);
        let mut file = OpenOptions::new().append(true).open(&path).unwrap();
        file.write_all(b"{\"stage\":\"dist").unwrap();
        Metrics::open(&path).unwrap().rewind("distant", 2).unwrap();
        let rows = read_steps(&path, Kind::Train, "loss").unwrap();
        let steps: Vec<_> = rows.iter().map(|(stage, step, _)| (stage.as_str(), *step)).collect();
        assert_eq!(steps, [("adjacent", 1), ("adjacent", 9), ("distant", 1), ("distant", 2)]);
        assert_eq!(rows[3].2, 2.0 / 3.0);
    }
}
