//! Structural similarity as scikit-image computes it (Wang et al. 2004).

use ops::planes::Planes;
use rayon::prelude::*;

/// Standard deviation of the window in pixels.
const SIGMA: f64 = 1.5;
/// The window ends at 3.5 standard deviations, as in scikit-image: 11 taps.
const RADIUS: usize = 5;
/// (0.01·range)² with a data range of 1.
const C1: f64 = 1e-4;
/// (0.03·range)² with a data range of 1.
const C2: f64 = 9e-4;
/// Images whose window doesn't fit have no SSIM.
pub const SMALLEST_SIDE: usize = 2 * RADIUS + 1;

/// Mean SSIM over all channels and all pixels whose window lies inside, for values in [0, 1]; `None` when the images are smaller
/// than the window or differ in size.
///
/// # Source
/// `skimage.metrics.structural_similarity(a, b, data_range=1, gaussian_weights=True, sigma=1.5, use_sample_covariance=False)`.
pub fn ssim(a: &Planes, b: &Planes) -> Option<f64> {
    let (h, w) = (a.height, a.width);
    let same = (a.channels, h, w) == (b.channels, b.height, b.width);
    if !same || a.channels == 0 || h < SMALLEST_SIDE || w < SMALLEST_SIDE {
        return None;
    }
    let sum: f64 = (0..a.channels).map(|c| plane_ssim(a.plane(c), b.plane(c), w)).sum();
    Some(sum / a.channels as f64)
}

/// (1 − SSIM) / 2.
pub fn dssim(a: &Planes, b: &Planes) -> Option<f64> {
    ssim(a, b).map(|s| (1.0 - s) / 2.0)
}

fn window() -> [f64; SMALLEST_SIDE] {
    let taps: [f64; SMALLEST_SIDE] = std::array::from_fn(|i| (-0.5 * ((i as f64 - RADIUS as f64) / SIGMA).powi(2)).exp());
    let sum: f64 = taps.iter().sum();
    taps.map(|t| t / sum)
}

/// Mean over the window's positions inside one plane of rows of `width` pixels.
fn plane_ssim(a: &[f32], b: &[f32], width: usize) -> f64 {
    let taps = window();
    let height = a.len() / width;
    let (rows, columns) = (height - 2 * RADIUS, width - 2 * RADIUS);
    // Sums per row come back in order, so the result doesn't depend on the number of threads.
    let sums: Vec<f64> = (0..rows)
        .into_par_iter()
        .map(|y| {
            let mut moments = vec![[0.0f64; 5]; width];
            for (k, tap) in taps.iter().enumerate() {
                let row = (y + k) * width;
                for (m, (a, b)) in moments.iter_mut().zip(a[row..row + width].iter().zip(&b[row..row + width])) {
                    let (a, b) = (f64::from(*a), f64::from(*b));
                    let products = [a, b, a * a, b * b, a * b];
                    m.iter_mut().zip(products).for_each(|(m, p)| *m += tap * p);
                }
            }
            (0..columns)
                .map(|x| {
                    let blend = |i: usize| taps.iter().zip(&moments[x..]).map(|(t, m)| t * m[i]).sum::<f64>();
                    let (mean_a, mean_b) = (blend(0), blend(1));
                    let (var_a, var_b) = (blend(2) - mean_a * mean_a, blend(3) - mean_b * mean_b);
                    let covariance = blend(4) - mean_a * mean_b;
                    (2.0 * mean_a * mean_b + C1) * (2.0 * covariance + C2)
                        / ((mean_a * mean_a + mean_b * mean_b + C1) * (var_a + var_b + C2))
                })
                .sum()
        })
        .collect();
    sums.iter().sum::<f64>() / (rows * columns) as f64
}
