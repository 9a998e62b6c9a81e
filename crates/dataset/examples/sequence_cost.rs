//! Prints what a synthetic video costs, beside what the machine can do:
//! `cargo run -p dataset --example sequence_cost`.
//!
//! One video is 141 frames of 256², the exact flow from its first frame to every other, and 20 sets of target maps, from a
//! material of 4096² texels. Then frames, resolution and material grow fourfold, one at a time. The second table has what each
//! option of the sensor adds to a frame, the third what the steps of the main job are given.

use std::sync::Arc;
use std::time::Instant;

use dataset::exemplar::{Exemplar, ExemplarConfig};
use dataset::material::{Material, MaterialInfo, Precision};
use dataset::pair::{FlowPair, PairConfig};
use dataset::path::PathConfig;
use dataset::sequence::sensor::SensorConfig;
use dataset::sequence::{Sequence, SequenceConfig};
use dataset::stream::Stream;
use ops::kernel::peak::Peak;
use ops::process::peak_rss_mib;
use render::direction::unit;
use render::texel::Texel;

/// Times of one video in seconds.
#[derive(Clone, Copy)]
struct Cost {
    frames: f64,
    flow: f64,
    targets: f64,
}

impl Cost {
    fn total(&self) -> f64 {
        self.frames + self.flow + self.targets
    }
}

/// Videos per row; the middle one is printed.
const ROUNDS: usize = 5;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    println!("{}\n", Peak::measure());
    println!("| material | frames | side | material MB | frames s | flow s | targets s | all s | frames/s | most memory MiB |");
    println!("|---|---|---|---|---|---|---|---|---|---|");
    for (texels, rate, side) in [(4096, 1.0, 256), (1024, 1.0, 256), (4096, 4.0, 256), (4096, 1.0, 512)] {
        let material = material(texels)?;
        let path = PathConfig { frame_rate: rate, ..PathConfig::default() };
        let video = video(&material, SequenceConfig { path, ..SequenceConfig::svbrdf() });
        let mut costs: Vec<Cost> = (0..ROUNDS).map(|_| cost(&video, side)).collect();
        costs.sort_by(|a, b| a.total().total_cmp(&b.total()));
        let Cost { frames, flow, targets } = costs[ROUNDS / 2];
        let (all, count) = (frames + flow + targets, video.len());
        println!(
            "| {texels}² | {count} | {side}² | {} | {frames:.2} | {flow:.2} | {targets:.2} | {all:.2} | {:.0} | {} |",
            material.bytes() / 1_000_000,
            count as f64 / all,
            peak_rss_mib().unwrap_or(f64::NAN) as usize
        );
    }
    sensor_options()?;
    training_items()
}

/// Milliseconds per frame of 256² from a material of 1024² texels, the options timed in turn.
fn sensor_options() -> Result<(), Box<dyn std::error::Error>> {
    const OPTIONS: [&str; 8] = [
        "",
        "vignetting = {}",
        "exposure = {}",
        "white_balance = {}",
        "motion_blur = {}",
        "distortion = {}",
        "rolling_shutter = {}",
        "compression = {}",
    ];
    let parsed: Result<Vec<SensorConfig>, _> = OPTIONS.iter().map(|text| toml::from_str(text)).collect();
    let material = material(1024)?;
    let videos: Vec<Sequence> = parsed?
        .into_iter()
        .chain([SensorConfig::phone()])
        .map(|sensor| video(&material, SequenceConfig { sensor, ..SequenceConfig::svbrdf() }))
        .collect();
    let mut times = vec![vec![]; videos.len()];
    for _ in 0..ROUNDS {
        for (video, times) in videos.iter().zip(&mut times) {
            times.push(seconds(|| (0..video.len()).for_each(|i| drop(video.frame(i, 256)))));
        }
    }
    let per_frame = times.iter_mut().zip(&videos).map(|(times, video)| {
        times.sort_by(f64::total_cmp);
        1e3 * times[ROUNDS / 2] / video.len() as f64
    });
    println!("\n| sensor | ms per frame |");
    println!("|---|---|");
    for (name, milliseconds) in OPTIONS.into_iter().chain(["all of them"]).zip(per_frame) {
        let name = if name.is_empty() { "ideal" } else { name.trim_end_matches(" = {}") };
        println!("| {name} | {milliseconds:.2} |");
    }
    Ok(())
}

/// Milliseconds per pair and exemplar as `configs/spiral.toml` has them, made one after the other.
fn training_items() -> Result<(), Box<dyn std::error::Error>> {
    const COUNT: usize = 60;
    let (material, streams) = (material(1024)?, Stream::new(3));
    let phone = |config: SequenceConfig| video(&material, SequenceConfig { sensor: SensorConfig::phone(), ..config });
    let (flow, svbrdf) = (phone(SequenceConfig::flow()), phone(SequenceConfig::svbrdf()));
    let pairs = |crop: usize| PairConfig { resolution: 256, crop, augment: true };
    let exemplars = ExemplarConfig { resolution: 128, key_frames: [3, 9], ..ExemplarConfig::default() };
    println!("\n| item | ms |");
    println!("|---|---|");
    let row = |name: &str, make: &dyn Fn(usize)| {
        println!("| {name} | {:.1} |", 1e3 * seconds(|| (0..COUNT).for_each(make)) / COUNT as f64);
    };
    row("pair of neighbours, 192²", &|i| {
        drop(FlowPair::adjacent(&flow, 2 * i, &pairs(192), &mut streams.rng("near", i as u64)))
    });
    row("pair of far frames, 128²", &|i| drop(FlowPair::distant(&flow, &pairs(128), &mut streams.rng("far", i as u64))));
    row("exemplar, 4 to 10 frames of 128²", &|i| {
        drop(Exemplar::draw(&svbrdf, i % 20, &exemplars, &mut streams.rng("exemplar", i as u64)));
    });
    Ok(())
}

/// As many frames as the path has; videos are drawn as in training.
fn video(material: &Arc<Material>, config: SequenceConfig) -> Sequence {
    Sequence::new(Arc::clone(material), &config, &Stream::new(7), 1)
}

fn seconds(work: impl FnOnce()) -> f64 {
    let began = Instant::now();
    work();
    began.elapsed().as_secs_f64()
}

fn cost(video: &Sequence, side: usize) -> Cost {
    Cost {
        frames: seconds(|| (0..video.len()).for_each(|i| drop(video.frame(i, side)))),
        flow: seconds(|| (1..video.len()).for_each(|i| drop(video.flow(0, i, side)))),
        targets: seconds(|| (0..20).for_each(|i| drop(video.target_maps(i, side)))),
    }
}

/// Waves in every map, so that no texel is like its neighbour.
fn material(size: usize) -> Result<Arc<Material>, Box<dyn std::error::Error>> {
    let info = MaterialInfo::made_up("waves");
    let texel = |x: usize, y: usize| {
        let wave = |a: usize, b: usize| ((a * x + b * y) % size) as f32 / size as f32;
        Texel {
            normal: unit([wave(37, 11) - 0.5, wave(13, 29) - 0.5, 1.0]),
            diffuse: [wave(17, 3), wave(5, 23), wave(41, 2)],
            roughness: 0.2 + 0.6 * wave(7, 19),
            specular: [0.04 + 0.3 * wave(3, 31), 0.05, 0.06],
        }
    };
    Ok(Arc::new(Material::build(info, size, size, Precision::Eight, texel)?))
}
