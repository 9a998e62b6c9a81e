use super::*;
use crate::material::{MaterialInfo, Precision};
use render::direction::unit;
use render::texel::Texel;

/// A tile of 512² texels with smooth colours, normals and roughness, none of them symmetric.
pub(crate) fn material() -> Arc<Material> {
    static MATERIAL: std::sync::OnceLock<Arc<Material>> = std::sync::OnceLock::new();
    Arc::clone(MATERIAL.get_or_init(waves))
}

fn waves() -> Arc<Material> {
    let size = 512;
    let info = MaterialInfo::made_up("waves");
    let wave = |x: usize, y: usize, a: f32, b: f32| (std::f32::consts::TAU * (a * x as f32 + b * y as f32) / size as f32).sin();
    let texel = move |x: usize, y: usize| Texel {
        normal: unit([0.2 * wave(x, y, 9.0, 2.0), 0.15 * wave(x, y, 3.0, -7.0), 1.0]),
        diffuse: std::array::from_fn(|c| 0.3 + 0.2 * wave(x, y, 8.0 + c as f32, 5.0) * wave(x, y, -3.0, 11.0)),
        roughness: 0.5 + 0.2 * wave(x, y, 4.0, 4.0),
        specular: [0.04, 0.05, 0.06],
    };
    Arc::new(Material::build(info, size, size, Precision::Sixteen, texel).unwrap())
}

pub(crate) fn sequence(config: &SequenceConfig, video: u64) -> Sequence {
    Sequence::new(material(), config, &Stream::new(5), video)
}

/// The same video taken by a sensor with the options of a text.
pub(crate) fn with_sensor(video: Sequence, options: &str) -> Sequence {
    Sequence { sensor: VideoSensor::draw(&toml::from_str(options).unwrap(), &Stream::new(5)), ..video }
}

/// Where the ray through a pixel meets z = 0, from the camera's axes alone.
pub(crate) fn cast(camera: &Camera, x: f64, y: f64, res: usize) -> [f64; 2] {
    let focal = 0.5 * res as f64 / (camera.fov_rad / 2.0).tan();
    let centre = (res as f64 - 1.0) / 2.0;
    let (u, v) = ((x - centre) / focal, (y - centre) / focal);
    let ray: [f64; 3] = std::array::from_fn(|k| u * camera.right[k] + v * camera.down[k] + camera.forward[k]);
    let t = -camera.position[2] / ray[2];
    [camera.position[0] + t * ray[0], camera.position[1] + t * ray[1]]
}

/// The pixel that shows a world point, from the camera's axes alone.
fn project(camera: &Camera, [x, y]: [f64; 2], res: usize) -> [f64; 2] {
    let offset = [x - camera.position[0], y - camera.position[1], -camera.position[2]];
    let along = |axis: [f64; 3]| (0..3).map(|k| axis[k] * offset[k]).sum::<f64>();
    let focal = 0.5 * res as f64 / (camera.fov_rad / 2.0).tan();
    let centre = (res as f64 - 1.0) / 2.0;
    let depth = along(camera.forward);
    [focal * along(camera.right) / depth + centre, focal * along(camera.down) / depth + centre]
}

#[test]
fn homographies_flow_labels_and_their_validity_are_ray_casting_at_every_pixel() {
    let res = 256;
    for (video, target, source) in [(0, 0, 1), (1, 3, 40), (2, 60, 12), (3, 139, 140)] {
        let video = sequence(&SequenceConfig::svbrdf(), video);
        let (map, (flow, valid)) = (video.homography(target, source, res), video.flow(target, source, res));
        for (y, x) in (0..res * res).map(|i| (i / res, i % res)) {
            let world = cast(video.camera(target), x as f64, y as f64, res);
            let [px, py] = project(video.camera(source), world, res);
            let (hx, hy) = map.apply(x as f64, y as f64).unwrap();
            assert!((hx - px).abs() < 1e-5 && (hy - py).abs() < 1e-5, "({x}, {y}): ({hx}, {hy}) instead of ({px}, {py})");
            let [fx, fy] = [0, 1].map(|c| f64::from(flow.at(c, y, x)));
            assert!((x as f64 + fx - px).abs() < 1e-3 && (y as f64 + fy - py).abs() < 1e-3, "({x}, {y})");
            let inside = |v: f64| (0.0..=res as f64 - 1.0).contains(&v);
            assert_eq!(valid.at(y, x), inside(px) && inside(py), "({x}, {y})");
        }
    }
}

/// A light that rests and shines alike on everything.
fn overhead() -> VideoLights {
    let light = Light::Directional { wi: [0.0, 0.0, 1.0], irradiance: [1.5; 3] };
    VideoLights { intensity: 0.0, exponent: 1.0, resting: vec![light] }
}

