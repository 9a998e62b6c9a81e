//! Bilinear warping and the masked maximum over warped frames on the CPU.

use rayon::prelude::*;

/// Sizes of a warp: `n` images of `c` channels, `h × w` pixels.
#[derive(Clone, Copy, Debug)]
pub struct Sizes {
    /// Images.
    pub n: usize,
    /// Channels.
    pub c: usize,
    /// Rows.
    pub h: usize,
    /// Columns.
    pub w: usize,
}

/// Upper-left tap and fractions of one sample; `index == OUTSIDE` marks an invalid pixel.
#[derive(Clone, Copy)]
struct Tap {
    index: u32,
    fx: f32,
    fy: f32,
}

const OUTSIDE: u32 = u32::MAX;

/// The taps of every pixel, and the steps to the right and lower tap.
struct TapField {
    taps: Vec<Tap>,
    right: usize,
    down: usize,
}

fn tap_field(flow: &[f32], s: &Sizes) -> TapField {
    let area = s.h * s.w;
    let mut taps = vec![Tap { index: OUTSIDE, fx: 0.0, fy: 0.0 }; s.n * area];
    taps.par_chunks_mut(s.w).enumerate().for_each(|(row, taps)| {
        let (n, y) = (row / s.h, row % s.h);
        let at = 2 * n * area + y * s.w;
        for (x, tap) in taps.iter_mut().enumerate() {
            let (px, py) = (x as f32 + flow[at + x], y as f32 + flow[at + area + x]);
            // Written so that NaN is outside.
            if px >= 0.0 && py >= 0.0 && px <= (s.w - 1) as f32 && py <= (s.h - 1) as f32 {
                let (x0, y0) = ((px as usize).min(s.w.saturating_sub(2)), (py as usize).min(s.h.saturating_sub(2)));
                *tap = Tap { index: (y0 * s.w + x0) as u32, fx: px - x0 as f32, fy: py - y0 as f32 };
            }
        }
    });
    TapField { taps, right: usize::from(s.w > 1), down: if s.h > 1 { s.w } else { 0 } }
}

impl TapField {
    #[inline(always)]
    fn sample(&self, plane: &[f32], tap: Tap) -> f32 {
        let i = tap.index as usize;
        let (a, b) = (plane[i], plane[i + self.right]);
        let (c, d) = (plane[i + self.down], plane[i + self.down + self.right]);
        let (top, bottom) = (a + tap.fx * (b - a), c + tap.fx * (d - c));
        top + tap.fy * (bottom - top)
    }

    #[inline(always)]
    fn scatter(&self, plane: &mut [f32], tap: Tap, g: f32) {
        let i = tap.index as usize;
        let (gx, gy) = (g * tap.fx, g * tap.fy);
        let both = gx * tap.fy;
        plane[i] += g - gx - gy + both;
        plane[i + self.right] += gx - both;
        plane[i + self.down] += gy - both;
        plane[i + self.down + self.right] += both;
    }
}

/// Values `[N, C, H, W]` at the flow's source positions; invalid pixels are 0.
pub fn warp(x: &[f32], flow: &[f32], s: &Sizes) -> Vec<f32> {
    let (area, field) = (s.h * s.w, tap_field(flow, s));
    let mut out = vec![0.0f32; x.len()];
    out.par_chunks_mut(area).zip(x.par_chunks(area)).enumerate().for_each(|(i, (to, from))| {
        let taps = &field.taps[i / s.c * area..][..area];
        for (t, &tap) in to.iter_mut().zip(taps) {
            if tap.index != OUTSIDE {
                *t = field.sample(from, tap);
            }
        }
    });
    out
}

/// Which pixels of [`warp`] are valid: `[N, 1, H, W]` of 1 and 0.
pub fn valid(flow: &[f32], s: &Sizes) -> Vec<f32> {
    tap_field(flow, s).taps.iter().map(|t| f32::from(t.index != OUTSIDE)).collect()
}

