//! The synthetic protocol: held-out materials, spiral scans, automatic alignment, maps; everything beside its baselines.

use std::sync::Arc;

use dataset::material::augment::AugmentConfig;
use dataset::material::library::MaterialLibrary;
use dataset::material::stored::Material;
use dataset::material::texture::Texture;
use dataset::sequence::{Sequence, SequenceConfig};
use dataset::stream::Stream;
use flow::align::metrics::ScanErrors;
use flow::align::size::Size;
use flow::align::{AlignConfig, Alignment};
use ops::homography::Homography;
use ops::planes::Planes;
use render::brdf::BrdfModel;
use render::svbrdf::SvbrdfImage;
use render::views::EvaluationViews;
use scan::nets::{ScanNets, key_frame};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use svbrdf::constants::ConstantMaps;
use svbrdf::metrics::{MapErrors, RenderErrors, Spikes};

use crate::EvaluateError;
use crate::adjacent::{AdjacentErrors, adjacent_errors};
use crate::baseline::constant_maps;
use crate::materials::held_out;

/// Budget and sizes of the protocol.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SyntheticConfig {
    /// Held-out materials with visible texture.
    pub textured: usize,
    /// Held-out materials with a little.
    pub low_texture: usize,
    /// Held-out materials that show nothing to align by; they are measured apart.
    pub featureless: usize,
    /// Side of the frames that are aligned, in pixels.
    #[schemars(extend("unit" = "pixels"))]
    pub resolution: usize,
    /// Side of the maps, in pixels.
    #[schemars(extend("unit" = "pixels"))]
    pub map_resolution: usize,
    /// Neighbouring frames per material on which the `adjacent` net is measured.
    pub pairs: usize,
    /// Training videos whose targets give the constant maps.
    pub constant_videos: u64,
    /// The alignment.
    pub align: AlignConfig,
    /// The scans: path, light and sensor, each a row of the paper's Table 5. Materials are shown as they are.
    pub videos: SequenceConfig,
    /// Seed of paths, lights and noise.
    pub seed: u64,
}

impl Default for SyntheticConfig {
    fn default() -> Self {
        Self {
            textured: 8,
            low_texture: 4,
            featureless: 2,
            resolution: 256,
            map_resolution: 256,
            pairs: 8,
            constant_videos: 48,
            align: AlignConfig::default(),
            videos: SequenceConfig { augment: AugmentConfig::none(), ..spirals() },
            seed: 7001,
        }
    }
}

impl SyntheticConfig {
    /// How many materials of a class are measured at most.
    pub fn most(&self, texture: Texture) -> usize {
        match texture {
            Texture::Rich => self.textured,
            Texture::Faint => self.low_texture,
            Texture::Absent => self.featureless,
        }
    }

    /// Checks the values before any work.
    ///
    /// # Errors
    /// Names the first value that can't work.
    pub fn validate(&self) -> Result<(), EvaluateError> {
        let error = |name, found: usize, expected| Err(EvaluateError::Config { name, found: found.to_string(), expected });
        match self {
            Self { textured: 0, low_texture: 0, .. } => error("textured", 0, "at least one material"),
            Self { resolution: r, .. } if !(64..=4096).contains(r) => error("resolution", *r, "64 to 4096 pixels"),
            Self { map_resolution: r, .. } if !(16..=4096).contains(r) => error("map_resolution", *r, "16 to 4096 pixels"),
            Self { pairs: 0, .. } => error("pairs", 0, "at least 1"),
            Self { constant_videos: 0, .. } => error("constant_videos", 0, "at least 1"),
            _ => {
                self.align.validate()?;
                self.videos.validate().map_err(EvaluateError::Videos)
            }
        }
    }
}

/// The SVBRDF net's training videos without the lines among them.
pub(crate) fn spirals() -> SequenceConfig {
    let mut videos = SequenceConfig::svbrdf();
    videos.path.line_share = 0.0;
    videos
}

/// Errors of one kind of maps.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct Errors {
    /// The maps.
    pub maps: MapErrors,
    /// Their renderings.
    pub render: RenderErrors,
    /// Isolated high values in the maps.
    pub spikes: Spikes,
}

impl Errors {
    /// Compares maps of one size.
    ///
    /// # Panics
    /// If the sizes differ.
    pub(crate) fn between(maps: &SvbrdfImage, reference: &SvbrdfImage) -> Self {
        let views = EvaluationViews::standard();
        Self {
            maps: MapErrors::between(maps, reference, None).expect("maps of one size"),
            render: RenderErrors::between(maps, reference, &views, BrdfModel::default()).expect("maps of one size"),
            spikes: Spikes::between(maps, reference).expect("maps of one size"),
        }
    }
}

/// Everything measured on one material.
#[derive(Clone, Debug)]
pub struct MaterialResult {
    /// Its name.
    pub material: String,
    /// What it shows to align by.
    pub texture: Texture,
    /// The `adjacent` net; `None` without a net.
    pub adjacent: Option<AdjacentErrors>,
    /// Automatic alignment.
    pub alignment: ScanErrors,
    /// Identity alignment.
    pub identity: ScanErrors,
    /// Key frames left out, of how many.
    pub dropped: (usize, usize),
    /// Maps by automatic alignment.
    pub automatic: Errors,
    /// Maps by exact warps.
    pub exact: Errors,
    /// Constant maps.
    pub constant: Errors,
    /// Pictures for the contact sheet.
    pub pictures: Pictures,
}

