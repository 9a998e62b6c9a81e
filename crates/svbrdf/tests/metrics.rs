//! Metrics against scikit-image and hand values; the loss against hand values; constants against medians.

use burn::tensor::{Device, Tensor};
use ops::planes::{Mask, Planes, values};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use render::brdf::BrdfModel;
use render::svbrdf::{Svbrdf, SvbrdfImage};
use render::views::{EvaluationViews, LossViews};
use serde::Deserialize;
use svbrdf::constants::ConstantMaps;
use svbrdf::loss::{LossConfig, LossKind, LossWeights};
use svbrdf::metrics::{MapErrors, RenderErrors, ssim, ssim::dssim};
use svbrdf::net::Prediction;
use svbrdf::visual::preview;

#[derive(Deserialize)]
struct SsimCase {
    name: String,
    first: String,
    second: String,
    channels: usize,
    height: usize,
    width: usize,
    ssim: f64,
}

#[derive(Deserialize)]
struct SsimFixture {
    cases: Vec<SsimCase>,
}

/// The formula images of fixtures/ssim.py.
fn formula(name: &str, channels: usize, height: usize, width: usize) -> Planes {
    let value = |y: usize, x: usize, c: usize| match name {
        "first" => ((3 * x + 5 * y + 7 * c) % 32) as f32 / 31.0,
        "second" => ((3 * x + 5 * y + 7 * c + (x * y) % 11) % 32) as f32 / 31.0,
        _ => (x + y + c) as f32 / 128.0,
    };
    let area = height * width;
    let data = (0..channels * area).map(|i| value(i % area / width, i % width, i / area)).collect();
    Planes::from_vec(channels, height, width, data)
}

#[test]
fn ssim_equals_scikit_image() {
    let fixture: SsimFixture = serde_json::from_str(include_str!("fixtures/ssim.json")).unwrap();
    assert!(fixture.cases.len() >= 4);
    for case in fixture.cases {
        let image = |name: &str| formula(name, case.channels, case.height, case.width);
        let found = ssim(&image(&case.first), &image(&case.second)).unwrap();
        assert!((found - case.ssim).abs() < 1e-5, "{}: {found} instead of {}", case.name, case.ssim);
    }
}

#[test]
fn ssim_needs_room_for_its_window_and_equal_sizes() {
    let image = |w| formula("first", 1, 16, w);
    assert!(ssim(&image(10), &image(10)).is_none());
    assert!(ssim(&image(16), &image(17)).is_none());
    assert!(dssim(&image(16), &image(16)).unwrap().abs() < 1e-9);
}

fn constant(h: usize, w: usize, v: f32) -> SvbrdfImage {
    ConstantMaps { diffuse: [v; 3], roughness: v, specular: [v; 3] }.to_image(h, w)
}

#[test]
fn map_errors_have_their_hand_values() {
    let reference = constant(2, 2, 0.5);
    let mut predicted = constant(2, 2, 0.5);
    predicted.diffuse = Planes::constant(2, 2, &[0.6, 0.5, 0.5]);
    predicted.roughness = Planes::from_vec(1, 2, 2, vec![0.9, 0.5, 0.5, 0.5]);
    // 60° around y, written down at twice the length.
    predicted.normal = Planes::constant(2, 2, &[3.0f32.sqrt(), 0.0, 1.0]);
    let errors = MapErrors::between(&predicted, &reference, None).unwrap();
    assert!((errors.diffuse_l1 - 0.1 / 3.0).abs() < 1e-6);
    assert!((errors.roughness_l1 - 0.1).abs() < 1e-6);
    assert_eq!(errors.specular_l1, 0.0);
    assert!((errors.normal_deg - 60.0).abs() < 1e-4);
    assert!((errors.normal_l1 - (0.75f64.sqrt() + 0.5) / 6.0).abs() < 1e-6);
    let mask = Mask::from_fn(2, 2, |y, x| (y, x) == (0, 0));
    assert!((MapErrors::between(&predicted, &reference, Some(&mask)).unwrap().roughness_l1 - 0.4).abs() < 1e-6);
}

#[test]
fn map_errors_of_nothing_are_none() {
    assert!(MapErrors::between(&constant(2, 2, 0.5), &constant(2, 3, 0.5), None).is_none());
    assert!(MapErrors::between(&constant(2, 2, 0.5), &constant(2, 2, 0.5), Some(&Mask::new(2, 2, false))).is_none());
    assert!(MapErrors::mean(&[]).is_none());
}

#[test]
fn the_mean_of_errors_weighs_materials_equally() {
    let one = MapErrors { roughness_l1: 0.2, normal_l1: 0.1, ..MapErrors::default() };
    let two = MapErrors { roughness_l1: 0.4, diffuse_l1: 0.3, ..MapErrors::default() };
    let mean = MapErrors::mean(&[one, two]).unwrap();
    assert!((mean.roughness_l1 - 0.3).abs() < 1e-12 && (mean.sum_l1() - 0.5).abs() < 1e-12);
}

#[test]
fn constants_are_medians_over_targets() {
    let targets = [constant(4, 4, 0.2), constant(4, 4, 0.3), constant(4, 4, 0.9)];
    let medians = ConstantMaps::medians(&targets).unwrap();
    assert_eq!(medians, ConstantMaps { diffuse: [0.3; 3], roughness: 0.3, specular: [0.3; 3] });
    assert!(ConstantMaps::medians([]).is_none());
    let bias = medians.output_bias();
    assert!((bias[5].tanh() * 0.5 + 0.5 - 0.3).abs() < 1e-6 && bias[0] == 0.0);
    let black = ConstantMaps { diffuse: [0.0; 3], roughness: 1.0, specular: [0.0; 3] };
    assert!(black.output_bias().iter().all(|b| b.abs() < 2.0));
}

