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

    /// Transforms each piece of up to sixteen tiles for [`winograd`](super::winograd): 6×6 pixels, at `from + y · row + x % 4 · phase
    /// + x / 4` of `source`, become 36 frequencies, at `to + frequency · step`.
    pub fn spread(self, source: &[f32], [from, row, phase]: [usize; 3], out: &mut [f32], [to, step]: [usize; 2]) {
        assert!(from + 5 * row + 3 * phase + 1 + TILE <= source.len() && to + 35 * step + TILE <= out.len());
        // SAFETY: a variant is only made after its features were found; loads and stores were checked above.
        unsafe {
            let (source, out) = (source.as_ptr().add(from), out.as_mut_ptr().add(to));
            match self {
                #[cfg(target_arch = "x86_64")]
                Self::Avx512 => avx512::spread(source, row, phase, out, step),
                #[cfg(target_arch = "x86_64")]
                Self::Avx2 => avx2::spread(source, row, phase, out, step),
                #[cfg(target_arch = "aarch64")]
                Self::Neon => neon::spread(source, row, phase, out, step),
                Self::Portable => portable::spread(source, row, phase, out, step),
            }
        }
    }

    /// Transforms the sums of 36 frequencies, `step` apart, into 4×4 results of sixteen tiles, `[y][x][tile]`.
    pub fn gather(self, sums: &[f32], step: usize) -> [[Outputs; 4]; 4] {
        assert!(35 * step + TILE <= sums.len());
        let mut out = [[[0.0; TILE]; 4]; 4];
        let (sums, to) = (sums.as_ptr(), out.as_flattened_mut().as_flattened_mut().as_mut_ptr());
        // SAFETY: a variant is only made after its features were found; loads were checked above, stores fill `out`.
        unsafe {
            match self {
                #[cfg(target_arch = "x86_64")]
                Self::Avx512 => avx512::gather(sums, step, to),
                #[cfg(target_arch = "x86_64")]
                Self::Avx2 => avx2::gather(sums, step, to),
                #[cfg(target_arch = "aarch64")]
                Self::Neon => neon::gather(sums, step, to),
                Self::Portable => portable::gather(sums, step, to),
            }
        }
        out
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

/// Winograd's points, beside 0 and infinity, are ±A and ±B. These lose less than a digit, the usual ±1 and ±2 four times as much;
/// all factors are exact.
pub const POINTS: [f32; 2] = [0.75, 1.5];

/// Winograd's transforms of F(4×4, 3×3) for one kind of vector (Lavin and Gray 2016, section 4.3, with other points).
macro_rules! winograd_loops {
    (
        [$(#[$features:meta])*], $vector:ident, $zero:expr, $splat:ident, $load:ident, $store:ident,
        |$sum:ident, $a:ident, $b:ident| $multiply_add:expr
    ) => {
        const A: f32 = super::POINTS[0];
        const B: f32 = super::POINTS[1];

        /// `sum + factor · b`
        // A number's own operations are safe, a vector's are not.
        #[allow(unused_unsafe)]
        #[inline]
        $(#[$features])*
        unsafe fn plus(sum: $vector, factor: f32, $b: $vector) -> $vector {
            // SAFETY: the module's features are there.
            unsafe {
                let $a = $splat(factor);
                let $sum = &mut { sum };
                $multiply_add
            }
        }

        /// Frequencies of six pixels in a row.
        #[inline]
        $(#[$features])*
        unsafe fn spread_row([a, b, c, d, e, f]: [$vector; 6]) -> [$vector; 6] {
            // SAFETY: the module's features are there.
            unsafe {
                let (near_even, near_odd) = (plus(e, -B * B, c), plus(d, -B * B, b));
                let (far_even, far_odd) = (plus(e, -A * A, c), plus(d, -A * A, b));
                [
                    plus(plus(e, -(A * A + B * B), c), A * A * B * B, a),
                    plus(near_even, A, near_odd),
                    plus(near_even, -A, near_odd),
                    plus(far_even, B, far_odd),
                    plus(far_even, -B, far_odd),
                    plus(plus(f, -(A * A + B * B), d), A * A * B * B, b),
                ]
            }
        }

        /// Four results in a row from the sums of their frequencies.
        #[inline]
        $(#[$features])*
        unsafe fn gather_row([a, b, c, d, e, f]: [$vector; 6]) -> [$vector; 4] {
            // SAFETY: the module's features are there.
            unsafe {
                let (near, far) = (plus(b, 1.0, c), plus(d, 1.0, e));
                let (step, leap) = (plus(b, -1.0, c), plus(d, -1.0, e));
                [
                    plus(plus(a, 1.0, near), 1.0, far),
                    plus(plus($zero, A, step), B, leap),
                    plus(plus($zero, A * A, near), B * B, far),
                    plus(plus(f, A * A * A, step), B * B * B, leap),
                ]
            }
        }

        /// # Safety
        /// Needs the module's features, and loads and stores as `Instructions::spread` has them.
        $(#[$features])*
        pub unsafe fn spread(source: *const f32, row: usize, phase: usize, to: *mut f32, step: usize) {
            // SAFETY: the caller's promise.
            unsafe {
                for i in (0..TILE).step_by(LANES) {
                    let mut lines = [[$zero; 6]; 6];
                    for (y, line) in lines.iter_mut().enumerate() {
                        for (x, pixel) in line.iter_mut().enumerate() {
                            *pixel = $load(source.add(y * row + x % 4 * phase + x / 4 + i));
                        }
                        *line = spread_row(*line);
                    }
                    for u in 0..6 {
                        let column = [lines[0][u], lines[1][u], lines[2][u], lines[3][u], lines[4][u], lines[5][u]];
                        for (v, frequency) in spread_row(column).into_iter().enumerate() {
                            $store(to.add((v * 6 + u) * step + i), frequency);
                        }
                    }
                }
            }
        }

        /// # Safety
        /// Needs the module's features, and loads and stores as `Instructions::gather` has them.
        $(#[$features])*
        pub unsafe fn gather(sums: *const f32, step: usize, to: *mut f32) {
            // SAFETY: the caller's promise.
            unsafe {
                for i in (0..TILE).step_by(LANES) {
                    let mut lines = [[$zero; 6]; 4];
                    for u in 0..6 {
                        let mut column = [$zero; 6];
                        for (v, frequency) in column.iter_mut().enumerate() {
                            *frequency = $load(sums.add((v * 6 + u) * step + i));
                        }
                        for (line, result) in lines.iter_mut().zip(gather_row(column)) {
                            line[u] = result;
                        }
                    }
                    for (y, line) in lines.into_iter().enumerate() {
                        for (x, result) in gather_row(line).into_iter().enumerate() {
                            $store(to.add((y * 4 + x) * TILE + i), result);
                        }
                    }
                }
            }
        }
    };
}

/// The same for one number at a time.
mod portable {
    use super::TILE;

    const LANES: usize = 1;

    winograd_loops!([], f32, 0.0, identity, load, store, |sum, a, b| *sum + a * b);

    fn identity(value: f32) -> f32 {
        value
    }

    /// # Safety
    /// As of `ptr::read`.
    unsafe fn load(from: *const f32) -> f32 {
        // SAFETY: the caller's promise.
        unsafe { from.read() }
    }

    /// # Safety
    /// As of `ptr::write`.
    unsafe fn store(to: *mut f32, value: f32) {
        // SAFETY: the caller's promise.
        unsafe { to.write(value) }
    }
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

            winograd_loops!([#[target_feature(enable = $features)]], $vector, $zero, $splat, $load, $store, |$sum, $a, $b| $multiply_add);

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
