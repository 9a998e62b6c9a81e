//! The three routes mean the same, in value and gradient.

use burn::tensor::{Device, Tensor, TensorData};
use ops::gradcheck::largest_relative_error;
use ops::planes::{Planes, values};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use render::brdf::{BrdfModel, DiffuseModel, SpecularModel};
use render::direction::{half, unit};
use render::shade::Geometry;
use render::svbrdf::{Svbrdf, SvbrdfImage};
use render::texel::Texel;
use render::views::{Emission, EvaluationViews, LossViews, Origin, View, plane_point};
use render::{fused, loss, pixel, shade};

fn models() -> Vec<BrdfModel> {
    let lobes = [SpecularModel::Ggx, SpecularModel::GgxClamped];
    let diffuse = [DiffuseModel::Lambert, DiffuseModel::Inria];
    lobes.iter().flat_map(|&specular| diffuse.map(|diffuse| BrdfModel { specular, diffuse })).collect()
}

fn random_maps(height: usize, width: usize, tilt: f32, seed: u64) -> SvbrdfImage {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut maps = SvbrdfImage::constant(height, width, &Texel::matte([0.5; 3]));
    for i in 0..height * width {
        let mut three = |low: f32, high: f32| std::array::from_fn::<f32, 3, _>(|_| rng.random_range(low..high));
        let [x, y, _] = three(-1.0, 1.0).map(|v| tilt * v);
        let texel = Texel {
            normal: unit([x, y, 1.0]),
            diffuse: three(0.02, 0.9),
            specular: three(0.02, 0.9),
            roughness: rng.random_range(0.08..1.0),
        };
        maps.set(i / width, i % width, &texel);
    }
    maps
}

#[test]
fn every_route_renders_the_same_picture() {
    let device = Device::flex();
    let maps = random_maps(5, 67, 1.0, 1);
    let views = LossViews::draw(&mut ChaCha8Rng::seed_from_u64(2));
    let flashes = EvaluationViews::standard().views;
    for model in models() {
        for view in views.all().chain(&flashes[..11]) {
            let tensor = Planes::from_tensor(shade::render(&maps.to_tensor(&device), view, model)).remove(0);
            let block = fused::render(&maps, view, model);
            for i in 0..5 * 67 {
                let (row, column) = (i / 67, i % 67);
                let single = render_pixel(&maps, view, model, row, column);
                for (c, single) in single.into_iter().enumerate() {
                    let (a, b) = (tensor.at(c, row, column), block.at(c, row, column));
                    let tolerance = 3e-4 * single.max(1e-3);
                    assert!((a - b).abs() < tolerance && (b - single).abs() < tolerance, "{a} {b} {single}");
                }
            }
        }
    }
}

fn render_pixel(maps: &SvbrdfImage, view: &View, model: BrdfModel, row: usize, column: usize) -> [f32; 3] {
    let (x, y) = plane_point(row, column, maps.height(), maps.width());
    let (wi, wo) = (view.light.from(x, y), view.camera.from(x, y));
    pixel::shade(&maps.texel(row, column), wi, wo, model).map(|v| v * view.irradiance(wi, x, y))
}

/// (value, gradient by map) of a loss route, weighed so that mixed-up terms show.
type Route = fn(&Svbrdf, &Svbrdf, &LossViews, BrdfModel) -> loss::RenderingLosses;

fn gradients(route: Route, pred: &[&SvbrdfImage], target: &[&SvbrdfImage], model: BrdfModel) -> (f64, f64, [Vec<f32>; 4]) {
    let device = Device::flex().autodiff();
    let maps = SvbrdfImage::batch(pred, &device).map(Tensor::require_grad);
    let views = LossViews::draw(&mut ChaCha8Rng::seed_from_u64(3));
    let losses = route(&maps, &SvbrdfImage::batch(target, &device), &views, model);
    let total = losses.rendering.clone() + losses.top.clone() * 3.0;
    let expected = losses.rendering_value + 3.0 * losses.top_value;
    assert!((f64::from(values(total.clone())[0]) - expected).abs() < 1e-5);
    let slopes = total.backward();
    let gradient = maps.maps().map(|m| values(m.grad(&slopes).expect("every map is rendered")));
    (losses.rendering_value, losses.top_value, gradient)
}

