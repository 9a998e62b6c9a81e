//! Training: configuration, run folder, the stages and the loop they share.
//!
//! A run is a row of stages (chairs → adjacent → distant → svbrdf → report), which [`pipeline`] walks through. [`run_loop`]
//! trains any [`stage::Stage`]; the stages say what a batch is, what the losses are and what to show.

pub mod atomic;
pub mod checkpoint;
pub mod cli;
pub mod config;
pub mod curves;
pub mod device;
pub mod export;
pub mod fingerprint;
pub mod finished;
pub mod guard;
pub mod import;
pub mod interrupt;
pub mod optimiser;
pub mod page;
pub mod pipeline;
pub mod progress;
pub mod recorder;
pub mod report;
pub mod revision;
pub mod run_folder;
pub mod run_loop;
pub mod stage;
pub mod sweep;
pub mod taken;
pub mod watch;
