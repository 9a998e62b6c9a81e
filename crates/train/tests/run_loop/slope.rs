//! A stage whose gradients are known: loss = c·w for one weight w, with c = 1, 2, 3 … batch by batch.

use burn::module::{Module, Param};
use burn::tensor::{Device, Tensor};
use ops::conv::{Conv3x3, Padding, conv3x3};
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;
use train::config::{Adam, Optimisation};
use train::guard::Array;
use train::stage::{Losses, Make, Moment, Picture, Stage, StageError};

#[derive(Module, Debug)]
pub struct Weight {
    pub weight: Param<Tensor<1>>,
}

pub struct Slope {
    pub steps: usize,
    pub plan: Optimisation,
}

impl Slope {
    /// A step moves the weight by `rate` times the gradient: an Adam that remembers nothing and whose ε dwarfs the gradient.
    pub fn plan(rate: f64, accumulate: usize, ema: f64) -> Optimisation {
        let adam = Adam { beta1: 0.0, beta2: 0.0, epsilon: 1e9 };
        let often = Optimisation { preview_every: 1000, validate_every: 0, histogram_every: 0, ..Optimisation::default() };
        Optimisation { learning_rate: rate * adam.epsilon, adam, accumulate, ema, ..often }
    }
}

impl Stage for Slope {
    type Net = Weight;
    type Item = f32;

    fn name(&self) -> &'static str {
        "toy"
    }

    fn steps(&self) -> usize {
        self.steps
    }

    fn batch(&self) -> usize {
        1
    }

    fn plan(&self) -> &Optimisation {
        &self.plan
    }

    fn start(&self, device: &Device, _rng: &mut ChaCha8Rng) -> Result<Weight, StageError> {
        Ok(Weight { weight: Param::from_tensor(Tensor::ones([1], device)) })
    }

    fn make(&self) -> Make<f32> {
        Arc::new(|index| Ok((index + 1) as f32))
    }

    fn losses(&self, net: &Weight, slope: &f32, _moment: Moment, device: &Device) -> Result<Losses, StageError> {
        // By a convolution, which is what half precision is about.
        let mut filter = [0.0; 9];
        filter[4] = *slope;
        let filter = Tensor::<1>::from_floats(filter, device).reshape([1, 1, 3, 3]);
        let product = conv3x3(net.weight.val().reshape([1, 1, 1, 1]), filter, Conv3x3::same(Padding::Zero));
        Ok(Losses { total: product.reshape([1]), terms: Vec::new() })
    }

    fn measure(&self, net: &Weight, _device: &Device) -> Result<Vec<(String, f64)>, StageError> {
        Ok(vec![("weight".into(), net.weight.val().into_scalar::<f32>().into())])
    }

    fn preview(&self, _net: &Weight, _device: &Device) -> Result<Vec<Picture>, StageError> {
        Ok(Vec::new())
    }

    fn arrays(&self, _item: &f32) -> Vec<Array> {
        Vec::new()
    }
}
