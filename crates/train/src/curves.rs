//! The curves of a run, read from `metrics.jsonl` while it grows, in bounded memory whatever the number of steps.

use crate::recorder::Kind;
use evaluate::plot::Point;
use serde_json::Value;
use std::fs::File;
use std::io::{self, BufRead, BufReader, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// A curve that has this many bins joins them two by two.
const MOST_BINS: usize = 512;
/// Names that stand at the end of a stage's list, because they are no losses.
const LAST: [&str; 2] = ["gradient_norm", "learning_rate"];

/// Neighbouring steps together.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Bin {
    first: u64,
    last: u64,
    low: f64,
    high: f64,
    sum: f64,
    count: u32,
}

/// One number over the steps of a stage.
#[derive(Debug, Clone, PartialEq)]
pub struct Curve {
    /// Its name in the metrics.
    pub name: String,
    bins: Vec<Bin>,
    per_bin: u32,
    first: f64,
    last: f64,
}

impl Curve {
    fn new(name: &str, value: f64) -> Self {
        Self { name: name.into(), bins: Vec::new(), per_bin: 1, first: value, last: value }
    }

    fn push(&mut self, step: u64, value: f64) {
        self.last = value;
        let new = Bin::one(step, value);
        if let Some(bin) = self.bins.last_mut().filter(|bin| bin.count < self.per_bin) {
            *bin = bin.joined(&new);
            return;
        }
        if self.bins.len() == MOST_BINS {
            self.bins = self.bins.chunks(2).map(Bin::all).collect();
            self.per_bin *= 2;
        }
        self.bins.push(new);
    }

    /// The first value.
    pub fn first(&self) -> f64 {
        self.first
    }

    /// The latest value.
    pub fn last(&self) -> f64 {
        self.last
    }

    /// The curve, at most 512 points.
    pub fn points(&self) -> Vec<Point> {
        let point = |bin: &Bin| Point {
            step: (bin.first + bin.last) as f64 / 2.0,
            mean: bin.sum / f64::from(bin.count),
            low: bin.low,
            high: bin.high,
        };
        self.bins.iter().map(point).collect()
    }
}

impl Bin {
    fn one(step: u64, value: f64) -> Self {
        Self { first: step, last: step, low: value, high: value, sum: value, count: 1 }
    }

    /// One bin of several that follow each other, at least one.
    fn all(bins: &[Self]) -> Self {
        bins[1..].iter().fold(bins[0], |sum, bin| sum.joined(bin))
    }

    fn joined(&self, later: &Self) -> Self {
        Self {
            first: self.first,
            last: later.last,
            low: self.low.min(later.low),
            high: self.high.max(later.high),
            sum: self.sum + later.sum,
            count: self.count + later.count,
        }
    }
}

/// The curves of one stage.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct StageCurves {
    /// Name of the stage.
    pub name: String,
    /// Steps done.
    pub step: u64,
    /// The total loss first, then its terms by name, gradient norm and learning rate last.
    pub train: Vec<Curve>,
    /// Measurements on held-out materials, by name.
    pub held_out: Vec<Curve>,
    measured: u64,
}

impl StageCurves {
    /// Takes a row in; `false` for one that goes back, as after a resume.
    fn add(&mut self, kind: Kind, step: u64, row: &serde_json::Map<String, Value>) -> bool {
        let (curves, latest) = match kind {
            Kind::Train => (&mut self.train, &mut self.step),
            Kind::Validate => (&mut self.held_out, &mut self.measured),
        };
        if step <= *latest {
            return false;
        }
        *latest = step;
        // A number that wasn't finite is null.
        for (name, value) in row.iter().filter_map(|(name, value)| Some((name, value.as_f64()?))).filter(|(n, _)| *n != "step")
        {
            let place = curves.iter().position(|curve| curve.name == *name).unwrap_or_else(|| {
                curves.push(Curve::new(name, value));
                curves.sort_by_cached_key(|curve| order(&curve.name));
                curves.iter().position(|curve| curve.name == *name).unwrap_or_default()
            });
            curves[place].push(step, value);
        }
        true
    }
}

fn order(name: &str) -> (usize, String) {
    let rank = if name == "loss" { 0 } else { 1 + LAST.iter().position(|last| *last == name).map_or(0, |at| 1 + at) };
    (rank, name.into())
}

/// The curves of all stages of a run.
#[derive(Debug)]
pub struct Curves {
    path: PathBuf,
    /// Bytes that were taken in: up to the end of a line.
    read: u64,
    /// In the order in which they began.
    pub stages: Vec<StageCurves>,
}

impl Curves {
    /// Of a metrics file, nothing read yet.
    pub fn new(path: &Path) -> Self {
        Self { path: path.into(), read: 0, stages: Vec::new() }
    }

    /// Everything that the file holds now.
    ///
    /// # Errors
    /// A file that isn't there or can't be read.
    pub fn read(path: &Path) -> io::Result<Self> {
        let mut curves = Self::new(path);
        curves.follow()?;
        Ok(curves)
    }

