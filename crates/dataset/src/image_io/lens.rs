//! What a photograph's EXIF data say of its lens.

use std::io::Cursor;
use std::path::Path;

use exif::{Exif, In, Tag, Value};

/// Diagonal of a 36 × 24 mm picture, in millimetres: equivalent focal lengths relate to it.
const FULL_FRAME_DIAGONAL_MM: f64 = 43.266_615;
/// Metadata of a picture with other proportions belong to what it was cut from.
const PROPORTION_TOLERANCE: f64 = 0.01;
/// Fields of view that a lens can have, in degrees.
const PLAUSIBLE_DEG: std::ops::RangeInclusive<f64> = 1.0..=150.0;

/// The focal length of a photograph.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lens {
    /// Focal length as a share of the picture's diagonal.
    pub focal_per_diagonal: f64,
    /// Longer over shorter side of the picture that the metadata describe, where they say.
    pub proportion: Option<f64>,
}

impl Lens {
    /// Field of view, in degrees, across a window of `window` pixels around the middle of a picture of `size` pixels; `None`
    /// where the picture was cut since it was taken.
    pub fn fov_deg(&self, size: [usize; 2], window: usize) -> Option<f64> {
        let [width, height] = size.map(|v| v as f64);
        let proportion = width.max(height) / width.min(height);
        if self.proportion.is_some_and(|p| (p / proportion - 1.0).abs() > PROPORTION_TOLERANCE) {
            return None;
        }
        let focal = self.focal_per_diagonal * width.hypot(height);
        let fov = 2.0 * (0.5 * window as f64 / focal).atan().to_degrees();
        PLAUSIBLE_DEG.contains(&fov).then_some(fov)
    }
}

/// The lens that a file's EXIF data describe; `None` where the file has none, can't be read, or doesn't tell the focal length.
pub fn read(path: &Path) -> Option<Lens> {
    of_bytes(&std::fs::read(path).ok()?)
}

/// As [`read`] for a file's bytes.
pub fn of_bytes(bytes: &[u8]) -> Option<Lens> {
    let exif = exif::Reader::new().read_from_container(&mut Cursor::new(bytes)).ok()?;
    let sides = [Tag::PixelXDimension, Tag::PixelYDimension].map(|tag| positive(&exif, tag));
    let proportion = match sides {
        [Some(x), Some(y)] => Some(x.max(y) / x.min(y)),
        _ => None,
    };
    let equivalent = positive(&exif, Tag::FocalLengthIn35mmFilm).map(|mm| mm / FULL_FRAME_DIAGONAL_MM);
    let focal_per_diagonal = equivalent.or_else(|| by_sensor(&exif, sides))?;
    Some(Lens { focal_per_diagonal, proportion })
}

/// From the focal length in millimetres and the sensor's pixels per inch or centimetre.
fn by_sensor(exif: &Exif, sides: [Option<f64>; 2]) -> Option<f64> {
    let unit_mm = match positive(exif, Tag::FocalPlaneResolutionUnit) {
        Some(3.0) => 10.0,
        Some(2.0) | None => 25.4,
        Some(_) => return None,
    };
    let focal_px = positive(exif, Tag::FocalLength)? * positive(exif, Tag::FocalPlaneXResolution)? / unit_mm;
    Some(focal_px / sides[0]?.hypot(sides[1]?))
}

/// The first number of a field, if it is above 0 and finite.
fn positive(exif: &Exif, tag: Tag) -> Option<f64> {
    let value = match &exif.get_field(tag, In::PRIMARY)?.value {
        Value::Rational(v) => v.first()?.to_f64(),
        other => f64::from(other.get_uint(0)?),
    };
    (value > 0.0 && value.is_finite()).then_some(value)
}

#[cfg(test)]
mod tests {
    use super::*;
    use exif::experimental::Writer;
    use exif::{Field, Rational};

    /// A JPEG of 40 × 30 pixels with the given fields.
    fn photo(fields: &[(Tag, Value)]) -> Vec<u8> {
        let fields: Vec<Field> =
            fields.iter().map(|(tag, value)| Field { tag: *tag, ifd_num: In::PRIMARY, value: value.clone() }).collect();
        let mut writer = Writer::new();
        fields.iter().for_each(|f| writer.push_field(f));
        let mut tiff = Cursor::new(b"Exif\0\0".to_vec());
        let mut block = Cursor::new(Vec::new());
        writer.write(&mut block, false).unwrap();
        tiff.get_mut().extend(block.into_inner());
        let mut jpeg = Vec::new();
        image::codecs::jpeg::JpegEncoder::new(&mut jpeg).encode(&[128; 1200], 40, 30, image::ExtendedColorType::L8).unwrap();
        let segment = tiff.into_inner();
        let length = (segment.len() as u16 + 2).to_be_bytes();
        [&jpeg[..2], &[0xff, 0xe1], &length, &segment, &jpeg[2..]].concat()
    }

    #[test]
    fn an_equivalent_focal_length_becomes_a_field_of_view() {
        // 26 mm, a usual phone: 4:3 picture, 66.9° across its longer side.
        let bytes = photo(&[(Tag::FocalLengthIn35mmFilm, Value::Short(vec![26]))]);
        let lens = of_bytes(&bytes).unwrap();
        let fov = lens.fov_deg([4032, 3024], 4032).unwrap();
        assert!((fov - 2.0 * (0.5 * 34.613 / 26.0f64).atan().to_degrees()).abs() < 0.01, "{fov}");
        let square = lens.fov_deg([3024, 4032], 3024).unwrap();
        assert!((square - 2.0 * (0.5 * 25.960 / 26.0f64).atan().to_degrees()).abs() < 0.01, "{square}");
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("photo.jpg");
        std::fs::write(&path, &bytes).unwrap();
        assert_eq!(read(&path), Some(lens));
        assert_eq!(crate::image_io::Picture::read(&path).unwrap().width, 40);
    }

    #[test]
    fn sensor_resolution_serves_where_there_is_no_equivalent() {
        let rational = |num| Value::Rational(vec![Rational { num, denom: 1000 }]);
        let fields = [
            (Tag::FocalLength, rational(5_000)),
            (Tag::FocalPlaneXResolution, rational(100_000)),
            (Tag::FocalPlaneResolutionUnit, Value::Short(vec![3])),
            (Tag::PixelXDimension, Value::Long(vec![40])),
            (Tag::PixelYDimension, Value::Long(vec![30])),
        ];
        // 5 mm at 100 pixels per centimetre: 50 px; so many has the diagonal.
        let lens = of_bytes(&photo(&fields)).unwrap();
        assert!((lens.focal_per_diagonal - 1.0).abs() < 1e-9);
        assert_eq!(lens.fov_deg([40, 40], 40), None, "cut to a square since");
        assert!(lens.fov_deg([400, 300], 300).is_some(), "made larger is no cut");
        assert_eq!(of_bytes(&photo(&fields[..1])), None, "no resolution");
    }

    #[test]
    fn files_without_metadata_and_broken_ones_say_nothing() {
        let bytes = photo(&[(Tag::FocalLengthIn35mmFilm, Value::Short(vec![0]))]);
        assert_eq!(of_bytes(&bytes), None, "0 means unknown");
        assert_eq!(of_bytes(b"not a picture"), None);
        let whole = photo(&[(Tag::FocalLengthIn35mmFilm, Value::Short(vec![26]))]);
        let lens = of_bytes(&whole);
        assert!((0..whole.len()).all(|end| of_bytes(&whole[..end]).is_none_or(|cut| Some(cut) == lens)), "cut anywhere");
    }
}