#[test]
fn fused_losses_are_the_tensor_route_in_value_and_gradient() {
    let (pred, target) = ([random_maps(6, 70, 0.5, 5), random_maps(6, 70, 0.5, 6)], [7, 8].map(|s| random_maps(6, 70, 0.5, s)));
    let (pred, target): (Vec<_>, Vec<_>) = (pred.iter().collect(), target.iter().collect());
    for model in models() {
        let (r, t, exact) = gradients(loss::rendering_losses, &pred, &target, model);
        let (fused_r, fused_t, fast) = gradients(fused::rendering_losses, &pred, &target, model);
        // The authors' 1 − (n·h)²(1 − alpha²) cancels at the peak, in either route.
        let bound = if model.specular == SpecularModel::Ggx { 1e-5 } else { 5e-5 };
        assert!((r - fused_r).abs() < 1e-5 * r && (t - fused_t).abs() < 1e-5 * t, "{r} {fused_r} {t} {fused_t}");
        for (map, (a, b)) in exact.iter().zip(&fast).enumerate() {
            assert!(a.iter().chain(b).all(|v| v.is_finite()));
            let norm = a.iter().map(|v| v * v).sum::<f32>().sqrt();
            let apart = a.iter().zip(b).map(|(x, y)| (x - y).powi(2)).sum::<f32>().sqrt();
            assert!(norm > 0.0 && apart < bound * norm, "{model:?} map {map}: {apart} of {norm}");
        }
    }
}

#[test]
fn the_tensor_route_has_the_gradient_of_central_differences() {
    let views = LossViews::draw(&mut ChaCha8Rng::seed_from_u64(12));
    let mut maps = random_maps(1, 2, 0.2, 13);
    maps.roughness = maps.roughness.map(|r| r.max(0.3)); // lobes that a step of the differences doesn't jump over
    let packed: Vec<f32> = maps.maps().iter().flat_map(|p| p.data.iter().copied()).collect();
    for model in models() {
        // Far, near and mirrored, near and in one place.
        for view in [&views.rendering[0], &views.rendering[3], &views.top[0]] {
            let error = largest_relative_error(&packed, [1, 10, 1, 2], 1e-3, |x| {
                (shade::render(&Svbrdf::from_stacked(x), view, model) + 0.1).log().sum()
            });
            assert!(error < 5e-3, "{model:?}: {error}");
        }
    }
}

/// One texel in one view, and what of it is hard.
struct Edge {
    light: [f32; 3],
    camera: [f32; 3],
    normal: [f32; 3],
    roughness: f32,
}

impl Edge {
    /// The normal lies beside the half vector by a share of the lobe's width.
    fn beside_the_peak(light: [f32; 3], camera: [f32; 3], roughness: f32, share: f32) -> Self {
        let (light, camera) = (unit(light), unit(camera));
        let h = half(light, camera);
        let aside = share * roughness * roughness;
        Self { light, camera, normal: unit([h[0] + 0.6 * aside, h[1] + 0.8 * aside, h[2]]), roughness }
    }

    /// Needles, grazing light, grazing viewers, and light that just reaches the surface.
    fn all() -> Vec<Self> {
        let just_lit = |cosine: f32| Self {
            light: unit([1.0, 0.0, 0.5]),
            camera: unit([-0.3, 0.2, 1.0]),
            normal: unit([-0.5 + cosine, 0.0, 1.0 + 0.5 * cosine]),
            roughness: 0.4,
        };
        vec![
            Self::beside_the_peak([0.3, 0.1, 1.0], [-0.25, -0.1, 1.0], 0.02, 0.7),
            Self::beside_the_peak([0.3, 0.1, 1.0], [-0.25, -0.1, 1.0], 0.02, 3.0),
            Self::beside_the_peak([0.9, 0.2, 0.02], [-0.9, 0.1, 0.5], 0.02, 0.7),
            Self::beside_the_peak([0.5, 0.2, 0.6], [-0.99, 0.1, 0.02], 0.05, 0.7),
            Self::beside_the_peak([0.99, 0.0, 0.02], [-0.99, 0.1, 0.03], 0.1, 1.0),
            just_lit(1e-2),
            just_lit(1e-3),
        ]
    }

