//! The slim net learns one pair by heart.

use burn::{
    optim::{AdamConfig, GradientsParams},
    tensor::Device,
};
use flow::{loss::FlowLossConfig, metrics::end_point_error, pwc::PwcConfig, target::FlowTarget};
use nalgebra::Matrix3;
use ops::{
    homography::Homography,
    planes::{Mask, Planes},
};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

const SIDE: usize = 64;

/// A texture of waves in all directions, defined between pixels too.
fn texture(x: f64, y: f64, channel: usize) -> f32 {
    let waves = (0..9).map(|k| {
        let (direction, length) = (k as f64 * 2.4 + channel as f64 * 0.3, 4.0 + 1.7 * k as f64);
        ((x * direction.cos() + y * direction.sin()) * std::f64::consts::TAU / length + k as f64).sin()
    });
    (0.5 + waves.sum::<f64>() / 12.0).clamp(0.0, 1.0) as f32
}

fn image(position: impl Fn(f64, f64) -> (f64, f64)) -> Planes {
    let mut out = Planes::new(3, SIDE, SIDE);
    for c in 0..3 {
        for y in 0..SIDE {
            for x in 0..SIDE {
                let (px, py) = position(x as f64, y as f64);
                out.set(c, y, x, texture(px, py, c));
            }
        }
    }
    out
}

#[test]
fn the_slim_net_overfits_one_pair() {
    // Every source position lies inside the image.
    let turn = Matrix3::new(0.86, -0.06, 7.0, 0.05, 0.88, 2.5, 2e-4, -1e-4, 1.0);
    let homography = Homography::new(turn);
    let target: Planes = homography.flow(SIDE, SIDE);
    let valid: Mask = homography.valid(SIDE, SIDE, SIDE, SIDE);
    let first = image(|x, y| homography.apply(x, y).expect("a mild homography maps every pixel"));
    let second = image(|x, y| (x, y));

    let device = Device::flex().autodiff();
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let mut net = PwcConfig::slim().init(&device, &mut rng);
    let mut optimiser = AdamConfig::new().with_epsilon(1e-8).init();
    // The flow error is a sum over pixels and the matching term a mean: a small image needs a small weight.
    let loss = FlowLossConfig { matching_weight: 0.02, ..FlowLossConfig::default() };
    let truth = FlowTarget::batch(&[&target], &[&valid], &device);
    let (a, b) = (first.to_tensor(&device), second.to_tensor(&device));
    let steps = 320;
    for step in 0..steps {
        let progress = step as f64 / steps as f64;
        let output = net.forward_teaching(a.clone(), b.clone(), &truth, 0.5 - 2.0 * progress, &mut rng);
        let terms = loss.forward(&output, &truth);
        let gradients = GradientsParams::from_grads(terms.total.backward(), &net);
        let rate = 2e-3 * (std::f64::consts::PI * progress).cos().mul_add(0.5, 0.5) + 5e-5;
        net = optimiser.step(rate, net, gradients);
    }
    let flow = Planes::from_tensor(net.flow(a, b).inner()).remove(0);
    let epe = end_point_error(&flow, &target, &valid).expect("most pixels are valid");
    assert!(epe.ratio < 0.05 && epe.median_px < 0.1, "{epe:?}");
}