    /// Takes in the lines that have been added. A run that was resumed may have taken lines back; then everything is read anew.
    ///
    /// # Errors
    /// A file that isn't there or can't be read.
    pub fn follow(&mut self) -> io::Result<()> {
        let goes_on = File::open(&self.path)?.metadata()?.len() >= self.read && self.take_new_lines()?;
        if !goes_on {
            (self.read, self.stages) = (0, Vec::new());
            self.take_new_lines()?;
        }
        Ok(())
    }

    /// `false` where the file isn't the one that was read before.
    fn take_new_lines(&mut self) -> io::Result<bool> {
        let mut file = BufReader::new(File::open(&self.path)?);
        file.seek(SeekFrom::Start(self.read))?;
        let mut line = Vec::new();
        while file.read_until(b'\n', &mut line)? > 0 {
            // The last line may still be being written.
            if line.last() != Some(&b'\n') {
                break;
            }
            if !self.take(&line) && self.read > 0 {
                return Ok(false);
            }
            self.read += line.len() as u64;
            line.clear();
        }
        Ok(true)
    }

    fn take(&mut self, line: &[u8]) -> bool {
        let Ok(Value::Object(row)) = serde_json::from_slice(line) else { return false };
        let text = |key: &str| row.get(key).and_then(Value::as_str);
        let kind = [Kind::Train, Kind::Validate].into_iter().find(|kind| text("kind") == Some(kind.name()));
        let (Some(stage), Some(kind), Some(step)) = (text("stage"), kind, row.get("step").and_then(Value::as_u64)) else {
            return false;
        };
        let place = self.stages.iter().position(|known| known.name == stage).unwrap_or_else(|| {
            self.stages.push(StageCurves { name: stage.into(), ..StageCurves::default() });
            self.stages.len() - 1
        });
        self.stages[place].add(kind, step, &row)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recorder::{Metrics, Recorder, Row};
    use std::io::Write;

    fn write(metrics: &mut Metrics, stage: &str, steps: std::ops::RangeInclusive<u64>) {
        for step in steps {
            let values = [("top", 2.0), ("loss", 1.0 / step as f64), ("learning_rate", 0.1), ("bad", f64::NAN)];
            let values = values.map(|(name, value)| (name.to_string(), value));
            metrics.row(&Row { stage, step, kind: Kind::Train, values: &values }).unwrap();
            if step % 10 == 0 {
                let measured = [("epe_px".to_string(), 5.0)];
                metrics.row(&Row { stage, step, kind: Kind::Validate, values: &measured }).unwrap();
            }
        }
        metrics.flush().unwrap();
    }

    #[test]
    fn curves_grow_with_the_file_and_stay_small() {
        let home = tempfile::tempdir().unwrap();
        let path = home.path().join("metrics.jsonl");
        assert!(Curves::read(&path).is_err());
        let mut metrics = Metrics::open(&path).unwrap();
        write(&mut metrics, "adjacent", 1..=20);
        let mut curves = Curves::read(&path).unwrap();
        write(&mut metrics, "adjacent", 21..=3000);
        write(&mut metrics, "svbrdf", 1..=9);
        curves.follow().unwrap();
        let stage = &curves.stages[0];
        let names: Vec<_> = stage.train.iter().map(|curve| curve.name.as_str()).collect();
        assert_eq!((names, stage.step), (vec!["loss", "top", "learning_rate"], 3000));
        let loss = &stage.train[0];
        let points = loss.points();
        assert!((200..=MOST_BINS).contains(&points.len()), "{}", points.len());
        assert_eq!((loss.first(), loss.last(), points[0].high), (1.0, 1.0 / 3000.0, 1.0));
        assert!(points.windows(2).all(|pair| pair[0].step < pair[1].step && pair[0].mean > pair[1].mean));
        let sum: f64 = loss.bins.iter().map(|bin| bin.sum).sum();
        assert!((sum - (1..=3000).map(|step| 1.0 / f64::from(step)).sum::<f64>()).abs() < 1e-9);
        assert_eq!((stage.held_out[0].points().len(), curves.stages[1].step), (300, 9));
        assert_eq!(curves.stages, Curves::read(&path).unwrap().stages);
    }

    #[test]
    fn a_resumed_run_and_a_line_in_the_making_are_understood() {
        let home = tempfile::tempdir().unwrap();
        let path = home.path().join("metrics.jsonl");
        let mut metrics = Metrics::open(&path).unwrap();
        write(&mut metrics, "adjacent", 1..=30);
        let mut curves = Curves::read(&path).unwrap();
        metrics.rewind("adjacent", 20).unwrap();
        // As long as before, so that only the steps tell.
        write(&mut metrics, "adjacent", 21..=40);
        curves.follow().unwrap();
        assert_eq!(curves.stages, Curves::read(&path).unwrap().stages);
        assert_eq!(curves.stages[0].step, 40);
        drop(metrics);
        let mut file = std::fs::OpenOptions::new().append(true).open(&path).unwrap();
        let line = "{\"stage\":\"adjacent\",\"step\":41,\"kind\":\"train\",\"loss\":0.5}\n";
        file.write_all(&line.as_bytes()[..20]).unwrap();
        curves.follow().unwrap();
        assert_eq!(curves.stages[0].step, 40);
        file.write_all(&line.as_bytes()[20..]).unwrap();
        curves.follow().unwrap();
        assert_eq!((curves.stages[0].step, curves.stages[0].train[0].last()), (41, 0.5));
    }
}
