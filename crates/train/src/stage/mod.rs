//! The stages of a run. Each says what an item is, what the losses are and what to show; the loop is the same for all.

pub mod flow_net;
pub mod picture;
pub mod plan;
pub mod svbrdf_net;
pub mod videos;

use crate::config::Optimisation;
use crate::guard::Array;
use burn::module::Module;
use burn::tensor::{Device, Tensor};
use image::RgbImage;
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

/// Makes item `index`, a pure function of it.
pub type Make<T> = Arc<dyn Fn(u64) -> Result<T, String> + Send + Sync>;

/// The losses of one batch.
pub struct Losses {
    /// What is minimised, one value.
    pub total: Tensor<1>,
    /// Its terms, before their weights, each one value.
    pub terms: Vec<(String, Tensor<1>)>,
}

/// Where in the stage a batch is used.
pub struct Moment {
    /// Steps done, from 0.
    pub step: u64,
    /// Share of the stage that is done, 0 to 1.
    pub done: f64,
    /// Randomness of this batch beyond its content (views of the losses, dropout): a function of seed, stage and batch.
    pub rng: ChaCha8Rng,
}

/// A picture for the previews.
pub struct Picture {
    /// What it shows.
    pub name: String,
    /// The picture.
    pub image: RgbImage,
}

/// What went wrong in a stage, in words for a person.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct StageError(pub String);

impl StageError {
    /// From any error of the libraries.
    pub fn from_error(error: impl std::fmt::Display) -> Self {
        Self(error.to_string())
    }
}

/// One stage of training.
pub trait Stage {
    /// The net.
    type Net: Module + 'static;
    /// A batch as the data workers make it, on the CPU.
    type Item: Send + 'static;

    /// Its name in files and on the screen.
    fn name(&self) -> &'static str;
    /// Optimiser steps.
    fn steps(&self) -> usize;
    /// Exemplars in a batch.
    fn batch(&self) -> usize;
    /// Optimiser and intervals.
    fn plan(&self) -> &Optimisation;
    /// The net before the first step.
    ///
    /// # Errors
    /// Starting weights that can't be read or don't fit.
    fn start(&self, device: &Device, rng: &mut ChaCha8Rng) -> Result<Self::Net, StageError>;
    /// What the data workers call.
    fn make(&self) -> Make<Self::Item>;
    /// The losses of a batch; `device` tracks gradients.
    ///
    /// # Errors
    /// A batch the net can't take.
    fn losses(&self, net: &Self::Net, item: &Self::Item, moment: Moment, device: &Device) -> Result<Losses, StageError>;
    /// Measurements on held-out materials, the most telling first: the smaller that one, the better the net.
    ///
    /// # Errors
    /// Data that can't be made.
    fn measure(&self, net: &Self::Net, device: &Device) -> Result<Vec<(String, f64)>, StageError>;
    /// Pictures of a held-out exemplar.
    ///
    /// # Errors
    /// Data that can't be made.
    fn preview(&self, net: &Self::Net, device: &Device) -> Result<Vec<Picture>, StageError>;
    /// A batch as plain arrays, for the dump when a loss is not finite.
    fn arrays(&self, item: &Self::Item) -> Vec<Array>;
}