/// What a contact sheet shows of a material.
#[derive(Clone, Debug)]
pub struct Pictures {
    /// The guidance frame.
    pub guidance: Planes,
    /// Some aligned key frames; black where they show nothing.
    pub aligned: Vec<Planes>,
    /// Reconstructed maps.
    pub predicted: SvbrdfImage,
    /// True maps.
    pub reference: SvbrdfImage,
}

/// Runs the protocol. `progress` hears of every finished material and says whether to go on.
///
/// # Errors
/// See [`EvaluateError`].
pub fn run(
    library: &MaterialLibrary,
    method: &ScanNets,
    config: &SyntheticConfig,
    mut progress: impl FnMut(&MaterialResult) -> bool,
) -> Result<Vec<MaterialResult>, EvaluateError> {
    config.validate()?;
    let streams = Stream::new(config.seed);
    let constants = constant_maps(library, &spirals(), &streams, config.constant_videos)?;
    let mut results = Vec::new();
    for (video, material) in held_out(library, |texture| config.most(texture))?.into_iter().enumerate() {
        let scan = TestScan::new(material, &streams, video as u64, config);
        let result = scan.measure(method, &constants)?;
        let go_on = progress(&result);
        results.push(result);
        if !go_on {
            return Err(EvaluateError::Stopped);
        }
    }
    Ok(results)
}

struct TestScan<'a> {
    video: Sequence,
    frames: Vec<Planes>,
    config: &'a SyntheticConfig,
}

impl<'a> TestScan<'a> {
    fn new(material: Arc<Material>, streams: &Stream, video: u64, config: &'a SyntheticConfig) -> Self {
        let video = Sequence::new(material, &config.videos, streams, video);
        let frames = (0..video.len()).map(|i| video.frame(i, config.resolution)).collect();
        Self { video, frames, config }
    }

    fn measure(&self, method: &ScanNets, constants: &ConstantMaps) -> Result<MaterialResult, EvaluateError> {
        let alignment = method.aligner(self.config.align.clone()).align(&self.frames, None)?;
        let exact: Vec<Homography> =
            alignment.key_frames.iter().map(|k| self.video.homography(0, k.index, self.config.resolution)).collect();
        let size = Size::of(&self.frames[0]);
        let still = vec![Some(Homography::identity()); exact.len()];
        let reference = self.video.target_maps(0, self.config.map_resolution);
        let predicted = self.maps_by(method, &alignment)?;
        let indices: Vec<usize> = alignment.key_frames.iter().map(|k| k.index).collect();
        let exactly = self.maps_by_exact_warps(method, &indices)?;
        let constant = constants.to_image(self.config.map_resolution, self.config.map_resolution);
        let errors = |maps: &SvbrdfImage| Errors::between(maps, &reference);
        let dropped = alignment.key_frames.iter().filter(|k| !k.aligned()).count();
        Ok(MaterialResult {
            material: self.video.material().to_string(),
            texture: self.video.texture(),
            adjacent: method.adjacent.as_ref().and_then(|net| adjacent_errors(net, &self.pairs())),
            alignment: ScanErrors::new(&alignment, &exact, size),
            identity: ScanErrors::of_homographies(&still, &exact, size, size),
            dropped: (dropped, exact.len()),
            automatic: errors(&predicted),
            exact: errors(&exactly),
            constant: errors(&constant),
            pictures: Pictures {
                guidance: self.frames[0].clone(),
                aligned: self.aligned_frames(&alignment),
                predicted,
                reference,
            },
        })
    }

    /// Neighbouring frames spread over the scan, with the exact homography between them.
    fn pairs(&self) -> Vec<(&Planes, &Planes, Homography)> {
        let count = self.config.pairs.min(self.frames.len() - 1);
        let first = |i: usize| i * (self.frames.len() - 1) / count;
        let pair = |i: usize| (&self.frames[i], &self.frames[i + 1], self.video.homography(i, i + 1, self.config.resolution));
        (0..count).map(|i| pair(first(i))).collect()
    }

    fn maps_by(&self, method: &ScanNets, alignment: &Alignment) -> Result<SvbrdfImage, EvaluateError> {
        let side = self.config.map_resolution;
        let factor = side as f64 / self.config.resolution as f64;
        let keys = alignment.key_frames.iter().filter(|k| k.aligned()).map(|k| {
            let warp = k.homography.scaled(factor, factor);
            key_frame(self.video.frame(k.index, side), (warp.flow(side, side), warp.valid(side, side, side, side)))
        });
        Ok(method.maps(&self.video.frame(0, side), keys)?)
    }

    fn maps_by_exact_warps(&self, method: &ScanNets, indices: &[usize]) -> Result<SvbrdfImage, EvaluateError> {
        let side = self.config.map_resolution;
        let keys = indices.iter().map(|&i| key_frame(self.video.frame(i, side), self.video.flow(0, i, side)));
        Ok(method.maps(&self.video.frame(0, side), keys)?)
    }

    fn aligned_frames(&self, alignment: &Alignment) -> Vec<Planes> {
        /// Key frames that a contact sheet shows.
        const SHOWN: usize = 4;
        let keys = &alignment.key_frames;
        let chosen = (0..SHOWN.min(keys.len())).map(|i| &keys[(i + 1) * keys.len() / (SHOWN + 1)]);
        let side = self.config.resolution;
        chosen
            .map(
                |k| if k.aligned() { k.aligned_frame(&self.frames[k.index], side, side).0 } else { Planes::new(3, side, side) },
            )
            .collect()
    }
}
