//! Alignment of a scan to its guidance image (paper §5; spec 3.2).
//!
//! All frames serve alignment, every k-th one is a key frame and serves reflectance. Neighbouring frames are linked by the
//! most consistent of several guesses ([`candidates`], [`steps`]), key frames by the product of these steps and directly to
//! the guidance image and to earlier key frames that show the same place ([`Aligner`]); all links together place the key
//! frames ([`graph`]). Every link is refined on the pixels ([`photometric`]). One camera explains all links ([`camera`]).
//!
//! Nets take part through [`FlowEstimator`] and may be absent.

pub mod camera;
pub mod candidates;
pub mod compose;
pub mod config;
pub mod contrast;
mod dense;
mod footage;
pub mod graph;
pub mod localise;
pub mod metrics;
pub mod phase;
pub mod photometric;
pub mod planar;
pub mod pose;
mod relief;
mod result;
mod rivals;
mod scan;
#[cfg(test)]
pub(crate) mod scene;
mod sequence;
pub mod size;
mod smooth;
pub mod steady;
pub mod steps;
mod track;

pub use config::{AlignConfig, CandidateSwitches, PhotometricConfig, Regularise};
pub use footage::Footage;
pub use result::{AlignError, Alignment, DropReason, KeyFrame, KeyFrameStatus, Seconds, Warning};
pub use sequence::Aligner;

use ops::planes::Planes;

/// Version of the aligner's results. Whoever changes what [`Aligner`] finds with the same frames, settings and nets adds one, so
/// that cases measured before and after are never put into one table.
pub const VERSION: u32 = 4;

/// Something that estimates the dense motion between two images, such as a trained net.
pub trait FlowEstimator {
    /// The backward flow on `first`'s pixels: `first(p)` shows what `second(p + flow(p))` shows.
    ///
    /// # Shapes
    /// Both images have 3 gamma-encoded planes and one size, any size; the result has 2 planes (x, y) in pixels.
    fn flow(&self, first: &Planes, second: &Planes) -> Planes;

    /// The flows of several pairs of one size; an estimator that works on batches overrides this.
    fn flows(&self, pairs: &[(&Planes, &Planes)]) -> Vec<Planes> {
        pairs.iter().map(|(first, second)| self.flow(first, second)).collect()
    }
}
