//! Bias and leaky ReLU in one pass.

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

/// The sum of each plane of `area` pixels, in eight interleaved partial sums.
pub fn plane_sums(x: &[f32], area: usize) -> Vec<f32> {
    x.par_chunks(area)
        .with_min_len(min_planes(area))
        .map(|plane| {
            let mut lanes = [0.0f32; 8];
            vectorised(|| {
                let whole = plane.chunks_exact(8);
                let rest: f32 = whole.remainder().iter().sum();
                for chunk in whole {
                    for l in 0..8 {
                        lanes[l] += chunk[l];
                    }
                }
                lanes.iter().sum::<f32>() + rest
            })
        })
        .collect()
}

fn min_planes(area: usize) -> usize {
    (1 << 14) / area.max(1) + 1
}
