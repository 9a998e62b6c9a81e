//! Sizes, shapes and laws of the net.

use burn::{
    module::Module,
    tensor::{Device, Tensor, TensorData},
};
use ops::{compute::Compute, planes::values};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::{loss::FlowLossConfig, target::FlowTarget};

fn rng() -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(3)
}

fn noise(shape: [usize; 4], device: &Device, seed: u64) -> Tensor<4> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let data: Vec<f32> = (0..shape.iter().product()).map(|_| rng.random()).collect();
    Tensor::from_data(TensorData::new(data, shape), device)
}

/// Small enough for tests, with every part on.
fn tiny() -> PwcConfig {
    PwcConfig { channels: vec![4, 6, 8], estimator: vec![8, 6], context: vec![6, 4], ..PwcConfig::slim() }
}

/// The published net, as small.
fn tiny_published() -> PwcConfig {
    PwcConfig { channels: vec![4, 6, 8], estimator: vec![8, 6], context: vec![6, 4], ..PwcConfig::published() }
}

/// Every choice between connections, upsampling, prediction and inputs of the coarsest level that can be built.
fn variants() -> Vec<PwcConfig> {
    let connected = [
        (Connections::Sequential, Upsampling::Bilinear),
        (Connections::Sequential, Upsampling::Deconvolution),
        (Connections::Dense, Upsampling::Deconvolution),
    ];
    let predicting = [(Prediction::Residual, true), (Prediction::Residual, false), (Prediction::Direct, false)];
    let variant = |((connections, upsampling), (prediction, match_head))| {
        let base = PwcConfig { connections, upsampling, prediction, match_head, ..tiny() };
        [true, false].map(|coarsest_features| PwcConfig { coarsest_features, ..base.clone() })
    };
    connected.into_iter().flat_map(|c| predicting.map(|p| (c, p))).flat_map(variant).collect()
}

#[test]
fn the_presets_have_the_parameters_they_promise() {
    let device = Device::flex();
    let count = |config: PwcConfig| config.init(&device, &mut rng()).num_params();
    let paper = count(PwcConfig::paper());
    assert!((paper as f64 / 5.03e6 - 1.0).abs() < 0.01, "{paper}");
    let slim = count(PwcConfig::slim());
    assert!((480_000..540_000).contains(&slim), "{slim}");
    assert_eq!(PwcConfig::published().parameters(), 9_374_274);
    let presets = [PwcConfig::paper(), PwcConfig::slim(), PwcConfig::published(), PwcConfig { convs_per_level: 1, ..tiny() }];
    for config in variants().into_iter().chain(presets) {
        assert_eq!(config.parameters(), count(config.clone()), "{config:?}");
    }
}

#[test]
fn levels_go_from_coarse_to_a_quarter() {
    let device = Device::flex();
    let net = tiny().init(&device, &mut rng());
    let output = net.forward(noise([2, 3, 24, 40], &device, 1), noise([2, 3, 24, 40], &device, 2));
    let shapes: Vec<_> = output.levels.iter().map(|l| (l.factor, l.flow.dims(), l.logits.dims())).collect();
    assert_eq!(shapes, [(8, [2, 2, 3, 5], [2, 81, 3, 5]), (4, [2, 2, 6, 10], [2, 81, 6, 10])]);
    assert!(output.levels[0].start.is_none() && output.levels[1].start.is_some());
}

/// The largest difference between two ways to compute flows of about 20 px, in pixels.
fn largest_difference(a: Tensor<4>, b: Tensor<4>) -> f32 {
    values((a - b).abs().max())[0]
}

#[test]
fn the_flow_is_the_same_by_kernels_and_by_what_other_devices_compute() {
    let device = Device::flex();
    for config in variants() {
        let net = config.init(&device, &mut rng());
        let flow = || net.flow(noise([2, 3, 33, 26], &device, 1), noise([2, 3, 33, 26], &device, 2));
        let difference = largest_difference(flow(), ops::kernel::without(flow));
        assert!(difference < 1e-3, "{config:?}: {difference} px");
    }
}

#[test]
fn half_precision_rounds_the_flow_and_no_more() {
    let device = Device::flex();
    for config in [tiny(), tiny_published()] {
        let net = config.init(&device, &mut rng());
        let flow = || net.flow(noise([1, 3, 32, 32], &device, 1), noise([1, 3, 32, 32], &device, 2));
        let size = values(flow().abs().max())[0];
        for (format, rounding) in [(Compute::F16, 1.0 / 2048.0), (Compute::Bf16, 1.0 / 256.0)] {
            let difference = largest_difference(flow(), format.within(flow));
            println!("{format:?}: {difference:.1e} of {size:.1} px");
            assert!(difference > 0.0 && difference < 64.0 * rounding * size, "{format:?}: {difference} of {size} px");
        }
    }
}

