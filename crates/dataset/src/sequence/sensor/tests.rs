use std::sync::Arc;

use ops::colour::gamma_decode;
use ops::flow_field::warp_planes;
use ops::planes::Planes;
use render::camera::Camera;
use render::light::Light;
use render::texel::Texel;

use super::*;
use crate::material::augment::{Augmentation, AugmentedMaterial};
use crate::material::{Material, MaterialInfo, Precision};
use crate::path::CameraPath;
use crate::sequence::lights::VideoLights;
use crate::sequence::tests::{sequence, with_sensor};
use crate::sequence::{Sequence, SequenceConfig, SequenceConfigError};

/// Every option at its defaults.
const ALL: &str = "vignetting = {}\nexposure = {}\nwhite_balance = {}\nmotion_blur = {}\ndistortion = {}\n\
                   rolling_shutter = {}\ncompression = {}";
/// Every option that has a strength 0, at 0.
const ZERO: &str = "vignetting = { corner_loss = [0.0, 0.0] }\nexposure = { stops = 0.0 }\nwhite_balance = { stops = 0.0 }\n\
                    motion_blur = { shutter = [0.0, 0.0] }\ndistortion = { k1 = [0.0, 0.0], k2 = [0.0, 0.0] }\n\
                    rolling_shutter = { readout = [0.0, 0.0] }";
/// A strong lens and a slow shutter.
const BENT: &str = "distortion = { k1 = [-0.3, -0.3], k2 = [0.1, 0.1] }\nrolling_shutter = { readout = [0.9, 0.9] }";

fn drawn(text: &str) -> VideoSensor {
    VideoSensor::draw(&toml::from_str(text).unwrap(), &Stream::new(8))
}

#[test]
fn an_option_leaves_the_draws_of_the_others_alone() {
    let all = drawn(ALL);
    assert_eq!(drawn(""), VideoSensor::default());
    assert_eq!(drawn("vignetting = {}"), VideoSensor { vignetting: all.vignetting, ..Default::default() });
    assert_eq!(drawn("exposure = {}"), VideoSensor { exposure: all.exposure, ..Default::default() });
    assert_eq!(drawn("white_balance = {}"), VideoSensor { white_balance: all.white_balance, ..Default::default() });
    let blur = VideoSensor { shutter: all.shutter, sub_frames: 16, ..Default::default() };
    assert_eq!(drawn("motion_blur = {}"), blur);
    assert_eq!(drawn("distortion = {}"), VideoSensor { distortion: all.distortion, ..Default::default() });
    assert_eq!(drawn("rolling_shutter = {}"), VideoSensor { readout: all.readout, ..Default::default() });
    assert_eq!(drawn("compression = {}"), VideoSensor { quality: all.quality, ..Default::default() });
}

#[test]
fn draws_stay_in_their_ranges() {
    let config: SensorConfig = toml::from_str(
        "motion_blur = { shutter = [0.2, 0.3] }\ndistortion = { k1 = [-0.1, 0.0], k2 = [0.01, 0.02] }\n\
         rolling_shutter = { readout = [0.5, 0.6] }\ncompression = { quality = [70, 72] }",
    )
    .unwrap();
    let mut qualities = std::collections::BTreeSet::new();
    for video in 0..60 {
        let sensor = VideoSensor::draw(&config, &Stream::new(1).child("sensor", video));
        assert!((0.2..=0.3).contains(&sensor.shutter) && (0.5..=0.6).contains(&sensor.readout));
        assert!((-0.1..=0.0).contains(&sensor.distortion.k1) && (0.01..=0.02).contains(&sensor.distortion.k2));
        qualities.extend(sensor.quality);
    }
    assert_eq!(qualities.into_iter().collect::<Vec<_>>(), [70, 71, 72]);
}

#[test]
fn white_balance_keeps_the_luminance_of_grey_and_changes_its_colour() {
    let sensor = drawn("white_balance = { stops = 0.5 }");
    assert_eq!(sensor.white_balance_gains(0.0), [1.0; 3]);
    for share in [0.3, 0.8, 1.0] {
        let gains = sensor.white_balance_gains(share).map(f64::from);
        let luminance: f64 = (0..3).map(|c| LUMINANCE[c] * gains[c]).sum();
        assert!((luminance - 1.0).abs() < 1e-6);
        assert!((gains[0] / gains[1] - 1.0).abs() > 1e-3 && (gains[2] / gains[1] - 1.0).abs() > 1e-3, "{gains:?}");
    }
}