    /// The mean over the channels of ln(R + 0.1) in `f64`: Walter et al. 2007 with Schlick's Fresnel term, written once more.
    fn log_radiance(&self, maps: &[f64; 10]) -> f64 {
        let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        let unit = |a: [f64; 3]| a.map(|v| v / dot(a, a).sqrt());
        let (wi, wo) = (unit(self.light.map(f64::from)), unit(self.camera.map(f64::from)));
        let h = unit(std::array::from_fn(|k| wi[k] + wo[k]));
        let n = [maps[0], maps[1], maps[2]];
        let alpha2 = maps[6].powi(4);
        let (nl, nv, nh) = (dot(n, wi), dot(n, wo), dot(n, h));
        assert!(nl > 0.0 && nv > 0.0);
        let bracket = alpha2 * nh * nh + dot(n, n) - nh * nh;
        let masking = |c: f64| 1.0 / (c + (alpha2 + (1.0 - alpha2) * c * c).sqrt());
        let lobe = alpha2 / (std::f64::consts::PI * bracket * bracket) * masking(nl) * masking(nv);
        let weight = (1.0 - dot(wo, h)).powi(5);
        let radiance = |c: usize| {
            let specular = maps[7 + c];
            nl * (maps[3 + c] / std::f64::consts::PI + lobe * (specular + (1.0 - specular) * weight)) * 3.0 / wi[2]
        };
        (0..3).map(|c| (radiance(c) + 0.1).ln()).sum::<f64>() / 3.0
    }
}

/// Where `f32` is at its end: central differences of `f64` judge both routes, map by map.
#[test]
fn needles_and_grazing_angles_have_the_gradient_of_central_differences() {
    let device = Device::flex().autodiff();
    for edge in Edge::all() {
        let texel =
            Texel { normal: edge.normal, diffuse: [0.3, 0.5, 0.2], roughness: edge.roughness, specular: [0.04, 0.3, 0.8] };
        let maps = SvbrdfImage::constant(1, 1, &texel);
        let packed: [f64; 10] = std::array::from_fn(|k| {
            let all = [&texel.normal[..], &texel.diffuse, &[texel.roughness], &texel.specular].concat();
            f64::from(all[k])
        });
        let expected: [f64; 10] = std::array::from_fn(|k| {
            // Needles are narrow in normal and roughness; the radiance is linear in the albedos.
            let step = if k < 3 || k == 6 { 1e-7 } else { 1e-4 };
            let moved = |by: f64| {
                let mut maps = packed;
                maps[k] += by;
                edge.log_radiance(&maps)
            };
            (moved(step) - moved(-step)) / (2.0 * step)
        });
        let emission = Emission::Even { intensity: 3.0 };
        let view = View { camera: Origin::Direction(edge.camera), light: Origin::Direction(edge.light), emission };
        // Nothing reaches the target, so every channel is brighter than it.
        let dark = SvbrdfImage::constant(1, 1, &Texel { normal: edge.light.map(|v| -v), ..texel });
        let fused = fused::log_difference(&maps, &dark, &[view], BrdfModel::default()).gradient.data;
        let tensors = maps.to_tensor(&device).map(Tensor::require_grad);
        let slopes = (shade::render(&tensors, &view, BrdfModel::default()) + 0.1).log().mean().backward();
        let composed = tensors.maps().map(|m| values(m.grad(&slopes).expect("every map is rendered"))).concat();
        for found in [fused, composed] {
            for map in [0..3, 3..6, 6..7, 7..10] {
                let norm = |values: &mut dyn Iterator<Item = f64>| values.map(|v| v * v).sum::<f64>().sqrt();
                let size = norm(&mut map.clone().map(|k| expected[k]));
                let apart = norm(&mut map.clone().map(|k| f64::from(found[k]) - expected[k]));
                assert!(apart < 5e-3 * size, "roughness {} map {map:?}: {found:?} instead of {expected:?}", edge.roughness);
            }
        }
    }
}

/// Camera and light may be what is looked for, too: positions and directions, under every kind of light.
#[test]
fn positions_of_camera_and_light_have_the_gradient_of_central_differences() {
    let mut maps = random_maps(3, 4, 0.2, 21);
    maps.roughness = maps.roughness.map(|r| r.max(0.3)); // lobes that a step of the differences doesn't jump over
    let (near, far) = (Origin::Point([0.3, -0.2, 1.1]), Origin::Direction(unit([0.2, 0.3, 1.0])));
    let flash = Emission::Flash { intensity: 2.0, exponent: 5.0 };
    let even = Emission::Even { intensity: 3.0 };
    for model in models() {
        for (light, emission) in [(near, flash), (near, even), (far, flash), (far, even)] {
            for camera in [Origin::Point([-0.4, 0.1, 0.9]), Origin::Direction(unit([-0.3, 0.1, 1.0]))] {
                let view = View { camera, light, emission };
                let packed = [camera.position().0, light.position().0].concat();
                let error = largest_relative_error(&packed, [2, 3, 1, 1], 3e-3, |x| {
                    let maps = SvbrdfImage::batch(&[&maps], &x.device());
                    let geometry = Geometry::from_positions(&view, x.clone().narrow(0, 0, 1), x.narrow(0, 1, 1), 3, 4);
                    (shade::render_with(&maps, &geometry, model) + 0.1).log().sum()
                });
                assert!(error < 1e-2, "{model:?} {view:?}: {error}");
            }
        }
    }
}

