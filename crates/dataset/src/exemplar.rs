//! Exemplars of the SVBRDF net: a guidance frame, key frames, exact warps and the maps to predict (§4, §6).

use ops::homography::Homography;
use ops::planes::{Mask, Planes};
use rand::seq::SliceRandom;
use rand::{Rng, RngExt};
use render::svbrdf::SvbrdfImage;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::mixing::{MOST_MIXED, Mixing};
use crate::sequence::Sequence;

/// Exemplars per video: each of the first 20 frames is the guidance image of one (§4).
pub const PER_VIDEO: u64 = 20;
/// Range of the distance of the first from the last key frame, in frames of a 141-frame video (§4).
const SPAN: [usize; 2] = [60, 120];
/// Steps between the frames of the video that [`SPAN`] speaks of.
const REFERENCE_STEPS: usize = 140;

/// What the SVBRDF net sees in one step, and what it should answer.
#[derive(Clone, Debug)]
pub struct Exemplar {
    /// The guidance frame, then the K key frames; 3 planes each, encoded.
    pub frames: Vec<Planes>,
    /// K backward flows from the guidance frame to each key frame, 2 planes (x, y) in pixels.
    pub flows: Vec<Planes>,
    /// Pixels of the guidance frame that each key frame sees.
    pub valid: Vec<Mask>,
    /// The same warps as matrices; under a lens that bends lines or a rolling shutter, those of
    /// [`Sequence::homography`], which `flows` and `valid` depart from.
    pub homographies: Vec<Homography>,
    /// The maps that the guidance frame sees, normals in its axes.
    pub target: SvbrdfImage,
    /// Indices of the guidance frame and the key frames in the video.
    pub indices: Vec<usize>,
}

/// How exemplars are drawn.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ExemplarConfig {
    /// Side of the frames and maps.
    #[schemars(extend("unit" = "pixels"))]
    pub resolution: usize,
    /// Range of K, the number of key frames besides the guidance frame (§4: 4 to 16).
    #[schemars(extend("unit" = "frames"))]
    pub key_frames: [usize; 2],
    /// How many videos are mixed: exemplars of a window of so many videos come in random order.
    pub mixed_videos: u64,
    /// Whether red, green and blue of every exemplar change places at random, in frames and albedos alike; not in the paper.
    /// Few materials have few hues, and a net that knows only those draws others towards them.
    pub shuffle_colours: bool,
}

impl Default for ExemplarConfig {
    fn default() -> Self {
        Self { resolution: 256, key_frames: [4, 16], mixed_videos: 50, shuffle_colours: false }
    }
}

/// A value of [`ExemplarConfig`] out of its range.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("exemplar.{key} is {found}; expected {expected}")]
pub struct ExemplarError {
    /// Name of the value.
    pub key: &'static str,
    /// What it is.
    pub found: String,
    /// What it may be.
    pub expected: &'static str,
}

impl ExemplarConfig {
    /// The order of exemplars: [`Mixing::place`] gives the video and the guidance frame of each.
    pub fn mixing(&self) -> Mixing {
        Mixing { per_video: PER_VIDEO, videos: self.mixed_videos }
    }

    /// Checks every value.
    ///
    /// # Errors
    /// [`ExemplarError`] for the first value out of range.
    pub fn validate(&self) -> Result<(), ExemplarError> {
        let fail = |key, found: String, expected| Err(ExemplarError { key, found, expected });
        let [low, high] = self.key_frames;
        if !(16..=8192).contains(&self.resolution) {
            return fail("resolution", self.resolution.to_string(), "16 to 8192 pixels");
        }
        if !(1 <= low && low <= high && high <= SPAN[0]) {
            return fail("key_frames", format!("[{low}, {high}]"), "[low, high] with 1 ≤ low ≤ high ≤ 60");
        }
        if !(1..=MOST_MIXED).contains(&self.mixed_videos) {
            return fail("mixed_videos", self.mixed_videos.to_string(), "1 to 100000");
        }
        Ok(())
    }
}

/// Indices of `count` key frames after the guidance frame, at a regular interval drawn from \[⌊60/K⌋, ⌊120/K⌋\] frames of a
/// 141-frame video (more or fewer frames in a video of another frame rate).
pub fn key_frames(guidance: usize, count: usize, frames: usize, rng: &mut impl Rng) -> Vec<usize> {
    let interval = rng.random_range(SPAN[0] / count..=SPAN[1] / count);
    let last = frames - 1;
    let spread = |step: usize| (step * interval * last + REFERENCE_STEPS / 2) / REFERENCE_STEPS;
    (1..=count).map(|k| (guidance + spread(k)).min(last)).collect()
}

impl Exemplar {
    /// Draws K and the interval, then makes the exemplar of a guidance frame (0 to 19).
    pub fn draw(video: &Sequence, guidance: usize, config: &ExemplarConfig, rng: &mut impl Rng) -> Self {
        let [low, high] = config.key_frames;
        let count = rng.random_range(low..=high);
        let keys = key_frames(guidance, count, video.len(), rng);
        let exemplar = Self::of(video, guidance, &keys, config.resolution);
        if config.shuffle_colours {
            let mut order = [0, 1, 2];
            order.shuffle(rng);
            return exemplar.with_colours(order);
        }
        exemplar
    }