fn maps(normal_x: f32, diffuse: f32, roughness: f32, specular: f32) -> Svbrdf {
    let device = Device::flex();
    let full = |c: usize, v: f32| Tensor::<4>::full([1, c, 2, 2], v, &device);
    let normal = Tensor::cat(vec![full(1, normal_x), full(1, 0.0), full(1, (1.0 - normal_x * normal_x).sqrt())], 1);
    Svbrdf { normal, diffuse: full(3, diffuse), roughness: full(1, roughness), specular: full(3, specular) }
}

#[test]
fn the_loss_has_its_hand_values() {
    let one = |v: f32| Tensor::<1>::full([1], v, &Device::flex());
    let (predicted, target) = (maps(0.6, 0.09, 0.5, 0.19), maps(0.0, 0.19, 0.25, 0.09));
    let loss = LossConfig::default().combine(&predicted, &target, one(0.3), one(0.4)).values();
    let ln2 = std::f32::consts::LN_2;
    let near = |a: f32, b: f32| assert!((a - b).abs() < 1e-6, "{a} instead of {b}");
    near(loss.normal, 0.8 / 3.0);
    near(loss.diffuse, ln2);
    near(loss.specular, ln2);
    near(loss.roughness, 0.5);
    near(loss.maps, 0.8 / 3.0 + 2.0 * ln2 + 0.5);
    near(loss.total, 0.1 * loss.maps + 0.7);
    let single = LossConfig { kind: LossKind::SingleMean, ..LossConfig::default() };
    near(
        single.combine(&predicted, &target, one(0.3), one(0.4)).values().total,
        0.1 * loss.maps + (9.0 * 0.3 + 6.0 * 0.4) / 15.0,
    );
    assert_eq!(values(single.combine(&target, &target, one(0.0), one(0.0)).total), [0.0]);
}

#[test]
fn equal_maps_render_equal_and_other_maps_differ() {
    let views = EvaluationViews::standard();
    let reference = constant(16, 16, 0.5);
    let same = RenderErrors::between(&reference, &reference, &views, BrdfModel::default()).unwrap();
    assert_eq!((same.l1, same.dssim.map(|d| d.abs() < 1e-9)), (0.0, Some(true)));
    let other = RenderErrors::between(&constant(16, 16, 0.6), &reference, &views, BrdfModel::default()).unwrap();
    assert!(other.l1 > 0.02 && other.l1 < 0.1 && other.dssim.unwrap() > 1e-4);
    let mean = RenderErrors::mean(&[same, other]).unwrap();
    assert!((mean.l1 - 0.5 * other.l1).abs() < 1e-12 && RenderErrors::mean(&[]).is_none());
    assert!(RenderErrors::between(&constant(8, 8, 0.5), &reference, &views, BrdfModel::default()).is_none());
    assert!(
        RenderErrors::between(&constant(8, 8, 0.5), &constant(8, 8, 0.2), &views, BrdfModel::default())
            .unwrap()
            .dssim
            .is_none()
    );
}

#[test]
fn a_preview_shows_one_row_per_set_of_maps() {
    let (a, b) = (constant(4, 5, 0.25), constant(4, 5, 0.5));
    let sheet = preview(&[&a, &b], BrdfModel::default());
    assert_eq!((sheet.channels, sheet.height, sheet.width), (3, 2 * 4, 6 * 5));
    assert_eq!((sheet.at(0, 0, 0), sheet.at(2, 0, 0)), (0.5, 1.0));
    assert!((sheet.at(0, 0, 5) - 0.25f32.powf(1.0 / 2.2)).abs() < 1e-4);
    assert_eq!((sheet.at(0, 0, 10), sheet.at(0, 4, 10)), (0.25, 0.5));
    // The renderings of the brighter, rougher row differ from the first row's.
    assert!((sheet.at(1, 2, 22) - sheet.at(1, 6, 22)).abs() > 0.01);
}

#[test]
fn a_prediction_equal_to_its_target_has_no_loss() {
    let device = Device::flex();
    let target = constant(6, 6, 0.4).to_tensor(&device);
    let views = LossViews::draw(&mut ChaCha8Rng::seed_from_u64(4));
    let prediction = |albedo: f32, logit: f32| Prediction {
        maps: constant(6, 6, albedo).to_tensor(&device),
        logits: Tensor::full([1, 9, 6, 6], logit, &device),
    };
    let evaluate =
        |config: LossConfig, prediction| config.evaluate(&prediction, &target, &views, BrdfModel::default()).values();
    let loss = evaluate(LossConfig::default(), prediction(0.4, 0.0));
    assert!(loss.total.abs() < 1e-5);
    // (3.3 − 2.3)² = 1; the paper's loss doesn't count it.
    assert!((evaluate(LossConfig::default(), prediction(0.4, -3.3)).total).abs() < 1e-5);
    let pulling = LossConfig { weights: LossWeights { excess: 0.25, ..LossWeights::default() }, ..LossConfig::default() };
    let tipped = evaluate(pulling, prediction(0.4, -3.3));
    assert!((tipped.excess - 1.0).abs() < 1e-4 && (tipped.total - 0.25).abs() < 1e-4, "{tipped:?}");
    let other = evaluate(LossConfig::default(), prediction(0.6, 0.0));
    assert!(
        other.rendering > 0.05
            && other.top > 0.05
            && (other.total - 0.1 * other.maps - other.rendering - other.top).abs() < 1e-5
    );
}
