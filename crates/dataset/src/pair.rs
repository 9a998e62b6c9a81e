//! Image pairs with exact flow, for the two flow nets (§4, §5).

use nalgebra::Matrix3;
use ops::homography::Homography;
use ops::planes::{Mask, Planes};
use rand::seq::SliceRandom;
use rand::{Rng, RngExt};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::sequence::{FrameWarp, Sequence};

/// Overlaps narrower than this teach nothing (§5).
pub const LEAST_OVERLAP_PX: usize = 30;
/// The random part of the coarse shift, per axis (§5).
const SHIFT_JITTER_PX: i64 = 10;
/// The first frame of a distant pair is one of the first 20, the second one of the last 120 (§5).
const GUIDANCE_FRAMES: usize = 20;
const LATE_FRAMES: usize = 120;
/// Draws of a distant pair before it is given up; almost all succeed within five.
const ATTEMPTS: usize = 200;
/// Pixels per axis of the grid over which the mean flow is taken; a homography's flow is so smooth that this is exact
/// to a fraction of a pixel, which rounding hides.
const MEAN_GRID: usize = 16;

/// Two images of one surface and the flow between them.
#[derive(Clone, Debug, PartialEq)]
pub struct FlowPair {
    /// Target: where the flow starts. 3 planes, encoded.
    pub first: Planes,
    /// Source: `position in second = pixel of first + flow`. 3 planes, encoded, of the same size.
    pub second: Planes,
    /// 2 planes (x, y) in pixels.
    pub flow: Planes,
    /// Pixels of `first` whose point is seen in `second`.
    pub valid: Mask,
}

/// How pairs are made from a video.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct PairConfig {
    /// Side of the frames the pair is cut from.
    #[schemars(extend("unit" = "pixels"))]
    pub resolution: usize,
    /// Side of the square that is cut out, so that pairs can be batched; 0 keeps everything that there is.
    #[schemars(extend("unit" = "pixels"))]
    pub crop: usize,
    /// Flips, transposition, exchange of the two images and of the colour channels, each with probability ½.
    pub augment: bool,
}

impl Default for PairConfig {
    fn default() -> Self {
        Self { resolution: 256, crop: 0, augment: true }
    }
}

/// A pair that can't be made.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PairError {
    /// The crop doesn't fit.
    #[error("pair.crop is {crop} and pair.resolution {resolution}; expected 0 (no crop) or 32 ≤ crop ≤ resolution")]
    Crop {
        /// Asked side of the crop.
        crop: usize,
        /// Side of the frames.
        resolution: usize,
    },
    /// The video has no early and late frame that overlap enough.
    #[error(
        "a video of {material} with {frames} frames has no two frames, early and late, that share {needed} px; use a smaller pair.crop or a longer path"
    )]
    NoOverlap {
        /// What the video shows.
        material: String,
        /// How many frames it has.
        frames: usize,
        /// Overlap that was asked for.
        needed: usize,
    },
}

impl PairConfig {
    /// Checks the sizes.
    ///
    /// # Errors
    /// [`PairError::Crop`].
    pub fn validate(&self) -> Result<(), PairError> {
        let fits = self.crop == 0 || (32..=self.resolution).contains(&self.crop);
        if fits && self.resolution >= 32 {
            Ok(())
        } else {
            Err(PairError::Crop { crop: self.crop, resolution: self.resolution })
        }
    }

    /// Pixels by which the frames of a distant pair must overlap.
    fn needed(&self) -> usize {
        self.crop.max(LEAST_OVERLAP_PX)
    }
}

/// A rectangle of pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Window {
    y: usize,
    x: usize,
    height: usize,
    width: usize,
}

impl Window {
    /// A square of side `crop` (0: everything) somewhere in a rectangle.
    fn draw(self, crop: usize, rng: &mut impl Rng) -> Self {
        let (height, width) = if crop == 0 { (self.height, self.width) } else { (crop, crop) };
        let y = self.y + rng.random_range(0..=self.height - height);
        let x = self.x + rng.random_range(0..=self.width - width);
        Self { y, x, height, width }
    }
}

