//! The two inner loops of every convolution pass, written once for AVX2+FMA and once for any processor.
//!
//! Both read *rows of pixels*: for each of `K` taps (an input channel at one kernel offset) a run of consecutive pixels at
//! `base + offsets[k]`. Vectors run along the pixels, so no layout change is needed anywhere.

/// Pixels per register tile.
pub const TILE: usize = 16;
/// Lanes of one vector.
pub const LANES: usize = 8;
/// Most output channels of a register tile: 6 × 16 accumulators fill twelve of sixteen AVX registers.
pub const MOST_OUTPUTS: usize = 6;
/// Output channels and taps of a weight-gradient tile.
pub const DOT: usize = 3;

/// Accumulators of a tile: `outputs × TILE`.
pub type Accumulators = [[f32; TILE]; MOST_OUTPUTS];
/// Accumulators of a weight-gradient tile: output channel, tap, lane.
pub type DotAccumulators = [[[f32; LANES]; DOT]; DOT];

/// Where each tap's pixels start, relative to a tile's base, and the largest of these distances.
pub struct Offsets {
    taps: Vec<usize>,
    reach: usize,
}

impl Offsets {
    /// Collects the offsets of all taps.
    pub fn new(taps: impl Iterator<Item = usize>) -> Self {
        let taps: Vec<usize> = taps.collect();
        let reach = taps.iter().copied().max().unwrap_or(0);
        Self { taps, reach }
    }

    /// Number of taps.
    pub fn len(&self) -> usize {
        self.taps.len()
    }

    /// The offset of tap `k`.
    pub fn at(&self, k: usize) -> usize {
        self.taps[k]
    }
}

/// Which instructions a kernel may use; found once per call.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Instructions {
    /// x86-64 with AVX2 and FMA.
    #[cfg(target_arch = "x86_64")]
    Avx2,
    /// Whatever the compiler's baseline offers.
    Portable,
}

impl Instructions {
    /// The best this processor has.
    pub fn detect() -> Self {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("fma") {
            return Self::Avx2;
        }
        Self::Portable
    }

    /// `out[r][p] = Σ_k weights[k · outputs + r] · source[base + offsets[k] + p]` for `outputs` (1 to 6) output channels.
    #[inline]
    pub fn correlate(
        self,
        outputs: usize,
        source: &[f32],
        base: usize,
        offsets: &Offsets,
        weights: &[f32],
        out: &mut Accumulators,
    ) {
        assert!(weights.len() == offsets.len() * outputs && base + offsets.reach + TILE <= source.len());
        match self {
            #[cfg(target_arch = "x86_64")]
            // SAFETY: `Avx2` is only made by `detect` after both features were found; all loads were checked above.
            Self::Avx2 => unsafe { avx2::correlate(outputs, source, base, offsets, weights, out) },
            Self::Portable => portable_correlate(outputs, source, base, offsets, weights, out),
        }
    }

    /// `acc[i][j][l] += Σ_p gradient_i[p] · x_j[p]` over the rows' pixels, lane by lane, for the first `rows` (1 to 3) gradients.
    #[inline]
    pub fn dot(self, rows: usize, gradient: [&[f32]; DOT], x: [&[f32]; DOT], acc: &mut DotAccumulators) {
        let length = gradient[0].len();
        assert!(gradient.iter().chain(&x).all(|r| r.len() == length));
        match self {
            #[cfg(target_arch = "x86_64")]
            // SAFETY: `Avx2` is only made by `detect` after both features were found; the lengths were checked above.
            Self::Avx2 => unsafe { avx2::dot(rows, gradient, x, acc) },
            Self::Portable => portable_dot(rows, 0, gradient, x, acc),
        }
    }
}