/// Gradients of features and flow from `gradient [N, C, H, W]`.
pub fn warp_backward(x: &[f32], flow: &[f32], gradient: &[f32], s: &Sizes) -> (Vec<f32>, Vec<f32>) {
    let (area, field) = (s.h * s.w, tap_field(flow, s));
    let mut gx = vec![0.0f32; x.len()];
    gx.par_chunks_mut(area).zip(gradient.par_chunks(area)).enumerate().for_each(|(i, (to, g))| {
        let taps = &field.taps[i / s.c * area..][..area];
        for (&tap, &g) in taps.iter().zip(g) {
            if tap.index != OUTSIDE {
                field.scatter(to, tap, g);
            }
        }
    });
    let mut gflow = vec![0.0f32; flow.len()];
    gflow.par_chunks_mut(2 * area).enumerate().for_each(|(n, gflow)| {
        let (to_x, to_y) = gflow.split_at_mut(area);
        for c in n * s.c..(n + 1) * s.c {
            let (plane, g) = (&x[c * area..][..area], &gradient[c * area..][..area]);
            for (p, &tap) in field.taps[n * area..][..area].iter().enumerate() {
                if tap.index == OUTSIDE {
                    continue;
                }
                let i = tap.index as usize;
                let (a, b) = (plane[i], plane[i + field.right]);
                let (c, d) = (plane[i + field.down], plane[i + field.down + field.right]);
                to_x[p] += g[p] * ((b - a) + tap.fy * ((d - c) - (b - a)));
                to_y[p] += g[p] * ((c - a) + tap.fx * ((d - b) - (c - a)));
            }
        }
    });
    (gx, gflow)
}

/// Maximum over the guidance features `[1, C, H, W]` and all valid warped features `[K, C, H, W]` (`s.n = K`).
pub fn warp_max(guidance: &[f32], x: &[f32], flow: &[f32], s: &Sizes) -> Vec<f32> {
    let (area, field) = (s.h * s.w, tap_field(flow, s));
    let mut out = guidance.to_vec();
    out.par_chunks_mut(area).enumerate().for_each(|(c, best)| {
        for k in 0..s.n {
            let plane = &x[(k * s.c + c) * area..][..area];
            for (b, &tap) in best.iter_mut().zip(&field.taps[k * area..][..area]) {
                if tap.index != OUTSIDE {
                    *b = b.max(field.sample(plane, tap));
                }
            }
        }
    });
    out
}

/// Gradients of guidance and key-frame features: each pixel's gradient goes to the first frame that holds the maximum.
pub fn warp_max_backward(guidance: &[f32], x: &[f32], flow: &[f32], gradient: &[f32], s: &Sizes) -> (Vec<f32>, Vec<f32>) {
    let (area, field) = (s.h * s.w, tap_field(flow, s));
    let mut to_guidance = gradient.to_vec();
    // The frame that holds the maximum, counted from 1; 0 is the guidance frame.
    let mut winners = vec![0u16; s.c * area];
    winners.par_chunks_mut(area).zip(to_guidance.par_chunks_mut(area)).enumerate().for_each(|(c, (winners, to_guidance))| {
        let mut best = guidance[c * area..][..area].to_vec();
        for k in 0..s.n {
            let (plane, taps) = (&x[(k * s.c + c) * area..][..area], &field.taps[k * area..][..area]);
            for ((best, winner), &tap) in best.iter_mut().zip(winners.iter_mut()).zip(taps) {
                if tap.index != OUTSIDE {
                    let value = field.sample(plane, tap);
                    if value > *best {
                        (*best, *winner) = (value, k as u16 + 1);
                    }
                }
            }
        }
        to_guidance.iter_mut().zip(winners).filter(|(_, winner)| **winner > 0).for_each(|(to, _)| *to = 0.0);
    });
    let mut to_frames = vec![0.0f32; x.len()];
    to_frames.par_chunks_mut(area).enumerate().for_each(|(i, to)| {
        let (k, c) = (i / s.c, i % s.c);
        let (taps, winners) = (&field.taps[k * area..][..area], &winners[c * area..][..area]);
        for ((&tap, &winner), &g) in taps.iter().zip(winners).zip(&gradient[c * area..][..area]) {
            if usize::from(winner) == k + 1 {
                field.scatter(to, tap, g);
            }
        }
    });
    (to_guidance, to_frames)
}