impl FlowPair {
    /// Frames `index` and `index + 1` of a video (in exchanged order with probability ½), cut to a square at a random
    /// place; only that square is rendered.
    ///
    /// # Errors
    /// [`PairError::Crop`] for a crop larger than the frames.
    ///
    /// # Panics
    /// If the video has no frame `index + 1`.
    pub fn adjacent(video: &Sequence, index: usize, config: &PairConfig, rng: &mut impl Rng) -> Result<Self, PairError> {
        config.validate()?;
        let res = config.resolution;
        let window = Window { y: 0, x: 0, height: res, width: res }.draw(config.crop, rng);
        let swap = config.augment && rng.random_bool(0.5);
        let (target, source) = if swap { (index + 1, index) } else { (index, index + 1) };
        Ok(Self::cut(video, [target, source], res, [window, window], config.augment, rng))
    }

    /// A frame of the first 20 and one of the last 120, brought together by a coarse shift (their rounded mean flow plus
    /// up to 10 px of error per axis) and cut to their overlap; the flow is what the shift leaves over. Draws that overlap
    /// by less than 30 px (or than the crop) in width or height are repeated with other frames.
    ///
    /// # Errors
    /// [`PairError::NoOverlap`] when no draw overlaps enough, [`PairError::Crop`] for a crop larger than the frames.
    pub fn distant(video: &Sequence, config: &PairConfig, rng: &mut impl Rng) -> Result<Self, PairError> {
        config.validate()?;
        let (res, frames) = (config.resolution, video.len());
        for _ in 0..ATTEMPTS {
            let target = rng.random_range(0..GUIDANCE_FRAMES.min(frames));
            let source = rng.random_range(frames.saturating_sub(LATE_FRAMES)..frames);
            let mean = mean_flow(&video.homography(target, source, res), res);
            let shift = mean.map(|m| m.round() as i64 + rng.random_range(-SHIFT_JITTER_PX..=SHIFT_JITTER_PX));
            let Some([overlap, _]) = shifted_overlap(shift, res, config.needed()) else { continue };
            if target == source {
                continue;
            }
            let first = overlap.draw(config.crop, rng);
            let moved = |at: usize, by: i64| (at as i64 + by) as usize;
            let second = Window { y: moved(first.y, shift[1]), x: moved(first.x, shift[0]), ..first };
            return Ok(Self::cut(video, [target, source], res, [first, second], config.augment, rng));
        }
        Err(PairError::NoOverlap { material: video.material().to_owned(), frames, needed: config.needed() })
    }

    /// A square of side `side` at a random place, cut out of both images alike, so that pairs of any size can be batched.
    /// Pixels whose point leaves the square become invalid.
    ///
    /// # Errors
    /// [`PairError::Crop`] for a square larger than the images.
    pub fn cropped(&self, side: usize, rng: &mut impl Rng) -> Result<Self, PairError> {
        let (height, width) = (self.first.height, self.first.width);
        if side == 0 || side > height.min(width) {
            return Err(PairError::Crop { crop: side, resolution: height.min(width) });
        }
        let Window { y, x, .. } = Window { y: 0, x: 0, height, width }.draw(side, rng);
        let flow = self.flow.crop(y, x, side, side);
        let inside = |at: usize, step: f32| (0.0..=(side - 1) as f32).contains(&(at as f32 + step));
        let stays = Mask::from_fn(side, side, |y, x| inside(x, flow.at(0, y, x)) && inside(y, flow.at(1, y, x)));
        Ok(Self {
            first: self.first.crop(y, x, side, side),
            second: self.second.crop(y, x, side, side),
            valid: self.valid.crop(y, x, side, side).and(&stays),
            flow,
        })
    }