/// Where light or viewer graze the surface or pass behind it, and where the lobe is a needle, every gradient is a number.
#[test]
fn positions_have_finite_gradients_everywhere() {
    let device = Device::flex().autodiff();
    let places = [[0.0, 0.0, 1.0], [0.7, 0.0, 1e-3], [0.3, 0.3, 0.0], [0.5, 0.1, -0.4], [0.25, 0.5, 0.0]];
    let mut maps = random_maps(2, 4, 0.0, 3);
    for i in 0..8 {
        let normal = [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, -0.8, 0.6], [0.0, 0.0, 1.0]][i % 4];
        maps.set(i / 4, i % 4, &Texel { normal, roughness: [0.02, 0.0][i / 4], ..maps.texel(i / 4, i % 4) });
    }
    for model in models() {
        for (camera, light) in places.iter().flat_map(|a| places.map(|b| (*a, b))) {
            let tensor =
                |p: [f32; 3]| Tensor::<4>::from_data(TensorData::new(p.to_vec(), [1, 3, 1, 1]), &device).require_grad();
            let (eye, lamp) = (tensor(camera), tensor(light));
            let emission = Emission::Flash { intensity: 1.0, exponent: 5.0 };
            let view = View { camera: Origin::Point(camera), light: Origin::Point(light), emission };
            let geometry = Geometry::from_positions(&view, eye.clone(), lamp.clone(), 2, 4);
            let picture = shade::render_with(&maps.to_tensor(&device), &geometry, model);
            assert!(values(picture.clone()).iter().all(|v| v.is_finite()));
            let slopes = (picture + 0.1).log().sum().backward();
            for position in [eye, lamp] {
                let slope = values(position.grad(&slopes).expect("the picture depends on it"));
                assert!(slope.iter().all(|v| v.is_finite()), "{model:?} camera {camera:?} light {light:?}: {slope:?}");
            }
        }
    }
}

#[test]
fn sharp_lobes_and_grazing_angles_stay_finite() {
    let mut pred = random_maps(3, 8, 0.0, 1);
    let normals = [[0.0, 0.0, 1.0], [0.9999, 0.0, 0.01], [0.0, -1.0, 0.0], [0.6, 0.0, 0.8]];
    for i in 0..24 {
        let texel = Texel { normal: unit(normals[i % 4]), roughness: [0.01, 0.0, 0.02][i / 8], ..pred.texel(i / 8, i % 8) };
        pred.set(i / 8, i % 8, &texel);
    }
    let target = SvbrdfImage::constant(3, 8, &Texel::matte([0.2; 3]));
    for model in models() {
        for route in [loss::rendering_losses as Route, fused::rendering_losses] {
            let (r, t, gradient) = gradients(route, &[&pred], &[&target], model);
            assert!(r.is_finite() && t.is_finite());
            assert!(gradient.iter().flatten().all(|v| v.is_finite()), "{model:?}");
        }
    }
}

#[test]
fn equal_maps_have_no_loss_and_no_gradient() {
    let maps = random_maps(4, 9, 0.4, 2);
    let views = LossViews::draw(&mut ChaCha8Rng::seed_from_u64(3));
    let difference = fused::log_difference(&maps, &maps, &views.rendering, BrdfModel::default());
    assert!(difference.value < 1e-7 && difference.gradient.data.iter().all(|v| v.abs() < 1.0));
    let again = fused::log_difference(&maps, &random_maps(4, 9, 0.4, 3), &views.top, BrdfModel::default());
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let single = pool.install(|| fused::log_difference(&maps, &random_maps(4, 9, 0.4, 3), &views.top, BrdfModel::default()));
    assert_eq!(again.value.to_bits(), single.value.to_bits());
    assert_eq!(again.gradient, single.gradient);
}
