//! Prints what the nets and their heaviest operations cost beside PyTorch, a step of each in turn, each in a process of its own:
//! `cargo run -p evaluate --example net_cost -- PYTHON [PART-OF-A-NAME…]`.
//!
//! PYTHON is one that has PyTorch and NumPy (main.py, which uses the twins of tests/golden/generate); `-` leaves it out. With
//! further arguments only work whose name contains one of them is done.

#[path = "../../../../tests/benchmark/worker.rs"]
mod worker;

use std::error::Error;
use std::io::{BufRead, Write};
use std::process::Command;
use std::time::Instant;

use burn::tensor::{Device, Tensor, TensorData};
use flow::loss::FlowLossConfig;
use flow::pwc::PwcConfig;
use flow::target::FlowTarget;
use ops::kernel::peak::Peak;
use ops::process::peak_rss_mib;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use render::brdf::BrdfModel;
use render::svbrdf::SvbrdfImage;
use render::texel::Texel;
use render::views::LossViews;
use serde::{Deserialize, Serialize};
use svbrdf::loss::LossConfig;
use svbrdf::net::SvbrdfNetConfig;
use worker::{Worker, median};

const SIDE: usize = 256;
const ROUNDS: usize = 3;

/// What is timed.
#[derive(Clone, Copy, Serialize, Deserialize)]
struct Work {
    kind: Kind,
    /// Width of the SVBRDF net.
    width: usize,
    /// Frames, the guidance frame among them; of the warped maximum, the key frames.
    frames: usize,
    /// Forward, losses and backward instead of forward only.
    training: bool,
}

#[derive(Clone, Copy, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Kind {
    Svbrdf,
    Pwc,
    WarpMaximum,
    CostVolume,
}

impl Work {
    fn all() -> Vec<Self> {
        let work = |kind, width, frames, training| Self { kind, width, frames, training };
        let nets = [true, false].into_iter().flat_map(|training| {
            let sizes = [64, 32, 16].into_iter().flat_map(|width| [(width, 5), (width, 11)]);
            let svbrdf = sizes.map(move |(width, frames)| work(Kind::Svbrdf, width, frames, training));
            svbrdf.chain([work(Kind::Pwc, 0, 2, training)])
        });
        let operations =
            [work(Kind::WarpMaximum, 64, 5, true), work(Kind::WarpMaximum, 64, 17, true), work(Kind::CostVolume, 0, 2, true)];
        nets.chain(operations).collect()
    }

    fn name(&self) -> String {
        let pass = if self.training { "training" } else { "inference" };
        match self.kind {
            Kind::Svbrdf => format!("svbrdf {pass}, width {}, {} frames", self.width, self.frames),
            Kind::Pwc => format!("pwc {pass}"),
            Kind::WarpMaximum => format!("warped maximum, {} frames × {}", self.frames, self.width),
            Kind::CostVolume => "cost volumes, five levels".into(),
        }
    }

    /// A closure that does it once.
    fn step(self) -> Result<Box<dyn FnMut()>, Box<dyn Error>> {
        let device = if self.training { Device::flex().autodiff() } else { Device::flex() };
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let Self { width, frames, training, .. } = self;
        Ok(match self.kind {
            Kind::Svbrdf => {
                let net = SvbrdfNetConfig { width, ..SvbrdfNetConfig::default() }.init(&device, &mut rng)?;
                let (pictures, flow) = (picture(frames, 3, SIDE, &device), shift(frames - 1, SIDE, &device));
                let target = maps().to_tensor(&device);
                let views = LossViews::draw(&mut rng);
                Box::new(move || {
                    let prediction = net.predict(pictures.clone(), flow.clone(), None, None);
                    if training {
                        let loss = LossConfig::default().evaluate(&prediction, &target, &views, BrdfModel::default());
                        drop(loss.total.backward());
                    }
                })
            }
            Kind::Pwc => {
                let net = PwcConfig::paper().init(&device, &mut rng);
                let (first, second) = (picture(1, 3, SIDE, &device), picture(1, 3, SIDE, &device) * 0.9);
                let target = FlowTarget::new(shift(1, SIDE, &device), Tensor::ones([1, 1, SIDE, SIDE], &device));
                Box::new(move || {
                    if training {
                        let output = net.forward(first.clone(), second.clone());
                        drop(FlowLossConfig::default().forward(&output, &target).total.backward());
                    } else {
                        drop(net.flow(first.clone(), second.clone()));
                    }
                })
            }
            Kind::WarpMaximum => {
                let guidance = picture(1, width, SIDE, &device).require_grad();
                let features = picture(frames, width, SIDE, &device).require_grad();
                let flow = shift(frames, SIDE, &device);
                Box::new(move || {
                    let maximum = ops::warp::warp_max(guidance.clone(), features.clone(), flow.clone());
                    drop(maximum.sum().backward());
                })
            }
            Kind::CostVolume => {
                let config = PwcConfig::paper();
                let levels = config.channels.iter().enumerate().skip(1);
                let pairs: Vec<[Tensor<4>; 2]> = levels
                    .map(|(level, &channels)| {
                        [(), ()].map(|()| picture(1, channels, SIDE >> (level + 1), &device).require_grad())
                    })
                    .collect();
                Box::new(move || {
                    let sums =
                        pairs.iter().map(|[a, b]| ops::cost_volume::cost_volume(a.clone(), b.clone(), config.radius).sum());
                    drop(sums.reduce(|a, b| a + b).map(|sum| sum.backward()));
                })
            }
        })
    }
}

