//! A stage of a few numbers: fits a line through noisy points, with randomness from every source a real stage has.

use burn::module::{Module, Param};
use burn::tensor::{Device, Distribution, Tensor, TensorData};
use dataset::stream::Stream;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;
use train::config::{Adam, Optimisation, Schedule};
use train::guard::Array;
use train::stage::{Losses, Make, Moment, Picture, Stage, StageError};

#[derive(Module, Debug)]
pub struct Line {
    layers: Vec<Layer>,
}

#[derive(Module, Debug)]
struct Layer {
    slope: Param<Tensor<2>>,
    offset: Param<Tensor<1>>,
}

pub struct Toy {
    pub steps: usize,
    pub plan: Optimisation,
    /// Batches whose points are not numbers.
    pub poisoned: Vec<u64>,
    /// Batches whose loss is a number but whose gradient isn't.
    pub steep: Vec<u64>,
}

impl Toy {
    pub fn new(steps: usize) -> Self {
        let plan = Optimisation {
            learning_rate: 0.05,
            schedule: Schedule::OneCycle,
            warm_up: 3,
            adam: Adam { beta1: 0.8, beta2: 0.95, epsilon: 1e-6 },
            weight_decay: 1e-3,
            clip: 5.0,
            accumulate: 1,
            ema: 0.9,
            preview_every: 8,
            validate_every: 5,
            histogram_every: 10,
        };
        Self { steps, plan, poisoned: Vec::new(), steep: Vec::new() }
    }
}

pub struct Points {
    x: Vec<f32>,
    y: Vec<f32>,
    steep: bool,
}

impl Stage for Toy {
    type Net = Line;
    type Item = Points;

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

    fn start(&self, device: &Device, rng: &mut ChaCha8Rng) -> Result<Line, StageError> {
        let mut layer = || Layer {
            slope: Param::from_tensor(Tensor::from_data(TensorData::from([[rng.random_range(-1.0_f32..1.0)]]), device)),
            offset: Param::from_tensor(Tensor::zeros([1], device)),
        };
        Ok(Line { layers: vec![layer(), layer()] })
    }

    fn make(&self) -> Make<Points> {
        let (poisoned, steep) = (self.poisoned.clone(), self.steep.clone());
        Arc::new(move |index| {
            let mut rng = Stream::new(9).rng("points", index);
            let x: Vec<f32> = (0..6).map(|_| rng.random_range(-1.0..1.0)).collect();
            let y = x.iter().map(|x| if poisoned.contains(&index) { f32::NAN } else { 3.0 * x - 1.0 }).collect();
            Ok(Points { x, y, steep: steep.contains(&index) })
        })
    }

    fn losses(&self, net: &Line, item: &Points, mut moment: Moment, device: &Device) -> Result<Losses, StageError> {
        let column = |values: &[f32]| Tensor::<2>::from_data(TensorData::new(values.to_vec(), [values.len(), 1]), device);
        let mut x = column(&item.x);
        for layer in &net.layers {
            x = x.matmul(layer.slope.val()) + layer.offset.val().unsqueeze();
        }
        let noise = x.random_like(Distribution::Normal(0.0, 0.01)) + moment.rng.random_range(-0.01_f32..0.01);
        let mut error = (x.clone() + noise - column(&item.y)).abs().mean();
        if item.steep {
            // The root is 0 and its slope infinite.
            error = error + x.mul_scalar(0.0).sqrt().mean();
        }
        Ok(Losses { total: error.clone() * 2.0, terms: vec![("distance".into(), error)] })
    }

    fn measure(&self, net: &Line, _device: &Device) -> Result<Vec<(String, f64)>, StageError> {
        let slope: f32 = net.layers.iter().map(|layer| layer.slope.val().into_scalar::<f32>()).product();
        Ok(vec![("slope_error".into(), f64::from((slope - 3.0).abs()))])
    }

    fn preview(&self, _net: &Line, _device: &Device) -> Result<Vec<Picture>, StageError> {
        Ok(vec![Picture { name: "line".into(), image: image::RgbImage::new(4, 4) }])
    }

    fn arrays(&self, item: &Points) -> Vec<Array> {
        let array =
            |name: &str, values: &[f32]| Array { name: name.into(), shape: vec![values.len()], values: values.to_vec() };
        vec![array("x", &item.x), array("y", &item.y)]
    }
}