    /// The same exemplar of a material, light and sensor whose colour channel c is this one's `order[c]`: the image formation
    /// treats the three alike.
    fn with_colours(mut self, order: [usize; 3]) -> Self {
        let reorder = |planes: &mut Planes| {
            let [a, b, c] = order.map(|from| planes.plane(from));
            planes.data = [a, b, c].concat();
        };
        self.frames.iter_mut().for_each(reorder);
        [&mut self.target.diffuse, &mut self.target.specular].into_iter().for_each(reorder);
        self
    }

    /// The exemplar of given frames.
    ///
    /// # Panics
    /// If the video lacks one of the frames.
    pub fn of(video: &Sequence, guidance: usize, key_frames: &[usize], resolution: usize) -> Self {
        let indices: Vec<usize> = std::iter::once(guidance).chain(key_frames.iter().copied()).collect();
        let homographies = key_frames.iter().map(|&key| video.homography(guidance, key, resolution)).collect();
        let side = resolution;
        let (flows, valid) = key_frames.iter().map(|&key| video.flow(guidance, key, side)).unzip();
        Self {
            frames: indices.iter().map(|&i| video.frame(i, side)).collect(),
            flows,
            valid,
            homographies,
            target: video.target_maps(guidance, side),
            indices,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sequence::SequenceConfig;
    use crate::sequence::tests::sequence;
    use crate::stream::Stream;

    #[test]
    fn key_frames_are_regular_and_inside_the_video() {
        for draw in 0..300 {
            let rng = &mut Stream::new(1).rng("keys", draw);
            let (guidance, count) = (rng.random_range(0..20), rng.random_range(4..=16));
            let keys = key_frames(guidance, count, 141, rng);
            let interval = keys[0] - guidance;
            assert!((60 / count..=120 / count).contains(&interval));
            assert!(keys.iter().enumerate().all(|(k, &f)| f == guidance + (k + 1) * interval && f <= 140));
        }
        let fast = key_frames(5, 4, 561, &mut Stream::new(1).rng("keys", 0));
        let slow = key_frames(5, 4, 141, &mut Stream::new(1).rng("keys", 0));
        assert_eq!(fast.iter().map(|f| (f - 5) / 4).collect::<Vec<_>>(), slow.iter().map(|f| f - 5).collect::<Vec<_>>());
    }

    #[test]
    fn an_exemplar_holds_its_frames_warps_and_target() {
        let video = sequence(&SequenceConfig::svbrdf(), 6);
        let config = ExemplarConfig { resolution: 32, key_frames: [3, 3], ..ExemplarConfig::default() };
        let exemplar = Exemplar::draw(&video, 7, &config, &mut Stream::new(2).rng("exemplar", 0));
        assert_eq!((exemplar.frames.len(), exemplar.flows.len(), exemplar.valid.len()), (4, 3, 3));
        assert_eq!(exemplar.indices[0], 7);
        assert_eq!(exemplar.frames[2], video.frame(exemplar.indices[2], 32));
        let (flow, valid) = video.flow(7, exemplar.indices[3], 32);
        assert_eq!((&exemplar.flows[2], &exemplar.valid[2]), (&flow, &valid));
        assert_eq!(exemplar.target.normal, video.target_maps(7, 32).normal);
        assert_eq!(exemplar.homographies[0].flow(32, 32), exemplar.flows[0]);
    }

    #[test]
    fn shuffled_colours_change_places_in_frames_and_albedos_only() {
        let video = sequence(&SequenceConfig::svbrdf(), 6);
        let config = ExemplarConfig { resolution: 16, key_frames: [2, 2], ..ExemplarConfig::default() };
        let shuffling = ExemplarConfig { shuffle_colours: true, ..config.clone() };
        let mut orders = std::collections::BTreeSet::new();
        for draw in 0..40 {
            let rng = || Stream::new(3).rng("exemplar", draw);
            let plain = Exemplar::draw(&video, 4, &config, &mut rng());
            let shuffled = Exemplar::draw(&video, 4, &shuffling, &mut rng());
            let place = |c: usize| (0..3).find(|&from| shuffled.frames[0].plane(c) == plain.frames[0].plane(from)).unwrap();
            let order = [place(0), place(1), place(2)];
            let coloured =
                |e: &Exemplar| [e.frames.clone(), vec![e.target.diffuse.clone(), e.target.specular.clone()]].concat();
            for (after, before) in coloured(&shuffled).iter().zip(coloured(&plain)) {
                assert!((0..3).all(|c| after.plane(c) == before.plane(order[c])), "{order:?}");
            }
            assert_eq!(shuffled.indices, plain.indices);
            assert_eq!((&shuffled.flows, &shuffled.valid), (&plain.flows, &plain.valid));
            assert_eq!((&shuffled.target.normal, &shuffled.target.roughness), (&plain.target.normal, &plain.target.roughness));
            orders.insert(order);
        }
        assert_eq!(orders.len(), 6);
    }

    #[test]
    fn bad_values_are_named() {
        let refused = |config: ExemplarConfig| config.validate().unwrap_err().to_string();
        assert!(refused(ExemplarConfig { key_frames: [5, 4], ..Default::default() }).contains("key_frames is [5, 4]"));
        assert!(refused(ExemplarConfig { key_frames: [0, 4], ..Default::default() }).contains("1 ≤ low"));
        assert!(refused(ExemplarConfig { resolution: 4, ..Default::default() }).contains("resolution is 4"));
        assert!(refused(ExemplarConfig { mixed_videos: u64::MAX, ..Default::default() }).contains("expected 1 to 100000"));
        ExemplarConfig::default().validate().unwrap();
    }
}
