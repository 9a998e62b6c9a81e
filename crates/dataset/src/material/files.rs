//! Materials that are one file each: which files a folder or a list names, and what is known of them before they are read.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::path::{Path, PathBuf};

use super::error::MaterialError;
use super::manifest::{Manifest, ManifestRow};
use super::split::identity_of_file;

/// Extension of a list of files.
const LIST: &str = "txt";

/// A file that holds a material, not yet read.
#[derive(Clone, Debug)]
pub struct MaterialFile {
    /// The file.
    pub path: PathBuf,
    /// Its name without the extension.
    pub name: String,
    /// What a manifest in its folder says of it.
    pub manifest: ManifestRow,
}

impl MaterialFile {
    /// What the split goes by.
    pub fn identity(&self) -> String {
        identity_of_file(&self.name)
    }
}

/// The materials of a folder (files with the extension that lie in it, by name), of a list, or of a single file.
///
/// A list is a `.txt` file with a path on each line, relative to the list; empty lines and those that begin with `#` are
/// passed over. So are files that the manifest of their folder marks as not used.
///
/// # Errors
/// [`MaterialError::NoFiles`] when there is none, [`MaterialError::Folder`] or [`MaterialError::Read`] when the system refuses,
/// [`MaterialError::Line`] for a line of a list or manifest that can't be understood.
pub fn find_files(path: &Path, extension: &'static str) -> Result<Vec<MaterialFile>, MaterialError> {
    let paths = if path.is_dir() {
        in_folder(path, extension)?
    } else if has_extension(path, LIST) {
        in_list(path)?
    } else {
        vec![path.into()]
    };
    let mut manifests: HashMap<PathBuf, Manifest> = HashMap::new();
    let mut files = Vec::new();
    for path in paths {
        let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let manifest = match manifests.entry(path.parent().unwrap_or(Path::new("")).into()) {
            Entry::Occupied(known) => known.get().row(&name),
            Entry::Vacant(new) => {
                let manifest = Manifest::beside(new.key())?;
                new.insert(manifest).row(&name)
            }
        };
        if manifest.used {
            files.push(MaterialFile { path, name, manifest });
        }
    }
    if files.is_empty() {
        return Err(MaterialError::NoFiles { path: path.into(), extension });
    }
    Ok(files)
}

fn in_folder(folder: &Path, extension: &str) -> Result<Vec<PathBuf>, MaterialError> {
    let fail = |source| MaterialError::Folder { path: folder.into(), source };
    let mut paths = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(fail)? {
        let path = entry.map_err(fail)?.path();
        if path.is_file() && has_extension(&path, extension) && !is_hidden(&path) {
            paths.push(path);
        }
    }
    paths.sort();
    Ok(paths)
}

fn in_list(list: &Path) -> Result<Vec<PathBuf>, MaterialError> {
    let bytes = std::fs::read(list).map_err(|source| MaterialError::Read { path: list.into(), source })?;
    let text = String::from_utf8_lossy(&bytes);
    let folder = list.parent().unwrap_or(Path::new(""));
    let lines = text.trim_start_matches('\u{feff}').lines().map(str::trim).enumerate();
    let named = lines.filter(|(_, line)| !line.is_empty() && !line.starts_with('#'));
    named
        .map(|(number, line)| {
            let path = folder.join(line);
            if path.is_file() {
                return Ok(path);
            }
            let reason = format!("no file {}; expected a path relative to the list", path.display());
            Err(MaterialError::Line { path: list.into(), line: number + 1, reason })
        })
        .collect()
}

fn has_extension(path: &Path, extension: &str) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case(extension))
}

/// Names that begin with a dot; archives made on a Mac hold a small `._NAME` beside every NAME.
pub(super) fn is_hidden(path: &Path) -> bool {
    path.file_name().is_some_and(|n| n.to_string_lossy().starts_with('.'))
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    fn names(path: &Path) -> Vec<String> {
        find_files(path, "npy").unwrap().into_iter().map(|file| file.name).collect()
    }

    #[test]
    fn folders_and_lists_name_files_and_manifests_their_licences() {
        let root = tempfile::tempdir().unwrap();
        let at = |name: &str| root.path().join(name);
        fs::create_dir_all(at("maps/folder.npy")).unwrap();
        for name in ["b.npy", "a.NPY", "c.npy", "._a.npy", "notes.txt", "photo.png"] {
            fs::write(at("maps").join(name), "").unwrap();
        }
        assert_eq!(names(&at("maps")), ["a", "b", "c"]);
        fs::write(at("maps/MANIFEST.tsv"), "name\tlicence\tused\nb\tCC0-1.0\t\nc\t\tno\n").unwrap();
        let files = find_files(&at("maps"), "npy").unwrap();
        let licences: Vec<_> = files.iter().map(|f| (f.name.as_str(), f.manifest.licence_or_unknown())).collect();
        assert_eq!(licences, [("a", "not stated".into()), ("b", "CC0-1.0".into())]);

        fs::write(at("train.txt"), "\u{feff}# mine\r\nmaps/b.npy\r\n\r\n  maps/a.NPY  \r\n").unwrap();
        assert_eq!(names(&at("train.txt")), ["b", "a"]);
        assert_eq!(find_files(&at("train.txt"), "npy").unwrap()[0].manifest.licence.as_deref(), Some("CC0-1.0"));
        assert_eq!(names(&at("maps/b.npy")), ["b"]);
    }

    #[test]
    fn sources_without_files_are_named() {
        let root = tempfile::tempdir().unwrap();
        let says = |path: &Path, parts: &[&str]| {
            let error = find_files(path, "png").unwrap_err().to_string();
            for part in parts.iter().chain([&path.to_str().unwrap()]) {
                assert!(error.contains(part), "{error}");
            }
        };
        says(root.path(), &["no material in it", "expected .png files"]);
        let list = root.path().join("list.txt");
        says(&list, &["can't be read", "check that it exists"]);
        fs::write(&list, "# nothing\n").unwrap();
        says(&list, &["no material in it"]);
        fs::write(&list, "# one\ngone.png\n").unwrap();
        says(&list, &["line 2", "gone.png", "relative to the list"]);
        fs::write(&list, [0xff, 0xfe, 0x00, b'\n']).unwrap();
        says(&list, &["line 1"]);
        fs::create_dir(root.path().join("manifest.tsv")).unwrap();
        fs::write(root.path().join("a.png"), "").unwrap();
        assert!(matches!(find_files(root.path(), "png"), Err(MaterialError::Read { .. })));
    }
}
