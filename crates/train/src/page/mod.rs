//! `report.html`: a run on one page that needs no network: figures, curves, pictures, costs, config.

mod figures;
mod pictures;

use crate::config::Config;
use crate::curves::{Curve, Curves, StageCurves};
use crate::finished::{Finished, FinishedStage};
use crate::progress::spoken;
use evaluate::plot::{curve, short};
use scan::html::{self, escape};
use serde_json::{Map, Value};
use std::io;
use std::path::Path;
use std::time::Duration;

/// The page of a run folder that holds everything but the page itself; `report` is what `report.json` says.
///
/// # Errors
/// Files of the run that can't be read; a file that isn't there leaves its part of the page out.
pub fn html(run: &Path, config: &Config, finished: &Finished, report: &Map<String, Value>) -> io::Result<String> {
    let curves = match Curves::read(&run.join("metrics.jsonl")) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Curves::new(run),
        curves => curves?,
    };
    let name = &config.run.name;
    let mut body = header(name, &describe(run)?, config, report);
    body += "<h2 id=\"figures\">What it reached</h2>\n";
    body += "<p class=\"soft\">On materials that no net has seen. Ratios below 1 are better than the baseline that they are named after; alignment errors are in pixels at a width of 1024. Goals are those of the main job (<code>spiral.toml</code> on two CPU cores); a smaller run needn't reach them.</p>\n";
    body += &figures::table(report);
    body += "<h2 id=\"curves\">Curves</h2>\n<p class=\"soft\">Line: mean of neighbouring steps; shade: from the least to the largest of them. The number is the last mean.</p>\n";
    for stage in &curves.stages {
        body += &stage_curves(stage, finished.stages.iter().find(|done| done.stage == stage.name));
    }
    body += "<h2 id=\"pictures\">Pictures</h2>\n";
    body += &pictures::previews(&run.join("previews"))?;
    body += &pictures::sheets(&run.join("report"))?;
    body += "<h2 id=\"costs\">Time, memory, data</h2>\n";
    body += &costs(finished, report);
    body += "<h2 id=\"config\">Config</h2>\n<p class=\"soft\">Every key as this run resolved it: <code>train --config config.toml</code> with this text repeats the run.</p>\n";
    body += &format!("<details><summary>config.toml</summary><pre>{}</pre></details>\n", escape(&config.to_toml()));
    Ok(html::page(&format!("{name} – training report"), &body))
}

/// What `run.json` says; empty where it isn't there.
fn describe(run: &Path) -> io::Result<Map<String, Value>> {
    match std::fs::read(run.join("run.json")) {
        Ok(bytes) => Ok(serde_json::from_slice(&bytes)?),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(Map::new()),
        Err(error) => Err(error),
    }
}

fn header(name: &str, run: &Map<String, Value>, config: &Config, report: &Map<String, Value>) -> String {
    let text = |key: &str| match run.get(key) {
        Some(Value::String(text)) => text.clone(),
        None | Some(Value::Null) => "unknown".into(),
        Some(value) => value.to_string(),
    };
    let number = |key: &str| report.get(key).and_then(Value::as_f64);
    let mut facts = vec![
        ("Device", text("device")),
        ("Machine", format!("{} cores, {}", text("cores"), text("system"))),
        ("Revision", text("revision")),
        ("Version", format!("{} on burn {}", text("version"), text("burn"))),
        ("Seed", config.run.seed.to_string()),
    ];
    facts.extend(run.get("started_unix").and_then(Value::as_u64).map(|unix| ("Started", utc(unix))));
    let time = number("minutes").and_then(|minutes| Duration::try_from_secs_f64(60.0 * minutes).ok());
    facts.extend(time.map(|time| ("Took", spoken(time))));
    facts.extend(number("peak_rss_mib").map(|memory| ("Most memory", format!("{memory:.0} MiB"))));
    facts.extend(number("skipped_batches").filter(|n| *n > 0.0).map(|n| ("Batches skipped (not finite)", format!("{n:.0}"))));
    let facts: String =
        facts.iter().map(|(name, value)| format!("<div><dt>{name}</dt><dd>{}</dd></div>\n", escape(value))).collect();
    format!(
        "<h1>{}</h1>\n<p class=\"soft\">Training report of Deep Reflectance Scanning in Rust</p>\n<nav><a href=\"#figures\">Figures</a><a href=\"#curves\">Curves</a><a href=\"#pictures\">Pictures</a><a href=\"#costs\">Costs</a><a href=\"#config\">Config</a></nav>\n<dl class=\"facts\">\n{facts}</dl>\n",
        escape(name)
    )
}

