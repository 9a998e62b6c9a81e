//! What a person sees while a stage trains: a bar on a terminal, plain lines elsewhere.

use crate::recorder::Status;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::IsTerminal;
use std::time::{Duration, Instant};

/// Between two plain lines.
const LINE_INTERVAL: Duration = Duration::from_secs(10);
/// Weight of the latest step in the mean duration that the remaining time is told from.
const LATEST: f64 = 0.02;
/// Columns where a terminal doesn't say how wide it is.
const USUAL_WIDTH: usize = 80;

/// The progress display of one stage.
pub struct Progress {
    steps: u64,
    bar: Option<ProgressBar>,
    last_line: Option<Instant>,
    pace: Pace,
}

impl Progress {
    /// A display for a stage that starts (or goes on) at step `first`.
    pub fn new(stage: &str, first: u64, steps: u64) -> Self {
        let bar = std::io::stderr().is_terminal().then(|| {
            let bar = ProgressBar::with_draw_target(Some(steps), ProgressDrawTarget::stderr_with_hz(5)).with_position(first);
            let style = ProgressStyle::with_template("{prefix:>9} [{bar:24}] {pos}/{len} {msg}");
            bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()).progress_chars("=> "));
            bar.set_prefix(stage.to_string());
            bar
        });
        Self { steps, bar, last_line: None, pace: Pace { last: Instant::now(), per_step: None, steps: 0 } }
    }

    /// Time that the steps after this one will take; asked once per step.
    pub fn remaining(&mut self, step: u64) -> Option<Duration> {
        let per_step = self.pace.stepped(Instant::now());
        Duration::try_from_secs_f64(per_step * self.steps.saturating_sub(step) as f64).ok()
    }

    /// Shows a step.
    pub fn show(&mut self, status: &Status<'_>) {
        if let Some(bar) = &self.bar {
            self.last_line = Some(Instant::now());
            let width = console::Term::stderr().size_checked().map_or(USUAL_WIDTH, |(_, columns)| usize::from(columns));
            bar.set_position(status.step);
            bar.set_message(below_bar(status, width));
            return;
        }
        let due = self.last_line.is_none_or(|last| last.elapsed() >= LINE_INTERVAL) || status.step == self.steps;
        if due {
            self.last_line = Some(Instant::now());
            eprintln!("{}", line(status));
        }
    }

    /// Prints a line without tearing the bar.
    pub fn say(&self, text: &str) {
        match &self.bar {
            Some(bar) => bar.println(text),
            None => eprintln!("{text}"),
        }
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        if let (Some(bar), Some(_)) = (&self.bar, self.last_line) {
            bar.abandon();
        }
    }
}

/// How long a step takes, measurements and previews in between included.
struct Pace {
    last: Instant,
    per_step: Option<f64>,
    steps: u32,
}

impl Pace {
    /// Notes the end of a step and returns the mean duration in seconds: of all steps at first, of the latest later.
    fn stepped(&mut self, now: Instant) -> f64 {
        let seconds = now.saturating_duration_since(self.last).as_secs_f64();
        self.last = now;
        self.steps = self.steps.saturating_add(1);
        let weight = (1.0 / f64::from(self.steps)).max(LATEST);
        let mean = self.per_step.map_or(seconds, |mean| mean + weight * (seconds - mean));
        *self.per_step.insert(mean)
    }
}

/// A status on one line.
fn line(status: &Status<'_>) -> String {
    let mut parts = losses(status);
    parts.extend(error(status));
    parts.extend(facts(status));
    format!("{} {}/{} {}", status.stage, status.step, status.steps, parts.join(", "))
}

/// What stands beside and below the bar: speed and the like on its line, then error and losses, wrapped at the terminal's width.
fn below_bar(status: &Status<'_>, width: usize) -> String {
    let mut text = facts(status).join(" · ");
    let mut column = width;
    for part in error(status).into_iter().chain(losses(status)) {
        let gap = if column + part.chars().count() + 3 > width { "\n          " } else { " · " };
        column = if gap.starts_with('\n') { gap.len() - 1 } else { column + gap.chars().count() };
        column += part.chars().count();
        text += gap;
        text += &part;
    }
    text
}

