//! Prints what one training step's fifteen renderings cost, value and gradient, by the fused route and by tensors:
//! `cargo run -p render --example rendering_cost [PYTHON]`.
//!
//! With the name of a Python that has PyTorch, the same is timed there (rendering_cost.py), a step of each in turn.
//! A second argument like `memory-fused` is how the program asks itself what one route holds at most.

#[path = "../../../tests/benchmark/worker.rs"]
mod worker;

use std::error::Error;
use std::process::Command;
use std::time::Instant;

use burn::tensor::{Device, Tensor};
use ops::kernel::peak::Peak;
use ops::process::peak_rss_mib;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use render::brdf::BrdfModel;
use render::evaluation::render_views;
use render::loss::RenderingLosses;
use render::svbrdf::{Svbrdf, SvbrdfImage};
use render::texel::Texel;
use render::views::{EvaluationViews, LossViews};
use render::{fused, loss};
use worker::{Worker, median};

const SIZE: usize = 256;
const ROUNDS: usize = 15;

type Route = fn(&Svbrdf, &Svbrdf, &LossViews, BrdfModel) -> RenderingLosses;

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let (python, memory) = (arguments.next(), arguments.next());
    let views = LossViews::draw(&mut ChaCha8Rng::seed_from_u64(1));
    let (pred, target) = (maps(0.3), maps(0.0));
    let step = |route: Route| step(route, &pred, &target, &views);
    if let Some(route) = memory {
        match route.as_str() {
            "memory-fused" => _ = step(fused::rendering_losses),
            "memory-tensors" => _ = step(loss::rendering_losses),
            _ => {}
        }
        println!("{}", peak_rss_mib().unwrap_or(0.0));
        return Ok(());
    }
    println!("{}\n{SIZE}² maps, 15 renderings, value and gradient\n", Peak::measure());
    let mut torch = python.as_deref().filter(|p| *p != "-").map(|python| torch(python, &views)).transpose()?;
    let [mut fused_ms, mut tensors_ms, mut torch_ms] = [const { Vec::new() }; 3];
    let mut losses = [0.0; 3];
    for round in 0..=ROUNDS {
        let fused = timed(|| step(fused::rendering_losses));
        let tensors = timed(|| step(loss::rendering_losses));
        let theirs = torch.as_mut().map(|torch| torch.ask::<2>("step")).transpose()?;
        losses = [fused.1, tensors.1, theirs.map_or(f64::NAN, |t| t[1])];
        if round > 0 {
            fused_ms.push(fused.0);
            tensors_ms.push(tensors.0);
            torch_ms.extend(theirs.map(|t| t[0]));
        }
    }
    let resting = most_memory_of("memory-none")?;
    let memory = |route| Ok::<_, Box<dyn Error>>(most_memory_of(route)? - resting);
    println!("| route | ms (median) | loss | MiB beyond the maps |\n|---|---|---|---|");
    let row = |name: &str, ms: &mut Vec<f64>, loss: f64, mb: String| {
        println!("| {name} | {:.1} | {loss:.6} | {mb} |", median(ms));
    };
    row("fused", &mut fused_ms, losses[0], format!("{:.0}", memory("memory-fused")?));
    row("tensors", &mut tensors_ms, losses[1], format!("{:.0}", memory("memory-tensors")?));
    if torch.is_some() {
        row("PyTorch", &mut torch_ms, losses[2], "–".into());
    }
    let views = EvaluationViews::standard();
    let mut pictures: Vec<f64> = (0..ROUNDS).map(|_| timed(|| drop(render_views(&pred, &views))).0).collect();
    println!("\n18 evaluation pictures, value only: {:.1} ms", median(&mut pictures));
    Ok(())
}

fn maps(phase: f32) -> SvbrdfImage {
    SvbrdfImage::from_fn(SIZE, SIZE, |y, x| Texel {
        normal: render::direction::unit([(0.1 * x as f32 + phase).sin() * 0.3, (0.13 * y as f32).cos() * 0.3, 1.0]),
        diffuse: [0.5 + 0.4 * (0.05 * x as f32).sin(), 0.3, 0.2],
        roughness: 0.5 + 0.4 * (0.07 * y as f32 + phase).sin(),
        specular: [0.04, 0.05, 0.3],
    })
}

/// One step by a route; its loss.
fn step(route: Route, pred: &SvbrdfImage, target: &SvbrdfImage, views: &LossViews) -> f64 {
    let device = Device::flex().autodiff();
    let pred = pred.to_tensor(&device).map(Tensor::require_grad);
    let losses = route(&pred, &target.to_tensor(&device), views, BrdfModel::default());
    drop((losses.rendering + losses.top).backward());
    losses.rendering_value + losses.top_value
}

/// (milliseconds, result).
fn timed<R>(work: impl FnOnce() -> R) -> (f64, R) {
    let began = Instant::now();
    let result = work();
    (began.elapsed().as_secs_f64() * 1e3, result)
}

/// Most memory of a fresh process that runs one route, in MiB.
fn most_memory_of(route: &str) -> Result<f64, Box<dyn Error>> {
    let output = Command::new(std::env::current_exe()?).args(["-", route]).output()?;
    Ok(String::from_utf8(output.stdout)?.trim().parse()?)
}

/// The Python program beside this one.
fn torch(python: &str, views: &LossViews) -> Result<Worker, Box<dyn Error>> {
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/examples/rendering_cost.py");
    let setup = serde_json::json!({ "size": SIZE, "rendering": views.rendering, "top": views.top });
    Worker::start(Command::new(python).args([script, &rayon::current_num_threads().to_string()]), &setup)
}