#[test]
fn any_image_size_goes_in_and_comes_out() {
    let device = Device::flex();
    for net in [tiny(), tiny_published()].map(|config| config.init(&device, &mut rng())) {
        for (h, w) in [(1, 1), (7, 30), (16, 16), (33, 17)] {
            let flow = net.flow(noise([1, 3, h, w], &device, 1), noise([1, 3, h, w], &device, 2));
            assert_eq!(flow.dims(), [1, 2, h, w]);
            assert!(values(flow).iter().all(|v| v.is_finite()), "{h}×{w}");
        }
    }
}

#[test]
fn pairs_of_a_batch_do_not_see_each_other() {
    let device = Device::flex();
    for config in [PwcConfig { channels: vec![4, 4, 4], ..PwcConfig::paper() }, tiny(), tiny_published()] {
        let net = config.init(&device, &mut rng());
        let (a, b) = (noise([2, 3, 16, 16], &device, 1), noise([2, 3, 16, 16], &device, 2));
        let pick = |t: &Tensor<4>| t.clone().slice([1..2, 0..3, 0..16, 0..16]);
        let both = net.flow(a.clone(), b.clone()).slice([1..2, 0..2, 0..16, 0..16]);
        let alone = net.flow(pick(&a), pick(&b));
        assert!(values((both - alone).abs().max())[0] < 1e-3, "{config:?}");
    }
}

#[test]
fn the_same_seed_gives_the_same_net() {
    let device = Device::flex();
    let (a, b) = (noise([1, 3, 16, 16], &device, 1), noise([1, 3, 16, 16], &device, 2));
    let flow = |seed| values(tiny().init(&device, &mut ChaCha8Rng::seed_from_u64(seed)).flow(a.clone(), b.clone()));
    assert_eq!(flow(1), flow(1));
    assert_ne!(flow(1), flow(2));
}

#[test]
fn identical_images_match_at_no_displacement() {
    let device = Device::flex();
    let net = PwcConfig::slim().init(&device, &mut rng());
    let image = noise([1, 3, 64, 64], &device, 5);
    let output = net.forward(image.clone(), image);
    let coarsest = &output.levels[0];
    let centre = 40;
    let best: Vec<i64> = coarsest.logits.clone().argmax(1).into_data().iter::<i64>().collect();
    assert!(best.iter().all(|&d| d == centre), "{best:?}");
    let expected = net.matchings[0].expected(&(coarsest.logits.clone() * 4.0)).expect("the slim net has a match head");
    assert!(values(expected.abs().mean())[0] < 0.1, "sharp logits expect next to no displacement");
}

#[test]
fn the_match_head_reads_displacements_x_first() {
    let matching = Matching::new(2, true, &Device::flex());
    let mut logits = vec![-50.0f32; 25];
    logits[4 * 5 + 3] = 50.0;
    let logits = Tensor::<4>::from_data(TensorData::new(logits, [1, 25, 1, 1]), &Device::flex());
    let expected = values(matching.expected(&logits).unwrap());
    assert!((expected[0] - 1.0).abs() < 1e-5 && (expected[1] - 2.0).abs() < 1e-5, "{expected:?}");
    assert!(Matching::new(2, false, &Device::flex()).expected(&logits).is_none());
}

#[test]
fn a_fully_taught_level_starts_near_the_truth() {
    let device = Device::flex();
    let net = tiny().init(&device, &mut rng());
    let (a, b) = (noise([2, 3, 32, 32], &device, 1), noise([2, 3, 32, 32], &device, 2));
    let valid: Vec<f32> = (0..2 * 32 * 32).map(|i| f32::from(i % 32 < 16)).collect();
    let valid = Tensor::from_data(TensorData::new(valid, [2, 1, 32, 32]), &device);
    let truth = FlowTarget::new(Tensor::full([2, 2, 32, 32], 100.0, &device), valid);
    let start = |share: f64| {
        let output = net.forward_teaching(a.clone(), b.clone(), &truth, share, &mut rng());
        output.levels[1].start.clone().unwrap() * FLOW_UNIT_PX
    };
    let untaught = net.forward(a.clone(), b.clone()).levels[1].start.clone().unwrap() * FLOW_UNIT_PX;
    assert_eq!(values(start(0.0)), values(untaught.clone()));
    let part = |t: Tensor<4>, columns: std::ops::Range<usize>| values(t.slice([0..2, 0..2, 0..8, columns]));
    // 3 px of a level of factor 4.
    let taught = start(1.0);
    assert!(part(taught.clone(), 0..4).iter().all(|v| (v - 100.0).abs() <= 12.01));
    assert_eq!(part(taught, 4..8), part(untaught, 4..8), "where the truth is unknown, nothing is taught");
}

