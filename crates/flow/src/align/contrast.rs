//! Locally contrast-normalised image pyramids: what alignment compares instead of colours.
//!
//! A light that travels with the camera makes a smooth brightness pattern that stands still in the image while the surface
//! moves. Subtracting the local mean and dividing by the local deviation removes most of it and keeps the texture.

use ops::planes::Planes;

use super::config::PhotometricConfig;
use super::size::Size;

/// Values are clipped here, so that a glint counts no more than an edge.
const CLIP: f32 = 3.0;
/// A neighbourhood whose mean brightness (gamma-encoded) is above this is saturated: what is seen there is the light.
const SATURATED: f32 = 0.93;
/// Images that are saturated nearly everywhere keep their pixels: better little to go by than nothing.
const MOSTLY_SATURATED: f32 = 0.5;
/// Pyramids end before a side becomes shorter than this.
const SMALLEST_SIDE: usize = 24;

/// Contrast-normalised planes of one image at halved sizes.
#[derive(Clone, Debug)]
pub struct ContrastPyramid {
    /// Finest level first; the planes are luminance and, where wanted, two chroma planes. NaN where the image is saturated:
    /// unknown.
    pub levels: Vec<Planes>,
}

impl ContrastPyramid {
    /// Builds the pyramid of a gamma-encoded image (3 planes, or 1 plane of luminance).
    pub fn new(image: &Planes, config: &PhotometricConfig) -> Self {
        let mut opponent = opponent_planes(image, config.chroma);
        let mut levels = vec![normalise(&opponent, config)];
        while opponent.height.min(opponent.width) / 2 >= SMALLEST_SIDE {
            opponent = opponent.resize_area(opponent.height / 2, opponent.width / 2);
            levels.push(normalise(&opponent, config));
        }
        Self { levels }
    }

    /// The size of the finest level.
    pub fn size(&self) -> Size {
        Size::of(&self.levels[0])
    }

    /// The standard deviation of the finest luminance: near 1 on texture, near 0 on a black or even image.
    pub fn texture(&self) -> f64 {
        let plane = self.levels[0].plane(0);
        let known = || plane.iter().filter(|v| !v.is_nan()).map(|&v| f64::from(v));
        let n = known().count().max(1) as f64;
        let mean = known().sum::<f64>() / n;
        (known().map(|v| (v - mean).powi(2)).sum::<f64>() / n).sqrt()
    }
}

/// The finest level of a [`ContrastPyramid`].
pub(super) fn normalised(image: &Planes, config: &PhotometricConfig) -> Planes {
    normalise(&opponent_planes(image, config.chroma), config)
}

/// Luminance and, with a weight, the two colour differences relative to brightness, which shading leaves alone.
fn opponent_planes(image: &Planes, chroma: f32) -> Planes {
    if image.channels < 3 {
        return Planes::from_vec(1, image.height, image.width, image.plane(0).to_vec());
    }
    let (r, g, b) = (image.plane(0), image.plane(1), image.plane(2));
    let luminance = |i: usize| 0.299 * r[i] + 0.587 * g[i] + 0.114 * b[i];
    let mut data: Vec<f32> = (0..image.area()).map(luminance).collect();
    if chroma > 0.0 {
        let relative = |difference: f32, i: usize| difference / (luminance(i) + 0.1);
        data.extend((0..image.area()).map(|i| relative(r[i] - g[i], i)));
        data.extend((0..image.area()).map(|i| relative(b[i] - 0.5 * (r[i] + g[i]), i)));
    }
    Planes::from_vec(data.len() / image.area(), image.height, image.width, data)
}

/// (value − local mean) / (local deviation + floor), clipped; the chroma planes carry their weight.
fn normalise(planes: &Planes, config: &PhotometricConfig) -> Planes {
    let (height, width) = (planes.height, planes.width);
    let mut out = planes.clone();
    let area = planes.area();
    let saturated = saturated(planes, config);
    out.data.chunks_mut(area).enumerate().for_each(|(channel, plane)| {
        let mean = blur(plane, height, width, config.mean_sigma_px);
        plane.iter_mut().zip(&mean).for_each(|(v, m)| *v -= m);
        let squares: Vec<f32> = plane.iter().map(|v| v * v).collect();
        let variance = blur(&squares, height, width, config.contrast_sigma_px);
        let weight = if channel == 0 { 1.0 } else { config.chroma };
        plane.iter_mut().zip(&variance).for_each(|(v, s)| {
            let value = *v / (s.max(0.0).sqrt() + config.contrast_floor);
            *v = if value.is_finite() { weight * value.clamp(-CLIP, CLIP) } else { 0.0 };
        });
        plane.iter_mut().zip(&saturated).filter(|(_, s)| **s).for_each(|(v, _)| *v = f32::NAN);
    });
    out
}

