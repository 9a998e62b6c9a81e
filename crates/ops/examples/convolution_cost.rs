//! Prints what each pass of typical convolutions reaches of the machine's peak: `cargo run -p ops --example convolution_cost`.
//!
//! Operations are those of the convolution as it is written (two per kernel tap, input and output pixel); an enlarging one does
//! with 4/9 of them, so that it may stand above the peak.

use std::time::Instant;

use ops::conv::{Conv3x3, Padding};
use ops::kernel::conv::{Sizes, backward_input, backward_weight, forward};
use ops::kernel::peak::Peak;
use ops::process::keep_memory;

const ROUNDS: usize = 8;

fn main() {
    keep_memory();
    let peak = Peak::measure();
    println!("{peak}\n\nGFLOP/s, and percent of the peak\n");
    println!("| convolution | forward | gradient of the input | gradient of the weights |\n|---|---|---|---|");
    let same = Conv3x3::same(Padding::Edge);
    let zero = Conv3x3::same(Padding::Zero);
    for (name, geometry, n, inputs, outputs, side) in [
        ("decoder, last block, width 64", Conv3x3::enlarging(Padding::Edge), 5, 128, 64, 128),
        ("decoder, refined, width 64", same, 5, 64, 64, 256),
        ("decoder, 32², width 64", same, 5, 512, 512, 32),
        ("encoder, halving, width 64", Conv3x3::halving(Padding::Edge), 5, 64, 128, 128),
        ("encoder, first, width 64", Conv3x3::halving(Padding::Edge), 5, 5, 64, 256),
        ("innermost, 4², width 64", same, 5, 512, 512, 4),
        ("decoder, last block, width 16", Conv3x3::enlarging(Padding::Edge), 5, 32, 16, 128),
        ("decoder, refined, width 16", same, 5, 16, 16, 256),
        ("head, last, width 16", same, 1, 16, 9, 256),
        ("flow estimator, 64²", zero, 1, 147, 128, 64),
        ("context, dilation 16, 64²", Conv3x3 { dilation: 16, ..zero }, 1, 96, 64, 64),
    ] {
        let s = Sizes { n, inputs, outputs, h: side, w: side, geometry };
        let area = geometry.output(side).pow(2);
        let (x, w) = (wave(n * inputs * side * side), wave(outputs * inputs * 9));
        let gradient = wave(n * outputs * area);
        let operations = (2 * 9 * n * inputs * outputs * area) as f64;
        let cell = |pass: &dyn Fn() -> Vec<f32>| {
            let gflops = operations / fastest(pass) * 1e-9;
            format!("{gflops:.0} ({:.0} %)", 100.0 * gflops / peak.gflops)
        };
        println!(
            "| {name}: {n}×{inputs}→{outputs}, {side}² | {} | {} | {} |",
            cell(&|| forward(&x, &w, &s)),
            cell(&|| backward_input(&gradient, &w, &s)),
            cell(&|| backward_weight(&x, &gradient, &s)),
        );
    }
}

fn wave(count: usize) -> Vec<f32> {
    (0..count).map(|i| ((i % 9973) as f32 * 0.31).sin()).collect()
}

/// Seconds of the fastest of some passes: the others were disturbed, and the peak is measured in the same way.
fn fastest(pass: &dyn Fn() -> Vec<f32>) -> f64 {
    let seconds = || {
        let began = Instant::now();
        drop(std::hint::black_box(pass()));
        began.elapsed().as_secs_f64()
    };
    (0..ROUNDS).map(|_| seconds()).fold(f64::INFINITY, f64::min)
}
