//! A folder of frames, in the order a person reads numbers: `frame2` before `frame10`.

use std::cmp::Ordering;
use std::path::{Path, PathBuf};

use super::CaptureError;
use super::collect::Collector;
use crate::image_io::{Picture, lens};

const EXTENSIONS: &[&str] = &["png", "jpg", "jpeg", "exr"];

/// Whether a path is named like a frame.
pub(super) fn is_frame(path: &Path) -> bool {
    let extension = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    EXTENSIONS.contains(&extension.as_str())
}

pub(super) fn read(folder: &Path, collector: &mut Collector) -> Result<(), CaptureError> {
    let fail = |source| CaptureError::Read { path: folder.into(), source };
    let mut files: Vec<PathBuf> = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(fail)? {
        let path = entry.map_err(fail)?.path();
        let hidden = path.file_name().is_some_and(|n| n.to_string_lossy().starts_with('.'));
        if !hidden && path.is_file() && is_frame(&path) {
            files.push(path);
        }
    }
    files.sort_by(|a, b| natural_order(&name(a), &name(b)));
    // One camera took them all: the first picture speaks for it.
    collector.lens = files.first().and_then(|file| lens::read(file));
    for file in files {
        let picture = Picture::read(&file)?;
        let pushed = collector.push(picture.width, picture.height, |fit| Ok(fit.planes(picture.to_frame())));
        pushed.map_err(|error| match error {
            CaptureError::Sizes { frame, found, expected, .. } => {
                CaptureError::Sizes { path: file.clone(), frame, found, expected }
            }
            other => other,
        })?;
    }
    Ok(())
}

fn name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().to_lowercase()
}

/// Compares runs of digits by value and everything else by character.
fn natural_order(a: &str, b: &str) -> Ordering {
    let (mut left, mut right) = (a, b);
    loop {
        let (digits_a, rest_a) = split_digits(left);
        let (digits_b, rest_b) = split_digits(right);
        if !digits_a.is_empty() && !digits_b.is_empty() {
            let (value_a, value_b) = (digits_a.trim_start_matches('0'), digits_b.trim_start_matches('0'));
            let order = value_a.len().cmp(&value_b.len()).then_with(|| value_a.cmp(value_b));
            if order != Ordering::Equal {
                return order;
            }
            (left, right) = (rest_a, rest_b);
            continue;
        }
        match (left.chars().next(), right.chars().next()) {
            (Some(x), Some(y)) if x == y => (left, right) = (&left[x.len_utf8()..], &right[y.len_utf8()..]),
            (Some(x), Some(y)) => return x.cmp(&y),
            // Equal up to leading zeros: the names themselves decide, so that the order is total.
            (None, None) => return a.cmp(b),
            (x, y) => return x.is_some().cmp(&y.is_some()),
        }
    }
}

fn split_digits(text: &str) -> (&str, &str) {
    text.split_at(text.bytes().take_while(u8::is_ascii_digit).count())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_compared_by_value() {
        let mut names =
            ["f10.png", "f2.png", "f1.png", "f002.png", "a9.png", "f1b.png", "f99999999999999999999999.png", "f.png"];
        names.sort_by(|a, b| natural_order(a, b));
        let sorted = ["a9.png", "f.png", "f1.png", "f1b.png", "f002.png", "f2.png", "f10.png", "f99999999999999999999999.png"];
        assert_eq!(names, sorted);
    }
}
