//! The two inner loops of every convolution pass, written once for vectors of any length and once for any processor.
//!
//! Both read *rows of pixels*: for each of `K` taps (an input channel at one kernel offset) a run of consecutive pixels at
//! `base + offsets[k]`. Vectors run along the pixels, so no layout change is needed anywhere.

/// Pixels per register tile.
pub const TILE: usize = 16;
/// Most output channels of a register tile.
pub const MOST_OUTPUTS: usize = 16;
/// Most taps of a weight-gradient tile.
const MOST_TAPS: usize = 9;

/// Accumulators of a tile: `outputs × TILE`.
pub type Accumulators = [[f32; TILE]; MOST_OUTPUTS];
/// What [`TILE`] output channels have at one pixel or tap.
pub type Outputs = [f32; TILE];

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
    /// x86-64 with AVX-512.
    #[cfg(target_arch = "x86_64")]
    Avx512,
    /// x86-64 with AVX2 and FMA.
    #[cfg(target_arch = "x86_64")]
    Avx2,
    /// 64-bit ARM.
    #[cfg(target_arch = "aarch64")]
    Neon,
    /// Whatever the compiler's baseline offers.
    Portable,
}

impl Instructions {
    /// All that this processor has, the best first.
    pub fn available() -> impl Iterator<Item = Self> {
        let mut found = Vec::with_capacity(3);
        #[cfg(target_arch = "x86_64")]
        {
            let avx2 = is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma");
            found.extend((avx2 && is_x86_feature_detected!("avx512f")).then_some(Self::Avx512));
            found.extend(avx2.then_some(Self::Avx2));
        }
        #[cfg(target_arch = "aarch64")]
        found.extend(std::arch::is_aarch64_feature_detected!("neon").then_some(Self::Neon));
        found.push(Self::Portable);
        found.into_iter()
    }

    /// The best this processor has.
    pub fn detect() -> Self {
        static BEST: std::sync::OnceLock<Instructions> = std::sync::OnceLock::new();
        *BEST.get_or_init(|| Self::available().next().unwrap_or(Self::Portable))
    }

    /// Output channels of a register tile: as many accumulators as the registers hold beside their operands.
    pub fn most_outputs(self) -> usize {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => avx512::MOST_OUTPUTS,
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => avx2::MOST_OUTPUTS,
            #[cfg(target_arch = "aarch64")]
            Self::Neon => neon::MOST_OUTPUTS,
            Self::Portable => 6,
        }
    }

    /// `out[r][p] = Σ_k weights[k · outputs + r] · source[base + offsets[k] + p]` for `outputs` output channels, 1 to
    /// [`Self::most_outputs`].
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
        assert!((1..=self.most_outputs()).contains(&outputs) && weights.len() == offsets.len() * outputs);
        assert!(base + offsets.reach + TILE <= source.len());
        // SAFETY: a variant is only made after its features were found; outputs, weights and loads were checked above.
        unsafe {
            match self {
                #[cfg(target_arch = "x86_64")]
                Self::Avx512 => avx512::correlate(outputs, source, base, offsets, weights, out),
                #[cfg(target_arch = "x86_64")]
                Self::Avx2 => avx2::correlate(outputs, source, base, offsets, weights, out),
                #[cfg(target_arch = "aarch64")]
                Self::Neon => neon::correlate(outputs, source, base, offsets, weights, out),
                Self::Portable => portable_correlate(outputs, source, base, offsets, weights, out),
            }
        }
    }

    /// Taps of a weight-gradient tile.
    pub fn taps(self) -> usize {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => avx512::TAPS,
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => avx2::TAPS,
            #[cfg(target_arch = "aarch64")]
            Self::Neon => neon::TAPS,
            Self::Portable => MOST_TAPS,
        }
    }

    /// `sums[k][o] += Σ_{l, p} gradient[l · length + p][o] · source[offsets[k] + lines[l] + p]` for [`Self::taps`] taps.
    #[inline]
    pub fn outer(
        self,
        source: &[f32],
        offsets: &[usize],
        lines: &[usize],
        length: usize,
        gradient: &[Outputs],
        sums: &mut [Outputs],
    ) {
        let most = |starts: &[usize]| starts.iter().copied().max().unwrap_or(0);
        assert!(offsets.len() == self.taps() && sums.len() == self.taps() && gradient.len() == lines.len() * length);
        assert!(most(offsets) + most(lines) + length <= source.len());
        // SAFETY: a variant is only made after its features were found; lengths were checked above.
        unsafe {
            match self {
                #[cfg(target_arch = "x86_64")]
                Self::Avx512 => avx512::outer(source, offsets, lines, length, gradient, sums),
                #[cfg(target_arch = "x86_64")]
                Self::Avx2 => avx2::outer(source, offsets, lines, length, gradient, sums),
                #[cfg(target_arch = "aarch64")]
                Self::Neon => neon::outer(source, offsets, lines, length, gradient, sums),
                Self::Portable => portable_outer(source, offsets, lines, length, gradient, sums),
            }
        }
    }

    /// Runs ten chains of multiply-adds; what they sum up to, and operations per round.
    pub fn multiply_adds(self, factor: f32, rounds: usize) -> (f32, usize) {
        // SAFETY: a variant is only made after its features were found.
        unsafe {
            match self {
                #[cfg(target_arch = "x86_64")]
                Self::Avx512 => avx512::multiply_adds(factor, rounds),
                #[cfg(target_arch = "x86_64")]
                Self::Avx2 => avx2::multiply_adds(factor, rounds),
                #[cfg(target_arch = "aarch64")]
                Self::Neon => neon::multiply_adds(factor, rounds),
                Self::Portable => portable_multiply_adds(factor, rounds),
            }
        }
    }
}