fn portable_correlate(outputs: usize, source: &[f32], base: usize, offsets: &Offsets, weights: &[f32], out: &mut Accumulators) {
    *out = [[0.0; TILE]; MOST_OUTPUTS];
    for (&offset, w) in offsets.taps.iter().zip(weights.chunks_exact(outputs)) {
        let x = &source[base + offset..][..TILE];
        for (acc, w) in out.iter_mut().zip(w) {
            acc.iter_mut().zip(x).for_each(|(a, x)| *a += w * x);
        }
    }
}

fn portable_dot(rows: usize, start: usize, gradient: [&[f32]; DOT], x: [&[f32]; DOT], acc: &mut DotAccumulators) {
    for (sums, g) in acc.iter_mut().zip(gradient).take(rows) {
        for (lanes, x) in sums.iter_mut().zip(x) {
            for (g, x) in g[start..].chunks(LANES).zip(x[start..].chunks(LANES)) {
                lanes.iter_mut().zip(g.iter().zip(x)).for_each(|(l, (g, x))| *l += g * x);
            }
        }
    }
}

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use std::arch::x86_64::{
        __m256, _mm256_broadcast_ss, _mm256_fmadd_ps, _mm256_loadu_ps, _mm256_setzero_ps, _mm256_storeu_ps,
    };

    use super::{Accumulators, DOT, DotAccumulators, LANES, Offsets};

    /// # Safety
    /// Needs AVX2 and FMA, `base + offset + TILE <= source.len()` for every offset and `outputs` weights per offset.
    #[target_feature(enable = "avx2,fma")]
    pub unsafe fn correlate(
        outputs: usize,
        source: &[f32],
        base: usize,
        offsets: &Offsets,
        weights: &[f32],
        out: &mut Accumulators,
    ) {
        // SAFETY: the caller's promise is passed on.
        unsafe {
            match outputs {
                1 => correlate_outputs::<1>(source, base, offsets, weights, out),
                2 => correlate_outputs::<2>(source, base, offsets, weights, out),
                3 => correlate_outputs::<3>(source, base, offsets, weights, out),
                4 => correlate_outputs::<4>(source, base, offsets, weights, out),
                5 => correlate_outputs::<5>(source, base, offsets, weights, out),
                _ => correlate_outputs::<6>(source, base, offsets, weights, out),
            }
        }
    }

    #[inline]
    #[target_feature(enable = "avx2,fma")]
    unsafe fn correlate_outputs<const R: usize>(
        source: &[f32],
        base: usize,
        offsets: &Offsets,
        weights: &[f32],
        out: &mut Accumulators,
    ) {
        // SAFETY: `correlate`'s promise covers every load; stores go to `R` whole rows of `out`.
        unsafe {
            let start = source.as_ptr().add(base);
            let mut weight = weights.as_ptr();
            let mut acc: [[__m256; 2]; R] = [[_mm256_setzero_ps(); 2]; R];
            for &offset in &offsets.taps {
                let x0 = _mm256_loadu_ps(start.add(offset));
                let x1 = _mm256_loadu_ps(start.add(offset + LANES));
                for (r, acc) in acc.iter_mut().enumerate() {
                    let w = _mm256_broadcast_ss(&*weight.add(r));
                    acc[0] = _mm256_fmadd_ps(w, x0, acc[0]);
                    acc[1] = _mm256_fmadd_ps(w, x1, acc[1]);
                }
                weight = weight.add(R);
            }
            for (to, acc) in out.iter_mut().zip(acc) {
                _mm256_storeu_ps(to.as_mut_ptr(), acc[0]);
                _mm256_storeu_ps(to.as_mut_ptr().add(LANES), acc[1]);
            }
        }
    }

    /// # Safety
    /// Needs AVX2 and FMA and six rows of one length.
    #[target_feature(enable = "avx2,fma")]
    pub unsafe fn dot(rows: usize, gradient: [&[f32]; DOT], x: [&[f32]; DOT], acc: &mut DotAccumulators) {
        // SAFETY: the caller's promise is passed on.
        unsafe {
            match rows {
                1 => dot_rows::<1>(gradient, x, acc),
                2 => dot_rows::<2>(gradient, x, acc),
                _ => dot_rows::<3>(gradient, x, acc),
            }
        }
        let whole = gradient[0].len() / LANES * LANES;
        // Most rows are whole vectors, and the nine empty loops would cost more than a short row itself.
        if whole < gradient[0].len() {
            super::portable_dot(rows, whole, gradient, x, acc);
        }
    }

    #[inline]
    #[target_feature(enable = "avx2,fma")]
    unsafe fn dot_rows<const R: usize>(gradient: [&[f32]; DOT], x: [&[f32]; DOT], acc: &mut DotAccumulators) {
        let g: [*const f32; DOT] = gradient.map(<[f32]>::as_ptr);
        let v: [*const f32; DOT] = x.map(<[f32]>::as_ptr);
        // SAFETY: all rows are `gradient[0].len()` long and `p + LANES` stays within it; `acc` rows are whole vectors.
        unsafe {
            let mut sum: [[__m256; DOT]; R] = [[_mm256_setzero_ps(); DOT]; R];
            for (i, sum) in sum.iter_mut().enumerate() {
                for (j, sum) in sum.iter_mut().enumerate() {
                    *sum = _mm256_loadu_ps(acc[i][j].as_ptr());
                }
            }
            for p in (0..gradient[0].len() / LANES * LANES).step_by(LANES) {
                let (x0, x1, x2) = (_mm256_loadu_ps(v[0].add(p)), _mm256_loadu_ps(v[1].add(p)), _mm256_loadu_ps(v[2].add(p)));
                for (i, sum) in sum.iter_mut().enumerate() {
                    let g = _mm256_loadu_ps(g[i].add(p));
                    sum[0] = _mm256_fmadd_ps(g, x0, sum[0]);
                    sum[1] = _mm256_fmadd_ps(g, x1, sum[1]);
                    sum[2] = _mm256_fmadd_ps(g, x2, sum[2]);
                }
            }
            for (acc, sum) in acc.iter_mut().zip(sum) {
                for (acc, sum) in acc.iter_mut().zip(sum) {
                    _mm256_storeu_ps(acc.as_mut_ptr(), sum);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_routes_agree() {
        let source: Vec<f32> = (0..200).map(|i| (i as f32 * 0.37).sin()).collect();
        let offsets = Offsets::new([0, 120, 3, 90, 17].into_iter());
        for outputs in 1..=MOST_OUTPUTS {
            let weights: Vec<f32> = (0..offsets.len() * outputs).map(|i| (i as f32).cos()).collect();
            let (mut fast, mut plain) = ([[0.0; TILE]; MOST_OUTPUTS], [[0.0; TILE]; MOST_OUTPUTS]);
            Instructions::detect().correlate(outputs, &source, 5, &offsets, &weights, &mut fast);
            Instructions::Portable.correlate(outputs, &source, 5, &offsets, &weights, &mut plain);
            for (a, b) in fast[..outputs].iter().flatten().zip(plain[..outputs].iter().flatten()) {
                assert!((a - b).abs() < 1e-5);
            }
        }
        for length in [1, 8, 13, 40] {
            let row = |s: usize| &source[s..s + length];
            let (mut fast, mut plain) = ([[[0.5; LANES]; DOT]; DOT], [[[0.5; LANES]; DOT]; DOT]);
            for rows in 1..=DOT {
                Instructions::detect().dot(rows, [row(0), row(31), row(62)], [row(7), row(8), row(9)], &mut fast);
                Instructions::Portable.dot(rows, [row(0), row(31), row(62)], [row(7), row(8), row(9)], &mut plain);
            }
            for (a, b) in fast.iter().flatten().flatten().zip(plain.iter().flatten().flatten()) {
                assert!((a - b).abs() < 1e-5);
            }
        }
    }
}
