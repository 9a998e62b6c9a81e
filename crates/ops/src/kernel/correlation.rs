//! Cost volume on the CPU: forward and both gradients.

use rayon::prelude::*;

use super::vectorise::vectorised;

const LANES: usize = 8;

/// Sizes of a cost volume.
#[derive(Clone, Copy, Debug)]
pub struct Sizes {
    /// Images.
    pub n: usize,
    /// Feature channels.
    pub c: usize,
    /// Rows.
    pub h: usize,
    /// Columns.
    pub w: usize,
    /// Largest displacement in pixels.
    pub radius: usize,
}

impl Sizes {
    fn side(&self) -> usize {
        2 * self.radius + 1
    }
}

/// Planes with a zero border of `radius` and room for one vector to read past a row's end.
struct Padded {
    data: Vec<f32>,
    plane: usize,
    row: usize,
}

fn pad(x: &[f32], s: &Sizes) -> Padded {
    let row = s.w + 2 * s.radius + LANES;
    let plane = (s.h + 2 * s.radius) * row;
    let planes = x.len() / (s.h * s.w);
    let mut data = vec![0.0f32; planes * plane];
    data.par_chunks_mut(plane).zip(x.par_chunks(s.h * s.w)).for_each(|(to, from)| {
        for y in 0..s.h {
            to[(y + s.radius) * row + s.radius..][..s.w].copy_from_slice(&from[y * s.w..][..s.w]);
        }
    });
    Padded { data, plane, row }
}

#[inline(always)]
fn lanes(data: &[f32], start: usize) -> &[f32; LANES] {
    data[start..start + LANES].try_into().expect("lanes")
}

/// `[N, C, H, W]` twice → `[N, side², H, W]`
pub fn forward(a: &[f32], b: &[f32], s: &Sizes) -> Vec<f32> {
    let (side, area, scale) = (s.side(), s.h * s.w, 1.0 / s.c as f32);
    let (pa, pb) = (pad(a, s), pad(b, s));
    let rows: Vec<Vec<f32>> = (0..s.n * s.h)
        .into_par_iter()
        .map(|i| {
            let (n, y) = (i / s.h, i % s.h);
            let mut out = vec![0.0f32; side * side * s.w];
            let mut acc = vec![[0.0f32; LANES]; side];
            vectorised(|| {
                for dy in 0..side {
                    for x in (0..s.w).step_by(LANES) {
                        acc.fill([0.0; LANES]);
                        for c in 0..s.c {
                            let plane = (n * s.c + c) * pa.plane;
                            let va = lanes(&pa.data, plane + (y + s.radius) * pa.row + s.radius + x);
                            let from = plane + (y + dy) * pb.row + x;
                            for (dx, acc) in acc.iter_mut().enumerate() {
                                let vb = lanes(&pb.data, from + dx);
                                for l in 0..LANES {
                                    acc[l] += va[l] * vb[l];
                                }
                            }
                        }
                        let count = LANES.min(s.w - x);
                        for (dx, acc) in acc.iter().enumerate() {
                            let to = &mut out[(dy * side + dx) * s.w + x..][..count];
                            to.iter_mut().zip(acc).for_each(|(t, v)| *t = v * scale);
                        }
                    }
                }
            });
            out
        })
        .collect();
    let mut out = vec![0.0f32; s.n * side * side * area];
    out.par_chunks_mut(area).enumerate().for_each(|(i, plane)| {
        let (n, d) = (i / (side * side), i % (side * side));
        for y in 0..s.h {
            plane[y * s.w..][..s.w].copy_from_slice(&rows[n * s.h + y][d * s.w..][..s.w]);
        }
    });
    out
}

/// Gradients of both inputs from `gradient [N, side², H, W]`.
pub fn backward(a: &[f32], b: &[f32], gradient: &[f32], s: &Sizes) -> (Vec<f32>, Vec<f32>) {
    let (pa, pb, pg) = (pad(a, s), pad(b, s), pad(gradient, s));
    // a's pixel p meets b at p + d under gradient p; b's pixel q meets a at q − d under gradient q − d.
    (gather(&pg, &pb, s, false), gather(&pg, &pa, s, true))
}

/// `out[n, c, q] = 1/C Σ_d gradient[n, d, q − shift] · other[n, c, q ± d]`
fn gather(gradient: &Padded, other: &Padded, s: &Sizes, reversed: bool) -> Vec<f32> {
    /// Channels that share one load of the gradient.
    const CHANNELS: usize = 4;
    let (side, r, scale) = (s.side(), s.radius, 1.0 / s.c as f32);
    let groups = s.c.div_ceil(CHANNELS);
    let tiles: Vec<Vec<f32>> = (0..s.n * groups)
        .into_par_iter()
        .map(|i| {
            let (n, first) = (i / groups, i % groups * CHANNELS);
            let count = CHANNELS.min(s.c - first);
            let mut out = vec![0.0f32; count * s.h * s.w];
            vectorised(|| {
                for y in 0..s.h {
                    for x in (0..s.w).step_by(LANES) {
                        let mut acc = [[0.0f32; LANES]; CHANNELS];
                        for d in 0..side * side {
                            let (dy, dx) = if reversed { (2 * r - d / side, 2 * r - d % side) } else { (d / side, d % side) };
                            let at = if reversed { (y + dy, x + dx) } else { (y + r, x + r) };
                            let g = lanes(&gradient.data, (n * side * side + d) * gradient.plane + at.0 * gradient.row + at.1);
                            let from = (y + dy) * other.row + x + dx;
                            for (c, acc) in acc.iter_mut().enumerate() {
                                let v = lanes(&other.data, (n * s.c + first + c.min(count - 1)) * other.plane + from);
                                for l in 0..LANES {
                                    acc[l] += g[l] * v[l];
                                }
                            }
                        }
                        let width = LANES.min(s.w - x);
                        for (c, acc) in acc[..count].iter().enumerate() {
                            let to = &mut out[(c * s.h + y) * s.w + x..][..width];
                            to.iter_mut().zip(acc).for_each(|(t, v)| *t = v * scale);
                        }
                    }
                }
            });
            out
        })
        .collect();
    tiles.concat()
}
