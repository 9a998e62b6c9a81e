use nalgebra::{Rotation3, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::*;
use crate::align::graph::Link;
use crate::align::planar::{PointPair, direct_linear};
use crate::align::result::{KeyFrame, KeyFrameStatus, Seconds};

const SIZE: Size = Size { height: 256, width: 256 };

/// A camera in world axes (z up, surface z = 0): how it turns them into its own, and its centre.
#[derive(Clone)]
struct World {
    rotation: Rotation3<f64>,
    centre: Vector3<f64>,
}

impl World {
    /// Looks down from `centre`, then turns by the given angles about its own axes.
    fn new(centre: [f64; 3], [about_x, about_y, about_z]: [f64; 3]) -> Self {
        let down = Rotation3::from_euler_angles(std::f64::consts::PI, 0.0, 0.0);
        Self { rotation: Rotation3::from_euler_angles(about_x, about_y, about_z) * down, centre: centre.into() }
    }

    fn world_to_pixel(&self, focal_px: f64, size: Size) -> Matrix3<f64> {
        let (cx, cy) = (0.5 * (size.width as f64 - 1.0), 0.5 * (size.height as f64 - 1.0));
        let k = Matrix3::new(focal_px, 0.0, cx, 0.0, focal_px, cy, 0.0, 0.0, 1.0);
        let r = self.rotation.matrix();
        k * Matrix3::from_columns(&[r.column(0).into(), r.column(1).into(), -(r * self.centre)])
    }
}

fn noise(rng: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(rng)
}

/// A hand-held spiral of some widths at height 1 with tilts of about `tilt` radians; frame 0 is tilted by `first`.
fn cameras(count: usize, tilt: f64, first: [f64; 2], seed: u64) -> Vec<World> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..count)
        .map(|i| {
            let (t, r) = (0.7 * i as f64, 0.015 * i as f64);
            let tilts: [f64; 2] = std::array::from_fn(|k| if i == 0 { first[k] } else { first[k] + tilt * noise(&mut rng) });
            let height = if i == 0 { 1.0 } else { 1.0 + 0.05 * noise(&mut rng) };
            World::new([r * t.cos(), r * t.sin(), height], [tilts[0], tilts[1], 0.03 * t.sin()])
        })
        .collect()
}

/// The alignment of cameras whose links are off by Gaussian noise of `noise_px` at the positions compared.
fn alignment(cameras: &[World], focal_px: f64, size: Size, noise_px: f64, seed: u64) -> Alignment {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let views: Vec<Matrix3<f64>> = cameras.iter().map(|c| c.world_to_pixel(focal_px, size)).collect();
    let between = |a: usize, b: usize| Homography::new(views[b] * views[a].try_inverse().unwrap());
    let mut measured = |a: usize, b: usize| {
        let exact = between(a, b);
        let off = |(x, y): (f64, f64), rng: &mut ChaCha8Rng| {
            let (u, v) = exact.apply(x, y).unwrap();
            PointPair { target: [x, y], source: [u + noise_px * noise(rng), v + noise_px * noise(rng)] }
        };
        let pairs: Vec<PointPair> = size.grid(4).map(|p| off(p, &mut rng)).collect();
        let homography = if noise_px > 0.0 { direct_linear(&pairs).unwrap() } else { exact };
        Link { target: a, source: b, homography, error_px: noise_px.max(0.01) }
    };
    let pairs = (1..cameras.len()).flat_map(|i| (0..i).filter(move |j| *j == 0 || *j + 3 > i).map(move |j| (j, i)));
    let links = pairs.map(|(j, i)| measured(j, i)).collect();
    let key = |i: usize| KeyFrame {
        index: 5 * i,
        status: KeyFrameStatus::Aligned,
        homography: between(0, i),
        residual_px: noise_px,
        valid_share: 1.0,
        zncc: 1.0,
        confidence: 1.0,
        dense: None,
        frame_size: size,
    };
    let key_frames = (1..cameras.len()).map(key).collect();
    Alignment { key_frames, warnings: vec![], links, guidance_filmed: true, seconds: Seconds::default() }
}

fn focal(fov_deg: f64, size: Size) -> f64 {
    0.5 * size.width as f64 / (0.5 * fov_deg.to_radians()).tan()
}

