//! The maps of a material as a net predicts them (tensors) and as a program measures and writes them (planes).

use burn::tensor::{Device, Tensor};
use ops::planes::Planes;

use crate::direction::unit;
use crate::texel::Texel;

/// Channels of all maps together: normal 3, diffuse 3, roughness 1, specular 3.
pub const CHANNELS: usize = 10;

/// The four maps as tensors.
#[derive(Clone, Debug)]
pub struct Svbrdf {
    /// Unit normals `[N, 3, H, W]`, +x right, +y up, +z to the viewer.
    pub normal: Tensor<4>,
    /// Linear diffuse albedo `[N, 3, H, W]`.
    pub diffuse: Tensor<4>,
    /// Perceptual roughness `[N, 1, H, W]`.
    pub roughness: Tensor<4>,
    /// Linear specular albedo `[N, 3, H, W]`.
    pub specular: Tensor<4>,
}

impl Svbrdf {
    /// \[batch, height, width\].
    pub fn dims(&self) -> [usize; 3] {
        let [n, _, h, w] = self.roughness.dims();
        [n, h, w]
    }

    /// The device of the maps.
    pub fn device(&self) -> Device {
        self.roughness.device()
    }

    /// The maps of every image of the batch, on the CPU.
    pub fn to_images(&self) -> Vec<SvbrdfImage> {
        let maps = self.maps().map(|m| Planes::from_tensor(m.clone().detach()));
        let [normal, diffuse, roughness, specular] = maps;
        let rest = diffuse.into_iter().zip(roughness).zip(specular);
        normal
            .into_iter()
            .zip(rest)
            .map(|(normal, ((diffuse, roughness), specular))| SvbrdfImage { normal, diffuse, roughness, specular })
            .collect()
    }

    /// All maps in one tensor, in the order normal, diffuse, roughness, specular.
    ///
    /// # Shapes
    /// `[N, 10, H, W]`
    pub fn stacked(&self) -> Tensor<4> {
        Tensor::cat(self.maps().map(Clone::clone).to_vec(), 1)
    }

    /// The inverse of [`Svbrdf::stacked`].
    ///
    /// # Panics
    /// If the tensor doesn't have 10 channels.
    pub fn from_stacked(maps: Tensor<4>) -> Self {
        assert_eq!(maps.dims()[1], CHANNELS, "normal 3 + diffuse 3 + roughness 1 + specular 3 channels");
        Self {
            normal: maps.clone().narrow(1, 0, 3),
            diffuse: maps.clone().narrow(1, 3, 3),
            roughness: maps.clone().narrow(1, 6, 1),
            specular: maps.narrow(1, 7, 3),
        }
    }

    /// The same values without their history.
    pub fn detach(self) -> Self {
        self.map(Tensor::detach)
    }

    /// Applies a function to each map.
    pub fn map(self, f: impl Fn(Tensor<4>) -> Tensor<4>) -> Self {
        Self { normal: f(self.normal), diffuse: f(self.diffuse), roughness: f(self.roughness), specular: f(self.specular) }
    }

    /// The maps in the order normal, diffuse, roughness, specular.
    pub fn maps(&self) -> [&Tensor<4>; 4] {
        [&self.normal, &self.diffuse, &self.roughness, &self.specular]
    }
}

/// The four maps of one image on the CPU.
#[derive(Clone, Debug, PartialEq)]
pub struct SvbrdfImage {
    /// Unit normals, 3 channels, +x right, +y up, +z to the viewer.
    pub normal: Planes,
    /// Linear diffuse albedo, 3 channels.
    pub diffuse: Planes,
    /// Perceptual roughness, 1 channel.
    pub roughness: Planes,
    /// Linear specular albedo, 3 channels.
    pub specular: Planes,
}

impl SvbrdfImage {
    /// Maps of one size from a function of (row, column).
    pub fn from_fn(height: usize, width: usize, texel: impl Fn(usize, usize) -> Texel) -> Self {
        let mut maps = Self::constant(height, width, &Texel::matte([0.0; 3]));
        for i in 0..height * width {
            maps.set(i / width, i % width, &texel(i / width, i % width));
        }
        maps
    }

    /// The same reflectance everywhere.
    pub fn constant(height: usize, width: usize, texel: &Texel) -> Self {
        Self {
            normal: Planes::constant(height, width, &texel.normal),
            diffuse: Planes::constant(height, width, &texel.diffuse),
            roughness: Planes::constant(height, width, &[texel.roughness]),
            specular: Planes::constant(height, width, &texel.specular),
        }
    }

    /// Rows of every map.
    pub fn height(&self) -> usize {
        self.roughness.height
    }

    /// Columns of every map.
    pub fn width(&self) -> usize {
        self.roughness.width
    }

    /// The maps in the order normal, diffuse, roughness, specular.
    pub fn maps(&self) -> [&Planes; 4] {
        [&self.normal, &self.diffuse, &self.roughness, &self.specular]
    }

    /// The reflectance at a pixel.
    #[inline]
    pub fn texel(&self, y: usize, x: usize) -> Texel {
        let three = |p: &Planes| std::array::from_fn(|c| p.at(c, y, x));
        Texel {
            normal: three(&self.normal),
            diffuse: three(&self.diffuse),
            roughness: self.roughness.at(0, y, x),
            specular: three(&self.specular),
        }
    }

