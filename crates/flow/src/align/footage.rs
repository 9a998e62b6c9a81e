//! The frames of a scan, wherever they come from: in memory, rendered or decoded one after the other.

use std::borrow::Cow;

use ops::planes::Planes;
use rayon::prelude::*;

use super::result::AlignError;

/// The frames of one clip. The aligner asks for each frame once, for a few at a time, and keeps only what it needs of it.
pub trait Footage: Sync {
    /// Number of frames.
    fn count(&self) -> usize;

    /// A frame with 3 gamma-encoded planes; all have one size.
    fn frame(&self, index: usize) -> Cow<'_, Planes>;
}

impl Footage for &[Planes] {
    fn count(&self) -> usize {
        self.len()
    }

    fn frame(&self, index: usize) -> Cow<'_, Planes> {
        Cow::Borrowed(&self[index])
    }
}

/// What `keep` makes of every frame, in the frames' order. No more frames are held at a time than there are threads.
///
/// # Errors
/// If a frame's shape differs from that of frame 0.
pub(super) fn digest<T: Send>(
    footage: &dyn Footage,
    first: &Planes,
    keep: impl Fn(usize, &Planes) -> T + Sync,
) -> Result<Vec<T>, AlignError> {
    let shape = |p: &Planes| (p.channels, p.height, p.width);
    let digested = |index: usize| {
        let frame = if index == 0 { Cow::Borrowed(first) } else { footage.frame(index) };
        if shape(&frame) != shape(first) {
            return Err(AlignError::FrameShape { index, found: described(&frame), expected: described(first) });
        }
        Ok(keep(index, &frame))
    };
    let mut kept = Vec::with_capacity(footage.count());
    let together = rayon::current_num_threads().max(1);
    for start in (0..footage.count()).step_by(together) {
        let end = (start + together).min(footage.count());
        let part: Vec<Result<T, AlignError>> = (start..end).into_par_iter().map(digested).collect();
        for one in part {
            kept.push(one?);
        }
    }
    Ok(kept)
}

/// Channels, height and width in words.
pub(super) fn described(image: &Planes) -> String {
    format!("{} channels of {}×{}", image.channels, image.height, image.width)
}