#[test]
fn exact_homographies_give_the_camera_and_every_pose() {
    let wide = Size { height: 240, width: 320 };
    for (fov, first, size) in [(30.0, [0.0, 0.0], SIZE), (65.0, [0.12, -0.2], SIZE), (22.0, [-0.15, 0.05], wide)] {
        let cameras = cameras(12, 0.08, first, 3);
        let focal_px = focal(fov, size);
        let found = alignment(&cameras, focal_px, size, 0.0, 0).camera(None).unwrap();
        assert!((found.focal_px / focal_px - 1.0).abs() < 1e-6, "{fov}: {found:?}");
        assert!((found.fov_deg - fov).abs() < 1e-5 && found.residual_px < 1e-6);
        let tilt = (first[0].cos() * first[1].cos()).acos().to_degrees();
        assert!((found.tilt_deg - tilt).abs() < 1e-4, "{} {tilt}", found.tilt_deg);
        // Straight above, the frame's width is width/f; over the tilted axis it is as much further away.
        let height = focal_px / size.width as f64 * tilt.to_radians().cos();
        assert!((found.height / height - 1.0).abs() < 1e-6);
        for (pose, world) in found.poses.iter().zip(&cameras) {
            assert!((pose.position[2] / found.height - world.centre.z / cameras[0].centre.z).abs() < 1e-6);
            let axis = -world.rotation.matrix()[(2, 2)];
            assert!((-pose.forward[2] - axis).abs() < 1e-6, "the angle to the surface");
        }
        let apart = |a: &CameraPose, b: &CameraPose| (Vector3::from(a.position) - Vector3::from(b.position)).norm();
        let truth = (cameras[7].centre - cameras[3].centre).norm() / cameras[0].centre.z;
        assert!((apart(&found.poses[7], &found.poses[3]) / found.height - truth).abs() < 1e-6);
        let start = &found.poses[0];
        assert!(start.right[1].abs() < 1e-9 && start.right[0] > 0.0 && start.frame == 0 && found.poses[2].frame == 10);
    }
}

#[test]
fn noisy_homographies_miss_by_what_is_stated() {
    let (mut focals, mut heights, mut tilts) = (Vec::new(), Vec::new(), Vec::new());
    for seed in 0..24 {
        let cameras = cameras(14, 0.1, [0.05, -0.04], seed);
        let mut scan = alignment(&cameras, focal(30.0, SIZE), SIZE, 0.1, seed);
        // Each frame measured once: then the errors are independent.
        scan.links.retain(|l| l.target == 0);
        let found = scan.camera(None).unwrap();
        assert!(found.focal_uncertainty < 0.03, "{found:?}");
        focals.push((found.focal_px / focal(30.0, SIZE)).ln() / found.focal_uncertainty);
        let height = focal(30.0, SIZE) / 256.0 * (0.05f64.cos() * 0.04f64.cos());
        heights.push((found.height / height).ln() / found.height_uncertainty);
        tilts.push((found.tilt_deg - (0.05f64.cos() * 0.04f64.cos()).acos().to_degrees()) / found.tilt_uncertainty_deg);
    }
    for (name, scores, range) in [("focal", focals, 0.3..1.8), ("height", heights, 0.3..1.8), ("tilt", tilts, 0.1..1.8)] {
        let mean = scores.iter().map(|z: &f64| z * z).sum::<f64>() / scores.len() as f64;
        assert!(range.contains(&mean), "{name}: mean squared error in squared standard errors {mean}");
    }
}

#[test]
fn a_phone_that_stays_parallel_says_nothing_of_its_focal_length() {
    let parallel = cameras(14, 0.0, [0.0, 0.0], 1);
    let error = alignment(&parallel, focal(30.0, SIZE), SIZE, 0.1, 1).camera(None).unwrap_err();
    assert!(matches!(error, CameraUnknown::NotObservable { .. }) && error.to_string().contains("tilt the phone"), "{error}");
    let slightly = cameras(14, 0.01, [0.0, 0.0], 1);
    assert!(alignment(&slightly, focal(30.0, SIZE), SIZE, 0.1, 1).camera(None).is_err());
    // A known field of view leaves height and poses to be found.
    let known = KnownFocal { fov_deg: 30.0, source: FocalSource::Config };
    let found = alignment(&parallel, focal(30.0, SIZE), SIZE, 0.1, 1).camera(Some(known)).unwrap();
    assert!(found.focal_uncertainty == 0.0 && found.tilt_deg < 1.0 && found.source == FocalSource::Config);
    assert!((found.poses[9].position[2] / found.height - parallel[9].centre.z).abs() < 0.005);
    let two = &cameras(2, 0.1, [0.0, 0.0], 1);
    let error = alignment(two, focal(30.0, SIZE), SIZE, 0.0, 1).camera(None).unwrap_err();
    assert_eq!(error, CameraUnknown::TooFewFrames { frames: 2 });
}

