//! Bilinear warping and the masked maximum over warped frames on the CPU.
//!
//! The maximum turns eight channels at a time into vectors, one for each pixel: a pixel's taps are found once for all
//! channels and read as whole vectors. Which frame won is kept, so that its gradient needn't sample again.

use std::mem::MaybeUninit;
use std::ops::Range;

use rayon::prelude::*;

use super::bands::bands;
use super::rows::filled;
use super::vectorise::vectorised;

/// Channels that are sampled together.
const LANES: usize = 8;
/// What [`LANES`] channels have at one pixel.
type Lanes = [f32; LANES];
/// Rows of a task: so few that what it reads and writes stays in the second-level cache.
const BAND: usize = 32;

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
    /// The source rows that the taps of each row read.
    reach: Vec<Range<usize>>,
    right: usize,
    down: usize,
}

fn tap_field(flow: &[f32], s: &Sizes) -> TapField {
    let area = s.h * s.w;
    let mut taps = vec![Tap { index: OUTSIDE, fx: 0.0, fy: 0.0 }; s.n * area];
    let reach = taps.par_chunks_mut(s.w).enumerate().with_min_len(8).map(|(row, taps)| {
        let (n, y) = (row / s.h, row % s.h);
        let (mut top, mut bottom) = (usize::MAX, 0);
        let at = 2 * n * area + y * s.w;
        for (x, tap) in taps.iter_mut().enumerate() {
            let (px, py) = (x as f32 + flow[at + x], y as f32 + flow[at + area + x]);
            // Written so that NaN is outside.
            if px >= 0.0 && py >= 0.0 && px <= (s.w - 1) as f32 && py <= (s.h - 1) as f32 {
                let (x0, y0) = ((px as usize).min(s.w.saturating_sub(2)), (py as usize).min(s.h.saturating_sub(2)));
                *tap = Tap { index: (y0 * s.w + x0) as u32, fx: px - x0 as f32, fy: py - y0 as f32 };
                (top, bottom) = (top.min(y0), bottom.max((y0 + 2).min(s.h)));
            }
        }
        top.min(bottom)..bottom
    });
    let reach = reach.collect();
    TapField { taps, reach, right: usize::from(s.w > 1), down: if s.h > 1 { s.w } else { 0 } }
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

    /// The source rows that frame `k`'s taps read in some rows.
    fn reach(&self, k: usize, rows: &Range<usize>, s: &Sizes) -> Range<usize> {
        let reach = self.reach[k * s.h..][rows.clone()].iter().filter(|reach| !reach.is_empty());
        reach.cloned().reduce(|a, b| a.start.min(b.start)..a.end.max(b.end)).unwrap_or(0..0)
    }

    /// Replaces the best values of all pixels, and who holds them, where the source's are larger.
    #[inline(always)]
    fn compete(&self, source: &Interleaved, taps: &[Tap], name: u32, best: &mut [Lanes], holders: &mut [[u32; LANES]]) {
        for ((best, holders), tap) in best.iter_mut().zip(holders).zip(taps).filter(|(_, tap)| tap.index != OUTSIDE) {
            let i = tap.index as usize - source.start;
            let row = &source.pixels[i..];
            let (a, b, c, d) = (row[0], row[self.right], row[self.down], row[self.down + self.right]);
            let old = *best;
            // Whole arrays, one after the other, become whole vectors.
            let top: Lanes = std::array::from_fn(|l| a[l] + tap.fx * (b[l] - a[l]));
            let bottom: Lanes = std::array::from_fn(|l| c[l] + tap.fx * (d[l] - c[l]));
            let value: Lanes = std::array::from_fn(|l| top[l] + tap.fy * (bottom[l] - top[l]));
            *best = std::array::from_fn(|l| if value[l] > old[l] { value[l] } else { old[l] });
            let held = *holders;
            *holders = std::array::from_fn(|l| if value[l] > old[l] { name } else { held[l] });
        }
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

/// The same rows of up to [`LANES`] planes, pixel by pixel.
#[derive(Default)]
struct Interleaved {
    pixels: Vec<Lanes>,
    start: usize,
}

impl Interleaved {
    fn load(&mut self, planes: &[f32], count: usize, rows: &Range<usize>, s: &Sizes) {
        self.start = rows.start * s.w;
        self.pixels.resize(rows.len() * s.w, [0.0; LANES]);
        for (lane, plane) in planes.chunks(s.h * s.w).take(count).enumerate() {
            self.pixels.iter_mut().zip(&plane[self.start..]).for_each(|(to, from)| to[lane] = *from);
        }
    }
}

/// Maximum over the guidance features `[1, C, H, W]` and all valid warped features `[K, C, H, W]` (`s.n = K`), and which frame
/// holds it, `[C, H, W]`, counted from 1; 0 is the guidance frame.
pub fn warp_max(guidance: &[f32], x: &[f32], flow: &[f32], s: &Sizes) -> (Vec<f32>, Vec<u16>) {
    let (area, field) = (s.h * s.w, tap_field(flow, s));
    let count = s.h.div_ceil(BAND);
    let mut winners = vec![0u16; s.c * area];
    let fill = |out: &mut [MaybeUninit<f32>]| {
        let pieces = bands(out, [s.h, s.w], LANES, BAND).into_par_iter();
        pieces.zip(bands(&mut winners, [s.h, s.w], LANES, BAND)).enumerate().for_each(|(task, (out, winners))| {
            let (first, top) = (task / count * LANES, task % count * BAND);
            let rows = top..s.h.min(top + BAND);
            let (mut best, mut source) = (Interleaved::default(), Interleaved::default());
            best.load(&guidance[first * area..], out.len(), &rows, s);
            let mut holders = vec![[0u32; LANES]; best.pixels.len()];
            for k in 0..s.n {
                source.load(&x[(k * s.c + first) * area..], out.len(), &field.reach(k, &rows, s), s);
                let taps = &field.taps[k * area + best.start..][..best.pixels.len()];
                vectorised(
                    #[inline(always)]
                    || field.compete(&source, taps, k as u32 + 1, &mut best.pixels, &mut holders),
                );
            }
            for (lane, (out, winners)) in out.into_iter().zip(winners).enumerate() {
                out.iter_mut().zip(&best.pixels).for_each(|(to, from)| _ = to.write(from[lane]));
                winners.iter_mut().zip(&holders).for_each(|(to, from)| *to = from[lane] as u16);
            }
        });
    };
    // SAFETY: the bands have every pixel.
    let out = unsafe { filled(guidance.len(), fill) };
    (out, winners)
}

/// Gradients of guidance and key-frame features: each pixel's gradient goes to the frame that holds the maximum, the first of
/// several.
pub fn warp_max_backward(winners: &[u16], flow: &[f32], gradient: &[f32], s: &Sizes) -> (Vec<f32>, Vec<f32>) {
    let (area, field) = (s.h * s.w, tap_field(flow, s));
    let mut to_guidance = vec![0.0f32; s.c * area];
    let fill = |to_frames: &mut [MaybeUninit<f32>]| {
        // What becomes of each channel in all frames.
        let mut channels: Vec<Vec<&mut [MaybeUninit<f32>]>> = (0..s.c).map(|_| Vec::with_capacity(s.n)).collect();
        to_frames.chunks_mut(area).enumerate().for_each(|(i, plane)| channels[i % s.c].push(plane));
        channels.par_chunks_mut(LANES).zip(to_guidance.par_chunks_mut(LANES * area)).enumerate().for_each(
            |(group, (frames, to_guidance))| {
                let first = group * LANES * area;
                let mut scatter = Scatter { field: &field, s, zeroed: vec![0; s.n], frames };
                for y in 0..s.h {
                    let at = first + y * s.w..;
                    scatter.row(y, &winners[at.clone()], &gradient[at], &mut to_guidance[y * s.w..]);
                }
                (0..s.n).for_each(|k| scatter.zero(k, s.h));
            },
        );
    };
    // SAFETY: all rows of all planes are zeroed at least.
    let to_frames = unsafe { filled(s.n * s.c * area, fill) };
    (to_guidance, to_frames)
}

/// Brings gradients back to some channels of all frames. Rows are zeroed just before they are first added to, while the cache
/// holds them.
struct Scatter<'a, 'o> {
    field: &'a TapField,
    s: &'a Sizes,
    /// Rows of each frame that hold numbers, from the first on.
    zeroed: Vec<usize>,
    /// Each channel's planes in all frames.
    frames: &'a mut [Vec<&'o mut [MaybeUninit<f32>]>],
}

impl Scatter<'_, '_> {
    fn zero(&mut self, k: usize, end: usize) {
        let rows = self.zeroed[k]..end.max(self.zeroed[k]);
        for channel in self.frames.iter_mut() {
            channel[k][rows.start * self.s.w..rows.end * self.s.w].fill(MaybeUninit::new(0.0));
        }
        self.zeroed[k] = rows.end;
    }

    /// Row `y` of the winners, the gradient and what the guidance frame gets; each channel's is `h · w` behind the one before.
    fn row(&mut self, y: usize, winners: &[u16], gradient: &[f32], to_guidance: &mut [f32]) {
        let Sizes { n, h, w, .. } = *self.s;
        (0..n).for_each(|k| self.zero(k, self.field.reach[k * h + y].end));
        for x in 0..w {
            for (c, frames) in self.frames.iter_mut().enumerate() {
                let p = c * h * w + x;
                match usize::from(winners[p]) {
                    0 => to_guidance[p] = gradient[p],
                    winner => {
                        let tap = self.field.taps[((winner - 1) * h + y) * w + x];
                        let plane = &mut frames[winner - 1][..self.zeroed[winner - 1] * w];
                        // SAFETY: so many rows are zeroed.
                        self.field.scatter(unsafe { plane.assume_init_mut() }, tap, gradient[p]);
                    }
                }
            }
        }
    }
}