/// Chains of multiply-adds that [`Instructions::multiply_adds`] runs: enough to hide the latency of one.
const CHAINS: usize = 10;

fn portable_correlate(outputs: usize, source: &[f32], base: usize, offsets: &Offsets, weights: &[f32], out: &mut Accumulators) {
    *out = [[0.0; TILE]; MOST_OUTPUTS];
    for (&offset, w) in offsets.taps.iter().zip(weights.chunks_exact(outputs)) {
        let x = &source[base + offset..][..TILE];
        for (acc, w) in out.iter_mut().zip(w) {
            acc.iter_mut().zip(x).for_each(|(a, x)| *a += w * x);
        }
    }
}

fn portable_outer(
    source: &[f32],
    offsets: &[usize],
    lines: &[usize],
    length: usize,
    gradient: &[Outputs],
    sums: &mut [Outputs],
) {
    for (sums, &offset) in sums.iter_mut().zip(offsets) {
        let mut acc = [0.0; TILE];
        for (&line, gradient) in lines.iter().zip(gradient.chunks_exact(length)) {
            for (gradient, x) in gradient.iter().zip(&source[offset + line..]) {
                acc.iter_mut().zip(gradient).for_each(|(acc, g)| *acc += g * x);
            }
        }
        sums.iter_mut().zip(acc).for_each(|(sum, acc)| *sum += acc);
    }
}

fn portable_multiply_adds(factor: f32, rounds: usize) -> (f32, usize) {
    let mut chains = [[1.0f32; 8]; CHAINS];
    for _ in 0..rounds {
        chains.as_flattened_mut().iter_mut().for_each(|lane| *lane = *lane * factor + 0.5);
    }
    (chains.as_flattened().iter().sum(), 2 * 8 * CHAINS)
}

