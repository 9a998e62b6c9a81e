//! From the config to the stages: what each starts from, learns from and is measured on.

use super::StageError;
use super::flow_net::{FlowStage, MakePair, StartNet, random_start};
use super::svbrdf_net::SvbrdfStage;
use super::videos::Videos;
use crate::config::{Config, FlowInit, PairStage};
use dataset::chairs::Chairs;
use dataset::material::{AugmentConfig, MaterialLibrary, Split};
use dataset::pair::{FlowPair, PairConfig};
use dataset::sequence::SequenceConfig;
use dataset::stream::Stream;
use flow::weights::{ADJACENT, DISTANT};
use rand::RngExt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

/// Name of the pre-training and of the net it leaves.
pub const CHAIRS: &str = "chairs";

/// What the stages of a run have in common.
pub struct Plan<'a> {
    /// The config.
    pub config: &'a Config,
    /// All materials.
    pub materials: Arc<MaterialLibrary>,
    /// The run's weights folder, where earlier stages left their nets.
    pub weights: PathBuf,
}

impl Plan<'_> {
    /// The streams of a stage's data, apart for training and measuring.
    fn streams(&self, stage: &str, split: Split) -> Stream {
        Stream::new(self.config.run.seed).child(stage, 1 + split as u64)
    }

    /// Pre-training on pairs of moving shapes.
    ///
    /// # Errors
    /// A config that can't work.
    pub fn chairs(&self) -> Result<FlowStage, StageError> {
        let table = &self.config.chairs;
        let side = table.pairs.resolution;
        let cut = PairConfig { crop: side, ..self.config.adjacent.pairs.clone() };
        let source = |split| -> Result<MakePair, StageError> {
            let streams = self.streams(CHAIRS, split);
            let chairs = Chairs::new(table.pairs.clone(), streams).map_err(StageError::from_error)?;
            let rendered = self.pairs(CHAIRS, split, &self.config.adjacent, cut.clone(), neighbours);
            let share = if split == Split::Train { table.rendered_share } else { 0.0 };
            let materials = Arc::clone(&self.materials);
            Ok(Arc::new(move |index| {
                if streams.rng("rendered", index).random_bool(share) {
                    return rendered(index);
                }
                chairs.pair(index, |number| materials.material(split, number)).map_err(|error| error.to_string())
            }))
        };
        Ok(FlowStage {
            name: CHAIRS,
            steps: table.steps,
            batch: table.batch,
            plan: table.optimisation.clone(),
            loss: table.loss.clone(),
            teaching: table.teaching.clone(),
            start: self.pretraining_start(),
            pairs: source(Split::Train)?,
            held_out: source(Split::Test)?,
            measured_pairs: table.validation_pairs,
            planar: false,
            cache: OnceLock::new(),
        })
    }

    /// Flow between neighbouring frames.
    pub fn adjacent(&self) -> FlowStage {
        self.pair_stage(ADJACENT, &self.config.adjacent, neighbours)
    }

    /// What is left of the flow between the guidance image and a coarsely aligned key frame.
    pub fn distant(&self) -> FlowStage {
        let draw: DrawPair = |video, config, rng| FlowPair::distant(video, config, rng).map_err(|error| error.to_string());
        self.pair_stage(DISTANT, &self.config.distant, draw)
    }

    fn pair_stage(&self, name: &'static str, table: &PairStage, draw: DrawPair) -> FlowStage {
        let whole = PairConfig { crop: 0, augment: false, ..table.pairs.clone() };
        FlowStage {
            name,
            steps: table.steps,
            batch: table.batch,
            plan: table.optimisation.clone(),
            loss: table.loss.clone(),
            teaching: table.teaching.clone(),
            start: self.start(),
            pairs: self.pairs(name, Split::Train, table, table.pairs.clone(), draw),
            held_out: self.pairs(name, Split::Test, table, whole, draw),
            measured_pairs: table.validation_pairs,
            planar: true,
            cache: OnceLock::new(),
        }
    }

    fn pairs(&self, name: &str, split: Split, table: &PairStage, config: PairConfig, draw: DrawPair) -> MakePair {
        let streams = self.streams(name, split);
        let videos = Videos {
            materials: Arc::clone(&self.materials),
            split,
            config: table.videos.clone(),
            streams,
            mixed: table.mixed_videos,
        };
        Arc::new(move |index| {
            let (video, _) = if split == Split::Train { videos.of_item(index)? } else { videos.of_held_out(index)? };
            draw(&video, &config, &mut videos.streams.rng("pair", index))
        })
    }

    /// Videos of one side of the split; held-out materials are shown as they are.
    fn videos(&self, split: Split, config: &SequenceConfig, streams: Stream, mixed: u64) -> Videos {
        let mut config = config.clone();
        if split == Split::Test {
            config.augment = AugmentConfig::none();
        }
        Videos { materials: Arc::clone(&self.materials), split, config, streams, mixed }
    }

    /// Maps from frames.
    pub fn svbrdf(&self) -> SvbrdfStage {
        let table = self.config.svbrdf.clone();
        let videos =
            |split| self.videos(split, &table.videos, self.streams(svbrdf::weights::NAME, split), table.exemplars.mixed_videos);
        let (train, held_out) = (videos(Split::Train), videos(Split::Test));
        SvbrdfStage { table, videos: train, held_out, constants: OnceLock::new(), cache: OnceLock::new() }
    }

    /// Pre-training starts from random weights, or goes on from a given file.
    fn pretraining_start(&self) -> StartNet {
        match &self.config.flow.init {
            FlowInit::File(path) => self.file_start(path.clone()),
            FlowInit::None | FlowInit::Weights => random_start(self.config.flow.architecture()),
        }
    }

    /// The flow nets start from this run's pre-training when it has one, else from what the config says.
    fn start(&self) -> StartNet {
        match &self.config.flow.init {
            _ if self.config.chairs.steps > 0 => self.folder_start(self.weights.clone()),
            FlowInit::Weights => match released_weights() {
                Some(folder) => self.folder_start(folder),
                None => Box::new(|_, _| Err(StageError(no_released_weights()))),
            },
            FlowInit::None => random_start(self.config.flow.architecture()),
            FlowInit::File(path) => self.file_start(path.clone()),
        }
    }

    fn folder_start(&self, folder: PathBuf) -> StartNet {
        let expected = self.config.flow.architecture();
        Box::new(move |device, _| {
            let (net, _) = flow::weights::load(&folder, CHAIRS, device).map_err(StageError::from_error)?;
            if *net.config() == expected {
                return Ok(net);
            }
            Err(StageError(format!(
                "the pre-trained flow net in {} has another architecture than `flow` in the config: change `flow.size`, pre-train one with `--config chairs.toml`, or set `flow.init = \"none\"`",
                folder.display()
            )))
        })
    }

    fn file_start(&self, path: PathBuf) -> StartNet {
        let architecture = self.config.flow.architecture();
        Box::new(move |device, rng| ops::weights::load(architecture.init(device, rng), &path).map_err(StageError::from_error))
    }
}