#[test]
fn every_parameter_gets_a_finite_gradient() {
    struct Check<'a>(&'a burn::tensor::Gradients, usize);
    impl burn::module::ModuleVisitor for Check<'_> {
        fn visit_float<const D: usize>(&mut self, param: &burn::module::Param<Tensor<D>>) {
            let gradient = values(param.val().grad(self.0).expect("every parameter takes part"));
            assert!(gradient.iter().all(|g| g.is_finite()));
            self.1 += gradient.len();
        }
    }
    let device = Device::flex().autodiff();
    let (a, b) = (noise([2, 3, 19, 32], &device, 1), noise([2, 3, 19, 32], &device, 2));
    let truth = FlowTarget::new(Tensor::zeros([2, 2, 19, 32], &device), Tensor::ones([2, 1, 19, 32], &device));
    let one_flow = PwcConfig { channels: vec![4, 6], ..tiny_published() };
    for config in variants().into_iter().chain([tiny_published(), one_flow]) {
        let net = config.init(&device, &mut rng());
        let loss = FlowLossConfig::teaching().forward(&net.forward(a.clone(), b.clone()), &truth);
        let gradients = loss.total.backward();
        let mut check = Check(&gradients, 0);
        net.visit(&mut check);
        assert_eq!(check.1, net.num_params(), "{config:?}");
    }
}

#[test]
fn a_direct_prediction_replaces_the_flow_and_a_residual_one_adds_to_it() {
    let device = Device::flex();
    let (a, b) = (noise([1, 3, 32, 32], &device, 1), noise([1, 3, 32, 32], &device, 2));
    let levels = |prediction| {
        let config = PwcConfig { prediction, context: Vec::new(), ..tiny_published() };
        config.init(&device, &mut rng()).forward(a.clone(), b.clone()).levels
    };
    let (residual, direct) = (levels(Prediction::Residual), levels(Prediction::Direct));
    let start = residual[1].start.clone().expect("a finer level starts from the coarser one's flow");
    let difference = residual[1].flow.clone() - direct[1].flow.clone() - start;
    assert!(values(difference.abs().max())[0] < 1e-6);
    assert_eq!(values(residual[0].flow.clone()), values(direct[0].flow.clone()));
}

#[test]
fn configs_are_strict_and_complete_themselves() {
    let config: PwcConfig = serde_json::from_str("{}").unwrap();
    assert_eq!(config, PwcConfig::paper());
    let config: PwcConfig = serde_json::from_str(r#"{"input": "local-contrast", "radius": 3}"#).unwrap();
    assert_eq!((config.input, config.radius), (Input::LocalContrast, 3));
    assert!(serde_json::from_str::<PwcConfig>(r#"{"radios": 3}"#).unwrap_err().to_string().contains("radios"));
    assert!(serde_json::from_str::<PwcConfig>(r#"{"input": "lcn"}"#).is_err());
    for config in variants() {
        let text = serde_json::to_string(&config).unwrap();
        assert_eq!(serde_json::from_str::<PwcConfig>(&text).unwrap(), config);
    }
}

#[test]
fn impossible_nets_are_named() {
    let error = |edit: fn(&mut PwcConfig)| {
        let mut config = PwcConfig::slim();
        edit(&mut config);
        config.validate().unwrap_err()
    };
    assert_eq!(PwcConfig::paper().validate(), Ok(()));
    assert_eq!(PwcConfig::slim().validate(), Ok(()));
    assert_eq!(PwcConfig::published().validate(), Ok(()));
    assert_eq!(error(|c| c.channels.truncate(1)), PwcConfigError::Levels(1));
    assert_eq!(error(|c| c.channels[1] = 0), PwcConfigError::Width { key: "channels", found: 0 });
    assert_eq!(error(|c| c.estimator.clear()), PwcConfigError::Estimator(0));
    assert_eq!(error(|c| c.estimator = vec![8; 17]), PwcConfigError::Estimator(17));
    assert_eq!(error(|c| c.context = vec![8; 7]), PwcConfigError::Context(7));
    assert_eq!(error(|c| c.radius = 0), PwcConfigError::Radius(0));
    assert_eq!(error(|c| c.convs_per_level = 0), PwcConfigError::ConvsPerLevel(0));
    assert_eq!(error(|c| c.connections = Connections::Dense), PwcConfigError::DenseBilinear);
    assert_eq!(error(|c| c.prediction = Prediction::Direct), PwcConfigError::DirectMatchHead);
}
