//! The stage that teaches maps.

use super::flow_net::array;
use super::picture::to_rgb;
use super::videos::Videos;
use super::{Losses, Make, Moment, Picture, Stage, StageError};
use crate::config::SvbrdfStage as Table;
use crate::guard::Array;
use burn::tensor::{Device, Tensor};
use dataset::exemplar::Exemplar;
use ops::planes::{Mask, Planes};
use rand_chacha::ChaCha8Rng;
use render::brdf::BrdfModel;
use render::svbrdf::SvbrdfImage;
use render::views::{EvaluationViews, LossViews};
use render::visual::below;
use std::sync::{Arc, OnceLock};
use svbrdf::constants::ConstantMaps;
use svbrdf::metrics::{MapErrors, RenderErrors};
use svbrdf::net::{FitExemplar, SvbrdfNet};
use svbrdf::visual::preview;

/// Exemplars shown in a preview.
const SHOWN: usize = 2;

/// Trains the SVBRDF net on exemplars.
pub struct SvbrdfStage {
    /// The config.
    pub table: Table,
    /// Training videos.
    pub videos: Videos,
    /// Videos of held-out materials.
    pub held_out: Videos,
    /// The constant maps that the outputs start from, drawn once.
    pub constants: OnceLock<Result<ConstantMaps, String>>,
    /// The held-out exemplars, made once.
    pub cache: OnceLock<Result<Vec<Exemplar>, String>>,
}

impl SvbrdfStage {
    /// Medians over training exemplars: where the net starts and the baseline it must beat.
    ///
    /// # Errors
    /// A material that can't be had.
    pub fn constants(&self) -> Result<ConstantMaps, StageError> {
        let made = self.constants.get_or_init(|| {
            let targets = (0..self.table.median_exemplars as u64).map(|number| {
                let side = self.table.exemplars.resolution.min(64);
                self.videos.video(number).map(|video| video.target_maps(0, side))
            });
            let targets = targets.collect::<Result<Vec<SvbrdfImage>, String>>()?;
            ConstantMaps::medians(&targets).ok_or_else(|| "there is no exemplar to take medians of".to_string())
        });
        made.clone().map_err(StageError)
    }

    /// Training exemplars for the start of the last layer, from the videos that the medians come from.
    fn fit_exemplars<'a>(&'a self, device: &'a Device) -> impl Iterator<Item = Result<FitExemplar, StageError>> + 'a {
        (0..self.table.median_exemplars as u64).map(|number| {
            let mut rng = self.videos.streams.rng("fit", number);
            let exemplar = Exemplar::draw(&self.videos.video(number).map_err(StageError)?, 0, &self.table.exemplars, &mut rng);
            let (frames, flow, valid) = inputs(&exemplar, device);
            Ok(FitExemplar { frames, flow, valid, target: exemplar.target })
        })
    }

    fn held_out(&self) -> Result<&[Exemplar], StageError> {
        let made = self.cache.get_or_init(|| {
            let exemplar = |index: u64| {
                let (video, guidance) = self.held_out.of_held_out(index)?;
                let mut rng = self.held_out.streams.rng("exemplar", index);
                Ok(Exemplar::draw(&video, guidance, &self.table.exemplars, &mut rng))
            };
            (0..self.table.validation_exemplars as u64).map(exemplar).collect()
        });
        made.as_deref().map_err(|reason| StageError(reason.clone()))
    }
}

/// Frames, flow and mask of an exemplar as the net takes them.
fn inputs(exemplar: &Exemplar, device: &Device) -> (Tensor<4>, Tensor<4>, Tensor<4>) {
    let planes = |list: &[Planes]| Planes::batch(&list.iter().collect::<Vec<_>>(), device);
    let masks: Vec<Planes> = exemplar.valid.iter().map(Mask::to_planes).collect();
    (planes(&exemplar.frames), planes(&exemplar.flows), planes(&masks))
}

fn predict(net: &SvbrdfNet, exemplar: &Exemplar, device: &Device) -> Result<SvbrdfImage, StageError> {
    let (frames, flow, valid) = inputs(exemplar, device);
    let maps = net.forward(frames, flow, Some(valid)).to_images();
    maps.into_iter().next().ok_or_else(|| StageError("the net returned no maps".into()))
}

impl Stage for SvbrdfStage {
    type Net = SvbrdfNet;
    type Item = Exemplar;

