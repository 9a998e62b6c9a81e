//! Distant pairs: which frames, what error of the coarse shift, and which overlaps are refused.

use std::f64::consts::PI;

use dataset::material::AugmentedMaterial;
use dataset::pair::{FlowPair, PairConfig};
use dataset::path::{CameraPath, PathConfig};
use dataset::sequence::Sequence;
use dataset::sequence::lights::VideoLights;
use render::camera::Camera;

use crate::laws::uniform_integers;
use crate::{painted, rng};

const RES: usize = 64;

/// A video by a camera that looks straight down and stands so many pixels right of and below the first place.
fn video(shift_px: impl Fn(usize) -> [f64; 2]) -> Sequence {
    let (fov_rad, height) = (PI / 6.0, 0.2);
    let pixel = 2.0 * height * (fov_rad / 2.0).tan() / RES as f64;
    let camera = |frame: usize| {
        let [x, y] = shift_px(frame);
        let [x, y] = [x * pixel, -y * pixel];
        Camera::look_at([x, y, height], [x, y, 0.0], [0.0, 1.0, 0.0], fov_rad)
    };
    let drawn = PathConfig { frames: 2, ..PathConfig::default() }.draw(&mut rng(0));
    let path = CameraPath { cameras: (0..141).map(camera).collect(), fov_rad, height, ..drawn };
    Sequence::from_parts(AugmentedMaterial::plain(painted(|_, _| 0.5)), path, VideoLights::flash(height))
}

fn pairs(video: &Sequence, count: usize) -> Vec<FlowPair> {
    let config = PairConfig { resolution: RES, crop: 0, augment: false };
    let mut rng = rng(10);
    (0..count).map(|_| FlowPair::distant(video, &config, &mut rng).expect("these frames overlap")).collect()
}

/// The coarse shift (the overlap lacks as many pixels) and the whole flow, which is the shift and the label; both along an
/// axis on which all shifts are to the right or down.
fn shift_and_flow(pair: &FlowPair, axis: usize) -> (i64, f64) {
    let label = pair.flow.plane(axis);
    assert!(label.iter().all(|v| (v - label[0]).abs() < 1e-3), "the flow of a straight view is even");
    let shift = RES - [pair.first.width, pair.first.height][axis];
    (shift as i64, shift as f64 + f64::from(label[0]))
}

#[test]
fn distant_pairs_join_early_and_late_frames_with_up_to_ten_pixels_of_error() {
    // The flow tells the frames: early ones stand at different heights, late ones at different places along x. All are 11 px
    // and more apart, so that no error turns a shift around, and so near that every overlap will do.
    let (apart, along, down) = (11.035, 0.09, 0.5);
    let video = video(|frame| if frame < 20 { [0.0, down * frame as f64] } else { [-apart - along * frame as f64, -apart] });
    let (mut early, mut late, mut errors) = (vec![], vec![], [vec![], vec![]]);
    let index = |frame: f64| {
        assert!((frame - frame.round()).abs() < 0.01, "{frame} is no frame");
        frame.round() as i64
    };
    for pair in pairs(&video, 1500) {
        let [x, y] = [0, 1].map(|axis| {
            let (shift, flow) = shift_and_flow(&pair, axis);
            errors[axis].push(shift - flow.round() as i64);
            flow
        });
        early.push(index((y - apart) / down));
        late.push(index((x - apart) / along));
    }
    uniform_integers(&errors[0], -10..=10).expect("error of the coarse shift along x");
    uniform_integers(&errors[1], -10..=10).expect("error of the coarse shift along y");
    uniform_integers(&early, 0..=19).expect("early frames");
    uniform_integers(&late, 21..=140).expect("late frames");
}

#[test]
fn overlaps_below_thirty_pixels_are_refused_in_width_and_height() {
    for axis in 0..2 {
        // Up to 39 px and the error apart.
        let away = |frame: usize| if frame > 20 { -11.0 - 0.2 * frame as f64 } else { 0.0 };
        let video = video(|frame| std::array::from_fn(|k| if k == axis { away(frame) } else { 0.0 }));
        let drawn = pairs(&video, 400);
        let side = |pair: &FlowPair| [pair.first.width, pair.first.height][axis];
        assert_eq!(drawn.iter().map(side).min(), Some(30));
        assert!(drawn.iter().map(side).collect::<std::collections::BTreeSet<_>>().len() > 20, "sizes vary");
    }
}
