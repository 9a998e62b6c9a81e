//! Images on the CPU: channel-major `f32` planes and boolean masks, and their way to and from tensors.

use burn::tensor::{Device, Tensor, TensorData};
use rayon::prelude::*;

/// An image of `channels` planes, `data[(c · height + y) · width + x]`.
#[derive(Clone, Debug, PartialEq)]
pub struct Planes {
    /// Number of planes.
    pub channels: usize,
    /// Rows.
    pub height: usize,
    /// Columns.
    pub width: usize,
    /// Channel-major values, `channels · height · width` of them.
    pub data: Vec<f32>,
}

impl Planes {
    /// An image of zeros.
    pub fn new(channels: usize, height: usize, width: usize) -> Self {
        Self { channels, height, width, data: vec![0.0; channels * height * width] }
    }

    /// Wraps channel-major values.
    ///
    /// # Panics
    /// If `data` doesn't hold `channels · height · width` values.
    pub fn from_vec(channels: usize, height: usize, width: usize, data: Vec<f32>) -> Self {
        assert_eq!(data.len(), channels * height * width, "planes of {channels}×{height}×{width}");
        Self { channels, height, width, data }
    }

    /// An image whose every pixel is `values` (one value per channel).
    pub fn constant(height: usize, width: usize, values: &[f32]) -> Self {
        let data = values.iter().flat_map(|&v| std::iter::repeat_n(v, height * width)).collect();
        Self { channels: values.len(), height, width, data }
    }

    /// Pixels per plane.
    pub fn area(&self) -> usize {
        self.height * self.width
    }

    /// One plane, row-major.
    pub fn plane(&self, channel: usize) -> &[f32] {
        &self.data[channel * self.area()..][..self.height * self.width]
    }

    /// One plane, row-major, to write to.
    pub fn plane_mut(&mut self, channel: usize) -> &mut [f32] {
        let area = self.area();
        &mut self.data[channel * area..][..area]
    }

    /// The value of a channel at row `y`, column `x`.
    #[inline]
    pub fn at(&self, channel: usize, y: usize, x: usize) -> f32 {
        self.data[(channel * self.height + y) * self.width + x]
    }

    /// Sets the value of a channel at row `y`, column `x`.
    #[inline]
    pub fn set(&mut self, channel: usize, y: usize, x: usize, value: f32) {
        self.data[(channel * self.height + y) * self.width + x] = value;
    }

    /// Bilinear sample of one channel; `None` when a tap with weight would lie outside the image.
    pub fn sample_bilinear(&self, channel: usize, x: f32, y: f32) -> Option<f32> {
        let taps = Taps::inside(x, y, self.height, self.width)?;
        Some(taps.apply(self.plane(channel)))
    }

    /// The rectangle of `height × width` pixels whose upper-left corner is row `y`, column `x`.
    ///
    /// # Panics
    /// If the rectangle leaves the image.
    pub fn crop(&self, y: usize, x: usize, height: usize, width: usize) -> Self {
        assert!(y + height <= self.height && x + width <= self.width, "crop leaves the image");
        let mut data = Vec::with_capacity(self.channels * height * width);
        for c in 0..self.channels {
            for row in y..y + height {
                data.extend_from_slice(&self.plane(c)[row * self.width + x..][..width]);
            }
        }
        Self { channels: self.channels, height, width, data }
    }

    /// The channels of all images in one image.
    ///
    /// # Panics
    /// If there is no image or the sizes differ.
    pub fn stack(images: &[&Planes]) -> Self {
        let (height, width) = (images[0].height, images[0].width);
        assert!(images.iter().all(|i| (i.height, i.width) == (height, width)), "stacked planes differ in size");
        let data = images.iter().flat_map(|i| i.data.iter().copied()).collect();
        Self { channels: images.iter().map(|i| i.channels).sum(), height, width, data }
    }

    /// Applies a function to every value.
    pub fn map(mut self, f: impl Fn(f32) -> f32 + Sync) -> Self {
        self.data.par_chunks_mut(1 << 14).for_each(|chunk| chunk.iter_mut().for_each(|v| *v = f(*v)));
        self
    }

    /// Area-weighted mean over each target pixel's footprint: the filter for making images smaller.
    pub fn resize_area(&self, height: usize, width: usize) -> Self {
        if (height, width) == (self.height, self.width) {
            return self.clone();
        }
        let rows = area_weights(self.height, height);
        let columns = area_weights(self.width, width);
        self.resize_separable(height, width, &rows, &columns)
    }

    /// Bilinear interpolation with half-pixel alignment (the image's *edges* stay where they are), clamped at the border.
    pub fn resize_bilinear(&self, height: usize, width: usize) -> Self {
        if (height, width) == (self.height, self.width) {
            return self.clone();
        }
        let rows = linear_weights(self.height, height);
        let columns = linear_weights(self.width, width);
        self.resize_separable(height, width, &rows, &columns)
    }

