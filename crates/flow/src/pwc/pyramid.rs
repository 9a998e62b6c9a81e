//! From images to a pyramid of features: input normalisation, the convolutions, and normalisation before matching.

use burn::{
    module::Module,
    tensor::{Device, Tensor, module::avg_pool2d, ops::AvgPoolOptions, ops::PadMode},
};
use rand::Rng;

use super::{Conv, Input};

/// Half the side of the window of the local contrast, in pixels.
const CONTRAST_RADIUS: usize = 8;
/// Contrast below which an area counts as flat instead of being amplified.
const CONTRAST_FLOOR: f32 = 0.02;
/// Largest normalised contrast.
const CONTRAST_LIMIT: f32 = 3.0;
/// Keeps the feature normalisation finite on constant images.
const FEATURE_FLOOR: f32 = 1e-3;

/// The convolutions of all levels, finest first. Both images pass through the same weights.
#[derive(Module, Debug)]
pub struct Pyramid {
    levels: Vec<Level>,
}

#[derive(Module, Debug)]
struct Level {
    convs: Vec<Conv>,
}

impl Pyramid {
    pub(crate) fn new(channels: &[usize], convs_per_level: usize, device: &Device, rng: &mut impl Rng) -> Self {
        let mut inputs = 3;
        let levels = channels
            .iter()
            .map(|&outputs| {
                let mut convs = vec![Conv::new(inputs, outputs, device, rng).halving()];
                convs.extend((1..convs_per_level).map(|_| Conv::new(outputs, outputs, device, rng)));
                inputs = outputs;
                Level { convs }
            })
            .collect();
        Self { levels }
    }

    /// # Shapes
    /// `[N, 3, H, W]` → level `l`: `[N, channels[l], H / 2^(l + 1), W / 2^(l + 1)]`, finest first.
    pub fn forward(&self, images: Tensor<4>) -> Vec<Tensor<4>> {
        let mut x = images;
        self.levels
            .iter()
            .map(|level| {
                x = level.convs.iter().fold(x.clone(), |x, conv| conv.forward(x));
                x.clone()
            })
            .collect()
    }
}

/// Prepares gamma-encoded RGB in \[0, 1\] for the pyramid.
///
/// # Shapes
/// `[N, 3, H, W]` → the same.
pub(crate) fn prepare(images: Tensor<4>, input: Input) -> Tensor<4> {
    match input {
        Input::Plain => images,
        Input::LocalContrast => local_contrast(images),
    }
}

/// Deviation from the local mean over the local deviation: shading and exposure leave, texture stays.
fn local_contrast(images: Tensor<4>) -> Tensor<4> {
    let deviation = images.clone() - local_mean(images);
    let energy = local_mean(deviation.clone().powi_scalar(2).mean_dim(1));
    (deviation / (energy.sqrt() + CONTRAST_FLOOR)).clamp(-CONTRAST_LIMIT, CONTRAST_LIMIT)
}

/// Mean over a square window; the border repeats.
fn local_mean(x: Tensor<4>) -> Tensor<4> {
    let (r, side) = (CONTRAST_RADIUS, 2 * CONTRAST_RADIUS + 1);
    let window = |kernel: [usize; 2]| AvgPoolOptions::new(kernel).with_stride([1, 1]);
    let padded = x.pad((r, r, r, r), PadMode::Edge);
    avg_pool2d(avg_pool2d(padded, window([1, side])), window([side, 1]))
}

/// Features of comparable scale for the cost volume: per image without mean, per pair and channel of unit deviation, per
/// pixel of unit length.
///
/// Without it the correlation of a freshly initialised net is dominated by what all pixels share, and matching isn't learnt
/// for a long time.
///
/// # Shapes
/// `[2N, C, H, W]`, the N first images before the N second ones → the same.
pub(crate) fn normalise(features: Tensor<4>) -> Tensor<4> {
    let [images, c, ..] = features.dims();
    let centred = features.clone() - features.mean_dims(&[2, 3]);
    let variance = centred.clone().powi_scalar(2).mean_dims(&[2, 3]).reshape([2, images / 2, c]).mean_dim(0);
    let deviation = (variance.repeat_dim(0, 2) + 1e-12).sqrt().reshape([images, c, 1, 1]);
    let scaled = centred / (deviation + FEATURE_FLOOR);
    let length = (scaled.clone().powi_scalar(2).mean_dim(1) + FEATURE_FLOOR).sqrt();
    scaled / length
}