/// A video of the waves with the options of a text.
fn video(options: &str, noise_scale: f32) -> Sequence {
    let sensor = toml::from_str(options).unwrap();
    sequence(&SequenceConfig { sensor, noise_scale, ..SequenceConfig::flow() }, 3)
}

/// Speed of [`moving`] in pixels of a frame of [`RES`] pixels, to the left: the camera goes to the right.
const SPEED: f64 = 6.0;
const RES: usize = 96;

/// An evenly lit, dull video by a camera that moves along x at a known speed and looks straight down; `diffuse` is a function
/// of the world's x and y.
fn moving(diffuse: impl Fn(f32, f32) -> f32 + Sync, options: &str) -> Sequence {
    let size = 1024;
    let info = MaterialInfo { texels: size, ..MaterialInfo::made_up("test") };
    let world = |v: usize| (v as f32 + 0.5) / size as f32 * 2.0 - 1.0;
    let texel = |x: usize, y: usize| Texel {
        normal: [0.0, 0.0, 1.0],
        diffuse: [diffuse(world(x), -world(y)); 3],
        roughness: 1.0,
        specular: [0.0; 3],
    };
    let material = Arc::new(Material::build(info, size, size, Precision::Sixteen, texel).unwrap());
    let drawn = sequence(&SequenceConfig::flow(), 0);
    // Half a radian sees tan(¼) to either side at height 1.
    let (fov_rad, height) = (0.5, 0.4);
    let step = SPEED / RES as f64 * 2.0 * height * f64::tan(0.25);
    let camera = |i: i32| {
        let x = f64::from(i - 2) * step;
        Camera::look_at([x, 0.0, height], [x, 0.0, 0.0], [0.0, 1.0, 0.0], fov_rad)
    };
    let path = CameraPath { cameras: (0..5).map(camera).collect(), ..drawn.path().clone() };
    let overhead = Light::Directional { wi: [0.0, 0.0, 1.0], irradiance: [2.0; 3] };
    let lights = VideoLights { intensity: 0.0, exponent: 1.0, resting: vec![overhead] };
    let surface = AugmentedMaterial { material, augmentation: Augmentation::IDENTITY };
    with_sensor(Sequence::from_parts(surface, path, lights), options)
}

#[test]
fn strength_0_is_bit_for_bit_the_paper_s_sensor() {
    let (plain, zero) = (video("", 1.0), video(ZERO, 1.0));
    for frame in [0, 9, 140] {
        assert_eq!(plain.frame(frame, 40), zero.frame(frame, 40));
        assert_eq!(plain.radiance(frame, 24), zero.radiance(frame, 24));
    }
    assert_eq!(plain.warp(3, 60, 40), zero.warp(3, 60, 40));
    assert_eq!(plain.target_maps(5, 24).normal, zero.target_maps(5, 24).normal);
}

#[test]
fn a_crop_is_the_rectangle_of_the_frame_under_every_option() {
    for option in ALL.lines().chain(["", ZERO, BENT, ALL]) {
        let video = video(option, 1.0);
        let whole = video.frame(9, 61);
        assert_eq!(video.frame_crop(9, 61, 13, 20, 30, 41), whole.crop(13, 20, 30, 41), "{option}");
        assert!(whole.data.iter().all(|v| (v * 255.0 - (v * 255.0).round()).abs() < 1e-4 && (0.0..=1.0).contains(v)));
    }
}

#[test]
fn every_option_but_none_changes_frames_and_repeats_on_any_number_of_threads() {
    // Large enough for the motion to exceed a pixel while the shutter is open.
    let plain = video("", 1.0).frame(30, 160);
    let one_thread = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let five_threads = rayon::ThreadPoolBuilder::new().num_threads(5).build().unwrap();
    for option in ALL.lines().chain([ALL]) {
        let frame = || video(option, 1.0).frame(30, 160);
        let reference = frame();
        assert!(reference != plain, "{option}");
        assert_eq!(one_thread.install(frame), reference);
        assert_eq!(five_threads.install(frame), reference);
    }
}

