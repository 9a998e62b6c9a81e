//! Renders a scan of a generated material as a folder of frames, for trying `scan` without a phone.
//!
//! ```text
//! cargo run -p acceptance --example clip -- FOLDER [FAMILY] [RESOLUTION] [FRAMES] [TRUTH]
//! ```
//!
//! The true maps of the first frame go to the folder TRUTH, for `evaluate maps`.

use std::path::PathBuf;

use acceptance::clip;
use anyhow::Context;
use dataset::material::procedural::Family;

fn main() -> anyhow::Result<()> {
    let mut arguments = std::env::args().skip(1);
    let folder = PathBuf::from(arguments.next().context("give a folder to write the frames to")?);
    let family = arguments.next().unwrap_or_else(|| "pavers".into());
    let mut number = |default: usize| arguments.next().map_or(Ok(default), |text| text.parse().context(text));
    let (resolution, frames) = (number(256)?, number(141)?);
    let names = || Family::ALL.iter().map(|f| f.name()).collect::<Vec<_>>().join(", ");
    let truth = arguments.next().map(PathBuf::from);
    let family = Family::from_name(&family).with_context(|| format!("no family `{family}`; there are {}", names()))?;
    let video = clip::spiral(family)?;
    anyhow::ensure!((2..=video.len()).contains(&frames), "FRAMES is {frames}; expected 2 to {}", video.len());
    std::fs::create_dir_all(&folder)?;
    clip::write(&video, frames, resolution, &folder)?;
    if let Some(truth) = truth {
        std::fs::create_dir_all(&truth)?;
        scan::export::maps::write_truth(&truth, &video.target_maps(0, resolution))?;
    }
    println!("{}: {frames} frames of {resolution}×{resolution} pixels, {}", folder.display(), video.material());
    Ok(())
}
