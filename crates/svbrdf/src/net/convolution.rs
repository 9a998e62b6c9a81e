//! The one convolution of the net: 3×3, edge padding, no bias, normalised (paper Eq. 5).

use burn::module::{Module, Param};
use burn::tensor::{Device, Tensor, TensorData};
use ops::conv::{Conv3x3, Padding, conv3x3};
use ops::filters::normalised_filters;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};

use super::{Normalisation, SvbrdfNetConfig};

/// Standard deviation of the initial filters (spec 4.1).
const INITIAL_STD: f32 = 0.02;
/// Added to an instance's variance.
const VARIANCE_EPSILON: f32 = 1e-5;

/// A parameter of independent Gaussian values.
pub(super) fn gaussian<const D: usize>(shape: [usize; D], std: f32, device: &Device, rng: &mut ChaCha8Rng) -> Param<Tensor<D>> {
    let normal = Normal::new(0.0, std).expect("initial standard deviations are finite constants");
    let values: Vec<f32> = (0..shape.iter().product()).map(|_| normal.sample(rng)).collect();
    Param::from_data(TensorData::new(values, shape), device)
}

/// A parameter with one value everywhere.
pub(super) fn filled<const D: usize>(shape: [usize; D], value: f32, device: &Device) -> Param<Tensor<D>> {
    Param::from_tensor(Tensor::full(shape, value, device))
}

/// Learned scale and offset after an instance normalisation.
#[derive(Module, Debug)]
pub struct Affine {
    scale: Param<Tensor<1>>,
    offset: Param<Tensor<1>>,
}

/// A normalised 3×3 convolution.
#[derive(Module, Debug)]
pub struct Convolution {
    /// Filters before normalisation, `[out, in, 3, 3]`.
    weight: Param<Tensor<4>>,
    /// Present for [`Normalisation::Instance`].
    affine: Option<Affine>,
    /// Norm of every filter under weight normalisation.
    gain: f32,
}

/// What a convolution hands on.
pub struct Response {
    /// `[N, out, H, W]`, normalised.
    pub maps: Tensor<4>,
    /// `[N, out]`, mean over the pixels before any instance normalisation: what the global track keeps.
    pub means: Tensor<2>,
}

impl Convolution {
    /// Draws a convolution from `inputs` to `outputs` channels.
    pub(super) fn init(inputs: usize, outputs: usize, config: &SvbrdfNetConfig, device: &Device, rng: &mut ChaCha8Rng) -> Self {
        let affine = match config.normalisation {
            Normalisation::Weight => None,
            Normalisation::Instance => {
                Some(Affine { scale: filled([outputs], 1.0, device), offset: filled([outputs], 0.0, device) })
            }
        };
        Self { weight: gaussian([outputs, inputs, 3, 3], INITIAL_STD, device, rng), affine, gain: config.filter_gain }
    }

    /// The filters that convolve: each of unit norm under weight normalisation.
    ///
    /// # Source
    /// Paper Eq. 5.
    pub fn filters(&self) -> Tensor<4> {
        let weight = self.weight.val();
        if self.affine.is_some() { weight } else { normalised_filters(weight, self.gain) }
    }

    /// Enlarges every pixel to a block of 2×2, convolves and normalises the upper-left `height × width` pixels: an odd level is
    /// one pixel smaller than twice the next one.
    ///
    /// # Shapes
    /// `[N, in, H, W]` → `[N, out, height, width]`
    pub fn enlarge(&self, x: Tensor<4>, [height, width]: [usize; 2]) -> Tensor<4> {
        // Cut off afterwards: what is cut off shows the same as what the border would repeat.
        let raw = conv3x3(x, self.filters(), Conv3x3::enlarging(Padding::Edge));
        let [n, c, h, w] = raw.dims();
        self.normalised(if (h, w) == (height, width) { raw } else { raw.slice([0..n, 0..c, 0..height, 0..width]) })
    }

    /// Convolves, normalises and keeps the means of the convolution's output.
    ///
    /// # Shapes
    /// `[N, in, H, W]` → `[N, out, ceil(H / stride), ceil(W / stride)]`
    pub fn respond(&self, x: Tensor<4>, geometry: Conv3x3) -> Response {
        let raw = conv3x3(x, self.filters(), geometry);
        Response { means: channel_means(raw.clone()), maps: self.normalised(raw) }
    }

    fn normalised(&self, raw: Tensor<4>) -> Tensor<4> {
        match &self.affine {
            Some(affine) => affine.normalise(raw),
            None => raw,
        }
    }

    /// The filters before normalisation: what the optimiser moves.
    pub fn parameter(&self) -> Tensor<4> {
        self.weight.val()
    }

    /// Parameters of the filters.
    pub fn filter_parameters(&self) -> usize {
        self.weight.lazy_shape().num_elements()
    }
}

impl Affine {
    /// Zero mean and unit variance per frame and channel, then scale and offset.
    ///
    /// A map of a single pixel has no variance; its value passes unnormalised, as in Deschaintre et al.'s innermost layer.
    fn normalise(&self, x: Tensor<4>) -> Tensor<4> {
        let [n, c, h, w] = x.dims();
        let x = x.reshape([n, c, h * w]);
        let x = if h * w > 1 {
            let centred = x.clone() - x.mean_dim(2);
            let deviation = centred.clone().square().mean_dim(2).add_scalar(VARIANCE_EPSILON).sqrt();
            centred / deviation
        } else {
            x
        };
        let x = x * self.scale.val().reshape([1, c, 1]) + self.offset.val().reshape([1, c, 1]);
        x.reshape([n, c, h, w])
    }
}

/// Mean over the pixels.
///
/// # Shapes
/// `[N, C, H, W]` → `[N, C]`
pub(super) fn channel_means(x: Tensor<4>) -> Tensor<2> {
    let [n, c, h, w] = x.dims();
    x.reshape([n, c, h * w]).mean_dim(2).reshape([n, c])
}
