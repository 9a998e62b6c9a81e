//! Times a training step of a flow net: `cargo run -p flow --example step_time -- [slim|paper|published] [side] [batch] [steps]`.

use std::time::Instant;

use burn::{
    optim::{AdamConfig, GradientsParams},
    tensor::{Device, Tensor, TensorData},
};
use flow::{loss::FlowLossConfig, pwc::PwcConfig, target::FlowTarget};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let number = |i: usize, default: usize| arguments.get(i).and_then(|a| a.parse().ok()).unwrap_or(default);
    let (config, loss) = match arguments.first().map(String::as_str) {
        Some("paper") => (PwcConfig::paper(), FlowLossConfig::default()),
        Some("published") => (PwcConfig::published(), FlowLossConfig::default()),
        _ => (PwcConfig::slim(), FlowLossConfig::teaching()),
    };
    let (side, batch, steps) = (number(1, 192), number(2, 2), number(3, 10));

    let device = Device::flex().autodiff();
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut net = config.init(&device, &mut rng);
    let mut optimiser = AdamConfig::new().with_epsilon(1e-8).init();
    let image = |rng: &mut ChaCha8Rng| {
        let values: Vec<f32> = (0..batch * 3 * side * side).map(|_| rng.random()).collect();
        Tensor::<4>::from_data(TensorData::new(values, [batch, 3, side, side]), &device)
    };
    let (first, second) = (image(&mut rng), image(&mut rng));
    let target =
        FlowTarget::new(Tensor::ones([batch, 2, side, side], &device) * 3.0, Tensor::ones([batch, 1, side, side], &device));
    println!("{} parameters, {batch} × {side}²", burn::module::Module::num_params(&net));
    let mut times = [Vec::new(), Vec::new(), Vec::new()];
    for _ in 0..steps {
        let mut clock = Instant::now();
        let mut lap = |i: usize| times[i].push(std::mem::replace(&mut clock, Instant::now()).elapsed());
        let output = net.forward_teaching(first.clone(), second.clone(), &target, 0.5, &mut rng);
        let terms = loss.forward(&output, &target);
        lap(0);
        let gradients = GradientsParams::from_grads(terms.total.backward(), &net);
        lap(1);
        net = optimiser.step(1e-4, net, gradients);
        lap(2);
    }
    for (name, times) in ["forward", "backward", "optimiser"].into_iter().zip(&mut times) {
        times.sort_unstable();
        println!("{name}: {:.1} ms (median)", times[times.len() / 2].as_secs_f64() * 1e3);
    }
}
