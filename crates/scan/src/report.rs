//! How the capture went: `alignment.json`, the warped key frames and a contact sheet.

use std::path::Path;

use dataset::image_io::{ImageError, Overwrite, write_bytes, write_png8};
use flow::align::KeyFrame;
use ops::homography::Homography;
use ops::planes::Planes;
use render::brdf::BrdfModel;
use render::visual::{below, beside};
use serde::Serialize;

use crate::camera_json::CameraJson;
use crate::guidance::View;
use crate::reconstruct::{CameraConfig, Reconstruction};

/// A capture with fewer aligned key frames than this share is called poor.
const POOR_ALIGNED_SHARE: f64 = 0.5;
/// A capture whose pixels were seen by fewer frames than this on average is called poor.
const POOR_MEAN_COVERAGE: f64 = 3.0;
/// Side of a picture on the contact sheet and columns of it.
const SIDE: usize = 192;
const COLUMNS: usize = 6;

#[derive(Serialize)]
struct AlignmentJson {
    format: u32,
    conventions: &'static str,
    #[serde(skip_serializing_if = "Option::is_none")]
    guidance_photo: Option<GuidanceJson>,
    camera: CameraJson,
    key_frames: Vec<KeyFrameJson>,
    warnings: Vec<String>,
}

/// Where frame 0 was found in the guidance photo.
#[derive(Serialize)]
struct GuidanceJson {
    /// Pixel of the maps to pixel of the photo.
    maps_to_photo: [[f64; 3]; 3],
    /// Pixel of the photo to pixel of frame 0.
    photo_to_frame_0: [[f64; 3]; 3],
    video_pixels_per_photo_pixel: f64,
    correlation: f64,
    significance: f64,
    expected_error_px: Option<f64>,
}

impl GuidanceJson {
    fn new(view: &View) -> Self {
        let found = &view.located;
        Self {
            maps_to_photo: rows(&view.to_photo),
            photo_to_frame_0: rows(&found.homography),
            video_pixels_per_photo_pixel: found.scale,
            correlation: found.zncc,
            significance: found.significance,
            expected_error_px: found.expected_px.is_finite().then_some(found.expected_px),
        }
    }
}

fn rows(homography: &Homography) -> [[f64; 3]; 3] {
    std::array::from_fn(|r| std::array::from_fn(|c| homography.matrix[(r, c)]))
}

#[derive(Serialize)]
struct KeyFrameJson {
    index: usize,
    status: &'static str,
    reason: Option<String>,
    homography: [[f64; 3]; 3],
    residual_px: Option<f64>,
    valid_share: f64,
    confidence: f64,
}

impl KeyFrameJson {
    fn new(key: &KeyFrame, index: usize) -> Self {
        let reason = match key.status {
            flow::align::KeyFrameStatus::Aligned => None,
            flow::align::KeyFrameStatus::Dropped(reason) => Some(reason.to_string()),
        };
        Self {
            index,
            status: if key.aligned() { "aligned" } else { "dropped" },
            reason,
            homography: rows(&key.homography),
            residual_px: key.residual_px.is_finite().then_some(key.residual_px),
            valid_share: key.valid_share,
            confidence: key.confidence,
        }
    }
}

/// Why a capture is poor, in words; empty for a good one.
pub fn shortcomings(result: &Reconstruction) -> Vec<String> {
    let keys = &result.alignment.key_frames;
    let aligned = keys.iter().filter(|k| k.aligned()).count();
    let coverage = f64::from(result.coverage.data.iter().sum::<f32>()) / result.coverage.area() as f64;
    let mut found = Vec::new();
    if (aligned as f64) < POOR_ALIGNED_SHARE * keys.len() as f64 {
        found.push(format!("only {aligned} of {} key frames could be aligned: scan more slowly, from one height", keys.len()));
    }
    if coverage < POOR_MEAN_COVERAGE {
        found.push(format!("a pixel was seen by {coverage:.1} frames on average: stay near the first frame for longer"));
    }
    found
}

/// Writes `alignment.json`, `keyframes/*.png` and `contact-sheet.png` into an existing folder.
///
/// `indices` are the frames' numbers in the clip.
///
/// # Errors
/// If a file can't be written.
pub fn write(
    folder: &Path,
    (frames, indices): (&[Planes], &[usize]),
    result: &Reconstruction,
    camera: &CameraConfig,
) -> Result<(), ImageError> {
    let alignment = &result.alignment;
    let keys = alignment.key_frames.iter().map(|k| KeyFrameJson::new(k, indices[k.index]));
    let json = AlignmentJson {
        format: 1,
        conventions: "homography: pixel of the maps to frame pixel, pixel centres at integers, x right, y down; the maps have the axes of frame 0, or of the guidance photo where there is one",
        guidance_photo: result.view.as_ref().map(GuidanceJson::new),
        camera: CameraJson::new(&result.camera, indices, camera.width_mm),
        key_frames: keys.collect(),
        warnings: alignment.warnings.iter().map(ToString::to_string).collect(),
    };
    let text = serde_json::to_string_pretty(&json).expect("plain numbers and text");
    write_bytes(&folder.join("alignment.json"), text.as_bytes(), Overwrite::Refuse)?;
    let keyframes = folder.join("keyframes");
    std::fs::create_dir_all(&keyframes).map_err(|source| ImageError::Write { path: keyframes.clone(), source })?;
    let guidance = result.view.as_ref().map_or(&frames[0], |v| &v.picture);
    let (height, width) = (guidance.height, guidance.width);
    let mut thumbnails = vec![guidance.resize_area(SIDE, SIDE)];
    for key in alignment.key_frames.iter().filter(|k| k.aligned()) {
        let (warped, _) = key.aligned_frame(&frames[key.index], height, width);
        write_png8(&keyframes.join(format!("frame-{:05}.png", indices[key.index])), &warped, Overwrite::Refuse)?;
        thumbnails.push(warped.resize_area(SIDE, SIDE));
    }
    write_png8(&folder.join("contact-sheet.png"), &contact_sheet(&thumbnails, result), Overwrite::Refuse)
}

/// Maps and renderings above, guidance and warped key frames below.
fn contact_sheet(thumbnails: &[Planes], result: &Reconstruction) -> Planes {
    let maps = svbrdf::visual::preview(&[&result.maps], BrdfModel::default()).resize_area(SIDE, COLUMNS * SIDE);
    let blank = Planes::new(3, SIDE, SIDE);
    let mut rows = vec![maps];
    for row in thumbnails.chunks(COLUMNS) {
        let pictures: Vec<&Planes> = row.iter().chain(std::iter::repeat(&blank)).take(COLUMNS).collect();
        rows.push(beside(&pictures));
    }
    below(&rows.iter().collect::<Vec<_>>())
}