/// The loops for one kind of vector. `$outputs` counts the output channels of a tile up to the most.
macro_rules! vector_loops {
    (
        $module:ident, $features:tt, $vector:ident, $lanes:literal, $most:literal, [$($outputs:literal)*], $taps:literal,
        $zero:expr, $splat:ident, $load:ident, $store:ident, |$sum:ident, $a:ident, $b:ident| $multiply_add:expr
    ) => {
        mod $module {
            #[cfg(target_arch = "aarch64")]
            use std::arch::aarch64::*;
            #[cfg(target_arch = "x86_64")]
            use std::arch::x86_64::*;

            use super::{Accumulators, CHAINS, Offsets, Outputs, TILE};

            const LANES: usize = $lanes;
            const VECTORS: usize = TILE / LANES;
            pub const MOST_OUTPUTS: usize = $most;
            pub const TAPS: usize = $taps;

            /// # Safety
            /// Needs the module's features, `base + offset + TILE <= source.len()` for every offset, and `outputs` weights per
            /// offset, 1 to [`MOST_OUTPUTS`].
            #[target_feature(enable = $features)]
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
                        $($outputs => correlate_outputs::<$outputs>(source, base, offsets, weights, out),)*
                        _ => unreachable!("more outputs than a tile has"),
                    }
                }
            }

            #[inline]
            #[target_feature(enable = $features)]
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
                    let mut acc: [[$vector; VECTORS]; R] = [[$zero; VECTORS]; R];
                    for &offset in &offsets.taps {
                        let mut x = [$zero; VECTORS];
                        for (i, x) in x.iter_mut().enumerate() {
                            *x = $load(start.add(offset + i * LANES));
                        }
                        for (r, acc) in acc.iter_mut().enumerate() {
                            let $a = $splat(*weight.add(r));
                            for ($sum, &$b) in acc.iter_mut().zip(&x) {
                                *$sum = $multiply_add;
                            }
                        }
                        weight = weight.add(R);
                    }
                    for (to, acc) in out.iter_mut().zip(acc) {
                        for (i, acc) in acc.into_iter().enumerate() {
                            $store(to.as_mut_ptr().add(i * LANES), acc);
                        }
                    }
                }
            }

            /// # Safety
            /// Needs the module's features, [`TAPS`] offsets and sums, `length` pixels of the gradient per line, and
            /// `offset + line + length <= source.len()` for all of them.
            #[target_feature(enable = $features)]
            pub unsafe fn outer(
                source: &[f32],
                offsets: &[usize],
                lines: &[usize],
                length: usize,
                gradient: &[Outputs],
                sums: &mut [Outputs],
            ) {
                // SAFETY: the caller's promise covers every load and store.
                unsafe {
                    let mut acc: [[$vector; VECTORS]; TAPS] = [[$zero; VECTORS]; TAPS];
                    for (&line, gradient) in lines.iter().zip(gradient.chunks_exact(length)) {
                        let mut x = [source.as_ptr(); TAPS];
                        for (x, offset) in x.iter_mut().zip(offsets) {
                            *x = x.add(line + offset);
                        }
                        for (p, gradient) in gradient.iter().enumerate() {
                            let mut g = [$zero; VECTORS];
                            for (i, g) in g.iter_mut().enumerate() {
                                *g = $load(gradient.as_ptr().add(i * LANES));
                            }
                            for (x, acc) in x.iter().zip(&mut acc) {
                                let $a = $splat(*x.add(p));
                                for ($sum, &$b) in acc.iter_mut().zip(&g) {
                                    *$sum = $multiply_add;
                                }
                            }
                        }
                    }
                    // Sums of sums: over thousands of pixels, one running sum would lose digits.
                    let $a = $splat(1.0);
                    for (sums, acc) in sums.iter_mut().zip(acc) {
                        for (i, $b) in acc.into_iter().enumerate() {
                            let to = sums.as_mut_ptr().add(i * LANES);
                            let $sum = &mut $load(to);
                            $store(to, $multiply_add);
                        }
                    }
                }
            }

            /// # Safety
            /// Needs the module's features.
            #[target_feature(enable = $features)]
            pub unsafe fn multiply_adds(factor: f32, rounds: usize) -> (f32, usize) {
                // SAFETY: the caller's promise; stores go to whole rows of `lanes`.
                unsafe {
                    let ($a, half) = ($splat(factor), $splat(0.5));
                    let mut chains = [half; CHAINS];
                    for (i, chain) in chains.iter_mut().enumerate() {
                        // Equal chains would be computed once.
                        *chain = $splat(i as f32);
                    }
                    for _ in 0..rounds {
                        for chain in &mut chains {
                            let ($sum, $b) = (&mut { half }, *chain);
                            *chain = $multiply_add;
                        }
                    }
                    let mut lanes = [[0.0f32; LANES]; CHAINS];
                    for (to, chain) in lanes.iter_mut().zip(chains) {
                        $store(to.as_mut_ptr(), chain);
                    }
                    (lanes.as_flattened().iter().sum(), 2 * LANES * CHAINS)
                }
            }
        }
    };
}