    /// Sets the reflectance at a pixel.
    #[inline]
    pub fn set(&mut self, y: usize, x: usize, texel: &Texel) {
        for c in 0..3 {
            self.normal.set(c, y, x, texel.normal[c]);
            self.diffuse.set(c, y, x, texel.diffuse[c]);
            self.specular.set(c, y, x, texel.specular[c]);
        }
        self.roughness.set(0, y, x, texel.roughness);
    }

    /// Mean reflectance over the image; the normal is the renormalised mean.
    pub fn mean(&self) -> Texel {
        let mean = |plane: &[f32]| (plane.iter().map(|&v| f64::from(v)).sum::<f64>() / plane.len() as f64) as f32;
        self.reduced(mean)
    }

    /// Median of every channel over the image; the normal is renormalised.
    pub fn median(&self) -> Texel {
        self.reduced(|plane| {
            let mut values = plane.to_vec();
            let middle = values.len() / 2;
            *values.select_nth_unstable_by(middle, f32::total_cmp).1
        })
    }

    fn reduced(&self, f: impl Fn(&[f32]) -> f32) -> Texel {
        let three = |p: &Planes| std::array::from_fn(|c| f(p.plane(c)));
        Texel {
            normal: unit(three(&self.normal)),
            diffuse: three(&self.diffuse),
            roughness: f(self.roughness.plane(0)),
            specular: three(&self.specular),
        }
    }

    /// The rectangle of `height × width` pixels whose upper-left corner is row `y`, column `x`.
    ///
    /// # Panics
    /// If the rectangle leaves the maps.
    pub fn crop(&self, y: usize, x: usize, height: usize, width: usize) -> Self {
        self.each(|p| p.crop(y, x, height, width))
    }

    /// The maps at another resolution: area filter when smaller, bilinear when larger; normals are renormalised.
    pub fn resize(&self, height: usize, width: usize) -> Self {
        let mut resized = self.each(|p| p.resize_area(height, width));
        resized.renormalise();
        resized
    }

    /// Makes every normal a unit vector; a vanished one points to the viewer.
    pub fn renormalise(&mut self) {
        let area = self.normal.area();
        for i in 0..area {
            let n: [f32; 3] = std::array::from_fn(|c| self.normal.data[c * area + i]);
            let usable = n.iter().map(|v| v * v).sum::<f32>() > 1e-12;
            let n = if usable { unit(n) } else { [0.0, 0.0, 1.0] };
            (0..3).for_each(|c| self.normal.data[c * area + i] = n[c]);
        }
    }

    /// A batch of one.
    pub fn to_tensor(&self, device: &Device) -> Svbrdf {
        Self::batch(&[self], device)
    }

    /// Several images of one size.
    ///
    /// # Panics
    /// If there is no image or the sizes differ.
    pub fn batch(images: &[&Self], device: &Device) -> Svbrdf {
        let gather = |map: fn(&Self) -> &Planes| {
            let planes: Vec<&Planes> = images.iter().map(|i| map(i)).collect();
            Planes::batch(&planes, device)
        };
        Svbrdf {
            normal: gather(|i| &i.normal),
            diffuse: gather(|i| &i.diffuse),
            roughness: gather(|i| &i.roughness),
            specular: gather(|i| &i.specular),
        }
    }

    fn each(&self, f: impl Fn(&Planes) -> Planes) -> Self {
        Self { normal: f(&self.normal), diffuse: f(&self.diffuse), roughness: f(&self.roughness), specular: f(&self.specular) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn graded(height: usize, width: usize) -> SvbrdfImage {
        SvbrdfImage::from_fn(height, width, |y, x| Texel {
            normal: unit([0.1 * x as f32, -0.05 * y as f32, 1.0]),
            diffuse: [x as f32 / 10.0, y as f32 / 10.0, 0.5],
            roughness: 0.1 + 0.01 * (x * y) as f32,
            specular: [0.04, 0.02 * x as f32, 0.03],
        })
    }

    #[test]
    fn tensors_round_trip() {
        let device = Device::flex();
        let (a, b) = (graded(3, 5), graded(3, 5).each(|p| p.clone().map(|v| 0.5 * v)));
        let batch = SvbrdfImage::batch(&[&a, &b], &device);
        assert_eq!(batch.dims(), [2, 3, 5]);
        assert_eq!(batch.stacked().dims(), [2, CHANNELS, 3, 5]);
        assert_eq!(Svbrdf::from_stacked(batch.stacked()).to_images(), vec![a, b]);
    }

    #[test]
    fn reductions_and_resizing() {
        let maps = graded(4, 4);
        let (mean, median) = (maps.mean(), maps.median());
        assert!((mean.diffuse[0] - 0.15).abs() < 1e-6 && (mean.diffuse[2] - 0.5).abs() < 1e-6);
        assert!((mean.normal.iter().map(|v| v * v).sum::<f32>() - 1.0).abs() < 1e-6);
        assert!((median.diffuse[0] - 0.2).abs() < 1e-6);
        let small = maps.resize(2, 2);
        assert!((small.diffuse.at(0, 0, 0) - 0.05).abs() < 1e-6);
        let n = small.texel(1, 1).normal;
        assert!((n.iter().map(|v| v * v).sum::<f32>() - 1.0).abs() < 1e-6);
        assert_eq!(SvbrdfImage::constant(2, 3, &mean).texel(1, 2), mean);
        let mut broken = maps.crop(1, 1, 1, 1);
        broken.normal.data = vec![0.0; 3];
        broken.renormalise();
        assert_eq!(broken.texel(0, 0).normal, [0.0, 0.0, 1.0]);
    }
}