#[test]
fn one_pixel_and_two_frames_are_enough() {
    let sensor: SensorConfig = toml::from_str(ALL).unwrap();
    let mut config = SequenceConfig { sensor, ..SequenceConfig::svbrdf() };
    config.path.frames = 2;
    let video = sequence(&config, 1);
    for frame in [0, 1] {
        assert_eq!(video.frame(frame, 1).data.len(), 3);
        assert!(video.radiance(frame, 1).data.iter().all(|v| v.is_finite()));
    }
    let (flow, _) = video.flow(0, 1, 1);
    assert!(flow.data.iter().all(|v| v.is_finite()));
}

#[test]
fn vignetting_multiplies_the_light_by_its_fall_off() {
    let (plain, dark) = (video("", 0.0), video("vignetting = { corner_loss = [0.4, 0.4] }", 0.0));
    let (a, b) = (plain.radiance(50, 33), dark.radiance(50, 33));
    for (c, y, x) in [(0, 16, 16), (1, 0, 0), (2, 30, 4)] {
        let expected = Vignetting::new(0.4).gain(x, y, 33);
        assert!((b.at(c, y, x) / a.at(c, y, x) - expected).abs() < 1e-5);
    }
    assert_eq!(a.at(0, 16, 16), b.at(0, 16, 16));
}

#[test]
fn exposure_drift_changes_the_mean_by_the_drawn_factor_and_starts_at_1() {
    let (plain, drifting) = (video("", 0.0), video("exposure = { stops = 1.0 }", 0.0));
    assert_eq!(plain.frame(0, 32), drifting.frame(0, 32));
    let mean = |image: &Planes| image.data.iter().sum::<f32>() / image.data.len() as f32;
    for frame in [35, 70, 140] {
        let factor = drifting.sensor.exposure_gain(frame as f64 / 140.0);
        assert!((factor - 1.0).abs() > 1e-3);
        let found = mean(&drifting.radiance(frame, 32)) / mean(&plain.radiance(frame, 32));
        assert!((found / factor - 1.0).abs() < 1e-4, "{found} instead of {factor}");
    }
}

#[test]
fn white_balance_multiplies_the_channels_of_a_frame() {
    let (plain, drifting) = (video("", 0.0), video("white_balance = { stops = 0.4 }", 0.0));
    assert_eq!(plain.frame(0, 32), drifting.frame(0, 32));
    let (a, b) = (plain.frame(140, 32), drifting.frame(140, 32));
    let gains = drifting.sensor.white_balance_gains(1.0);
    for c in 0..3 {
        let unclipped = |i: &usize| (0.2..0.9).contains(&a.plane(c)[*i]) && b.plane(c)[*i] < 0.95;
        let pixels: Vec<usize> = (0..a.area()).filter(unclipped).collect();
        let sum = |image: &Planes| pixels.iter().map(|&i| gamma_decode(image.plane(c)[i])).sum::<f32>();
        assert!(pixels.len() > 100 && (sum(&b) / sum(&a) / gains[c] - 1.0).abs() < 5e-3, "channel {c}");
    }
}

#[test]
fn distortion_shows_at_a_pixel_what_the_pinhole_shows_where_the_lens_bends_it_from() {
    let lens = RadialDistortion { k1: -0.3, k2: 0.1 };
    let (plain, bent) = (video("", 0.0), video("distortion = { k1 = [-0.3, -0.3], k2 = [0.1, 0.1] }", 0.0));
    // As fine as it takes to interpolate the waves to within two per cent.
    let (a, b) = (plain.radiance(20, 192), bent.radiance(20, 192));
    for (x, y) in [(95_u16, 95_u16), (24, 36), (180, 120), (90, 165)] {
        // By bisection: the pinhole pixel on the same ray from the centre that the polynomial sends here.
        let (dx, dy) = (f64::from(x) - 95.5, f64::from(y) - 95.5);
        let focal = plain.camera(20).focal_px(192);
        let shown = |t: f64| {
            let r2 = (dx * dx + dy * dy) * t * t / (focal * focal);
            t * (1.0 + lens.k1 * r2 + lens.k2 * r2 * r2)
        };
        let (mut low, mut high) = (0.5, 1.5);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if shown(middle) < 1.0 { low = middle } else { high = middle }
        }
        let from = [95.5 + low * dx, 95.5 + low * dy].map(|v| v as f32);
        for c in 0..3 {
            let expected = a.sample_bilinear(c, from[0], from[1]).unwrap();
            let found = b.at(c, y.into(), x.into());
            assert!((found / expected - 1.0).abs() < 0.02, "({x}, {y}): {found} instead of {expected}");
        }
    }
}

