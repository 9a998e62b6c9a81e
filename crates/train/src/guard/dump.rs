//! The batch on which numbers went bad, as files that a person can look at.

use super::NonFinite;
use image::{Rgb, RgbImage};
use serde::Serialize;
use std::io;
use std::path::{Path, PathBuf};

/// Values that aren't finite are painted in a colour that no map or frame is made of.
const MARK: Rgb<u8> = Rgb([255, 0, 255]);

/// An array of an exemplar.
#[derive(Debug, Clone, PartialEq)]
pub struct Array {
    /// What it is.
    pub name: String,
    /// Its shape.
    pub shape: Vec<usize>,
    /// Its values, last axis fastest.
    pub values: Vec<f32>,
}

/// A dumped batch.
#[derive(Debug, Clone, PartialEq)]
pub struct Dump {
    /// The arrays.
    pub path: PathBuf,
    /// Name of the first array that isn't finite, and how many of its values aren't.
    pub bad: Option<(String, usize)>,
}

impl Dump {
    /// Whether the batch or the weights are at fault, and what to try then.
    pub fn verdict(&self) -> String {
        match &self.bad {
            Some((name, count)) => format!(
                "{count} values of its array `{name}` aren't numbers (purple in the .png): find the material they come from"
            ),
            None => "All its values are numbers, so the weights have gone astray: try a lower learning rate or `clip`".into(),
        }
    }
}

/// Writes a batch as `STAGE-STEP-BATCH.safetensors`, with what was found and the arrays' ranges in a `.json` and their pictures in a
/// `.png` beside it.
///
/// # Errors
/// The system's refusal.
pub fn dump(folder: &Path, stage: &str, step: u64, batch: u64, found: &NonFinite, arrays: &[Array]) -> io::Result<Dump> {
    std::fs::create_dir_all(folder)?;
    let path = folder.join(format!("{stage}-{step:08}-{batch}.safetensors"));
    crate::atomic::write(&path, &tensors(arrays)?)?;
    let arrays_found = arrays.iter().map(Range::of).collect();
    let record = Record { stage, step, batch, term: &found.term, value: found.value.to_string(), arrays: arrays_found };
    crate::atomic::write(&path.with_extension("json"), crate::report::pretty(&record)?.as_bytes())?;
    if let Some(picture) = picture(arrays) {
        let mut png = io::Cursor::new(Vec::new());
        picture.write_to(&mut png, image::ImageFormat::Png).map_err(io::Error::other)?;
        crate::atomic::write(&path.with_extension("png"), png.get_ref())?;
    }
    let bad = arrays.iter().map(|array| (array, not_finite(array))).find(|(_, count)| *count > 0);
    Ok(Dump { path, bad: bad.map(|(array, count)| (array.name.clone(), count)) })
}

fn tensors(arrays: &[Array]) -> io::Result<Vec<u8>> {
    use safetensors::tensor::{Dtype, TensorView};
    let bytes: Vec<Vec<u8>> =
        arrays.iter().map(|array| array.values.iter().flat_map(|value| value.to_le_bytes()).collect()).collect();
    let views = arrays
        .iter()
        .zip(&bytes)
        .map(|(array, bytes)| TensorView::new(Dtype::F32, array.shape.clone(), bytes).map(|view| (array.name.as_str(), view)))
        .collect::<Result<Vec<_>, _>>()
        .map_err(io::Error::other)?;
    safetensors::serialize(views, None).map_err(io::Error::other)
}

fn not_finite(array: &Array) -> usize {
    array.values.iter().filter(|value| !value.is_finite()).count()
}

/// Smallest and largest finite value; none in an array without any.
fn range(array: &Array) -> Option<(f32, f32)> {
    let finite = array.values.iter().copied().filter(|value| value.is_finite());
    finite.fold(None, |range, value| {
        Some(range.map_or((value, value), |(low, high): (f32, f32)| (low.min(value), high.max(value))))
    })
}

/// What is told of a dumped batch.
#[derive(Serialize)]
struct Record<'a> {
    stage: &'a str,
    step: u64,
    batch: u64,
    term: &'a str,
    /// JSON has no NaN.
    value: String,
    arrays: Vec<Range<'a>>,
}

/// What is told of an array.
#[derive(Serialize)]
struct Range<'a> {
    name: &'a str,
    shape: &'a [usize],
    not_finite: usize,
    range: Option<(f32, f32)>,
}

impl<'a> Range<'a> {
    fn of(array: &'a Array) -> Self {
        Self { name: &array.name, shape: &array.shape, not_finite: not_finite(array), range: range(array) }
    }
}

