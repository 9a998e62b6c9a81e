//! What the acceptance tests share: the real programs, rendered clips with known motion, and small nets on disk.
//!
//! The tests in `tests/` drive the programs as a person does, through their command lines and files.

pub mod clip;
pub mod nets;
pub mod programs;