    fn resize_separable(&self, height: usize, width: usize, rows: &[Span], columns: &[Span]) -> Self {
        let mut out = Self::new(self.channels, height, width);
        out.data.par_chunks_mut(width).enumerate().for_each(|(i, row)| {
            let (channel, y) = (i / height, i % height);
            let plane = self.plane(channel);
            let mut blended = vec![0.0f32; self.width];
            for (k, &weight) in rows[y].weights.iter().enumerate() {
                let source = &plane[(rows[y].first + k) * self.width..][..self.width];
                blended.iter_mut().zip(source).for_each(|(b, s)| *b += weight * s);
            }
            for (value, span) in row.iter_mut().zip(columns) {
                *value = span.weights.iter().zip(&blended[span.first..]).map(|(w, b)| w * b).sum();
            }
        });
        out
    }

    /// The image as a tensor.
    ///
    /// # Shapes
    /// `[1, channels, height, width]`
    pub fn to_tensor(&self, device: &Device) -> Tensor<4> {
        Self::batch(&[self], device)
    }

    /// Several images of one size as a tensor.
    ///
    /// # Shapes
    /// `[images, channels, height, width]`
    ///
    /// # Panics
    /// If there is no image or the sizes differ.
    pub fn batch(images: &[&Planes], device: &Device) -> Tensor<4> {
        let first = images[0];
        let shape = [images.len(), first.channels, first.height, first.width];
        let mut data = Vec::with_capacity(shape.iter().product());
        for image in images {
            assert_eq!([image.channels, image.height, image.width], shape[1..], "a batch needs one size");
            data.extend_from_slice(&image.data);
        }
        Tensor::from_data(TensorData::new(data, shape), device)
    }

    /// The images of a `[N, C, H, W]` tensor, one each.
    pub fn from_tensor(tensor: Tensor<4>) -> Vec<Self> {
        let [_, channels, height, width] = tensor.dims();
        let data = values(tensor);
        data.chunks_exact(channels * height * width).map(|d| Self::from_vec(channels, height, width, d.to_vec())).collect()
    }
}

/// All values of a tensor in row-major order, on the CPU, as `f32`.
pub fn values<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor.into_data().convert::<f32>().try_into_vec().expect("converted to f32 just above")
}

/// Per-pixel truth: which pixels of an image carry a value.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mask {
    /// Rows.
    pub height: usize,
    /// Columns.
    pub width: usize,
    /// Row-major.
    pub data: Vec<bool>,
}

impl Mask {
    /// A mask with the same value everywhere.
    pub fn new(height: usize, width: usize, value: bool) -> Self {
        Self { height, width, data: vec![value; height * width] }
    }

    /// A mask from a function of (row, column).
    pub fn from_fn(height: usize, width: usize, f: impl Fn(usize, usize) -> bool) -> Self {
        Self { height, width, data: (0..height * width).map(|i| f(i / width, i % width)).collect() }
    }

    /// The value at row `y`, column `x`.
    pub fn at(&self, y: usize, x: usize) -> bool {
        self.data[y * self.width + x]
    }

    /// How many pixels are set.
    pub fn count(&self) -> usize {
        self.data.iter().filter(|&&v| v).count()
    }

    /// The share of pixels that are set; 0 for an empty mask.
    pub fn share(&self) -> f64 {
        self.count() as f64 / self.data.len().max(1) as f64
    }

    /// Pixels set in both.
    ///
    /// # Panics
    /// If the sizes differ.
    pub fn and(&self, other: &Self) -> Self {
        assert_eq!((self.height, self.width), (other.height, other.width), "masks differ in size");
        let data = self.data.iter().zip(&other.data).map(|(&a, &b)| a && b).collect();
        Self { height: self.height, width: self.width, data }
    }

    /// The rectangle of `height × width` pixels whose upper-left corner is row `y`, column `x`.
    pub fn crop(&self, y: usize, x: usize, height: usize, width: usize) -> Self {
        Self::from_fn(height, width, |r, c| self.at(y + r, x + c))
    }

    /// 1 where set, 0 elsewhere.
    pub fn to_planes(&self) -> Planes {
        Planes::from_vec(1, self.height, self.width, self.data.iter().map(|&v| f32::from(v)).collect())
    }

    /// 1 where set, 0 elsewhere.
    ///
    /// # Shapes
    /// `[1, 1, height, width]`
    pub fn to_tensor(&self, device: &Device) -> Tensor<4> {
        self.to_planes().to_tensor(device)
    }
}

