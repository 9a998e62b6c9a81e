//! Previews and contact sheets inside the page.

use image::RgbImage;
use image::imageops::{FilterType, resize};
use scan::html::figure;
use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};

/// Widest picture of the page, in pixels: as wide as its text on a usual screen.
const WIDEST: u32 = 1120;
/// Most times that a small picture is enlarged.
const LARGEST: u32 = 3;
/// Contact sheets that are shown; the others lie in `report/`.
const MOST_SHEETS: usize = 16;

/// What the pictures whose names begin so show.
const SHOWN: [(&str, &str); 3] = [
    ("pair", "target, source, true flow, estimated flow, distance between them, wheel of directions (paler is shorter)"),
    ("maps", "estimated above true: normals, diffuse, roughness, specular, rendered from the top and from 45°"),
    ("frames", "guidance frame and key frames"),
];

/// The first and the last of every picture that a stage has shown.
///
/// # Errors
/// A folder or file that can't be read; a folder that isn't there is no error.
pub fn previews(folder: &Path) -> io::Result<String> {
    let mut series: BTreeMap<(String, String), BTreeMap<u64, PathBuf>> = BTreeMap::new();
    for path in files(folder)? {
        let Some((stage, step, name)) = parts(&path) else { continue };
        series.entry((stage, name)).or_default().insert(step, path);
    }
    let mut text = String::new();
    for ((stage, name), steps) in &series {
        let what = SHOWN.iter().find(|(prefix, _)| name.starts_with(prefix)).map_or("", |(_, what)| what);
        let (Some((began, first)), Some((ended, last))) = (steps.first_key_value(), steps.last_key_value()) else { continue };
        let (before, after) = (read(first)?, read(last)?);
        // What isn't made by the net stays the same.
        if before != after {
            text += &embedded(&format!("{stage}, {name}, step {began}: {what}"), &before)?;
        }
        text += &embedded(&format!("{stage}, {name}, step {ended}: {what}"), &after)?;
    }
    Ok(text)
}

/// The contact sheets of the evaluation.
///
/// # Errors
/// As [`previews`].
pub fn sheets(folder: &Path) -> io::Result<String> {
    let name = |path: &Path| path.file_stem()?.to_str()?.strip_prefix("sheet-").map(str::to_string);
    let sheets: Vec<(String, PathBuf)> = files(folder)?.into_iter().filter_map(|path| Some((name(&path)?, path))).collect();
    let mut text = String::new();
    for (name, path) in sheets.iter().take(MOST_SHEETS) {
        text +=
            &embedded(&format!("evaluation, {name}: guidance frame and aligned key frames, estimated, true"), &read(path)?)?;
    }
    if sheets.len() > MOST_SHEETS {
        text += &format!("<p class=\"soft\">{} more contact sheets are in report/.</p>\n", sheets.len() - MOST_SHEETS);
    }
    Ok(text)
}

/// Small pictures are shown larger, pixel by pixel: 64 pixels of a map are hardly seen on a screen.
fn embedded(caption: &str, picture: &RgbImage) -> io::Result<String> {
    let times = (WIDEST / picture.width().max(1)).clamp(1, LARGEST);
    let larger = resize(picture, picture.width() * times, picture.height() * times, FilterType::Nearest);
    figure(caption, &larger, WIDEST).map_err(io::Error::other)
}

fn read(path: &Path) -> io::Result<RgbImage> {
    let decoded = image::load_from_memory(&std::fs::read(path)?);
    decoded.map(|picture| picture.to_rgb8()).map_err(|error| io::Error::other(format!("{}: {error}", path.display())))
}

/// The PNG files of a folder by name.
fn files(folder: &Path) -> io::Result<Vec<PathBuf>> {
    let entries = match std::fs::read_dir(folder) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        entries => entries?,
    };
    let paths: io::Result<Vec<PathBuf>> = entries.map(|entry| entry.map(|entry| entry.path())).collect();
    let mut paths: Vec<PathBuf> = paths?.into_iter().filter(|path| path.extension().is_some_and(|e| e == "png")).collect();
    paths.sort();
    Ok(paths)
}

/// `STAGE-STEP-NAME.png`, as the recorder names previews.
fn parts(path: &Path) -> Option<(String, u64, String)> {
    let mut parts = path.file_stem()?.to_str()?.splitn(3, '-');
    let (stage, step, name) = (parts.next()?, parts.next()?, parts.next()?);
    Some((stage.into(), step.parse().ok()?, name.into()))
}
