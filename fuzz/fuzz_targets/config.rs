//! Configs of `train`: the file up to the first zero byte, then one `--set` per line.
#![no_main]

use std::fs;
use std::path::PathBuf;
use std::sync::LazyLock;

use fuzz::{show, split_at_zero};
use libfuzzer_sys::fuzz_target;
use tempfile::TempDir;
use train::config::Config;

/// Written over by every input.
static FOLDER: LazyLock<TempDir> = LazyLock::new(|| tempfile::tempdir().expect("a folder for temporary files"));
static FILE: LazyLock<PathBuf> = LazyLock::new(|| FOLDER.path().join("fuzzed.toml"));

fuzz_target!(|input: &[u8]| {
    let (text, assignments) = split_at_zero(input);
    let assignments: Vec<String> = String::from_utf8_lossy(assignments).lines().map(str::to_owned).collect();
    fs::write(&*FILE, text).expect("the folder takes small files");
    match Config::from_file(&FILE, &assignments) {
        // A run writes its config out in full and reads it back when it goes on.
        Ok(config) => {
            fs::write(&*FILE, config.to_toml()).expect("the folder takes small files");
            let again = Config::from_file(&FILE, &[]).unwrap_or_else(|error| panic!("{error}"));
            assert_eq!(again.to_toml(), config.to_toml());
        }
        Err(error) => show(&error),
    }
});
