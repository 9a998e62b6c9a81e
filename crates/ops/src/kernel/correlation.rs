//! Cost volume on the CPU: forward and both gradients.

use rayon::prelude::*;

use super::vectorise::vectorised;

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

/// Planes with a zero border of `radius`.
struct Padded {
    data: Vec<f32>,
    plane: usize,
    row: usize,
    width: usize,
}

impl Padded {
    fn new(x: &[f32], s: &Sizes) -> Self {
        let row = s.w + 2 * s.radius;
        let plane = (s.h + 2 * s.radius) * row;
        let mut data = vec![0.0f32; x.len() / (s.h * s.w) * plane];
        data.par_chunks_mut(plane).zip(x.par_chunks(s.h * s.w)).for_each(|(to, from)| {
            for y in 0..s.h {
                to[(y + s.radius) * row + s.radius..][..s.w].copy_from_slice(&from[y * s.w..][..s.w]);
            }
        });
        Self { data, plane, row, width: s.w }
    }

    /// A row of the plane's own width that begins (`y`, `x`) from the border's corner.
    #[inline(always)]
    fn row(&self, plane: usize, y: usize, x: usize) -> &[f32] {
        &self.data[plane * self.plane + y * self.row + x..][..self.width]
    }
}

/// Sets a row to `scale` times the sum of `count` products of two rows.
#[inline(always)]
fn sum_products<'a>(to: &mut [f32], count: usize, scale: f32, pair: impl Fn(usize) -> [&'a [f32]; 2]) {
    let width = to.len();
    let pair = |i: usize| pair(i).map(|row| &row[..width]);
    to.fill(0.0);
    // Four at a time, so that the row of sums is loaded and stored less often.
    for i in (0..count / 4 * 4).step_by(4) {
        let [[a, b], [c, d], [e, f], [g, h]] = [pair(i), pair(i + 1), pair(i + 2), pair(i + 3)];
        for x in 0..width {
            to[x] += (a[x] * b[x] + c[x] * d[x]) + (e[x] * f[x] + g[x] * h[x]);
        }
    }
    for i in count / 4 * 4..count {
        let [a, b] = pair(i);
        for x in 0..width {
            to[x] += a[x] * b[x];
        }
    }
    to.iter_mut().for_each(|to| *to *= scale);
}

/// Fills planes of `area` numbers row by row: `sum(plane, y, row)`.
fn fill(out: &mut [f32], s: &Sizes, sum: impl Fn(usize, usize, &mut [f32]) + Sync) {
    out.par_chunks_mut(s.h * s.w).enumerate().for_each(|(plane, to)| {
        vectorised(
            #[inline(always)]
            || to.chunks_exact_mut(s.w).enumerate().for_each(|(y, row)| sum(plane, y, row)),
        );
    });
}

/// `[N, C, H, W]` twice → `[N, side², H, W]`
pub fn forward(a: &[f32], b: &[f32], s: &Sizes) -> Vec<f32> {
    let (side, r) = (s.side(), s.radius);
    let (a, b) = (Padded::new(a, s), Padded::new(b, s));
    let mut out = vec![0.0f32; s.n * side * side * s.h * s.w];
    fill(
        &mut out,
        s,
        #[inline(always)]
        |plane, y, row| {
            let (n, dy, dx) = (plane / (side * side), plane / side % side, plane % side);
            let first = n * s.c;
            sum_products(row, s.c, 1.0 / s.c as f32, |c| [a.row(first + c, y + r, r), b.row(first + c, y + dy, dx)]);
        },
    );
    out
}

/// Gradients of both inputs from `gradient [N, side², H, W]`.
pub fn backward(a: &[f32], b: &[f32], gradient: &[f32], s: &Sizes) -> (Vec<f32>, Vec<f32>) {
    let (side, r) = (s.side(), s.radius);
    let (volume, scale) = (side * side, 1.0 / s.c as f32);
    let (pa, pb, g) = (Padded::new(a, s), Padded::new(b, s), Padded::new(gradient, s));
    let (mut ga, mut gb) = (vec![0.0f32; a.len()], vec![0.0f32; b.len()]);
    // a's pixel p meets b at p + d under gradient p.
    fill(
        &mut ga,
        s,
        #[inline(always)]
        |plane, y, row| {
            let first = plane / s.c * volume;
            sum_products(row, volume, scale, |d| [g.row(first + d, y + r, r), pb.row(plane, y + d / side, d % side)]);
        },
    );
    // b's pixel q meets a at q − d under gradient q − d.
    fill(
        &mut gb,
        s,
        #[inline(always)]
        |plane, y, row| {
            let first = plane / s.c * volume;
            sum_products(row, volume, scale, |d| {
                let (y, x) = (y + 2 * r - d / side, 2 * r - d % side);
                [g.row(first + d, y, x), pa.row(plane, y, x)]
            });
        },
    );
    (ga, gb)
}
