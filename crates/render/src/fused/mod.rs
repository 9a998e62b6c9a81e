//! The rendering losses with their gradient in one pass over the pixels, on the CPU.
//!
//! Fifteen renderings by tensors write some hundred images each and read them again backwards; here every pixel's loss and
//! its derivatives with respect to the ten map channels are computed while the pixel is in registers. The result joins the
//! autodiff graph as Σ maps·G with the constant gradient G, so it works on any device and keeps its meaning: it equals
//! [`crate::loss::rendering_losses`] in value and gradient.

mod block;
mod lobe;

use burn::tensor::{Tensor, TensorData};
use ops::planes::{Planes, values};
use rayon::prelude::*;

use crate::brdf::{BrdfModel, DiffuseModel, SpecularModel};
use crate::loss::RenderingLosses;
use crate::svbrdf::{CHANNELS, Svbrdf, SvbrdfImage};
use crate::views::{LossViews, View, plane_x, plane_y};
use block::{Geometry, LANES, Lane, Maps};

/// Mean of |ln(R + 0.1) − ln(R* + 0.1)| over views, pixels and channels, and its gradient.
#[derive(Clone, Debug)]
pub struct LogDifference {
    /// The mean.
    pub value: f64,
    /// Its derivative with respect to each channel of the prediction: normal, diffuse, roughness, specular.
    ///
    /// # Shapes
    /// 10 channels. The normal's is with respect to its three components as given, without renormalisation.
    pub gradient: Planes,
}

/// Map channels of one image, row-major planes, wherever they are stored.
#[derive(Clone, Copy)]
struct Channels<'a> {
    planes: [&'a [f32]; CHANNELS],
    height: usize,
    width: usize,
}

impl<'a> Channels<'a> {
    fn of(maps: &'a SvbrdfImage) -> Self {
        let [n, d, r, s] = maps.maps();
        let planes = std::array::from_fn(|c| match c {
            0..3 => n.plane(c),
            3..6 => d.plane(c - 3),
            6 => r.plane(0),
            _ => s.plane(c - 7),
        });
        Self { planes, height: maps.height(), width: maps.width() }
    }

    /// The maps of `LANES` pixels from `column` on; past the row's end the last pixel is repeated.
    #[inline(always)]
    fn load(&self, row: usize, column: usize) -> Maps {
        let used = LANES.min(self.width - column);
        let mut maps = [[0.0; LANES]; CHANNELS];
        for (lane, plane) in maps.iter_mut().zip(self.planes) {
            let pixels = &plane[row * self.width + column..][..used];
            lane[..used].copy_from_slice(pixels);
            lane[used..].fill(pixels[used - 1]);
        }
        maps
    }
}

#[inline(always)]
fn lane_x(column: usize, width: usize) -> Lane {
    std::array::from_fn(|k| plane_x((column + k).min(width - 1), width))
}

/// Runs a row kernel with the widest vectors that this machine has. The kernels use no fused multiply-add, so the bits are
/// the same either way.
macro_rules! dispatch {
    ($kernel:ident, $wide:ident, ($($name:ident : $kind:ty),*) -> $result:ty) => {
        #[cfg(target_arch = "x86_64")]
        #[target_feature(enable = "avx2")]
        fn $wide<const CLAMPED: bool, const INRIA: bool>($($name: $kind),*) -> $result {
            $kernel::kernel::<CLAMPED, INRIA>($($name),*)
        }

        fn $kernel(model: BrdfModel, $($name: $kind),*) -> $result {
            #[cfg(target_arch = "x86_64")]
            if is_x86_feature_detected!("avx2") {
                // SAFETY: the processor has AVX2, the only feature that the callee enables.
                return unsafe {
                    match (model.specular, model.diffuse) {
                        (SpecularModel::Ggx, DiffuseModel::Lambert) => $wide::<false, false>($($name),*),
                        (SpecularModel::Ggx, DiffuseModel::Inria) => $wide::<false, true>($($name),*),
                        (SpecularModel::GgxClamped, DiffuseModel::Lambert) => $wide::<true, false>($($name),*),
                        (SpecularModel::GgxClamped, DiffuseModel::Inria) => $wide::<true, true>($($name),*),
                    }
                };
            }
            match (model.specular, model.diffuse) {
                (SpecularModel::Ggx, DiffuseModel::Lambert) => $kernel::kernel::<false, false>($($name),*),
                (SpecularModel::Ggx, DiffuseModel::Inria) => $kernel::kernel::<false, true>($($name),*),
                (SpecularModel::GgxClamped, DiffuseModel::Lambert) => $kernel::kernel::<true, false>($($name),*),
                (SpecularModel::GgxClamped, DiffuseModel::Inria) => $kernel::kernel::<true, true>($($name),*),
            }
        }
    };
}

