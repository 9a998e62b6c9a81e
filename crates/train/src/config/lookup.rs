//! Where a config name leads: as given, then in `configs/` here and in the workspace.

use super::{ConfigError, diagnosis::nearest};
use std::path::{Path, PathBuf};

/// The folders in which a bare config name is looked up, in order.
pub fn config_folders() -> Vec<PathBuf> {
    let workspace = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs");
    let mut folders = vec![PathBuf::from("configs")];
    // The binary may have left the machine that built it, and then the workspace is not there.
    if let Ok(workspace) = workspace.canonicalize()
        && Path::new("configs").canonicalize().ok().as_ref() != Some(&workspace)
    {
        folders.push(workspace);
    }
    folders
}

/// Finds a config file by path or by name, with or without `.toml`.
///
/// # Errors
/// [`ConfigError::NotFound`] with every place that was tried and the nearest existing name.
pub fn find(name: &str) -> Result<PathBuf, ConfigError> {
    let mut looked = vec![PathBuf::from(name)];
    looked.extend(config_folders().into_iter().map(|folder| folder.join(name)));
    if Path::new(name).extension().is_none() {
        looked = looked.into_iter().flat_map(|path| [path.with_extension("toml"), path]).collect();
    }
    if let Some(found) = looked.iter().find(|path| path.is_file()) {
        return Ok(found.clone());
    }
    let names: Vec<String> = config_folders().iter().flat_map(|folder| toml_files(folder)).collect();
    Err(ConfigError::NotFound { name: name.into(), looked, nearest: nearest(name, names.iter().map(String::as_str)) })
}

fn toml_files(folder: &Path) -> Vec<String> {
    let Ok(entries) = std::fs::read_dir(folder) else {
        return Vec::new();
    };
    let mut names: Vec<String> = entries
        .flatten()
        .map(|entry| entry.file_name().to_string_lossy().into_owned())
        .filter(|name| name.ends_with(".toml"))
        .collect();
    names.sort();
    names
}
