//! Another process that does a piece of work when it is told to: what benchmarks time beside themselves.
//!
//! Its first line in is the work as JSON. Every further line asks for something; the answer is a line of numbers.

use std::error::Error;
use std::io::{BufRead, BufReader, Write};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::time::Duration;

/// How long threads may take to come to rest.
const REST: Duration = Duration::from_millis(300);

/// A running process. It ends with this value.
pub struct Worker {
    child: Child,
    ask: ChildStdin,
    answers: BufReader<ChildStdout>,
}

impl Worker {
    /// Starts a program and gives it its work.
    pub fn start(command: &mut Command, work: &impl serde::Serialize) -> Result<Self, Box<dyn Error>> {
        let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn()?;
        let mut ask = child.stdin.take().ok_or("no pipe to the worker")?;
        let answers = BufReader::new(child.stdout.take().ok_or("no pipe from the worker")?);
        writeln!(ask, "{}", serde_json::to_string(work)?)?;
        Ok(Self { child, ask, answers })
    }

    /// Asks a question; the answer has `N` numbers. Returns when the worker's threads have come to rest: OpenMP's wait for more
    /// work at full speed before they sleep.
    pub fn ask<const N: usize>(&mut self, question: &str) -> Result<[f64; N], Box<dyn Error>> {
        writeln!(self.ask, "{question}")?;
        let mut line = String::new();
        self.answers.read_line(&mut line)?;
        std::thread::sleep(REST);
        let numbers: Vec<f64> = line.split_whitespace().map(str::parse).collect::<Result<_, _>>()?;
        <[f64; N]>::try_from(numbers)
            .map_err(|_| format!("the worker answered {line:?}; a Python has to have PyTorch and NumPy").into())
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        // A process that is gone already is no loss.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The middle one of some values.
pub fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}