fn losses(status: &Status<'_>) -> Vec<String> {
    status.losses.iter().map(|(name, value)| format!("{name} {value:.4}")).collect()
}

fn error(status: &Status<'_>) -> Option<String> {
    status.measured.first().map(|(name, value)| format!("{name} {value:.3}"))
}

fn facts(status: &Status<'_>) -> Vec<String> {
    let mut parts = vec![format!("{:.2}/s", status.samples_per_second), format!("data {:.0} %", 100.0 * status.waiting)];
    parts.extend(status.memory_mib.map(|memory| format!("{memory:.0} MiB")));
    parts.extend(status.remaining.map(|remaining| format!("eta {}", spoken(remaining))));
    parts
}

/// A duration as people say it.
pub fn spoken(duration: Duration) -> String {
    let seconds = duration.as_secs_f64().round() as u64;
    match (seconds / 86_400, seconds / 3600 % 24, seconds / 60 % 60, seconds % 60) {
        (0, 0, 0, s) => format!("{s} s"),
        (0, 0, m, s) if m < 10 => format!("{m} min {s} s"),
        (0, 0, m, _) => format!("{m} min"),
        (0, h, m, _) => format!("{h} h {m} min"),
        (d, h, _, _) => format!("{d} d {h} h"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn named(list: &[(&str, f64)]) -> Vec<(String, f64)> {
        list.iter().map(|(name, value)| (name.to_string(), *value)).collect()
    }

    fn status<'a>(losses: &'a [(String, f64)], measured: &'a [(String, f64)]) -> Status<'a> {
        Status {
            stage: "adjacent",
            step: 3,
            steps: 600,
            losses,
            measured,
            samples_per_second: 2.0,
            waiting: 0.1,
            memory_mib: Some(812.4),
            remaining: Some(Duration::from_secs(4000)),
        }
    }

    #[test]
    fn a_line_tells_everything() {
        let (losses, measured) = (named(&[("loss", 0.5), ("matching", 0.25)]), named(&[("epe_ratio", 1.5), ("epe_px", 9.0)]));
        let expected =
            "adjacent 3/600 loss 0.5000, matching 0.2500, epe_ratio 1.500, 2.00/s, data 10 %, 812 MiB, eta 1 h 6 min";
        assert_eq!(line(&status(&losses, &measured)), expected);
    }

    #[test]
    fn the_bar_tells_everything_within_the_terminal() {
        let names: Vec<String> = (0..9).map(|i| format!("term{i}")).collect();
        let losses: Vec<_> = names.iter().map(|name| (name.clone(), 0.125)).collect();
        let measured = named(&[("maps_l1_ratio", 0.7)]);
        let text = below_bar(&status(&losses, &measured), 60);
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines[0], "2.00/s · data 10 % · 812 MiB · eta 1 h 6 min");
        assert!(lines[1].starts_with("          maps_l1_ratio 0.700 · term0 0.1250 · "), "{text}");
        assert!(lines.len() > 3 && lines.iter().all(|line| line.chars().count() <= 60), "{text}");
        assert!(names.iter().all(|name| text.contains(name)), "{text}");
    }

    #[test]
    fn the_remaining_time_follows_the_pace() {
        let start = Instant::now();
        let mut pace = Pace { last: start, per_step: None, steps: 0 };
        let at = |seconds: f64| start + Duration::from_secs_f64(seconds);
        assert!((pace.stepped(at(2.0)) - 2.0).abs() < 1e-9);
        assert!((pace.stepped(at(3.0)) - 1.5).abs() < 1e-9);
        // Long after, only the latest steps count.
        let mean = (1..=500).map(|i| pace.stepped(at(3.0 + 0.1 * f64::from(i)))).last().unwrap();
        assert!((mean - 0.1).abs() < 0.01, "{mean}");
    }

    #[test]
    fn durations_are_spoken() {
        let said = [8.4, 95.0, 754.0, 3700.0, 200_000.0].map(|seconds| spoken(Duration::from_secs_f64(seconds)));
        assert_eq!(said, ["8 s", "1 min 35 s", "12 min", "1 h 1 min", "2 d 7 h"]);
    }
}