    fn name(&self) -> &'static str {
        svbrdf::weights::NAME
    }

    fn steps(&self) -> usize {
        self.table.steps
    }

    fn batch(&self) -> usize {
        1
    }

    fn plan(&self) -> &crate::config::Optimisation {
        &self.table.optimisation
    }

    fn start(&self, device: &Device, rng: &mut ChaCha8Rng) -> Result<SvbrdfNet, StageError> {
        let net = self.table.net.init(device, rng).map_err(StageError::from_error)?;
        Ok(match self.table.net.output.start {
            svbrdf::net::OutputStart::Medians => net.starting_at(&self.constants()?),
            svbrdf::net::OutputStart::LeastSquares => {
                net.starting_at(&self.constants()?).fitted_to(self.fit_exemplars(device))?
            }
            svbrdf::net::OutputStart::Zero => net,
        })
    }

    fn make(&self) -> Make<Exemplar> {
        let (videos, config) = (self.videos.clone(), self.table.exemplars.clone());
        Arc::new(move |index| {
            let (video, guidance) = videos.of_item(index)?;
            Ok(Exemplar::draw(&video, guidance, &config, &mut videos.streams.rng("exemplar", index)))
        })
    }

    fn losses(&self, net: &SvbrdfNet, exemplar: &Exemplar, mut moment: Moment, device: &Device) -> Result<Losses, StageError> {
        let (frames, flow, valid) = inputs(exemplar, device);
        let views = LossViews::draw(&mut moment.rng);
        let prediction = net.predict(frames, flow, Some(valid), Some(&mut moment.rng));
        let target = exemplar.target.to_tensor(device);
        let loss = self.table.loss.evaluate(&prediction, &target, &views, BrdfModel::default());
        let saturated = Tensor::from_data([prediction.saturation()], device);
        let terms = [
            ("rendering", loss.rendering),
            ("top", loss.top),
            ("normal", loss.normal),
            ("diffuse", loss.diffuse),
            ("roughness", loss.roughness),
            ("specular", loss.specular),
            ("excess", loss.excess),
            // Watched, not minimised: a share that climbs early means that the net tips over.
            ("saturated", saturated),
        ];
        Ok(Losses { total: loss.total, terms: terms.map(|(name, term)| (name.to_string(), term)).into() })
    }

    fn measure(&self, net: &SvbrdfNet, device: &Device) -> Result<Vec<(String, f64)>, StageError> {
        let (constants, views) = (self.constants()?, EvaluationViews::standard());
        let (mut found, mut baseline) = (Vec::new(), Vec::new());
        for exemplar in self.held_out()? {
            let truth = &exemplar.target;
            let errors = |maps: &SvbrdfImage| {
                let rendering = RenderErrors::between(maps, truth, &views, BrdfModel::default());
                MapErrors::between(maps, truth, None).zip(rendering)
            };
            found.extend(errors(&predict(net, exemplar, device)?));
            baseline.extend(errors(&constants.to_image(truth.height(), truth.width())));
        }
        Ok(measurements(found, baseline))
    }

    /// A row per exemplar: predicted maps and renderings above the true ones; its frames in another picture.
    fn preview(&self, net: &SvbrdfNet, device: &Device) -> Result<Vec<Picture>, StageError> {
        let mut pictures = Vec::new();
        for (index, exemplar) in self.held_out()?.iter().take(SHOWN).enumerate() {
            let maps = predict(net, exemplar, device)?;
            let rows = preview(&[&maps, &exemplar.target], BrdfModel::default());
            pictures.push(Picture { name: format!("maps{index}"), image: to_rgb(&rows) });
            let frames: Vec<&Planes> = exemplar.frames.iter().collect();
            pictures
                .push(Picture { name: format!("frames{index}"), image: to_rgb(&below(&[&render::visual::beside(&frames)])) });
        }
        Ok(pictures)
    }

    fn arrays(&self, exemplar: &Exemplar) -> Vec<Array> {
        let mut arrays = Vec::new();
        let mut push = |name: &str, list: &[Planes]| {
            arrays.extend(list.iter().enumerate().map(|(i, planes)| array(format!("{name}.{i}"), planes.clone())));
        };
        push("frames", &exemplar.frames);
        push("flows", &exemplar.flows);
        push("target", &exemplar.target.maps().map(Clone::clone));
        arrays
    }
}

/// Ratios to the constant-map baseline first, then the errors themselves.
fn measurements(found: Vec<(MapErrors, RenderErrors)>, baseline: Vec<(MapErrors, RenderErrors)>) -> Vec<(String, f64)> {
    let mean = |errors: Vec<(MapErrors, RenderErrors)>| {
        let (maps, renderings): (Vec<_>, Vec<_>) = errors.into_iter().unzip();
        MapErrors::mean(&maps).zip(RenderErrors::mean(&renderings))
    };
    let Some(((maps, rendering), (constant_maps, constant_rendering))) = mean(found).zip(mean(baseline)) else {
        return Vec::new();
    };
    let row = [
        ("maps_l1_ratio", maps.sum_l1() / constant_maps.sum_l1()),
        ("render_l1_ratio", rendering.l1 / constant_rendering.l1),
        ("diffuse_l1_ratio", maps.diffuse_l1 / constant_maps.diffuse_l1),
        ("normal_l1_ratio", maps.normal_l1 / constant_maps.normal_l1),
        ("roughness_l1_ratio", maps.roughness_l1 / constant_maps.roughness_l1),
        ("specular_l1_ratio", maps.specular_l1 / constant_maps.specular_l1),
        ("diffuse_l1", maps.diffuse_l1),
        ("normal_l1", maps.normal_l1),
        ("roughness_l1", maps.roughness_l1),
        ("specular_l1", maps.specular_l1),
        ("render_l1", rendering.l1),
    ];
    row.map(|(name, value)| (name.to_string(), value)).into()
}