/// The saturated core of a highlight with the border that the normalisation smears it over: the strongest contrast in the
/// image, which doesn't move with the surface.
fn saturated(planes: &Planes, config: &PhotometricConfig) -> Vec<bool> {
    let (height, width) = (planes.height, planes.width);
    let bright = blur(planes.plane(0), height, width, 1.0);
    let core: Vec<f32> = bright.iter().map(|&v| f32::from(v > SATURATED)).collect();
    let share = core.iter().sum::<f32>() / core.len() as f32;
    if share == 0.0 || share > MOSTLY_SATURATED {
        return vec![false; core.len()];
    }
    blur(&core, height, width, config.mean_sigma_px).iter().map(|&v| v > 0.05).collect()
}

/// Separable Gaussian blur; at the border the kernel is cut off and renormalised.
pub fn blur(plane: &[f32], height: usize, width: usize, sigma: f32) -> Vec<f32> {
    let radius = (2.5 * sigma).ceil() as usize;
    let kernel: Vec<f32> = (0..=radius).map(|i| (-0.5 * (i as f32 / sigma).powi(2)).exp()).collect();
    let mut rows = vec![0.0f32; plane.len()];
    // Columns first: whole rows are added with one weight, which vectorises.
    for (y, row) in rows.chunks_mut(width).enumerate() {
        let mut total = 0.0;
        for source in y.saturating_sub(radius)..(y + radius + 1).min(height) {
            let weight = kernel[source.abs_diff(y)];
            total += weight;
            row.iter_mut().zip(&plane[source * width..][..width]).for_each(|(r, s)| *r += weight * s);
        }
        row.iter_mut().for_each(|v| *v /= total);
    }
    let mut out = vec![0.0f32; plane.len()];
    let mut total = vec![0.0f32; width];
    let ones = vec![1.0f32; width];
    add_shifted(&mut total, &ones, &kernel);
    for (out_row, row) in out.chunks_mut(width).zip(rows.chunks(width)) {
        add_shifted(out_row, row, &kernel);
        out_row.iter_mut().zip(&total).for_each(|(v, t)| *v /= t);
    }
    out
}

/// Adds the row's convolution with a symmetric kernel, without values from beyond its ends.
fn add_shifted(out: &mut [f32], row: &[f32], kernel: &[f32]) {
    let width = row.len();
    out.iter_mut().zip(row).for_each(|(o, r)| *o += kernel[0] * r);
    for (shift, &weight) in kernel.iter().enumerate().skip(1).take_while(|(shift, _)| *shift < width) {
        out[shift..].iter_mut().zip(row).for_each(|(o, r)| *o += weight * r);
        out.iter_mut().zip(&row[shift..]).for_each(|(o, r)| *o += weight * r);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn texture(height: usize, width: usize) -> Planes {
        let value = |i: usize| 0.5 + 0.1 * ((i % width) as f32 * 0.9).sin() * ((i / width) as f32 * 0.7).cos();
        Planes::from_vec(1, height, width, (0..height * width).map(value).collect())
    }

    #[test]
    fn blur_keeps_constants_and_matches_a_direct_sum() {
        let (h, w, sigma) = (9, 13, 1.3f32);
        assert!(blur(&vec![0.7; h * w], h, w, sigma).iter().all(|v| (v - 0.7).abs() < 1e-6));
        let image = texture(h, w);
        let blurred = blur(&image.data, h, w, sigma);
        let (mut sum, mut total) = (0.0, 0.0);
        for y in 0..h {
            for x in 0..w {
                let (dy, dx) = (y as f32 - 2.0, x as f32 - 11.0);
                if dy.abs() <= 4.0 && dx.abs() <= 4.0 {
                    let weight = (-(dx * dx + dy * dy) / (2.0 * sigma * sigma)).exp();
                    sum += weight * image.at(0, y, x);
                    total += weight;
                }
            }
        }
        assert!((blurred[2 * w + 11] - sum / total).abs() < 1e-5);
    }

    #[test]
    fn gain_offset_and_smooth_light_hardly_matter() {
        let config = PhotometricConfig::default();
        let plain = texture(64, 64);
        let mut lit = plain.clone();
        for y in 0..64 {
            for x in 0..64 {
                let light = 0.5 + 0.4 * (-((x as f32 - 30.0).powi(2) + (y as f32 - 20.0).powi(2)) / 1800.0).exp();
                lit.set(0, y, x, plain.at(0, y, x) * light + 0.05);
            }
        }
        let (a, b) = (ContrastPyramid::new(&plain, &config), ContrastPyramid::new(&lit, &config));
        let difference: f32 = a.levels[0].data.iter().zip(&b.levels[0].data).map(|(a, b)| (a - b).abs()).sum();
        assert!(difference / (64.0 * 64.0) < 0.1, "{}", difference / 4096.0);
        assert!(a.texture() > 0.7);
        assert_eq!(a.levels.len(), 2);
    }

    #[test]
    fn even_black_and_broken_images_become_zero() {
        let config = PhotometricConfig { chroma: 0.5, ..Default::default() };
        for value in [0.0, 0.4, 1.0, f32::NAN] {
            let pyramid = ContrastPyramid::new(&Planes::constant(32, 32, &[value; 3]), &config);
            assert!(pyramid.texture() < 1e-3, "{value}");
            assert!(pyramid.levels[0].data.iter().all(|v| v.is_finite()));
        }
    }
}