#[test]
fn a_rolling_shutter_shears_a_vertical_edge_by_the_speed_of_the_image() {
    let readout = 0.8;
    // Some pixels wide, so that its middle is found to a small part of a pixel.
    let edge = |x: f32, _: f32| 0.35 + 0.25 * (x / 0.006).clamp(-1.0, 1.0);
    let light = moving(edge, &format!("rolling_shutter = {{ readout = [{readout}, {readout}] }}")).radiance(2, RES);
    // The column where a row crosses the mean of dark and bright.
    let crossing = |y: usize| {
        let row: Vec<f64> = (0..RES).map(|x| f64::from(light.at(1, y, x))).collect();
        let level = 0.5 * (row[5] + row[RES - 6]);
        let x = row.windows(2).position(|w| w[0] < level && level <= w[1]).unwrap();
        x as f64 + (level - row[x]) / (row[x + 1] - row[x])
    };
    let shear = (crossing(RES - 1) - crossing(0)) / (RES - 1) as f64;
    let expected = -SPEED * readout / RES as f64;
    assert!((shear / expected - 1.0).abs() < 0.02, "{shear} instead of {expected} px per row");
    // Middle rows are read at the middle of the frame, when the camera stands over the edge.
    let middle = 0.5 * (crossing(RES / 2 - 1) + crossing(RES / 2));
    assert!((middle - (RES as f64 - 1.0) / 2.0).abs() < 0.05, "{middle}");
}

#[test]
fn blur_takes_gradients_along_the_motion_and_leaves_those_across() {
    // Waves along x and waves along y, 12 px long in the image.
    let per_world = std::f32::consts::TAU / (12.0 / RES as f32 * 0.8 * 0.25_f32.tan());
    let waves = |x: f32, y: f32| 0.4 + 0.15 * (per_world * x).sin() + 0.15 * (per_world * y).sin();
    let shutter = 0.8;
    let energy = |options: &str| {
        let light = moving(waves, options).radiance(2, RES);
        let squares = |dy: usize, dx: usize| {
            let inner = (0..(RES - 1) * (RES - 1)).map(|i| (i / (RES - 1), i % (RES - 1)));
            inner.map(|(y, x)| (light.at(0, y + dy, x + dx) - light.at(0, y, x)).powi(2)).sum::<f32>()
        };
        [squares(0, 1), squares(1, 0)]
    };
    let sharp = energy("");
    let blurred = energy(&format!("motion_blur = {{ shutter = [{shutter}, {shutter}], sub_frames = 64 }}"));
    // A box of 4.8 px takes sinc(4.8/12) of a wave of 12 px; five sub-frames are that box to within a few per cent.
    let angle = std::f64::consts::PI * shutter * SPEED / 12.0;
    let expected = (angle.sin() / angle).powi(2) as f32;
    assert!((blurred[0] / sharp[0] / expected - 1.0).abs() < 0.06, "{} instead of {expected}", blurred[0] / sharp[0]);
    assert!((blurred[1] / sharp[1] - 1.0).abs() < 0.01, "{}", blurred[1] / sharp[1]);
    let once = energy(&format!("motion_blur = {{ shutter = [{shutter}, {shutter}], sub_frames = 1 }}"));
    assert_eq!(once, sharp);
}