// One accumulator per output: sixteen of 32 registers, and weights come straight from memory into the multiply-add.
#[cfg(target_arch = "x86_64")]
vector_loops!(
    avx512, "avx512f", __m512, 16, 16, [1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16], 9,
    _mm512_setzero_ps(), _mm512_set1_ps, _mm512_loadu_ps, _mm512_storeu_ps, |sum, a, b| _mm512_fmadd_ps(a, b, *sum)
);
// 6 × 16 accumulators fill twelve of sixteen registers.
#[cfg(target_arch = "x86_64")]
vector_loops!(
    avx2, "avx2,fma", __m256, 8, 6, [1 2 3 4 5 6], 6,
    _mm256_setzero_ps(), _mm256_set1_ps, _mm256_loadu_ps, _mm256_storeu_ps, |sum, a, b| _mm256_fmadd_ps(a, b, *sum)
);
// 6 × 16 accumulators fill 24 of 32 registers.
#[cfg(target_arch = "aarch64")]
vector_loops!(
    neon, "neon", float32x4_t, 4, 6, [1 2 3 4 5 6], 6,
    vdupq_n_f32(0.0), vdupq_n_f32, vld1q_f32, vst1q_f32, |sum, a, b| vfmaq_f32(*sum, a, b)
);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_routes_agree() {
        let source: Vec<f32> = (0..200).map(|i| (i as f32 * 0.37).sin()).collect();
        let offsets = Offsets::new([0, 120, 3, 90, 17].into_iter());
        for route in Instructions::available() {
            for outputs in 1..=route.most_outputs() {
                let weights: Vec<f32> = (0..offsets.len() * outputs).map(|i| (i as f32).cos()).collect();
                let mut found = [[0.0; TILE]; MOST_OUTPUTS];
                route.correlate(outputs, &source, 5, &offsets, &weights, &mut found);
                for (r, p) in (0..outputs * TILE).map(|i| (i / TILE, i % TILE)) {
                    let term = |k: usize| weights[k * outputs + r] * source[5 + offsets.at(k) + p];
                    let expected: f32 = (0..offsets.len()).map(term).sum();
                    assert!((found[r][p] - expected).abs() < 1e-5, "{route:?}, {outputs} outputs");
                }
            }
            let starts: Vec<usize> = (0..route.taps()).map(|k| 15 * k).collect();
            let lines = [3, 0, 40];
            let gradient: Vec<Outputs> = (0..21).map(|p| std::array::from_fn(|o| ((7 * p + o) as f32).cos())).collect();
            let mut sums = vec![[0.5; TILE]; route.taps()];
            route.outer(&source, &starts, &lines, 7, &gradient, &mut sums);
            for (k, o) in (0..route.taps() * TILE).map(|i| (i / TILE, i % TILE)) {
                let term = |p: usize| gradient[p][o] * source[starts[k] + lines[p / 7] + p % 7];
                let expected = 0.5 + (0..21).map(term).sum::<f32>();
                assert!((sums[k][o] - expected).abs() < 1e-5, "{route:?}, tap {k}");
            }
        }
    }

    #[test]
    fn chains_of_multiply_adds_end_at_their_fixed_point() {
        for route in Instructions::available() {
            let (sum, operations) = route.multiply_adds(0.5, 100);
            // x = x/2 + 1/2
            assert_eq!(sum, operations as f32 / 2.0, "{route:?}");
        }
    }
}
