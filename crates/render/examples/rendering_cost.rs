//! Prints what one training step's fifteen renderings cost, by the fused route and by tensors:
//! `cargo run -p render --example rendering_cost`.

use std::time::Instant;

use burn::tensor::{Device, Tensor};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use render::brdf::BrdfModel;
use render::evaluation::render_views;
use render::svbrdf::SvbrdfImage;
use render::texel::Texel;
use render::views::{EvaluationViews, LossViews};
use render::{fused, loss};

/// (median, smallest) wall time in milliseconds; the smallest is what a busy machine would take if it were quiet.
fn timed(mut work: impl FnMut(), rounds: usize) -> (f64, f64) {
    let mut times: Vec<f64> = (0..rounds)
        .map(|_| {
            let start = Instant::now();
            work();
            start.elapsed().as_secs_f64() * 1e3
        })
        .collect();
    times.sort_by(f64::total_cmp);
    (times[rounds / 2], times[0])
}

fn main() {
    let size = 256;
    let device = Device::flex().autodiff();
    let maps = |phase: f32| {
        SvbrdfImage::from_fn(size, size, |y, x| Texel {
            normal: render::direction::unit([(0.1 * x as f32 + phase).sin() * 0.3, (0.13 * y as f32).cos() * 0.3, 1.0]),
            diffuse: [0.5 + 0.4 * (0.05 * x as f32).sin(), 0.3, 0.2],
            roughness: 0.5 + 0.4 * (0.07 * y as f32 + phase).sin(),
            specular: [0.04, 0.05, 0.3],
        })
    };
    let (pred, target) = (maps(0.3), maps(0.0));
    let views = LossViews::draw(&mut ChaCha8Rng::seed_from_u64(1));
    let model = BrdfModel::default();
    let kernel = timed(
        || {
            fused::log_difference(&pred, &target, &views.rendering, model);
            fused::log_difference(&pred, &target, &views.top, model);
        },
        60,
    );
    let step = |route: fn(&_, &_, &_, _) -> loss::RenderingLosses| {
        let p = pred.to_tensor(&device).map(Tensor::require_grad);
        let losses = route(&p, &target.to_tensor(&device), &views, model);
        let _ = (losses.rendering + losses.top).backward();
    };
    let fused_step = timed(|| step(fused::rendering_losses), 40);
    let tensor_step = timed(|| step(loss::rendering_losses), 5);
    let pictures = timed(|| drop(render_views(&pred, &EvaluationViews::standard())), 20);
    println!("{size}² maps, 15 renderings, value and gradient, milliseconds: median (smallest)");
    let rows = [
        ("fused kernel alone", kernel),
        ("fused, in autodiff", fused_step),
        ("tensor route", tensor_step),
        ("18 evaluation pictures, value only", pictures),
    ];
    for (name, (median, smallest)) in rows {
        println!("  {name:36}{median:8.1} ({smallest:.1})");
    }
}