dispatch!(
    loss_row,
    loss_row_wide,
    (pred: &Channels, target: &Channels, views: &[View], row: usize, gradient: &mut [f32]) -> f64
);

mod loss_row {
    use super::*;

    /// One row's sum of log differences; its derivatives go to `gradient`, channel after channel.
    #[inline(always)]
    pub fn kernel<const CLAMPED: bool, const INRIA: bool>(
        pred: &Channels,
        target: &Channels,
        views: &[View],
        row: usize,
        gradient: &mut [f32],
    ) -> f64 {
        let width = pred.width;
        let y = plane_y(row, pred.height);
        let mut total = 0.0;
        for column in (0..width).step_by(LANES) {
            let (mut loss, mut slope) = ([0.0; LANES], [[0.0; LANES]; CHANNELS]);
            let (p, t, x) = (pred.load(row, column), target.load(row, column), lane_x(column, width));
            block::accumulate::<CLAMPED, INRIA>(&p, &t, views, (&x, y), &mut loss, &mut slope);
            let used = LANES.min(width - column);
            total += loss[..used].iter().map(|&l| f64::from(l)).sum::<f64>();
            for (lane, out) in slope.iter().zip(gradient.chunks_exact_mut(width)) {
                out[column..column + used].copy_from_slice(&lane[..used]);
            }
        }
        total
    }
}

dispatch!(radiance_row, radiance_row_wide, (maps: &Channels, view: &View, row: usize, out: &mut [f32]) -> ());

mod radiance_row {
    use super::*;

    /// One row of linear radiance, RGB one channel after the other.
    #[inline(always)]
    pub fn kernel<const CLAMPED: bool, const INRIA: bool>(maps: &Channels, view: &View, row: usize, out: &mut [f32]) {
        let width = maps.width;
        let y = plane_y(row, maps.height);
        let mut geometry = Geometry::empty();
        for column in (0..width).step_by(LANES) {
            let mut rgb = [[0.0; LANES]; 3];
            let (m, x) = (maps.load(row, column), lane_x(column, width));
            block::radiance::<CLAMPED, INRIA>(&m, view, (&x, y), &mut geometry, &mut rgb);
            let used = LANES.min(width - column);
            for (lane, out) in rgb.iter().zip(out.chunks_exact_mut(width)) {
                out[column..column + used].copy_from_slice(&lane[..used]);
            }
        }
    }
}

/// Rows of `channels × width` values to planes.
fn to_planes(rows: &[f32], channels: usize, height: usize, width: usize, scale: f32) -> Planes {
    let mut planes = Planes::new(channels, height, width);
    planes.data.par_chunks_mut(width).enumerate().for_each(|(i, out)| {
        let (channel, row) = (i / height, i % height);
        let values = &rows[(row * channels + channel) * width..][..width];
        out.iter_mut().zip(values).for_each(|(o, v)| *o = v * scale);
    });
    planes
}

/// The mean log difference between renderings of two images' maps, with its gradient.
///
/// Rows are summed in order, so the result doesn't depend on the number of threads.
///
/// # Panics
/// If the sizes differ or `views` is empty.
pub fn log_difference(pred: &SvbrdfImage, target: &SvbrdfImage, views: &[View], model: BrdfModel) -> LogDifference {
    channel_difference(Channels::of(pred), Channels::of(target), views, model)
}