/// The arrays of planes side by side in the order of their names' first parts, one row per part (`frames`, `flows`, `target` …).
/// What leaves 0 to 1 is stretched to its own range. `None` when no array has planes.
fn picture(arrays: &[Array]) -> Option<RgbImage> {
    let mut rows: Vec<(&str, Vec<RgbImage>)> = Vec::new();
    for array in arrays {
        let &[channels, height, width] = array.shape.as_slice() else { continue };
        if channels * height * width == 0 {
            continue;
        }
        let part = array.name.split('.').next().unwrap_or_default();
        let image = planes(array, channels, height, width);
        match rows.last_mut() {
            Some((name, row)) if *name == part => row.push(image),
            _ => rows.push((part, vec![image])),
        }
    }
    let size = |row: &[RgbImage]| (row.iter().map(RgbImage::width).sum(), row.iter().map(RgbImage::height).max().unwrap_or(0));
    let width = rows.iter().map(|(_, row)| size(row).0).max()?;
    let mut sheet = RgbImage::new(width, rows.iter().map(|(_, row)| size(row).1).sum());
    let mut y = 0;
    for (_, row) in &rows {
        let mut x = 0;
        for image in row {
            image::imageops::replace(&mut sheet, image, x, y);
            x += i64::from(image.width());
        }
        y += i64::from(size(row).1);
    }
    Some(sheet)
}

fn planes(array: &Array, channels: usize, height: usize, width: usize) -> RgbImage {
    let (low, high) = range(array).unwrap_or((0.0, 1.0));
    let (low, high) = if low >= 0.0 && high <= 1.0 { (0.0, 1.0) } else { (low, high) };
    let scale = 255.0 / (high - low).max(f32::MIN_POSITIVE);
    RgbImage::from_fn(width as u32, height as u32, |x, y| {
        let at = |channel: usize| array.values[(channel * height + y as usize) * width + x as usize];
        if (0..channels).any(|channel| !at(channel).is_finite()) {
            return MARK;
        }
        // One plane is grey, two are red and green.
        let shown = |c: usize| if channels == 2 && c == 2 { low } else { at(c.min(channels - 1)) };
        Rgb(std::array::from_fn(|c| ((shown(c) - low) * scale).clamp(0.0, 255.0).round() as u8))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn found() -> NonFinite {
        NonFinite { term: "top".into(), value: f64::NAN }
    }

    #[test]
    fn the_dump_reads_back_and_says_what_is_wrong() {
        let home = tempfile::tempdir().unwrap();
        let folder = home.path().join("failures");
        let good = Array { name: "flows.0".into(), shape: vec![2, 1, 2], values: vec![-4.0, 4.0, 0.0, 0.0] };
        let bad = Array { name: "frames.0".into(), shape: vec![3, 1, 2], values: vec![f32::NAN, 0.5, 0.0, 1.0, 0.25, 0.0] };
        let dumped = dump(&folder, "svbrdf", 7, 9, &found(), &[good, bad]).unwrap();
        assert_eq!(dumped.bad, Some(("frames.0".into(), 1)));
        assert!(dumped.verdict().contains("`frames.0`") && dumped.verdict().contains("material"));
        let bytes = std::fs::read(&dumped.path).unwrap();
        let tensors = safetensors::SafeTensors::deserialize(&bytes).unwrap();
        assert_eq!(tensors.tensor("frames.0").unwrap().shape(), [3, 1, 2]);
        assert_eq!(tensors.tensor("frames.0").unwrap().data()[4..8], 0.5_f32.to_le_bytes());
        let text = std::fs::read(dumped.path.with_extension("json")).unwrap();
        let record: serde_json::Value = serde_json::from_slice(&text).unwrap();
        assert_eq!((&record["term"], &record["value"], &record["batch"]), (&"top".into(), &"NaN".into(), &9.into()));
        assert_eq!(record["arrays"][0]["range"], json!([-4.0, 4.0]));
        let picture = image::open(dumped.path.with_extension("png")).unwrap().to_rgb8();
        assert_eq!(picture.dimensions(), (2, 2));
        let pixels: Vec<[u8; 3]> = picture.pixels().map(|pixel| pixel.0).collect();
        assert_eq!(pixels, [[0, 128, 0], [255, 128, 0], MARK.0, [128, 255, 0]]);
    }

    #[test]
    fn a_batch_of_good_numbers_puts_the_blame_on_the_weights() {
        let home = tempfile::tempdir().unwrap();
        let array = Array { name: "x".into(), shape: vec![2], values: vec![1.0, 2.0] };
        let dumped = dump(home.path(), "toy", 7, 9, &found(), &[array]).unwrap();
        assert!(dumped.verdict().contains("learning rate"));
        assert!(!dumped.path.with_extension("png").exists());
    }
}