#[test]
fn a_wrong_link_is_outvoted_and_loose_frames_are_left_out() {
    let cameras = cameras(14, 0.1, [0.05, -0.04], 9);
    let mut scan = alignment(&cameras, focal(30.0, SIZE), SIZE, 0.05, 9);
    scan.links[5].homography = Homography::translation(9.0, -4.0).after(&scan.links[5].homography);
    let found = scan.camera(None).unwrap();
    assert!((found.focal_px / focal(30.0, SIZE) - 1.0).abs() < 4.0 * found.focal_uncertainty, "{found:?}");
    assert!(found.focal_uncertainty < 0.02);
    scan.links.retain(|l| l.source != 13);
    assert_eq!(scan.camera(None).unwrap().poses.len(), 13);
}

#[test]
fn another_picture_as_guidance_is_no_frame_of_the_camera() {
    let cameras = cameras(12, 0.1, [0.0, 0.0], 4);
    let mut scan = alignment(&cameras, focal(30.0, SIZE), SIZE, 0.0, 4);
    // A macro photo: other scale, other camera.
    let photo = Homography::new(Matrix3::new(3.0, 0.2, -40.0, -0.1, 2.0, 10.0, 1e-4, 2e-3, 1.0));
    scan.guidance_filmed = false;
    scan.key_frames.iter_mut().for_each(|k| k.homography = k.homography.after(&photo));
    scan.links.iter_mut().filter(|l| l.target == 0).for_each(|l| l.homography = l.homography.after(&photo));
    let found = scan.camera(None).unwrap();
    assert!((found.focal_px / focal(30.0, SIZE) - 1.0).abs() < 1e-6);
    assert!(found.poses.len() == 11 && found.poses[0].frame == 5);
}

#[derive(serde::Deserialize)]
struct Golden {
    width: usize,
    height: usize,
    links: Vec<GoldenLink>,
    focal_px: f64,
    focal_uncertainty: f64,
    slopes: [f64; 2],
    centre_of_3: [f64; 3],
}

#[derive(serde::Deserialize)]
struct GoldenLink {
    target: usize,
    source: usize,
    homography: [f64; 9],
}

#[test]
fn scipy_finds_the_same_camera_with_the_same_standard_error() {
    let golden: Golden = serde_json::from_str(include_str!("goldens/camera.json")).unwrap();
    let size = Size { height: golden.height, width: golden.width };
    let mut scan = alignment(&cameras(11, 0.1, [0.0, 0.0], 1), 300.0, size, 0.0, 0);
    // A pessimistic expectation: then the robust weights are even, as SciPy's are.
    let link = |l: &GoldenLink| {
        let homography = Homography::new(Matrix3::from_row_slice(&l.homography));
        Link { target: l.target, source: l.source, homography, error_px: 4.0 }
    };
    scan.links = golden.links.iter().map(link).collect();
    let direct = |node: usize| scan.links.iter().find(|l| (l.target, l.source) == (0, node)).unwrap().homography;
    let places: Vec<Homography> = (1..11).map(direct).collect();
    scan.key_frames.iter_mut().zip(places).for_each(|(k, place)| k.homography = place);
    let found = scan.camera(None).unwrap();
    assert!((found.focal_px / golden.focal_px - 1.0).abs() < 1e-5, "{} {}", found.focal_px, golden.focal_px);
    // SciPy takes all homographies for independent; here each frame is believed once.
    let shared = golden.links.len() as f64 / 10.0;
    let ratio = found.focal_uncertainty / (golden.focal_uncertainty * shared.sqrt());
    assert!((ratio - 1.0).abs() < 0.01, "{ratio}");
    let plane = Vector3::new(golden.slopes[0], golden.slopes[1], 1.0);
    assert!((found.tilt_deg - Vector3::z().angle(&plane).to_degrees()).abs() < 1e-3);
    let height = (1.0 - plane.dot(&Vector3::from(golden.centre_of_3))) / plane.norm() * golden.focal_px / golden.width as f64;
    assert!((found.poses[3].position[2] / height - 1.0).abs() < 1e-5);
}