/// Red rises with the texel's column and green with its row, so a rendered colour tells the place that it shows.
#[test]
fn frames_and_target_maps_show_the_points_that_rays_hit() {
    let (tile, res) = (32, 256);
    let info = MaterialInfo { name: "ramps".into(), ..material().info().clone() };
    let ramp = |k: usize| 0.1 + 0.8 * k as f32 / tile as f32;
    let texel = |x: usize, y: usize| Texel { specular: [0.0; 3], ..Texel::matte([ramp(x), ramp(y), 1.0]) };
    let ramps = Arc::new(Material::build(info, tile, tile, Precision::Sixteen, texel).unwrap());
    let path = sequence(&SequenceConfig::svbrdf(), 4).path().clone();
    let video = Sequence::from_parts(AugmentedMaterial::plain(ramps), path, overhead());
    for frame in [0, 77] {
        for image in [video.radiance(frame, res), video.target_maps(frame, res).diffuse] {
            let (mut sum, mut squares, mut count) = ([0.0; 2], [0.0; 2], 0.0);
            for (y, x) in (0..res * res).map(|i| (i / res, i % res)) {
                let [wx, wy] = cast(video.camera(frame), x as f64, y as f64, res);
                let expected = [(wx + 1.0) * 2048.0 - 0.5, (1.0 - wy) * 2048.0 - 0.5].map(|t| t.rem_euclid(tile as f64));
                // Away from the ramps' ends, which filters blur.
                if expected.iter().all(|t| (5.0..tile as f64 - 6.0).contains(t)) {
                    for axis in 0..2 {
                        let value = f64::from(image.at(axis, y, x) / image.at(2, y, x));
                        let offset = (value - 0.1) / 0.8 * tile as f64 - expected[axis];
                        sum[axis] += offset;
                        squares[axis] += offset * offset;
                    }
                    count += 1.0;
                }
            }
            assert!(count > 20_000.0);
            // A pixel of these frames covers a texel, give or take a half.
            for axis in 0..2 {
                let (mean, spread) = (sum[axis] / count, f64::sqrt(squares[axis] / count));
                assert!(mean.abs() < 2e-4 && spread < 1e-3, "frame {frame}: {mean} and {spread} texels off along {axis}");
            }
        }
    }
}

#[test]
fn rendering_an_augmented_material_by_an_equally_moved_camera_gives_the_moved_frame() {
    let res = 48;
    let drawn = sequence(&SequenceConfig::flow(), 6);
    let source = Sequence::from_parts(AugmentedMaterial::plain(material()), drawn.path().clone(), drawn.lights().clone());
    for code in 0..8 {
        let (flip_x, flip_y, transpose) = (code & 1 > 0, code & 2 > 0, code & 4 > 0);
        let moved = |[x, y, z]: [f64; 3]| {
            let (x, y) = (if flip_x { -x } else { x }, if flip_y { -y } else { y });
            if transpose { [-y, -x, z] } else { [x, y, z] }
        };
        let camera = |c: &Camera| {
            let ahead = std::array::from_fn(|k| c.position[k] + c.forward[k]);
            Camera::look_at(moved(c.position), moved(ahead), moved(c.down.map(|v| -v)), c.fov_rad)
        };
        let path = CameraPath { cameras: drawn.path().cameras.iter().map(camera).collect(), ..drawn.path().clone() };
        let light = |light: &Light| match *light {
            Light::Point { position, irradiance } => {
                Light::Point { position: moved(position.map(f64::from)).map(|v| v as f32), irradiance }
            }
            _ => panic!("the second light is a point"),
        };
        let lights = VideoLights { resting: drawn.lights().resting.iter().map(light).collect(), ..drawn.lights().clone() };
        let augmentation = Augmentation { flip_x, flip_y, transpose, ..Augmentation::IDENTITY };
        let surface = AugmentedMaterial { material: material(), augmentation };
        let augmented = Sequence::from_parts(surface, path, lights);
        // A mirrored camera is no camera: one with the same upright image shows it with left and right exchanged.
        let mirrored = flip_x ^ flip_y ^ transpose;
        for frame in [0, 90] {
            let maps = |video: &Sequence| {
                let maps = video.target_maps(frame, res);
                [video.radiance(frame, res), maps.normal, maps.diffuse, maps.roughness, maps.specular]
            };
            for (k, (found, expected)) in maps(&augmented).into_iter().zip(maps(&source)).enumerate() {
                for (c, i) in (0..found.channels).flat_map(|c| (0..res * res).map(move |i| (c, i))) {
                    let (y, x) = (i / res, i % res);
                    let from = expected.at(c, y, if mirrored { res - 1 - x } else { x });
                    let from = if mirrored && k == 1 && c == 0 { -from } else { from };
                    let difference = (found.at(c, y, x) - from).abs();
                    assert!(difference < 3e-4, "augmentation {code}, frame {frame}, map {k}, ({x}, {y}): {difference}");
                }
            }
        }
    }
}

