//! PWC-Net and its losses beside a PyTorch twin that was written from the papers (`tests/golden/generate`).

#[path = "../../../tests/golden/case.rs"]
mod case;
#[path = "../../../tests/golden/gradient.rs"]
mod gradient;

use burn::module::Module;
use burn::tensor::{Device, Tensor};
use case::{Case, TOLERANCE, golden, relative_largest, worst_term};
use flow::loss::{FlowError, FlowLossConfig};
use flow::pwc::PwcConfig;
use flow::target::FlowTarget;
use flow::weights::ADJACENT;
use ops::planes::values;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// Flows of all levels, terms of the losses and all gradients of one configuration.
fn check_net(name: &str, errors: &[(&str, FlowError)], matching_weight: f32) {
    let device = Device::flex().autodiff();
    let (net, _) = flow::weights::load(&golden(&format!("flow/{name}")), ADJACENT, &device).unwrap();
    let case = Case::read(&format!("flow/{name}/case.safetensors"));
    let images: Tensor<4> = case.tensor("images", &device);
    let [n, c, h, w] = images.dims();
    let half = |from: usize| images.clone().slice([from..from + n / 2, 0..c, 0..h, 0..w]);
    let (first, second) = (half(0), half(n / 2));
    let target = FlowTarget::new(case.tensor("target", &device), case.tensor("valid", &device));

    for (index, level) in net.forward(first.clone(), second.clone()).levels.into_iter().enumerate() {
        let error = relative_largest(&values(level.flow), case.values(&format!("level.{index}")));
        println!("{name}: level {index} {error:.1e}");
        assert!(error <= TOLERANCE, "level {index} differs by {error}");
    }
    let error = relative_largest(&values(net.flow(first.clone(), second.clone())), case.values("flow"));
    println!("{name}: full resolution {error:.1e}");
    assert!(error <= TOLERANCE, "the flow differs by {error}");

    for (prefix, error) in errors {
        let config = FlowLossConfig { error: *error, matching_weight, ..FlowLossConfig::default() };
        let loss = config.forward(&net.forward(first.clone(), second.clone()), &target);
        let expected = case.values(&format!("terms.{prefix}"));
        let terms: Vec<f32> = loss.levels.iter().chain(&loss.matching).map(|t| values(t.clone())[0]).collect();
        let worst = worst_term(&terms, expected);
        let gradients = gradient::errors(&net, &loss.total.backward(), &case, prefix);
        println!("{name}, {prefix}: terms {worst:.1e}, {} gradients, worst {:?}", gradients.len(), &gradients[..2]);
        assert!(worst <= TOLERANCE, "{prefix}: {terms:?} instead of {expected:?}");
        assert!(gradients[0].0 <= TOLERANCE, "{prefix}: {gradients:?}");
    }
}

const BOTH: [(&str, FlowError); 2] = [("euclidean", FlowError::Euclidean), ("robust", FlowError::Robust)];

#[test]
fn the_papers_net_at_an_eighth_of_its_width_is_the_twins() {
    check_net("paper-eighth", &BOTH[..1], 0.0);
}

#[test]
fn a_batch_through_four_levels_is_the_twins_for_both_losses() {
    check_net("four-levels", &BOTH, 0.0);
}

#[test]
fn the_learning_aids_are_the_twins() {
    check_net("learning-aids", &BOTH, 1.0);
}

#[test]
fn the_published_net_at_a_sixteenth_of_its_width_is_the_twins() {
    check_net("published-sixteenth", &BOTH[..1], 0.0);
}

#[test]
fn dense_connections_and_deconvolutions_around_a_residual_flow_are_the_twins() {
    check_net("dense-residual", &BOTH, 0.0);
}

#[test]
fn the_nets_have_the_twins_parameters() {
    let counts: serde_json::Value = serde_json::from_slice(&std::fs::read(golden("counts.json")).unwrap()).unwrap();
    let nets = [("pwc", PwcConfig::paper(), "5.03 M"), ("pwc_published", PwcConfig::published(), "9.37 M")];
    for (name, config, promised) in nets {
        let net = config.init(&Device::flex(), &mut ChaCha8Rng::seed_from_u64(0));
        assert_eq!(net.num_params() as u64, counts[name].as_u64().unwrap());
        assert_eq!(format!("{:.2} M", net.num_params() as f64 / 1e6), promised);
    }
}