/// Measurements first: they are what a person looks for.
fn stage_curves(stage: &StageCurves, done: Option<&FinishedStage>) -> String {
    let planned = done.map_or(String::new(), |done| format!(" of {}", done.steps));
    let name = escape(&stage.name);
    let mut text = format!("<h3>{name} – held-out materials, {}{planned} steps</h3>\n", stage.step);
    text += &panels(&stage.held_out);
    text += &format!("<h3>{name} – training</h3>\n");
    text + &panels(&stage.train)
}

/// A panel per curve; what was measured once needs no axes.
fn panels(curves: &[Curve]) -> String {
    let (courses, single): (Vec<&Curve>, Vec<&Curve>) = curves.iter().partition(|curve| curve.points().len() > 1);
    let panels: String = courses.iter().map(|course| curve(&course.name, &course.points())).collect();
    let values: String = single
        .iter()
        .map(|curve| format!("<div><dt>{}</dt><dd>{}</dd></div>\n", escape(&curve.name), short(curve.last())))
        .collect();
    let mut text = String::new();
    if !panels.is_empty() {
        text += &format!("<div class=\"panels\">\n{panels}</div>\n");
    }
    if !values.is_empty() {
        text += &format!("<dl class=\"facts\">\n{values}</dl>\n");
    }
    text
}

fn costs(finished: &Finished, report: &Map<String, Value>) -> String {
    let mut before = 0.0;
    let mut rows = String::new();
    for done in &finished.stages {
        let seconds = (done.seconds - before).max(0.0);
        before = done.seconds;
        rows += &format!(
            "<tr><td>{}</td><td class=\"number\">{}</td><td class=\"number\">{}</td><td class=\"number\">{:.3}</td><td class=\"number\">{:.1} %</td><td class=\"number\">{}</td></tr>\n",
            escape(&done.stage),
            done.steps,
            spoken(Duration::from_secs_f64(seconds)),
            done.steps as f64 / seconds.max(1e-9),
            100.0 * done.data_wait_share,
            done.skipped.len()
        );
    }
    let whole = report.get("minutes").and_then(Value::as_f64).map_or(0.0, |minutes| 60.0 * minutes);
    if whole > before {
        let time = spoken(Duration::from_secs_f64(whole - before));
        rows += &format!("<tr><td>evaluation</td><td></td><td class=\"number\">{time}</td><td></td><td></td><td></td></tr>\n");
    }
    let names = ["steps", "time", "steps per second", "waited for data", "batches skipped"];
    let heads: String = names.iter().map(|name| format!("<th class=\"number\">{name}</th>")).collect();
    format!("<div class=\"scroll\"><table>\n<tr><th>stage</th>{heads}</tr>\n{rows}</table></div>\n")
}

/// A moment as `2026-11-24 03:15 UTC`.
fn utc(unix: u64) -> String {
    let (mut days, minutes) = (unix / 86_400, unix / 60 % 1440);
    let leap = |year: u64| year.is_multiple_of(4) && (!year.is_multiple_of(100) || year.is_multiple_of(400));
    let mut year = 1970;
    while days >= 365 + u64::from(leap(year)) {
        days -= 365 + u64::from(leap(year));
        year += 1;
    }
    let lengths = [31, 28 + u64::from(leap(year)), 31, 30, 31, 30, 31, 31, 30, 31, 30, 31];
    let mut month = 0;
    while days >= lengths[month] {
        days -= lengths[month];
        month += 1;
    }
    format!("{year}-{:02}-{:02} {:02}:{:02} UTC", month + 1, days + 1, minutes / 60, minutes % 60)
}

#[cfg(test)]
mod tests;
