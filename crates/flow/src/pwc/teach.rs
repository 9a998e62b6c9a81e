//! Teacher forcing: fine levels start from the truth while the coarse ones still guess.

use burn::tensor::{Tensor, TensorData};
use rand::{Rng, RngExt};

use crate::target::{FLOW_UNIT_PX, FlowTarget};

/// Largest error of a taught start, in pixels of the level: less than the cost volume reaches, so it can be found.
const LARGEST_OFFSET: f32 = 3.0;

/// The draws of one forward pass.
pub(crate) struct Teacher<'a> {
    target: &'a FlowTarget,
    levels: Vec<Lesson>,
}

/// One level: which images are taught, and how far off.
struct Lesson {
    taught: Vec<f32>,
    offset_px: Vec<f32>,
}

impl<'a> Teacher<'a> {
    pub(crate) fn draw(target: &'a FlowTarget, images: usize, levels: usize, share: f64, rng: &mut impl Rng) -> Self {
        let lesson = |_| Lesson {
            taught: (0..images).map(|_| f32::from(rng.random::<f64>() < share)).collect(),
            offset_px: (0..2 * images).map(|_| rng.random_range(-LARGEST_OFFSET..LARGEST_OFFSET)).collect(),
        };
        Self { target, levels: (0..levels).map(lesson).collect() }
    }

    /// Replaces the start of taught images by the truth plus an offset, where the truth is known.
    pub(crate) fn guide(&self, start: Tensor<4>, level: usize, factor: usize) -> Tensor<4> {
        let [n, _, h, w] = start.dims();
        let lesson = &self.levels[level];
        if lesson.taught.iter().all(|&t| t == 0.0) {
            return start;
        }
        let device = start.device();
        let tensor =
            |values: &[f32], channels| Tensor::<4>::from_data(TensorData::new(values.to_vec(), [n, channels, 1, 1]), &device);
        let truth = self.target.at_level(factor, h, w);
        let offset = tensor(&lesson.offset_px, 2) * (factor as f32 / FLOW_UNIT_PX);
        let taught = truth.valid * tensor(&lesson.taught, 1);
        start * (taught.clone() * -1.0 + 1.0) + (truth.flow + offset) * taught
    }
}