fn channel_difference(pred: Channels, target: Channels, views: &[View], model: BrdfModel) -> LogDifference {
    let (height, width) = (pred.height, pred.width);
    assert_eq!((height, width), (target.height, target.width), "prediction and target differ in size");
    assert!(!views.is_empty(), "a loss needs at least one view");
    let mut rows = vec![0.0; CHANNELS * height * width];
    let sums: Vec<f64> = rows
        .par_chunks_mut(CHANNELS * width)
        .enumerate()
        .map(|(row, gradient)| loss_row(model, &pred, &target, views, row, gradient))
        .collect();
    let count = (views.len() * 3 * height * width) as f64;
    let gradient = to_planes(&rows, CHANNELS, height, width, (1.0 / count) as f32);
    LogDifference { value: sums.iter().sum::<f64>() / count, gradient }
}

/// Linear radiance of the maps in one view, RGB.
pub fn render(maps: &SvbrdfImage, view: &View, model: BrdfModel) -> Planes {
    let channels = Channels::of(maps);
    let (height, width) = (channels.height, channels.width);
    let mut rows = vec![0.0; 3 * height * width];
    let chunks = rows.par_chunks_mut(3 * width).enumerate();
    chunks.for_each(|(row, out)| radiance_row(model, &channels, view, row, out));
    to_planes(&rows, 3, height, width, 1.0)
}

/// L_r and L_t, differentiable with respect to the predicted maps.
///
/// # Panics
/// If the batches or sizes differ or a list of views is empty.
///
/// # Source
/// Paper §6; see [`crate::loss`].
pub fn rendering_losses(pred: &Svbrdf, target: &Svbrdf, views: &LossViews, model: BrdfModel) -> RenderingLosses {
    assert_eq!(pred.dims(), target.dims(), "prediction and target differ in batch or size");
    let [batch, height, width] = pred.dims();
    let (pred_values, target_values) = (planes_of(pred), planes_of(target));
    let one = |list: &[View]| {
        let mut value = 0.0;
        let mut gradient = Vec::with_capacity(batch * CHANNELS * height * width);
        for image in 0..batch {
            let p = Channels { planes: slices(&pred_values, image, height, width), height, width };
            let t = Channels { planes: slices(&target_values, image, height, width), height, width };
            let difference = channel_difference(p, t, list, model);
            value += difference.value / batch as f64;
            gradient.extend(difference.gradient.data.iter().map(|g| g / batch as f32));
        }
        (attach(pred, value, gradient), value)
    };
    let (rendering, rendering_value) = one(&views.rendering);
    let (top, top_value) = one(&views.top);
    RenderingLosses { rendering, top, rendering_value, top_value }
}

fn planes_of(maps: &Svbrdf) -> [Vec<f32>; 4] {
    maps.maps().map(|m| values(m.clone().detach()))
}

fn slices(maps: &[Vec<f32>; 4], image: usize, height: usize, width: usize) -> [&[f32]; CHANNELS] {
    let area = height * width;
    std::array::from_fn(|c| {
        let (map, channel, channels) = match c {
            0..3 => (0, c, 3),
            3..6 => (1, c - 3, 3),
            6 => (2, 0, 1),
            _ => (3, c - 7, 3),
        };
        &maps[map][(image * channels + channel) * area..][..area]
    })
}

/// A scalar of the given value whose gradient with respect to the maps is the given constant: Σ maps·G, shifted.
fn attach(pred: &Svbrdf, value: f64, gradient: Vec<f32>) -> Tensor<1> {
    let [batch, height, width] = pred.dims();
    let shape = [batch, CHANNELS, height, width];
    // The constant is made on the maps' own device; it has no history, so nothing flows into it.
    let slope = Svbrdf::from_stacked(Tensor::from_data(TensorData::new(gradient, shape), &pred.device()));
    let products = pred.maps().into_iter().zip(slope.maps()).map(|(m, g)| (m.clone() * g.clone()).sum());
    let linear = products.reduce(|a, b| a + b).expect("four maps");
    linear.clone() - linear.detach() + value as f32
}
