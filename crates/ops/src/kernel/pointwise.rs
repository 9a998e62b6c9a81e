//! Bias and leaky ReLU in one pass; filters of one norm in two.

use std::mem::MaybeUninit;

use rayon::prelude::*;

use super::rows::filled;
use super::vectorise::vectorised;

/// `leaky(x + bias)` plane by plane.
///
/// # Shapes
/// `x` holds planes of `area` pixels; plane `i` takes `bias[i % bias.len()]` (`[N·C]` or `[C]` values).
pub fn bias_leaky(x: &[f32], bias: &[f32], area: usize, slope: f32) -> Vec<f32> {
    let fill = |out: &mut [MaybeUninit<f32>]| {
        let planes = out.par_chunks_mut(area).zip(x.par_chunks(area)).enumerate().with_min_len(min_planes(area));
        planes.for_each(|(i, (to, from))| {
            let b = bias[i % bias.len()];
            vectorised(|| {
                for (t, &f) in to.iter_mut().zip(from) {
                    let v = f + b;
                    t.write(v.max(0.0) + slope * v.min(0.0));
                }
            });
        });
    };
    // SAFETY: every pixel has a source.
    unsafe { filled(x.len(), fill) }
}

/// Gradient of the input from the output's signs.
pub fn leaky_backward(output: &[f32], gradient: &[f32], slope: f32) -> Vec<f32> {
    const CHUNK: usize = 1 << 14;
    assert_eq!(output.len(), gradient.len());
    let fill = |out: &mut [MaybeUninit<f32>]| {
        out.par_chunks_mut(CHUNK).zip(output.par_chunks(CHUNK)).zip(gradient.par_chunks(CHUNK)).for_each(|((to, y), g)| {
            vectorised(|| {
                for ((t, &y), &g) in to.iter_mut().zip(y).zip(g) {
                    t.write(if y > 0.0 { g } else { slope * g });
                }
            });
        });
    };
    // SAFETY: every pixel has a source.
    unsafe { filled(gradient.len(), fill) }
}

/// The sum of each plane of `area` pixels.
pub fn plane_sums(x: &[f32], area: usize) -> Vec<f32> {
    let sum = |plane| vectorised(|| sum(plane, plane, |v, _| v));
    x.par_chunks(area).with_min_len(min_planes(area)).map(sum).collect()
}

/// `Σ term(a, b)` in 32 interleaved partial sums.
#[inline(always)]
fn sum(a: &[f32], b: &[f32], term: impl Fn(f32, f32) -> f32) -> f32 {
    let mut lanes = [0.0f32; 32];
    let (whole_a, whole_b) = (a.chunks_exact(32), b.chunks_exact(32));
    let rest: f32 = whole_a.remainder().iter().zip(whole_b.remainder()).map(|(&a, &b)| term(a, b)).sum();
    for (a, b) in whole_a.zip(whole_b) {
        for l in 0..32 {
            lanes[l] += term(a[l], b[l]);
        }
    }
    lanes.iter().sum::<f32>() + rest
}

/// Filters of `length` weights, each `gain · w / √(Σ w² + epsilon)`.
pub fn normalised(w: &[f32], length: usize, gain: f32, epsilon: f32) -> Vec<f32> {
    let fill = |out: &mut [MaybeUninit<f32>]| {
        out.par_chunks_mut(length).zip(w.par_chunks(length)).for_each(|(to, w)| {
            vectorised(|| {
                let scale = gain / (sum(w, w, |a, b| a * b) + epsilon).sqrt();
                to.iter_mut().zip(w).for_each(|(to, w)| {
                    to.write(scale * w);
                });
            });
        });
    };
    // SAFETY: every weight has a source.
    unsafe { filled(w.len(), fill) }
}

/// The gradient of [`normalised`]'s weights: what is left of the results' gradient across each filter.
pub fn normalised_backward(w: &[f32], gradient: &[f32], length: usize, gain: f32, epsilon: f32) -> Vec<f32> {
    assert_eq!(w.len(), gradient.len());
    let fill = |out: &mut [MaybeUninit<f32>]| {
        let filters = out.par_chunks_mut(length).zip(w.par_chunks(length)).zip(gradient.par_chunks(length));
        filters.for_each(|((to, w), g)| {
            vectorised(|| {
                let square = sum(w, w, |a, b| a * b) + epsilon;
                let (scale, along) = (gain / square.sqrt(), sum(w, g, |a, b| a * b) / square);
                for ((to, w), g) in to.iter_mut().zip(w).zip(g) {
                    to.write(scale * (g - along * w));
                }
            });
        });
    };
    // SAFETY: every weight has a source.
    unsafe { filled(w.len(), fill) }
}

fn min_planes(area: usize) -> usize {
    (1 << 14) / area.max(1) + 1
}
