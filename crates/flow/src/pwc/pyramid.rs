//! From images to a pyramid of features: input normalisation, the convolutions, and normalisation before matching.

use burn::{
    module::Module,
    tensor::{Device, Tensor, TensorData},
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
    let [n, c, h, w] = x.dims();
    let device = x.device();
    let along_rows = x.reshape([n * c * h, w]).matmul(window_matrix(w, &device));
    let down_columns = along_rows.reshape([n * c, h, w]).swap_dims(1, 2).reshape([n * c * w, h]);
    let mean = down_columns.matmul(window_matrix(h, &device));
    mean.reshape([n * c, w, h]).swap_dims(1, 2).reshape([n, c, h, w])
}

/// A line times this matrix is the line's moving mean: far quicker than pooling, whose cost grows with the window.
fn window_matrix(length: usize, device: &Device) -> Tensor<2> {
    let side = 2 * CONTRAST_RADIUS + 1;
    let mut weights = vec![0.0f32; length * length];
    for to in 0..length {
        for tap in 0..side {
            let from = (to + tap).saturating_sub(CONTRAST_RADIUS).min(length - 1);
            weights[from * length + to] += 1.0 / side as f32;
        }
    }
    Tensor::from_data(TensorData::new(weights, [length, length]), device)
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

#[cfg(test)]
mod tests {
    use super::*;
    use burn::tensor::{module::avg_pool2d, ops::AvgPoolOptions, ops::PadMode};
    use ops::planes::values;

    fn waves(shape: [usize; 4]) -> Tensor<4> {
        let count = shape.iter().product();
        let wave = |i: usize| ((i * 37 % 101) as f32 * 0.7).sin() * 0.5 + 0.5;
        Tensor::from_data(TensorData::new((0..count).map(wave).collect(), shape), &Device::flex())
    }

    fn largest_difference(a: Tensor<4>, b: Tensor<4>) -> f32 {
        values((a - b).abs().max())[0]
    }

    #[test]
    fn the_local_mean_is_a_pooling_with_repeated_border() {
        let x = waves([2, 3, 20, 13]);
        let (r, side) = (CONTRAST_RADIUS, 2 * CONTRAST_RADIUS + 1);
        let options = AvgPoolOptions::new([side, side]).with_stride([1, 1]);
        let pooled = avg_pool2d(x.clone().pad((r, r, r, r), PadMode::Edge), options);
        assert!(largest_difference(local_mean(x), pooled) < 1e-5);
    }

    #[test]
    fn local_contrast_forgets_exposure_and_keeps_flat_areas_flat() {
        let x = waves([1, 3, 32, 32]);
        let (bright, dark) = (local_contrast(x.clone() + 3.0), local_contrast(x));
        assert!(largest_difference(bright, dark) < 1e-3);
        let flat = local_contrast(Tensor::full([1, 3, 16, 16], 0.7, &Device::flex()));
        assert!(values(flat.abs().max())[0] < 1e-4);
    }

    #[test]
    fn normalised_features_have_unit_length_and_know_only_their_pair() {
        let features = waves([4, 6, 9, 7]) * 5.0;
        let normalised = normalise(features.clone());
        let length = values(normalised.clone().powi_scalar(2).mean_dim(1));
        assert!(length.iter().all(|l| (0.8..1.0).contains(l)), "{length:?}");
        // The first pair alone gives what it gave in the batch of two.
        let pick = |t: &Tensor<4>, i: usize| t.clone().slice([i..i + 1, 0..6, 0..9, 0..7]);
        let alone = normalise(Tensor::cat(vec![pick(&features, 0), pick(&features, 2)], 0));
        let batched = Tensor::cat(vec![pick(&normalised, 0), pick(&normalised, 2)], 0);
        assert!(largest_difference(alone, batched) < 1e-5);
        let constant = normalise(Tensor::full([2, 4, 5, 5], 2.0, &Device::flex()));
        assert!(values(constant.abs().max())[0] < 1e-3);
    }
}
