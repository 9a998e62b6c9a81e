//! Camera paths of scanning videos: a template (paper Fig. 4), its placement, and a hand's deviations (Eqs. 1–4, Table 1).
//!
//! World: the material lies on z = 0 over \[−1, 1\]², x right, y up, z towards the camera. A template is given in *units* of
//! which 12 are half the width of a view (ξ), so that its turns overlap by the same share whatever the height.

pub mod jitter;
pub mod line;
pub mod spiral;
pub mod zigzag;

use rand::{Rng, RngExt};
use render::camera::Camera;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use jitter::{CameraJitter, Deviation};
use line::LineOrder;

/// The camera's x and y never leave ±0.9 (§4; the material ends at ±1).
pub const CLAMP: f64 = 0.9;

/// Least height of a camera, as a share of the height it should have.
const LEAST_HEIGHT: f64 = 0.2;

/// Longest path, at frame rate 1.
const MOST_FRAMES: f64 = 1e5;

/// Template units in half the width of a view.
const UNITS_PER_HALF_VIEW: f64 = 12.0;

/// The shape of a scan.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Template {
    /// Square spiral (Fig. 4): both flow nets and the SVBRDF net.
    #[default]
    Spiral,
    /// Up-down line (Fig. 4): the SVBRDF net only.
    Line,
    /// Boustrophedon: testing (Table 5) and large areas (Fig. 9).
    Zigzag,
}

/// How long a template unit is in the world.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum UnitLength {
    /// U\[0.8, 1.2\]·ξ/12, as the authors' released code has it: steps are a share of the view.
    #[default]
    View,
    /// The paper's text: the template (±12 units = ±1) is scaled by U\[0.075, 0.1\], whatever the view.
    World,
}

/// What paths to draw.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct PathConfig {
    /// The template of a video that isn't a line.
    pub template: Template,
    /// Probability of the line instead of `template` (paper: 1/3 for the SVBRDF net, 0 for the flow nets).
    #[schemars(extend("unit" = "probability"))]
    pub line_share: f64,
    /// In which order a line is visited.
    pub line_order: LineOrder,
    /// Length of a template unit.
    pub unit_length: UnitLength,
    /// Multiplies λ of Table 1 (Table 5, "deviations": 0, 0.25, 0.5, 1, 2).
    pub deviation_scale: f64,
    /// By how many degrees the phone turns about its view axis from the first frame to the last, evenly; to the left or to the
    /// right by a draw.
    pub roll_deg: f64,
    /// Frames per frame of the original path (Table 5: 4, 2, 0.5); the path itself stays the same.
    pub frame_rate: f64,
    /// Frames of the path at frame rate 1; the spiral has 141 points.
    #[schemars(extend("unit" = "frames"))]
    pub frames: usize,
}

impl Default for PathConfig {
    fn default() -> Self {
        Self {
            template: Template::Spiral,
            line_share: 0.0,
            line_order: LineOrder::Scan,
            unit_length: UnitLength::View,
            deviation_scale: 1.0,
            roll_deg: 0.0,
            frame_rate: 1.0,
            frames: spiral::POINTS,
        }
    }
}

/// A path that can't be drawn.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PathError {
    /// A video needs two frames.
    #[error("path.frames is {0}; a video needs at least 2 frames")]
    TooFewFrames(usize),
    /// The spiral is a fixed list of points.
    #[error("path.frames is {0}, but the spiral has 141 points; use at most 141, or template = \"zigzag\" for longer scans")]
    LongerThanSpiral(usize),
    /// A number outside its range.
    #[error("path.{name} is {value}; expected {expected}")]
    OutOfRange {
        /// The key.
        name: &'static str,
        /// What was found.
        value: f64,
        /// What is allowed.
        expected: &'static str,
    },
}

impl PathConfig {
    /// Checks every value.
    ///
    /// # Errors
    /// [`PathError`] names the key, its value and the allowed range.
    pub fn validate(&self) -> Result<(), PathError> {
        let in_range = |name, value: f64, low, high, expected| {
            if (low..=high).contains(&value) { Ok(()) } else { Err(PathError::OutOfRange { name, value, expected }) }
        };
        in_range("line_share", self.line_share, 0.0, 1.0, "a probability, 0 to 1")?;
        in_range("deviation_scale", self.deviation_scale, 0.0, 10.0, "a factor, 0 to 10")?;
        in_range("roll_deg", self.roll_deg, 0.0, 3600.0, "an angle in degrees, 0 to 3600")?;
        in_range("frame_rate", self.frame_rate, 0.05, 20.0, "a factor, 0.05 to 20")?;
        in_range("frames", self.frames as f64, 0.0, MOST_FRAMES, "2 to 100000, an hour of video")?;
        if self.frames < 2 || self.frame_count() < 2 {
            return Err(PathError::TooFewFrames(self.frames));
        }
        if self.template == Template::Spiral && self.frames > spiral::POINTS {
            return Err(PathError::LongerThanSpiral(self.frames));
        }
        Ok(())
    }

