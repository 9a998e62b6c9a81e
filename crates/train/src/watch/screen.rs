//! What `train watch` shows, as text.

use super::chart::{Chart, chart};
use crate::curves::{Curve, StageCurves};
use crate::progress::spoken;
use crate::recorder::StoredStatus;
use console::{pad_str, style, truncate_str};
use std::fmt::Write;
use std::time::Duration;

/// Rows of a curve, at least and at most.
const ROWS: [usize; 2] = [2, 5];
/// Columns of a curve, with its gap.
const LEAST_WIDTH: usize = 44;
const GAP: usize = 3;
/// A run that hasn't said anything for so long may have been killed.
const SILENT: Duration = Duration::from_secs(120);

/// A run at this moment.
pub struct Run<'a> {
    /// Its name.
    pub name: &'a str,
    /// Whether its report is written.
    pub done: bool,
    /// The last that it said.
    pub status: Option<StoredStatus>,
    /// The stage to show; `None` before the first step.
    pub stage: Option<&'a StageCurves>,
}

/// Two lines about the run, then every curve of the stage, as many beside each other as fit.
pub fn screen<'a>(run: &Run<'a>, (columns, rows): (usize, usize)) -> String {
    let mut text = format!("{}  {}\n", style(run.name).bold(), state(run));
    if let Some(status) = &run.status {
        text += &format!("{}\n", truncate_str(&facts(status), columns, "…"));
    }
    let Some(stage) = run.stage else { return text + "no step yet\n" };
    text += &format!("{} step {}\n\n", style(&stage.name).bold(), stage.step);
    let (losses, others) = stage.train.split_at(stage.train.len().min(1));
    let held_out = stage.held_out.iter().map(|curve| (curve, true));
    let train = |curves: &'a [Curve]| curves.iter().map(|curve| (curve, false));
    let all = train(losses).chain(held_out).chain(train(others));
    // A line takes two points; single values stand together.
    let (curves, single): (Vec<(&Curve, bool)>, Vec<_>) = all.partition(|(curve, _)| curve.points().len() > 1);
    text += &values(&single, columns);
    let beside = (columns / LEAST_WIDTH).max(1);
    let width = (columns / beside).saturating_sub(GAP).max(8);
    let lines = curves.len().div_ceil(beside);
    let fits = (rows.saturating_sub(text.lines().count() + 1) / lines.max(1)).saturating_sub(1);
    let height = fits.clamp(ROWS[0], ROWS[1]);
    for line in curves.chunks(beside) {
        let panels: Vec<Vec<String>> = line.iter().map(|(curve, held_out)| panel(curve, *held_out, width, height)).collect();
        for row in 0..=height {
            let parts: Vec<String> = panels
                .iter()
                .map(|panel| pad_str(&panel[row], width + GAP, console::Alignment::Left, None).into_owned())
                .collect();
            text += &format!("{}\n", parts.concat().trim_end());
        }
    }
    text
}

/// Curves of one point each as names and values, wrapped.
fn values(curves: &[(&Curve, bool)], columns: usize) -> String {
    let (mut text, mut column) = (String::new(), 0);
    for (curve, held_out) in curves {
        let part = format!("{} {}", name(curve, *held_out), number(curve.last()));
        let width = part.chars().count();
        if column > 0 && column + GAP + width > columns {
            text += "\n";
            column = 0;
        }
        text += if column > 0 { " · " } else { "" };
        column += width + if column > 0 { GAP } else { 0 };
        text += &part;
    }
    if curves.is_empty() { text } else { text + "\n\n" }
}

fn name(curve: &Curve, held_out: bool) -> String {
    if held_out { format!("{} (held-out)", curve.name) } else { curve.name.clone() }
}

fn state(run: &Run<'_>) -> String {
    let silent = run.status.as_ref().map(StoredStatus::age).filter(|age| *age >= SILENT);
    match silent {
        _ if run.done => style("finished").green().to_string(),
        Some(age) => style(format!("silent for {}: evaluating, stopped or killed", spoken(age))).yellow().to_string(),
        None => style("training").green().to_string(),
    }
}

