//! Frames and exact warps for programs that other people wrote: `frames/CONDITION/NNNN/`.

use std::path::Path;

use dataset::image_io::{Overwrite, write_bytes, write_png8};
use dataset::material::library::MaterialLibrary;
use dataset::material::texture::Texture;
use dataset::sequence::{FrameWarp, Sequence};
use serde::Serialize;

use crate::EvaluateError;

use super::AlignmentConfig;
use super::conditions::Condition;
use super::footage::footage;

/// Name of the file with the exact warps.
const TRUTH: &str = "truth.json";

/// What is true of a folder of frames.
#[derive(Serialize)]
struct Truth<'a> {
    material: &'a str,
    texture: Texture,
    resolution: usize,
    key_frames: Vec<KeyFrame>,
}

/// An exact homography, pixel of frame 0 to pixel of frame `frame`, row by row.
#[derive(Serialize)]
struct KeyFrame {
    frame: usize,
    homography: Vec<f64>,
}

/// Writes `frame-NNNN.png` and `truth.json` of every scan that isn't there yet.
///
/// # Errors
/// If a file can't be written, a material can't be loaded, or a condition's frames are no pinhole camera's: then no homography
/// says where they lie.
pub fn frames(
    library: &MaterialLibrary,
    config: &AlignmentConfig,
    conditions: &[Condition],
    folder: &Path,
) -> Result<(), EvaluateError> {
    for condition in conditions {
        let config = condition.settings(config)?;
        for index in config.numbers() {
            let folder = folder.join("frames").join(condition.name).join(format!("{index:04}"));
            if !folder.join(TRUTH).exists() {
                std::fs::create_dir_all(&folder).map_err(|source| EvaluateError::Folder { folder: folder.clone(), source })?;
                write(&config.sequence(library, index)?, &config, condition, &folder)?;
            }
        }
    }
    Ok(())
}

fn write(sequence: &Sequence, config: &AlignmentConfig, condition: &Condition, folder: &Path) -> Result<(), EvaluateError> {
    let step = config.align.key_frame_step;
    let exact = (step..sequence.len()).step_by(step).map(|frame| match sequence.warp(0, frame, config.resolution) {
        FrameWarp::Plane(map) => Ok(KeyFrame { frame, homography: map.matrix.transpose().iter().copied().collect() }),
        FrameWarp::Bent(_) => Err(EvaluateError::Config {
            name: "--keep-frames",
            found: condition.name.into(),
            expected: "conditions without lens distortion and rolling shutter; choose with --conditions",
        }),
    });
    let key_frames = exact.collect::<Result<Vec<KeyFrame>, EvaluateError>>()?;
    let (material, texture) = (sequence.material(), sequence.texture());
    let truth = Truth { material, texture, resolution: config.resolution, key_frames };
    let footage = footage(sequence, config)?;
    for frame in 0..footage.count() {
        let path = folder.join(format!("frame-{frame:04}.png"));
        write_png8(&path, &footage.frame(frame), Overwrite::Allow)?;
    }
    let json = serde_json::to_vec_pretty(&truth).expect("plain values");
    // Comes last: where it is, the frames are whole.
    Ok(write_bytes(&folder.join(TRUTH), &json, Overwrite::Allow)?)
}