/// Waves between 0 and 1.
fn picture(count: usize, channels: usize, side: usize, device: &Device) -> Tensor<4> {
    let wave = |i: usize| 0.5 + 0.5 * ((i % 9973) as f32 * 0.31).sin();
    let values: Vec<f32> = (0..count * channels * side * side).map(wave).collect();
    Tensor::from_data(TensorData::new(values, [count, channels, side, side]), device)
}

/// Flows that turn, enlarge and shift by up to 20 pixels, another one for each frame.
fn shift(count: usize, side: usize, device: &Device) -> Tensor<4> {
    let value = |i: usize| {
        let (frame, axis, y, x) = (i / (2 * side * side), i / (side * side) % 2, i / side % side, i % side);
        let (along, across) = if axis == 0 { (x, y) } else { (y, x) };
        let sign = if frame % 2 == 0 { 1.0 } else { -1.0 };
        sign * (0.02 * along as f32 + 0.03 * across as f32 + frame as f32)
    };
    let values: Vec<f32> = (0..count * 2 * side * side).map(value).collect();
    Tensor::from_data(TensorData::new(values, [count, 2, side, side]), device)
}

fn maps() -> SvbrdfImage {
    SvbrdfImage::from_fn(SIDE, SIDE, |y, x| Texel {
        normal: render::direction::unit([(0.1 * x as f32).sin() * 0.3, (0.13 * y as f32).cos() * 0.3, 1.0]),
        diffuse: [0.5 + 0.4 * (0.05 * x as f32).sin(), 0.3, 0.2],
        roughness: 0.5 + 0.4 * (0.07 * y as f32).sin(),
        specular: [0.04, 0.05, 0.3],
    })
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let python = arguments.next().ok_or("expected the name of a Python that has PyTorch, or -")?;
    if python == "--work" {
        ops::process::keep_memory();
        return work();
    }
    let parts: Vec<String> = arguments.collect();
    println!("{}\n\nmedians of {ROUNDS}, {SIDE}²; memory beyond a process that has only started\n", Peak::measure());
    println!("| work | ms | PyTorch ms | ratio | MiB | PyTorch MiB | ratio |\n|---|---|---|---|---|---|---|");
    let chosen = |work: &Work| parts.is_empty() || parts.iter().any(|part| work.name().contains(part));
    for work in Work::all().into_iter().filter(chosen) {
        let ours = Worker::start(Command::new(std::env::current_exe()?).arg("--work"), &work)?;
        let theirs = (python != "-").then(|| torch(&python, &work)).transpose()?;
        let mut workers: Vec<Worker> = std::iter::once(ours).chain(theirs).collect();
        let mut times = vec![Vec::new(); workers.len()];
        for round in 0..=ROUNDS {
            for (worker, times) in workers.iter_mut().zip(&mut times) {
                let [ms] = worker.ask("step")?;
                // The first step warms up.
                times.extend((round > 0).then_some(ms));
            }
        }
        let ms: Vec<f64> = times.iter_mut().map(|times| median(times)).collect();
        let mb = workers.iter_mut().map(|w| Ok(w.ask::<1>("memory")?[0])).collect::<Result<Vec<f64>, Box<dyn Error>>>()?;
        let beside = |values: &[f64], digits: usize| match values {
            [ours, theirs] => format!("{ours:.digits$} | {theirs:.digits$} | {:.2}", ours / theirs),
            values => format!("{:.digits$} | – | –", values[0]),
        };
        println!("| {} | {} | {} |", work.name(), beside(&ms, 1), beside(&mb, 0));
    }
    Ok(())
}

fn torch(python: &str, work: &Work) -> Result<Worker, Box<dyn Error>> {
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/examples/net_cost/main.py");
    Worker::start(Command::new(python).args([script, &rayon::current_num_threads().to_string()]), work)
}

/// Answers questions about one piece of work.
fn work() -> Result<(), Box<dyn Error>> {
    let before = peak_rss_mib().unwrap_or(0.0);
    let mut lines = std::io::stdin().lock().lines();
    let work: Work = serde_json::from_str(&lines.next().ok_or("expected the work as JSON")??)?;
    let mut step = work.step()?;
    for line in lines {
        let answer = if line? == "memory" {
            peak_rss_mib().unwrap_or(0.0) - before
        } else {
            let began = Instant::now();
            step();
            began.elapsed().as_secs_f64() * 1e3
        };
        let mut out = std::io::stdout();
        writeln!(out, "{answer}")?;
        out.flush()?;
    }
    Ok(())
}