fn facts(status: &StoredStatus) -> String {
    let share = 100.0 * status.step as f64 / status.steps.max(1) as f64;
    let mut text = format!("{} {}/{} ({share:.0} %)", status.stage, status.step, status.steps);
    let _ = write!(text, " · {:.2} exemplars/s · data {:.0} %", status.samples_per_second, 100.0 * status.data_wait_share);
    if let Some(memory) = status.rss_mib {
        let _ = write!(text, " · {memory:.0} MiB");
    }
    if let Some(left) = status.remaining_seconds.and_then(|seconds| Duration::try_from_secs_f64(seconds).ok()) {
        let _ = write!(text, " · eta of the stage {}", spoken(left));
    }
    text
}

/// A line with name and values, then the curve.
fn panel(curve: &Curve, held_out: bool, width: usize, height: usize) -> Vec<String> {
    let name = name(curve, held_out);
    let values = format!("{} ← {}", number(curve.last()), number(curve.first()));
    let Some(Chart { rows, range: [low, high], logarithmic }) = chart(&curve.points(), width - 2, height) else {
        return vec![name; height + 1];
    };
    let scale = if logarithmic { " log" } else { "" };
    let range = format!("[{}, {}]{scale}", number(low), number(high));
    let head = truncate_str(&format!("{} {} {}", style(name).bold(), style(values).cyan(), style(range).dim()), width, "…")
        .into_owned();
    std::iter::once(head).chain(rows.into_iter().map(|row| format!("│{}", style(row).cyan()))).collect()
}

/// Three digits, whatever the size.
fn number(value: f64) -> String {
    match value.abs() {
        0.0 => "0".into(),
        size if (1e-3..1e5).contains(&size) => format!("{value:.*}", (2 - size.log10().floor() as i32).clamp(0, 6) as usize),
        _ => format!("{value:.1e}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::curves::Curves;

    fn curves(home: &std::path::Path) -> Curves {
        let path = home.join("metrics.jsonl");
        let mut text = String::new();
        for step in 1..=40 {
            let loss = 1.0 / f64::from(step);
            let _ = writeln!(
                text,
                "{{\"stage\":\"svbrdf\",\"kind\":\"train\",\"step\":{step},\"loss\":{loss},\"top\":0.5,\"bad\":null}}"
            );
        }
        text += "{\"stage\":\"svbrdf\",\"kind\":\"validate\",\"step\":40,\"maps_l1_ratio\":0.71}\n";
        std::fs::write(&path, text).unwrap();
        Curves::read(&path).unwrap()
    }

    fn status() -> StoredStatus {
        let json = serde_json::json!({ "stage": "svbrdf", "step": 40, "steps": 600, "samples_per_second": 0.62,
            "data_wait_share": 0.03, "rss_mib": 812.0, "remaining_seconds": 900.0, "written_unix": 0 });
        serde_json::from_value(json).unwrap()
    }

    #[test]
    fn the_screen_tells_everything_within_its_width() {
        let home = tempfile::tempdir().unwrap();
        let curves = curves(home.path());
        for columns in [40, 80, 200] {
            let run = Run { name: "spiral", done: false, status: Some(status()), stage: curves.stages.last() };
            let text = console::strip_ansi_codes(&screen(&run, (columns, 40))).into_owned();
            assert!(text.lines().skip(1).all(|line| line.chars().count() <= columns), "{text}");
            let parts = ["silent for", "svbrdf step 40", "loss 0.025", "top 0.500", "maps_l1_ratio (held-out)"];
            assert!(parts.iter().all(|part| text.contains(part)), "{text}");
            if columns > 100 {
                let facts = "svbrdf 40/600 (7 %) · 0.62 exemplars/s · data 3 % · 812 MiB · eta of the stage 15 min";
                assert!(text.contains(facts), "{text}");
            }
        }
    }

    #[test]
    fn a_run_without_steps_is_no_fault() {
        let run = Run { name: "new", done: false, status: None, stage: None };
        assert!(screen(&run, (80, 24)).contains("no step yet"));
    }
}