#[test]
fn a_crop_is_the_rectangle_of_the_frame() {
    let video = sequence(&SequenceConfig::flow(), 2);
    let whole = video.frame(9, 64);
    assert_eq!(video.frame_crop(9, 64, 13, 20, 30, 25), whole.crop(13, 20, 30, 25));
    assert!(whole.data.iter().all(|v| (v * 255.0 - (v * 255.0).round()).abs() < 1e-4 && (0.0..=1.0).contains(v)));
}

#[test]
fn frames_are_a_function_of_seed_video_and_index_alone() {
    let config = SequenceConfig::svbrdf();
    let frame = |seed, video, index| Sequence::new(material(), &config, &Stream::new(seed), video).frame(index, 32);
    let reference = frame(1, 2, 3);
    let one_thread = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let five_threads = rayon::ThreadPoolBuilder::new().num_threads(5).build().unwrap();
    assert_eq!(one_thread.install(|| frame(1, 2, 3)), reference);
    assert_eq!(five_threads.install(|| frame(1, 2, 3)), reference);
    for other in [frame(2, 2, 3), frame(1, 3, 3), frame(1, 2, 4)] {
        assert!(other != reference);
    }
}

#[test]
fn a_frame_is_exposed_and_its_noise_has_the_asked_strength() {
    let quiet = SequenceConfig { noise_scale: 0.0, ..SequenceConfig::svbrdf() };
    let (clean, noisy) = (sequence(&quiet, 3).frame(5, 64), sequence(&SequenceConfig::svbrdf(), 3).frame(5, 64));
    let mean = clean.data.iter().sum::<f32>() / clean.data.len() as f32;
    assert!((0.2..0.8).contains(&mean), "mean {mean}");
    let linear = |v: f32| ops::colour::gamma_decode(v);
    let squares: f32 = clean.data.iter().zip(&noisy.data).map(|(a, b)| (linear(*a) - linear(*b)).powi(2)).sum();
    let sigma = (squares / clean.data.len() as f32).sqrt();
    assert!((0.002..0.02).contains(&sigma), "sigma {sigma}");
}

#[test]
fn motion_is_as_fast_as_the_papers() {
    let (mut flow, mut overlap) = (vec![], vec![]);
    for index in 0..24 {
        let path = PathConfig::default().draw(&mut Stream::new(3).rng("camera path", index));
        let between = |a: usize, b: usize| Camera::between(&path.cameras[a], &path.cameras[b], 256).scaled(0.125, 0.125);
        for frame in (0..140).step_by(10) {
            let step = between(frame, frame + 1).flow(32, 32);
            let length = |i: usize| 8.0 * step.data[i].hypot(step.data[1024 + i]);
            flow.push((0..1024).map(length).sum::<f32>() / 1024.0);
            overlap.push(between(0, frame + 1).valid(32, 32, 32, 32).share());
        }
    }
    flow.sort_by(f32::total_cmp);
    let mean = flow.iter().sum::<f32>() / flow.len() as f32;
    let shared = overlap.iter().sum::<f64>() / overlap.len() as f64;
    assert!((13.0..17.0).contains(&mean), "adjacent flow {mean} px");
    assert!((24.0..36.0).contains(&flow[flow.len() * 95 / 100]), "p95 {}", flow[flow.len() * 95 / 100]);
    assert!((0.38..0.58).contains(&shared), "overlap with the guidance frame {shared}");
}

#[test]
fn bad_values_are_named() {
    let refused = |config: SequenceConfig| config.validate().unwrap_err().to_string();
    let ambient = LightConfig { ambient: [0.3, 0.1], ..LightConfig::default() };
    assert!(refused(SequenceConfig { light: ambient, ..SequenceConfig::svbrdf() }).contains("light.ambient"));
    assert!(refused(SequenceConfig { noise_scale: -1.0, ..SequenceConfig::svbrdf() }).contains("noise_scale"));
    let path = PathConfig { frames: 0, ..PathConfig::default() };
    assert!(refused(SequenceConfig { path, ..SequenceConfig::svbrdf() }).contains("path.frames"));
    SequenceConfig::flow().validate().unwrap();
    SequenceConfig::svbrdf().validate().unwrap();
}