    /// Frames that a drawn path has: `frames` resampled by `frame_rate`.
    pub fn frame_count(&self) -> usize {
        ((self.frames.max(1) - 1) as f64 * self.frame_rate).round() as usize + 1
    }

    /// Draws the path of one video. Every draw is made whatever the configuration, so that switching one option (the
    /// deviations, say) leaves the rest of the video as it was.
    ///
    /// # Source
    /// §4 and the released code: fov ~ U\[25°, 35°\], ξ ~ U\[0.05, 0.1\], height d0 = ξ / tan(fov/2), start ~ U\[−0.5, 0.5\]²,
    /// swap of x and y, negation of x and of y with probability ½ each, then the perturbation.
    pub fn draw(&self, rng: &mut impl Rng) -> CameraPath {
        let is_line = rng.random_range(0.0..1.0) < self.line_share;
        let fov_rad = rng.random_range(25.0_f64..=35.0).to_radians();
        let half_view = rng.random_range(0.05..=0.1);
        let height = half_view / (fov_rad / 2.0).tan();
        let start: [f64; 2] = std::array::from_fn(|_| rng.random_range(-0.5..=0.5));
        let share: f64 = rng.random_range(0.0..=1.0);
        let unit = match self.unit_length {
            UnitLength::View => (0.8 + 0.4 * share) * half_view / UNITS_PER_HALF_VIEW,
            UnitLength::World => (0.075 + 0.025 * share) / UNITS_PER_HALF_VIEW,
        };
        let [swap, negate_x, negate_y]: [bool; 3] = std::array::from_fn(|_| rng.random_bool(0.5));
        let template = if is_line { Template::Line } else { self.template };
        let mut jitter = CameraJitter::at_rest();
        let poses: Vec<Pose> = template_points(template, self.frames, self.line_order)
            .into_iter()
            .enumerate()
            .map(|(i, [x, y])| {
                let deviation = if i == 0 { Deviation::default() } else { jitter.step(self.deviation_scale, rng) };
                let [x, y] = if swap { [y, x] } else { [x, y] };
                let sign = |negate| if negate { -unit } else { unit };
                Pose::on_path([start[0] + sign(negate_x) * x, start[1] + sign(negate_y) * y, height], &deviation)
            })
            .collect();
        let roll = if rng.random_bool(0.5) { self.roll_deg } else { -self.roll_deg }.to_radians();
        let last = self.frame_count().max(2) - 1;
        let cameras = resampled(&poses, self.frame_count())
            .iter()
            .enumerate()
            .map(|(i, pose)| pose.camera(fov_rad).rolled(roll * i as f64 / last as f64))
            .collect();
        CameraPath { cameras, template, fov_rad, half_view, height, unit }
    }
}

fn template_points(template: Template, frames: usize, order: LineOrder) -> Vec<[f64; 2]> {
    match template {
        Template::Spiral => spiral::spiral().into_iter().take(frames).collect(),
        Template::Line => line::line(frames, order),
        Template::Zigzag => zigzag::zigzag(frames),
    }
}

/// The cameras of one video and the figures they were drawn from.
#[derive(Clone, Debug)]
pub struct CameraPath {
    /// One camera per frame.
    pub cameras: Vec<Camera>,
    /// The template that was drawn.
    pub template: Template,
    /// Full field of view.
    pub fov_rad: f64,
    /// ξ: half the width of the first frame's view, world units.
    pub half_view: f64,
    /// d0: the height of the template, world units.
    pub height: f64,
    /// Length of a template unit, world units.
    pub unit: f64,
}

impl CameraPath {
    /// The cameras one frame before, at, and one frame after a frame. Before the first and after the last frame the motion is
    /// taken to go on as it was.
    ///
    /// # Panics
    /// If there is no such frame.
    pub fn around(&self, frame: usize) -> [Camera; 3] {
        let at = self.cameras[frame];
        let neighbour = |index: Option<usize>, opposite: usize| match index.and_then(|i| self.cameras.get(i)) {
            Some(camera) => *camera,
            None => continued(&at, self.cameras.get(opposite).unwrap_or(&at)),
        };
        [neighbour(frame.checked_sub(1), frame + 1), at, neighbour(Some(frame + 1), frame.saturating_sub(1))]
    }
}

