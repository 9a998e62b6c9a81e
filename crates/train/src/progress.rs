//! What a person sees while a stage trains: a bar on a terminal, plain lines elsewhere.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::IsTerminal;
use std::time::{Duration, Instant};

/// Between two plain lines.
const LINE_INTERVAL: Duration = Duration::from_secs(10);

/// The numbers of one step that a person wants to see.
pub struct Status<'a> {
    /// Steps done.
    pub step: u64,
    /// Losses of this step.
    pub losses: &'a [(String, f64)],
    /// The latest measurement on held-out materials (end-point error, map error …).
    pub measured: Option<(&'a str, f64)>,
    /// Exemplars per second.
    pub samples_per_second: f64,
    /// Share of the time spent waiting for data.
    pub waiting: f64,
}

/// The progress display of one stage.
pub struct Progress {
    stage: String,
    steps: u64,
    first: u64,
    bar: Option<ProgressBar>,
    began: Instant,
    last_line: Option<Instant>,
}

impl Progress {
    /// A display for a stage that starts (or goes on) at step `first`.
    pub fn new(stage: &str, first: u64, steps: u64) -> Self {
        let bar = std::io::stderr().is_terminal().then(|| {
            let bar = ProgressBar::with_draw_target(Some(steps), ProgressDrawTarget::stderr_with_hz(5)).with_position(first);
            let style = ProgressStyle::with_template("{prefix:>9} [{bar:24}] {pos}/{len} {msg} eta {eta}");
            bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()).progress_chars("=> "));
            bar.set_prefix(stage.to_string());
            bar
        });
        Self { stage: stage.into(), steps, first, bar, began: Instant::now(), last_line: None }
    }

    /// Shows a step.
    pub fn show(&mut self, status: &Status<'_>) {
        if let Some(bar) = &self.bar {
            self.last_line = Some(Instant::now());
            bar.set_position(status.step);
            bar.set_message(describe(status));
            return;
        }
        let due = self.last_line.is_none_or(|last| last.elapsed() >= LINE_INTERVAL) || status.step == self.steps;
        if due {
            self.last_line = Some(Instant::now());
            let done = status.step.saturating_sub(self.first).max(1) as f64;
            let eta = self.began.elapsed().as_secs_f64() / done * self.steps.saturating_sub(status.step) as f64;
            eprintln!("{} {}/{} {} eta {eta:.0} s", self.stage, status.step, self.steps, describe(status));
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

fn describe(status: &Status<'_>) -> String {
    let mut parts: Vec<String> = status.losses.iter().map(|(name, value)| format!("{name} {value:.4}")).collect();
    if let Some((name, value)) = status.measured {
        parts.push(format!("{name} {value:.3}"));
    }
    parts.push(format!("{:.2}/s", status.samples_per_second));
    parts.push(format!("data {:.0} %", 100.0 * status.waiting));
    if let Some(memory) = ops::process::rss_mib() {
        parts.push(format!("{memory:.0} MiB"));
    }
    parts.join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_tells_losses_error_speed_and_waiting() {
        let losses = [("loss".to_string(), 0.5), ("matching".to_string(), 0.25)];
        let status = Status { step: 3, losses: &losses, measured: Some(("epe", 1.5)), samples_per_second: 2.0, waiting: 0.1 };
        let line = describe(&status);
        for part in ["loss 0.5000", "matching 0.2500", "epe 1.500", "2.00/s", "data 10 %"] {
            assert!(line.contains(part), "{line}");
        }
    }
}