    /// Cuts windows out of two frames. The flow is that between the windows' own pixel coordinates.
    fn cut(
        video: &Sequence,
        [target, source]: [usize; 2],
        res: usize,
        [first, second]: [Window; 2],
        augment: bool,
        rng: &mut impl Rng,
    ) -> Self {
        let render = |frame, w: Window| video.frame_crop(frame, res, w.y, w.x, w.height, w.width);
        let mut images = [render(target, first), render(source, second)];
        let to_frame = Homography::translation(first.x as f64, first.y as f64);
        let to_window = Homography::translation(-(second.x as f64), -(second.y as f64));
        let mut warp = video.warp(target, source, res).within(&to_frame, &to_window);
        if augment {
            let change = Change::draw(rng);
            let sides = (first.height, first.width);
            images = images.map(|image| change.image(&image));
            warp = change.warp(warp, sides);
        }
        let [first, second] = images;
        let (flow, valid) = warp.flow([first.height, first.width], [second.height, second.width]);
        Self { first, second, flow, valid }
    }
}

/// Mean flow over the target image.
fn mean_flow(map: &Homography, res: usize) -> [f64; 2] {
    let mut sum = [0.0; 2];
    let at = |k: usize| (k as f64 + 0.5) / MEAN_GRID as f64 * res as f64 - 0.5;
    for (y, x) in (0..MEAN_GRID * MEAN_GRID).map(|i| (at(i / MEAN_GRID), at(i % MEAN_GRID))) {
        // A point beyond the horizon counts as no motion; the overlap test sorts such pairs out.
        let (sx, sy) = map.apply(x, y).unwrap_or((x, y));
        sum[0] += sx - x;
        sum[1] += sy - y;
    }
    sum.map(|s| s / (MEAN_GRID * MEAN_GRID) as f64)
}

/// The windows of target and source that a shift by (x, y) brings onto each other; `None` below `needed` pixels.
fn shifted_overlap(shift: [i64; 2], res: usize, needed: usize) -> Option<[Window; 2]> {
    let side = |s: i64| {
        let length = (res as i64).checked_sub(s.checked_abs()?)?;
        (length >= needed as i64).then_some(((-s).max(0) as usize, s.max(0) as usize, length as usize))
    };
    let ((tx, sx, width), (ty, sy, height)) = (side(shift[0])?, side(shift[1])?);
    Some([Window { y: ty, x: tx, height, width }, Window { y: sy, x: sx, height, width }])
}

/// A change that both images undergo.
#[derive(Clone, Copy, Debug)]
struct Change {
    flip_x: bool,
    flip_y: bool,
    transpose: bool,
    /// Source channel of each channel.
    channels: [usize; 3],
}

impl Change {
    fn draw(rng: &mut impl Rng) -> Self {
        let [flip_x, flip_y, transpose]: [bool; 3] = std::array::from_fn(|_| rng.random_bool(0.5));
        let mut channels = [0, 1, 2];
        channels.shuffle(rng);
        Self { flip_x, flip_y, transpose, channels }
    }

    fn image(&self, image: &Planes) -> Planes {
        let (height, width) = (image.height, image.width);
        let (out_height, out_width) = if self.transpose { (width, height) } else { (height, width) };
        let mut out = Planes::new(3, out_height, out_width);
        for c in 0..3 {
            let source = image.plane(self.channels[c]);
            for (i, value) in out.plane_mut(c).iter_mut().enumerate() {
                let (y, x) = (i / out_width, i % out_width);
                let (y, x) = if self.transpose { (x, y) } else { (y, x) };
                let y = if self.flip_y { height - 1 - y } else { y };
                let x = if self.flip_x { width - 1 - x } else { x };
                *value = source[y * width + x];
            }
        }
        out
    }

