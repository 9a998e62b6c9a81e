//! The net learns one tiny exemplar by heart, with the whole loss: forward, warp, renderings and gradients work together.

use burn::optim::{AdamConfig, GradientsParams};
use burn::tensor::Device;
use ops::homography::Homography;
use ops::planes::Planes;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use render::brdf::BrdfModel;
use render::evaluation::encode;
use render::svbrdf::SvbrdfImage;
use render::texel::Texel;
use render::views::{Emission, LossViews, Origin, View};
use svbrdf::constants::ConstantMaps;
use svbrdf::loss::{LossConfig, SvbrdfLossValues};
use svbrdf::net::{OutputConfig, OutputStart, PixelFeatures, SvbrdfNetConfig};

const SIDE: usize = 64;
/// Each key frame sees the sample shifted by this many pixels more.
const SHIFT: usize = 4;
const FRAMES: usize = 3;
const STEPS: usize = 400;

/// One term of the loss.
type Term = fn(&SvbrdfLossValues) -> f32;

/// Bricks in a groove pattern, larger than a frame.
fn sample() -> SvbrdfImage {
    let side = SIDE + SHIFT * (FRAMES - 1);
    SvbrdfImage::from_fn(side, side, |y, x| {
        let brick = ((x / 16 + y / 8) % 2) as f32;
        let slope = 0.3 * (x as f32 * 0.4).sin();
        let length = (1.0 + slope * slope).sqrt();
        Texel {
            normal: [slope / length, 0.0, 1.0 / length],
            diffuse: [0.1 + 0.4 * brick, 0.2 + 0.1 * brick, 0.15],
            roughness: 0.3 + 0.4 * brick,
            specular: [0.1 - 0.06 * brick; 3],
        }
    })
}

/// Flash-lit frames from different places and the flows from the first to the others.
fn exemplar() -> (Vec<Planes>, Vec<Planes>, SvbrdfImage) {
    let sample = sample();
    let frame = |k: usize| {
        let place = Origin::Point([0.8 * k as f32 - 0.8, 0.4 - 0.3 * k as f32, 2.5]);
        let flash = View { camera: place, light: place, emission: Emission::Flash { intensity: 8.0, exponent: 1.0 } };
        let seen = render::fused::render(&sample, &flash, BrdfModel::default());
        encode(seen.crop(0, k * SHIFT, SIDE, SIDE))
    };
    let flows = (1..FRAMES).map(|k| Homography::translation(-((k * SHIFT) as f64), 0.0).flow(SIDE, SIDE)).collect();
    ((0..FRAMES).map(frame).collect(), flows, sample.crop(0, 0, SIDE, SIDE))
}

#[test]
fn the_net_learns_one_exemplar_by_heart() {
    let device = Device::flex().autodiff();
    let (frames, flows, target) = exemplar();
    let frames = Planes::batch(&frames.iter().collect::<Vec<_>>(), &device);
    let flow = Planes::batch(&flows.iter().collect::<Vec<_>>(), &device);
    let config = SvbrdfNetConfig {
        width: 8,
        levels: 4,
        dropout: 0.0,
        pixel_features: PixelFeatures::Extremes,
        output: OutputConfig { start: OutputStart::Medians, gain: 0.02 },
        ..SvbrdfNetConfig::default()
    };
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let constants = ConstantMaps::medians([&target]).expect("one target");
    let mut net = config.init(&device, &mut rng).expect("a valid config").starting_at(&constants);
    let target = target.to_tensor(&device);
    let mut adam = AdamConfig::new().with_epsilon(1e-4).init();
    let loss = LossConfig::default();
    let mut history: Vec<SvbrdfLossValues> = Vec::new();
    for step in 0..STEPS {
        let views = LossViews::draw(&mut rng);
        let prediction = net.predict(frames.clone(), flow.clone(), None, None);
        let terms = loss.evaluate(&prediction, &target, &views, BrdfModel::default());
        history.push(terms.values());
        assert!(prediction.saturation() < 0.05, "the outputs tip over at step {step}");
        let gradients = GradientsParams::from_grads(terms.total.backward(), &net);
        let progress = step as f64 / STEPS as f64;
        let rate = 1e-3 * (1.0 - progress).max(0.05) * ((step + 1) as f64 / 20.0).min(1.0);
        net = adam.step(rate, net, gradients);
    }
    let mean = |part: &[SvbrdfLossValues], f: Term| part.iter().map(f).sum::<f32>() / part.len() as f32;
    let (first, last) = (&history[..3], &history[STEPS - 10..]);
    // The specular albedo of rough bricks hardly shows in any picture, so it comes last.
    let terms: [(Term, f32); 6] = [
        (|v| v.total, 0.15),
        (|v| v.normal, 0.2),
        (|v| v.diffuse, 0.2),
        (|v| v.roughness, 0.2),
        (|v| v.specular, 0.4),
        (|v| v.rendering, 0.15),
    ];
    for (i, (term, left)) in terms.into_iter().enumerate() {
        let (before, after) = (mean(first, term), mean(last, term));
        assert!(after < left * before, "term {i}: {before} only fell to {after}");
    }
}