#[test]
fn a_compressed_frame_is_close_to_the_uncompressed_one() {
    let (plain, small) = (video("", 1.0), video("compression = { quality = [80, 80] }", 1.0));
    let (a, b) = (plain.frame(12, 64), small.frame(12, 64));
    let mean_square = a.data.iter().zip(&b.data).map(|(a, b)| (a - b).powi(2)).sum::<f32>() / a.data.len() as f32;
    let psnr = -10.0 * mean_square.log10();
    assert!((28.0..50.0).contains(&psnr), "{psnr} dB");
    assert_eq!(b, compressed(&a, 80));
}

/// Flow and validity by brute force: rays are cast through the undistorted pixel at the time of its row, and the source row is
/// the one, of many, whose camera sees the point in it.
#[test]
fn flow_labels_follow_the_lens_and_the_rolling_shutter() {
    let res = 64;
    let video = video(BENT, 0.0);
    let (lens, readout) = (video.sensor.distortion, video.sensor.readout);
    let camera = |frame: usize, row: f64| {
        let delay = readout * ((row + 0.5) / res as f64 - 0.5);
        let neighbour = if delay < 0.0 { frame - 1 } else { frame + 1 };
        video.camera(frame).towards(video.camera(neighbour), delay.abs())
    };
    for (target, source) in [(5, 6), (40, 3), (70, 71)] {
        let (flow, valid) = video.flow(target, source, res);
        for (y, x) in [(0_u16, 0_u16), (31, 33), (50, 7), (63, 63)] {
            let at = camera(target, y.into());
            let (u, v) = lens.undistort(&at, (x.into(), y.into()), res);
            let (wx, wy) = at.pixel_to_world(res).apply(u, v).unwrap();
            let seen = |row: f64| {
                let at = camera(source, row);
                lens.distort(&at, at.world_to_pixel(res).apply(wx, wy).unwrap(), res)
            };
            // The image moves less than a row while a row is read, so `seen(row) − row` falls all the way.
            let (mut low, mut high) = (-0.5, res as f64 - 0.5);
            for _ in 0..60 {
                let middle: f64 = 0.5 * (low + high);
                if seen(middle).1 > middle { low = middle } else { high = middle }
            }
            let (px, py) = seen(low);
            let (fx, fy) = (flow.at(0, y.into(), x.into()), flow.at(1, y.into(), x.into()));
            assert!((f64::from(x) + f64::from(fx) - px).abs() < 1e-3 && (f64::from(y) + f64::from(fy) - py).abs() < 1e-3);
            let inside = |v: f64| (0.0..=res as f64 - 1.0).contains(&v);
            assert_eq!(valid.at(y.into(), x.into()), inside(px) && inside(py));
        }
    }
}

#[test]
fn target_maps_agree_with_the_flow_where_the_homography_does_not() {
    let res = 96;
    let video = video(BENT, 0.0);
    let (target, source) = (video.target_maps(10, res).diffuse, video.target_maps(14, res).diffuse);
    let (flow, valid) = video.flow(10, 14, res);
    let error = |flow: &Planes| {
        let (warped, seen) = warp_planes(&source, flow);
        let pixels: Vec<usize> = (0..res * res).filter(|&i| valid.data[i] && seen.data[i]).collect();
        assert!(pixels.len() > res * res / 3);
        pixels.iter().map(|&i| (warped.data[i] - target.data[i]).abs()).sum::<f32>() / pixels.len() as f32
    };
    let (exact, ideal) = (error(&flow), error(&video.homography(10, 14, res).flow(res, res)));
    assert!(exact < 0.4 * ideal, "{exact} by the flow, {ideal} by the homography");
}

#[test]
fn a_path_that_jumps_has_no_motion_to_follow() {
    let mut config = SequenceConfig { sensor: toml::from_str("motion_blur = {}").unwrap(), ..SequenceConfig::svbrdf() };
    config.validate().unwrap();
    config.path.line_order = crate::path::line::LineOrder::Interleaved;
    assert!(matches!(config.validate(), Err(SequenceConfigError::Jumps)));
    config.sensor = toml::from_str("exposure = { stops = 9.0 }").unwrap();
    assert!(config.validate().unwrap_err().to_string().contains("sensor.exposure.stops is 9"));
}
