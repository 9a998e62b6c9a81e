//! Camera paths: the figures of a video and the hand's deviations (Eqs. 1–4, Table 1).

use dataset::path::{CameraPath, PathConfig, Template, UnitLength};
use dataset::sequence::SequenceConfig;
use render::camera::Camera;

use crate::laws::{column, normal, share, uniform, uniform_integers, unrelated};
use crate::rng;

/// Paths of the same number, with their own seeds: paths of two configurations with one number share their draws.
fn paths(config: &PathConfig, count: u64) -> Vec<CameraPath> {
    (0..count).map(|seed| config.draw(&mut rng(seed))).collect()
}

#[test]
fn field_of_view_height_start_and_unit_length_have_the_ranges_of_the_paper() {
    let short = PathConfig { frames: 2, ..PathConfig::default() };
    let drawn = paths(&short, 100_000);
    let fov = column(&drawn, |p| p.fov_rad.to_degrees());
    let half_view = column(&drawn, |p| p.half_view);
    let start: [Vec<f64>; 2] = std::array::from_fn(|k| column(&drawn, |p| p.cameras[0].position[k]));
    let unit = column(&drawn, |p| p.unit / (p.half_view / 12.0));
    uniform(&fov, [25.0, 35.0]).expect("field of view");
    uniform(&half_view, [0.05, 0.1]).expect("half the view");
    uniform(&start[0], [-0.5, 0.5]).expect("start along x");
    uniform(&start[1], [-0.5, 0.5]).expect("start along y");
    uniform(&unit, [0.8, 1.2]).expect("unit length");
    unrelated(&[&fov, &half_view, &start[0], &start[1], &unit]).expect("own draws");
    for path in &drawn {
        let height = path.half_view / (path.fov_rad / 2.0).tan();
        assert!((path.cameras[0].position[2] - height).abs() < 1e-12 && (path.height - height).abs() < 1e-12);
        assert_eq!(path.cameras[0].fov_rad, path.fov_rad);
    }
    let paper = PathConfig { unit_length: UnitLength::World, ..short };
    uniform(&column(&paths(&paper, 100_000), |p| 12.0 * p.unit), [0.075, 0.1]).expect("unit length of the paper's text");
}

#[test]
fn axes_are_swapped_and_negated_with_probability_one_half_each() {
    let calm = PathConfig { frames: 9, deviation_scale: 0.0, ..PathConfig::default() };
    let orientations: Vec<i64> = paths(&calm, 20_000)
        .iter()
        .map(|path| {
            // The template goes four units along y, then four along x.
            let way = |from: usize, to: usize| {
                let [a, b] = [from, to].map(|i| path.cameras[i].position);
                [b[0] - a[0], b[1] - a[1]]
            };
            let (first, second) = (way(0, 4), way(4, 8));
            let swapped = first[0].abs() > first[1].abs();
            i64::from(swapped) + 2 * i64::from(first[0] + second[0] < 0.0) + 4 * i64::from(first[1] + second[1] < 0.0)
        })
        .collect();
    uniform_integers(&orientations, 0..=7).expect("orientation");
}

#[test]
fn a_third_of_the_svbrdf_videos_and_none_of_the_flow_videos_are_lines() {
    let lines = |config: SequenceConfig| {
        let short = PathConfig { frames: 2, ..config.path };
        paths(&short, 20_000).iter().filter(|p| p.template == Template::Line).count()
    };
    share(lines(SequenceConfig::svbrdf()), 20_000, 1.0 / 3.0).expect("lines");
    assert_eq!(lines(SequenceConfig::flow()), 0);
}

/// The six perturbed components of a camera as the cameras themselves show them, less what the template has.
fn deviation(camera: &Camera, template: &Camera) -> [f64; 6] {
    let [x, y, z] = camera.position;
    let [fx, fy, fz] = camera.forward;
    // The axis meets the plane at (c_x + l_x, c_y + l_y); the image's x axis is perpendicular to up = (t, 1, 0).
    let look_at = [-z / fz * fx, -z / fz * fy];
    let tilt = -camera.right[1] / camera.right[0];
    let [tx, ty, tz] = template.position;
    [x - tx, y - ty, z - tz, look_at[0], look_at[1], tilt]
}

fn deviations(scale: f64, count: u64) -> Vec<Vec<[f64; 6]>> {
    let with = |deviation_scale| paths(&PathConfig { deviation_scale, ..PathConfig::default() }, count);
    let pairs = with(scale).into_iter().zip(with(0.0));
    pairs.map(|(a, b)| a.cameras.iter().zip(&b.cameras).map(|(a, b)| deviation(a, b)).collect()).collect()
}

#[test]
fn cameras_deviate_from_the_template_by_the_amounts_of_table_1() {
    let videos = deviations(1.0, 8000);
    for (k, (name, expected)) in
        [("c_x", 0.0050), ("c_y", 0.0050), ("c_z", 0.0155), ("l_x", 0.0155), ("l_y", 0.0155), ("t", 0.0155)].iter().enumerate()
    {
        let squares: f64 = videos.iter().flatten().map(|d| d[k].powi(2)).sum();
        let found = (squares / (videos.len() * 141) as f64).sqrt();
        assert!((found / expected - 1.0).abs() < 0.03, "{name} deviates by {found} instead of {expected}");
    }
    for frame in [1, 20, 140] {
        let at = |k: usize| column(&videos, |v| v[frame][k]);
        for k in 0..6 {
            let strengths = if k < 2 { [0.001, 0.1, 0.2] } else { [0.001, 0.01, 0.1] };
            normal(&at(k), 0.0, deviation_after(frame, strengths)).unwrap_or_else(|e| panic!("{k} at frame {frame}: {e}"));
        }
        let columns: Vec<Vec<f64>> = (0..6).map(at).collect();
        unrelated(&columns.iter().map(Vec::as_slice).collect::<Vec<_>>()).expect("own pushes");
    }
    assert!(videos.iter().all(|v| v[0].iter().all(|d| d.abs() < 1e-12)), "the first frame is on the template");
}

/// Standard deviation after so many steps of Eqs. 1–3: the responses to the single pushes add up as variances.
fn deviation_after(steps: usize, [push, damping, spring]: [f64; 3]) -> f64 {
    let (mut velocity, mut position, mut variance) = (0.0, 0.0, 0.0);
    for step in 0..steps {
        let acceleration = if step == 0 { push } else { 0.0 } - damping * velocity - spring * position;
        velocity += acceleration;
        position += velocity;
        variance += position * position;
    }
    variance.sqrt()
}

#[test]
fn the_deviation_scales_of_table_5_multiply_every_component() {
    let once = deviations(1.0, 20);
    for scale in [0.25, 0.5, 2.0] {
        for (scaled, once) in deviations(scale, 20).iter().flatten().zip(once.iter().flatten()) {
            assert!((0..6).all(|k| (scaled[k] - scale * once[k]).abs() < 1e-9), "{scale}: {scaled:?} and {once:?}");
        }
    }
}

#[test]
fn the_camera_stops_at_nine_tenths_of_the_material() {
    let far = PathConfig { template: Template::Zigzag, frames: 6000, ..PathConfig::default() };
    let mut reached = [[0.0f64; 2]; 2];
    for path in paths(&far, 12) {
        for camera in &path.cameras {
            for k in 0..2 {
                reached[k] = [reached[k][0].min(camera.position[k]), reached[k][1].max(camera.position[k])];
            }
        }
    }
    assert_eq!(reached, [[-0.9, 0.9]; 2]);
}