/// The four taps of a bilinear sample.
#[derive(Clone, Copy, Debug)]
pub struct Taps {
    index: [usize; 4],
    weight: [f32; 4],
}

impl Taps {
    /// The taps at (x, y), or `None` when a tap with weight lies outside a `height × width` image (NaN counts as outside).
    #[inline]
    pub fn inside(x: f32, y: f32, height: usize, width: usize) -> Option<Self> {
        if !(x >= 0.0 && y >= 0.0 && x <= (width - 1) as f32 && y <= (height - 1) as f32) {
            return None;
        }
        let (x0, y0) = (x as usize, y as usize);
        let (fx, fy) = (x - x0 as f32, y - y0 as f32);
        let (x1, y1) = ((x0 + 1).min(width - 1), (y0 + 1).min(height - 1));
        Some(Self {
            index: [y0 * width + x0, y0 * width + x1, y1 * width + x0, y1 * width + x1],
            weight: [(1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy],
        })
    }

    /// Plane indices of the taps, upper left first, row by row.
    #[inline]
    pub fn indices(&self) -> [usize; 4] {
        self.index
    }

    /// Weights of the taps; they sum to 1.
    #[inline]
    pub fn weights(&self) -> [f32; 4] {
        self.weight
    }

    /// The interpolated value of a plane.
    #[inline]
    pub fn apply(&self, plane: &[f32]) -> f32 {
        (0..4).map(|k| self.weight[k] * plane[self.index[k]]).sum()
    }
}

struct Span {
    first: usize,
    weights: Vec<f32>,
}

fn area_weights(source: usize, target: usize) -> Vec<Span> {
    let scale = source as f64 / target as f64;
    if scale < 1.0 {
        return linear_weights(source, target);
    }
    (0..target)
        .map(|i| {
            let (lo, hi) = (i as f64 * scale, (i + 1) as f64 * scale);
            let (first, last) = (lo.floor() as usize, (hi.ceil() as usize).min(source));
            let cover = |s: usize| ((s + 1) as f64).min(hi) - (s as f64).max(lo);
            Span { first, weights: (first..last).map(|s| (cover(s).max(0.0) / scale) as f32).collect() }
        })
        .collect()
}

fn linear_weights(source: usize, target: usize) -> Vec<Span> {
    let scale = source as f64 / target as f64;
    (0..target)
        .map(|i| {
            let position = ((i as f64 + 0.5) * scale - 0.5).clamp(0.0, (source - 1) as f64);
            let first = (position.floor() as usize).min(source.saturating_sub(2));
            let fraction = (position - first as f64) as f32;
            if source == 1 {
                Span { first: 0, weights: vec![1.0] }
            } else {
                Span { first, weights: vec![1.0 - fraction, fraction] }
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp(h: usize, w: usize) -> Planes {
        Planes::from_vec(1, h, w, (0..h * w).map(|i| (i % w) as f32 + 10.0 * (i / w) as f32).collect())
    }

    #[test]
    fn bilinear_is_exact_on_a_plane_and_refuses_outside() {
        let image = ramp(5, 7);
        assert!((image.sample_bilinear(0, 2.25, 3.5).unwrap() - 37.25).abs() < 1e-5);
        assert_eq!(image.sample_bilinear(0, 6.0, 4.0), Some(46.0));
        assert_eq!(image.sample_bilinear(0, 6.01, 4.0), None);
        assert_eq!(image.sample_bilinear(0, -0.01, 0.0), None);
        assert_eq!(image.sample_bilinear(0, f32::NAN, 0.0), None);
    }

    #[test]
    fn area_resize_keeps_the_mean_and_bilinear_keeps_a_ramp() {
        let image = ramp(12, 9);
        let mean = |p: &Planes| p.data.iter().sum::<f32>() / p.data.len() as f32;
        assert!((mean(&image.resize_area(5, 4)) - mean(&image)).abs() < 1e-3);
        let twice = image.resize_bilinear(24, 18);
        assert!((twice.at(0, 11, 9) - (4.25 + 10.0 * 5.25)).abs() < 1e-4);
        assert_eq!(image.resize_area(12, 9), image);
        assert_eq!(Planes::constant(1, 1, &[3.0]).resize_bilinear(4, 4), Planes::constant(4, 4, &[3.0]));
    }

    #[test]
    fn tensors_and_planes_round_trip() {
        let device = Device::flex();
        let (a, b) = (ramp(3, 4), ramp(3, 4).map(|v| -v));
        let back = Planes::from_tensor(Planes::batch(&[&a, &b], &device));
        assert_eq!(back, vec![a.clone(), b]);
        assert_eq!(a.crop(1, 2, 2, 2).data, vec![12.0, 13.0, 22.0, 23.0]);
    }
}
