//! A start for the last layer: the weights whose albedo logits are nearest to those of known maps, in the sense of least squares.
//!
//! Only the albedos: what colours say about them holds for any material, while what they say about roughness and normals in a few
//! dozen materials is chance (measured: roughness began 12 % worse than its median and stayed behind for hundreds of steps).

use nalgebra::{DMatrix, DVector};
use ops::planes::Planes;
use render::svbrdf::SvbrdfImage;

/// Target outputs come no nearer to ±1 than this: a logit grows without bound there and a few pixels would outweigh the rest.
const LARGEST_OUTPUT: f32 = 0.95;
/// Pixels per row and column of an exemplar that enter the fit, at most.
const SAMPLES: usize = 48;
/// Ridge, as a share of the inputs' mean square: unsure directions stay near 0.
const RIDGE: f64 = 1e-2;
/// Taps of the last layer's filters.
const TAPS: usize = 9;

/// The outputs that are fitted: diffuse ×3 and specular ×3.
pub(super) const ALBEDOS: [usize; 6] = [2, 3, 4, 6, 7, 8];

/// The last layer's rows for [`ALBEDOS`].
pub(super) struct AlbedoRows {
    /// `[6, C, 3, 3]`, row-major.
    pub weight: Vec<f32>,
    /// `[6]`
    pub bias: Vec<f32>,
}

/// Sums of products over samples, from which the last layer is solved.
pub(super) struct LeastSquares {
    channels: usize,
    /// XᵀX of the inputs and a constant 1.
    products: DMatrix<f64>,
    /// XᵀY with the target logits.
    responses: DMatrix<f64>,
}

impl LeastSquares {
    /// A fit for a last layer of `channels` inputs.
    pub fn new(channels: usize) -> Self {
        let n = channels * TAPS + 1;
        Self { channels, products: DMatrix::zeros(n, n), responses: DMatrix::zeros(n, ALBEDOS.len()) }
    }

    /// Adds an exemplar: what the last layer reads and the maps that it should answer with.
    pub fn add(&mut self, inputs: &Planes, target: &SvbrdfImage) {
        let (h, w) = (inputs.height, inputs.width);
        let n = self.channels * TAPS + 1;
        let places = |length: usize| (0..length).step_by(length.div_ceil(SAMPLES));
        let pixels: Vec<(usize, usize)> = places(h).flat_map(|y| places(w).map(move |x| (y, x))).collect();
        let mut x = DMatrix::<f64>::zeros(n, pixels.len());
        let mut y = DMatrix::<f64>::zeros(ALBEDOS.len(), pixels.len());
        for (i, &(row, column)) in pixels.iter().enumerate() {
            let mut sample = x.column_mut(i);
            for c in 0..self.channels {
                for tap in 0..TAPS {
                    // Edge padding, as in the convolution.
                    let (r, k) =
                        ((row + tap / 3).saturating_sub(1).min(h - 1), (column + tap % 3).saturating_sub(1).min(w - 1));
                    sample[c * TAPS + tap] = f64::from(inputs.at(c, r, k));
                }
            }
            sample[n - 1] = 1.0;
            y.set_column(
                i,
                &DVector::from_iterator(ALBEDOS.len(), target_logits(target, row, column).into_iter().map(f64::from)),
            );
        }
        self.products += &x * x.transpose();
        self.responses += &x * y.transpose();
    }

    /// The rows, or `None` without samples.
    pub fn solve(mut self) -> Option<AlbedoRows> {
        let n = self.products.nrows();
        let samples = self.products[(n - 1, n - 1)];
        if samples == 0.0 {
            return None;
        }
        let mean_square = (0..n - 1).map(|i| self.products[(i, i)]).sum::<f64>() / (n - 1).max(1) as f64;
        // The bias is free.
        (0..n - 1).for_each(|i| self.products[(i, i)] += RIDGE * mean_square + f64::MIN_POSITIVE.sqrt());
        let solution = self.products.cholesky()?.solve(&self.responses);
        let weight = (0..ALBEDOS.len()).flat_map(|o| (0..n - 1).map(move |i| (i, o))).map(|at| solution[at] as f32).collect();
        let bias = (0..ALBEDOS.len()).map(|o| solution[(n - 1, o)] as f32).collect();
        Some(AlbedoRows { weight, bias })
    }
}

/// The logits that decode to the albedos at a pixel.
fn target_logits(maps: &SvbrdfImage, y: usize, x: usize) -> [f32; ALBEDOS.len()] {
    let logit = |albedo: f32| (2.0 * albedo - 1.0).clamp(-LARGEST_OUTPUT, LARGEST_OUTPUT).atanh();
    std::array::from_fn(|i| logit(if i < 3 { &maps.diffuse } else { &maps.specular }.at(i % 3, y, x)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use render::texel::Texel;

    #[test]
    fn a_linear_relation_is_found_again() {
        // One input whose centre pixel is the diffuse albedo's logit.
        let values: Vec<f32> = (0..64 * 64).map(|i| ((i * 7919) % 1000) as f32 / 1000.0 - 0.5).collect();
        let inputs = Planes::from_vec(1, 64, 64, values.clone());
        let grey = Texel { normal: [0.0, 0.0, 1.0], diffuse: [0.5; 3], roughness: 0.3, specular: [0.04; 3] };
        let mut target = SvbrdfImage::constant(64, 64, &grey);
        (0..3).for_each(|c| {
            target.diffuse.plane_mut(c).iter_mut().zip(&values).for_each(|(d, v)| *d = 0.5 + 0.5 * (0.8 * v + 0.1).tanh());
        });
        let mut fit = LeastSquares::new(1);
        fit.add(&inputs, &target);
        let layer = fit.solve().expect("there are samples");
        let diffuse = &layer.weight[..TAPS];
        assert!((diffuse[4] - 0.8).abs() < 0.02 && (layer.bias[0] - 0.1).abs() < 0.01, "{diffuse:?} {:?}", layer.bias);
        assert!(diffuse.iter().enumerate().all(|(tap, w)| tap == 4 || w.abs() < 0.02));
        // A constant map needs no input.
        assert!(layer.weight[3 * TAPS..].iter().all(|w| w.abs() < 1e-6));
        assert!((layer.bias[3] - (2.0f32 * 0.04 - 1.0).atanh()).abs() < 1e-3);
    }

    #[test]
    fn without_samples_there_is_no_layer() {
        assert!(LeastSquares::new(3).solve().is_none());
    }
}