/// Where the motion from `from` to `at` leads within another frame, as high above the surface as [`Pose::on_path`] demands.
fn continued(at: &Camera, from: &Camera) -> Camera {
    let mut camera = at.towards(from, -1.0);
    camera.position[2] = camera.position[2].max(LEAST_HEIGHT * at.position[2]);
    camera
}

/// A camera's position, look-at point and tilt, before they become axes.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Pose {
    position: [f64; 3],
    look_at: [f64; 2],
    tilt: f64,
}

impl Pose {
    /// Eq. 4: the template's position plus the deviations; x and y clamped; the view follows the clamped position.
    fn on_path(template: [f64; 3], deviation: &Deviation) -> Self {
        let clamped = |k: usize| (template[k] + deviation.position[k]).clamp(-CLAMP, CLAMP);
        let (x, y) = (clamped(0), clamped(1));
        // A hand never reaches the surface: at deviation scales far above the paper's the height would cross it.
        let z = (template[2] + deviation.position[2]).max(LEAST_HEIGHT * template[2]);
        Self { position: [x, y, z], look_at: [x + deviation.look_at[0], y + deviation.look_at[1]], tilt: deviation.tilt }
    }

    fn camera(&self, fov_rad: f64) -> Camera {
        Camera::look_at(self.position, [self.look_at[0], self.look_at[1], 0.0], [self.tilt, 1.0, 0.0], fov_rad)
    }

    fn between(&self, next: &Self, share: f64) -> Self {
        let mix = |a: f64, b: f64| a + share * (b - a);
        Self {
            position: std::array::from_fn(|k| mix(self.position[k], next.position[k])),
            look_at: std::array::from_fn(|k| mix(self.look_at[k], next.look_at[k])),
            tilt: mix(self.tilt, next.tilt),
        }
    }
}