/// Two neighbouring frames of a video.
fn neighbours(
    video: &dataset::sequence::Sequence,
    config: &PairConfig,
    rng: &mut rand_chacha::ChaCha8Rng,
) -> Result<FlowPair, String> {
    let frame = rng.random_range(0..video.len() - 1);
    FlowPair::adjacent(video, frame, config, rng).map_err(|error| error.to_string())
}

type DrawPair = fn(&dataset::sequence::Sequence, &PairConfig, &mut rand_chacha::ChaCha8Rng) -> Result<FlowPair, String>;

/// The folder of weights that come with the program: here, or in the workspace.
pub fn released_weights() -> Option<PathBuf> {
    let workspace = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../weights");
    [PathBuf::from("weights"), workspace].into_iter().find(|folder| holds_pretrained(folder))
}

fn holds_pretrained(folder: &Path) -> bool {
    ops::weights::Manifest::read(folder).is_ok_and(|manifest| manifest.nets.contains_key(CHAIRS))
}

/// Why a run that needs the pre-trained net can't start.
pub fn no_released_weights() -> String {
    format!(
        "`flow.init = \"weights\"`, but there is no pre-trained flow net `{CHAIRS}` in weights/ (here or in the workspace): \
         pre-train one with `--config chairs.toml` and copy its weights folder, or set `flow.init = \"none\"`"
    )
}