    /// The map between the changed images.
    fn warp(&self, warp: FrameWarp, (height, width): (usize, usize)) -> FrameWarp {
        let flip = |on: bool, side: usize| if on { (-1.0, side as f64 - 1.0) } else { (1.0, 0.0) };
        let ((sx, ox), (sy, oy)) = (flip(self.flip_x, width), flip(self.flip_y, height));
        let flips = Matrix3::new(sx, 0.0, ox, 0.0, sy, oy, 0.0, 0.0, 1.0);
        let transpose =
            if self.transpose { Matrix3::new(0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0) } else { Matrix3::identity() };
        // Flips are their own inverse, and so is the transposition.
        let (there, back) = (Homography::new(transpose * flips), Homography::new(flips * transpose));
        warp.within(&back, &there)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::path::PathConfig;
    use crate::sequence::SequenceConfig;
    use crate::sequence::lights::VideoLights;
    use crate::sequence::tests::{sequence, with_sensor};
    use crate::stream::Stream;
    use ops::flow_field::warp_planes;
    use render::light::Light;

    fn calm() -> SequenceConfig {
        SequenceConfig { noise_scale: 0.0, ..SequenceConfig::flow() }
    }

    /// A dull material under one light that rests: frames differ by the flow, not by a moving highlight.
    fn evenly_lit(video: u64) -> Sequence {
        let drawn = sequence(&calm(), video);
        let overhead = Light::Directional { wi: [0.0, 0.0, 1.0], irradiance: [1.5; 3] };
        let lights = VideoLights { intensity: 0.0, exponent: 1.0, resting: vec![overhead] };
        let mut surface = drawn.surface().clone();
        surface.augmentation.specular = 0.0;
        Sequence::from_parts(surface, drawn.path().clone(), lights)
    }

    fn config(crop: usize) -> PairConfig {
        PairConfig { resolution: 128, crop, augment: true }
    }

    /// Mean |second warped − first| beside mean |second − first|, over valid pixels.
    fn residual(pair: &FlowPair) -> (f32, f32) {
        let (warped, _) = warp_planes(&pair.second, &pair.flow);
        let area = pair.first.area();
        let pixels: Vec<usize> = (0..area).filter(|&i| pair.valid.data[i]).collect();
        let error = |image: &Planes| {
            let sum = |c: usize| -> f32 {
                pixels.iter().map(|&i| (image.data[c * area + i] - pair.first.data[c * area + i]).abs()).sum()
            };
            (0..3).map(sum).sum::<f32>() / (3 * pixels.len()) as f32
        };
        (error(&warped), error(&pair.second))
    }

    #[test]
    fn warping_the_second_image_by_the_flow_gives_the_first_under_every_augmentation() {
        let video = evenly_lit(4);
        for draw in 0..24 {
            let rng = &mut Stream::new(9).rng("pair", draw);
            let pair = FlowPair::adjacent(&video, 3 + draw as usize, &config(96), rng).unwrap();
            let (warped, still) = residual(&pair);
            assert!(warped < 0.2 * still, "draw {draw}: {warped} warped, {still} as it is");
        }
    }

    #[test]
    fn the_flow_of_a_pair_follows_a_bending_lens_and_a_rolling_shutter() {
        let options = "distortion = { k1 = [-0.4, -0.4], k2 = [0.0, 0.0] }\nrolling_shutter = { readout = [1.0, 1.0] }";
        let bent = with_sensor(evenly_lit(4), options);
        for draw in 0..12 {
            let rng = || Stream::new(9).rng("pair", draw);
            let pair = FlowPair::adjacent(&bent, 3 + draw as usize, &config(96), &mut rng()).unwrap();
            let (warped, still) = residual(&pair);
            assert!(warped < 0.2 * still, "draw {draw}: {warped} warped, {still} as it is");
            let ideal = FlowPair::adjacent(&evenly_lit(4), 3 + draw as usize, &config(96), &mut rng()).unwrap();
            assert_ne!(pair.flow, ideal.flow);
            assert_eq!((pair.flow.height, pair.flow.width), (ideal.flow.height, ideal.flow.width));
        }
        let pair = FlowPair::distant(&bent, &config(0), &mut Stream::new(9).rng("pair", 0)).unwrap();
        let (warped, still) = residual(&pair);
        assert!(warped < 0.5 * still, "{warped} warped, {still} as it is");
    }

    #[test]
    fn distant_pairs_overlap_and_their_flow_is_what_the_shift_leaves() {
        for draw in 0..24 {
            let video = evenly_lit(draw % 4);
            let pair = FlowPair::distant(&video, &config(0), &mut Stream::new(9).rng("pair", draw)).unwrap();
            assert!(pair.first.height >= LEAST_OVERLAP_PX && pair.first.width >= LEAST_OVERLAP_PX);
            assert_eq!((pair.first.height, pair.first.width), (pair.second.height, pair.second.width));
            let mean = |c: usize| pair.flow.plane(c).iter().sum::<f32>() / pair.first.area() as f32;
            assert!(mean(0).abs() < 30.0 && mean(1).abs() < 30.0);
            if pair.valid.count() > 400 {
                let (warped, still) = residual(&pair);
                assert!(warped < 0.3 * still, "draw {draw}: {warped} warped, {still} as it is");
            }
        }
    }

    #[test]
    fn crops_of_one_size_can_be_batched() {
        let video = sequence(&calm(), 1);
        let sizes = |pair: FlowPair| [pair.first, pair.second, pair.flow].map(|p| (p.height, p.width));
        for draw in 0..6 {
            let rng = &mut Stream::new(2).rng("pair", draw);
            assert_eq!(sizes(FlowPair::distant(&video, &config(64), rng).unwrap()), [(64, 64); 3]);
            assert_eq!(sizes(FlowPair::adjacent(&video, 50, &config(64), rng).unwrap()), [(64, 64); 3]);
        }
    }

    #[test]
    fn a_square_of_a_pair_keeps_its_flow_and_forgets_what_leaves_it() {
        let pair = FlowPair::adjacent(&evenly_lit(1), 20, &config(0), &mut Stream::new(2).rng("pair", 0)).unwrap();
        let square = pair.cropped(48, &mut Stream::new(2).rng("pair", 1)).unwrap();
        assert_eq!((square.first.height, square.flow.width, square.valid.height), (48, 48, 48));
        let (warped, still) = residual(&square);
        assert!(warped < 0.2 * still, "{warped} warped, {still} as it is");
        let (_, inside) = warp_planes(&square.second, &square.flow);
        assert!((0..48 * 48).all(|i| inside.data[i] || !square.valid.data[i]));
        assert!(pair.cropped(129, &mut Stream::new(2).rng("pair", 1)).is_err());
    }

    #[test]
    fn small_overlaps_are_rejected() {
        let side = |shift| shifted_overlap([shift, 0], 128, 30).map(|w| (w[0].x, w[1].x, w[0].width));
        assert_eq!(side(98), Some((0, 98, 30)));
        assert_eq!(side(-98), Some((98, 0, 30)));
        assert_eq!(side(99), None);
        assert_eq!(side(i64::MIN), None);
        // From frame 60 on the spiral is 4 units (20 px) and more away from its first frames: no random shift cancels that.
        let path = PathConfig { deviation_scale: 0.0, ..PathConfig::default() };
        let drawn = sequence(&SequenceConfig { path, ..calm() }, 0);
        let mut path = drawn.path().clone();
        path.cameras.splice(20..60, []);
        path.cameras.extend_from_within(60..);
        let video = Sequence::from_parts(drawn.surface().clone(), path, drawn.lights().clone());
        let error = FlowPair::distant(&video, &config(128), &mut Stream::new(0).rng("pair", 0)).unwrap_err();
        assert!(matches!(error, PairError::NoOverlap { needed: 128, .. }), "{error}");
        let error = FlowPair::adjacent(&sequence(&calm(), 0), 0, &config(129), &mut Stream::new(0).rng("pair", 0));
        assert!(error.unwrap_err().to_string().contains("pair.crop is 129"));
    }

    #[test]
    fn the_mean_flow_is_the_mean_of_the_dense_flow() {
        let map = sequence(&calm(), 2).homography(3, 60, 64);
        let dense = map.flow(64, 64);
        let coarse = mean_flow(&map, 64);
        for c in 0..2 {
            let mean = dense.plane(c).iter().sum::<f32>() / 4096.0;
            assert!((f64::from(mean) - coarse[c]).abs() < 0.05);
        }
    }
}