/// The same way through the poses with another number of frames, linear between poses.
fn resampled(poses: &[Pose], count: usize) -> Vec<Pose> {
    if count == poses.len() {
        return poses.to_vec();
    }
    let last = poses.len() - 1;
    (0..count)
        .map(|i| {
            let position = i as f64 * last as f64 / (count - 1).max(1) as f64;
            let first = (position.floor() as usize).min(last.saturating_sub(1));
            poses[first].between(&poses[(first + 1).min(last)], position - first as f64)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    fn paths(config: &PathConfig, count: u64) -> Vec<CameraPath> {
        (0..count).map(|seed| config.draw(&mut ChaCha8Rng::seed_from_u64(seed))).collect()
    }

    #[test]
    fn figures_stay_in_the_ranges_of_the_paper() {
        for path in paths(&PathConfig::default(), 60) {
            assert_eq!(path.cameras.len(), 141);
            assert!((25.0..=35.0).contains(&path.fov_rad.to_degrees()));
            assert!((0.05..=0.1).contains(&path.half_view));
            assert!((path.height * (path.fov_rad / 2.0).tan() - path.half_view).abs() < 1e-12);
            assert!((0.8..=1.2).contains(&(path.unit * 12.0 / path.half_view)));
            assert!(path.cameras.iter().all(|c| c.position[0].abs() <= CLAMP && c.position[1].abs() <= CLAMP));
        }
    }

    #[test]
    fn without_deviations_the_camera_looks_straight_down_on_the_template() {
        let config = PathConfig { deviation_scale: 0.0, ..Default::default() };
        for path in paths(&config, 8) {
            let first = path.cameras[0].position;
            for camera in &path.cameras {
                assert!((camera.forward[2] + 1.0).abs() < 1e-12 && (camera.right[0] - 1.0).abs() < 1e-12);
                assert_eq!(camera.position[2], path.height);
            }
            let step = |i: usize| (0..2).map(|k| (path.cameras[i].position[k] - first[k]).abs()).sum::<f64>();
            assert!((step(1) - path.unit).abs() < 1e-12 && (step(8) - 8.0 * path.unit).abs() < 1e-12);
        }
    }

    #[test]
    fn deviations_leave_the_other_draws_alone() {
        let calm = PathConfig { deviation_scale: 0.0, ..Default::default() };
        for (a, b) in paths(&calm, 5).iter().zip(&paths(&PathConfig::default(), 5)) {
            assert_eq!((a.fov_rad, a.height, a.unit), (b.fov_rad, b.height, b.unit));
            assert_eq!(a.cameras[0].position, b.cameras[0].position);
            assert!(a.cameras[50].position != b.cameras[50].position);
        }
    }

    #[test]
    fn all_eight_orientations_and_the_line_share_are_drawn() {
        let config = PathConfig { line_share: 1.0 / 3.0, deviation_scale: 0.0, ..Default::default() };
        let drawn = paths(&config, 300);
        let lines = drawn.iter().filter(|p| p.template == Template::Line).count();
        assert!((70..130).contains(&lines), "{lines} lines of 300");
        let mut seen = std::collections::BTreeSet::new();
        for path in drawn.iter().filter(|p| p.template == Template::Spiral) {
            let along = |i: usize, k: usize| path.cameras[i].position[k] - path.cameras[0].position[k];
            seen.insert((along(4, 0).abs() > along(4, 1).abs(), along(8, 0) > 0.0, along(8, 1) > 0.0));
        }
        assert_eq!(seen.len(), 8);
    }

    #[test]
    fn a_roll_turns_the_camera_about_its_view_axis_and_changes_nothing_else() {
        let rolled = paths(&PathConfig { roll_deg: 180.0, ..Default::default() }, 12);
        let upright = paths(&PathConfig::default(), 12);
        let mut directions = std::collections::BTreeSet::new();
        for (rolled, upright) in rolled.iter().zip(&upright) {
            for (a, b) in rolled.cameras.iter().zip(&upright.cameras) {
                assert_eq!((a.position, a.forward), (b.position, b.forward));
            }
            let across = |i: usize, axis: [f64; 3]| (0..3).map(|k| rolled.cameras[i].right[k] * axis[k]).sum::<f64>();
            assert!((across(70, upright.cameras[70].right)).abs() < 1e-9, "a quarter turn half way");
            assert!((across(140, upright.cameras[140].right) + 1.0).abs() < 1e-9, "half a turn at the end");
            assert_eq!(rolled.cameras[0], upright.cameras[0]);
            directions.insert(across(70, upright.cameras[70].down) > 0.0);
        }
        assert_eq!(directions.len(), 2);
    }

    #[test]
    fn the_frame_rate_resamples_the_same_way() {
        let base = &paths(&PathConfig::default(), 1)[0];
        let fast = &paths(&PathConfig { frame_rate: 4.0, ..Default::default() }, 1)[0];
        let slow = &paths(&PathConfig { frame_rate: 0.5, ..Default::default() }, 1)[0];
        assert_eq!((fast.cameras.len(), slow.cameras.len()), (561, 71));
        for k in 0..3 {
            assert!((fast.cameras[4 * 37].position[k] - base.cameras[37].position[k]).abs() < 1e-12);
            assert!((slow.cameras[33].position[k] - base.cameras[66].position[k]).abs() < 1e-12);
        }
    }

    #[test]
    fn the_motion_goes_on_beyond_both_ends_of_the_path() {
        let path = &paths(&PathConfig::default(), 1)[0];
        assert_eq!(path.around(7), [path.cameras[6], path.cameras[7], path.cameras[8]]);
        let ([before, first, second], [.., last, after]) = (path.around(0), path.around(140));
        assert_eq!((first, second, last), (path.cameras[0], path.cameras[1], path.cameras[140]));
        for k in 0..3 {
            assert!((before.position[k] - 2.0 * first.position[k] + second.position[k]).abs() < 1e-12);
            assert!((after.position[k] - 2.0 * last.position[k] + path.cameras[139].position[k]).abs() < 1e-12);
        }
        let still = CameraPath { cameras: vec![first], ..path.clone() };
        assert!(still.around(0).iter().all(|c| (c.position[0] - first.position[0]).abs() < 1e-12));
        let mut diving = path.clone();
        diving.cameras[1].position[2] = 3.0 * first.position[2];
        assert_eq!(diving.around(0)[0].position[2], LEAST_HEIGHT * first.position[2]);
    }

    #[test]
    fn bad_values_are_named() {
        let refused = |config: PathConfig| config.validate().unwrap_err().to_string();
        assert!(refused(PathConfig { frames: 1, ..Default::default() }).contains("frames is 1"));
        assert!(refused(PathConfig { frames: 142, ..Default::default() }).contains("141 points"));
        let endless = PathConfig { template: Template::Zigzag, frames: usize::MAX, ..Default::default() };
        assert!(refused(endless).contains("frames is 18446744073709552000; expected 2 to 100000"));
        assert!(refused(PathConfig { line_share: 1.5, ..Default::default() }).contains("line_share is 1.5"));
        assert!(refused(PathConfig { roll_deg: -5.0, ..Default::default() }).contains("roll_deg is -5"));
        assert!(refused(PathConfig { frame_rate: f64::NAN, ..Default::default() }).contains("frame_rate"));
        assert!(PathConfig { template: Template::Zigzag, frames: 500, ..Default::default() }.validate().is_ok());
    }
}
