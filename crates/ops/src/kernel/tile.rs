//! The two inner loops of every convolution pass, written once for vectors of any length and once for any processor.
//!
//! Both read *rows of pixels*: for each of `K` taps (an input channel at one kernel offset) a run of consecutive pixels at
//! `base + offsets[k]`. Vectors run along the pixels, so no layout change is needed anywhere.

/// Pixels per register tile.
pub const TILE: usize = 16;
/// Most taps of a weight-gradient tile.
const MOST_TAPS: usize = 8;

/// Six rows of pixels that [`TILE`] neighbouring tiles of 6×6 read, four pixels apart.
#[repr(align(64))]
pub struct Window(pub [[f32; Window::WIDTH]; 6]);

impl Window {
    /// Where the first tile's second pixel stands in a row: vectors from there on are aligned.
    pub const SECOND: usize = TILE;
    /// Numbers in a row.
    const WIDTH: usize = Self::SECOND + 4 * TILE + TILE;
}

impl Default for Window {
    fn default() -> Self {
        Self([[0.0; Self::WIDTH]; 6])
    }
}

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

    /// All taps, at most so many at a time.
    pub fn chunks(&self, most: usize) -> impl Iterator<Item = Taps<'_>> {
        self.taps.chunks(most).map(|offsets| Taps { offsets, reach: self.reach })
    }
}

/// Some taps of [`Offsets`].
#[derive(Clone, Copy)]
pub struct Taps<'o> {
    /// Where their pixels start.
    pub offsets: &'o [usize],
    reach: usize,
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

    /// `out[r][p] += Σ_k weights[k · outputs + r] · source[base + offsets[k] + p]` for `outputs` output channels, 1 to
    /// [`Self::most_outputs`].
    #[inline]
    pub fn correlate(
        self,
        outputs: usize,
        source: &[f32],
        base: usize,
        Taps { offsets, reach }: Taps,
        weights: &[f32],
        out: &mut [[f32; TILE]],
    ) {
        assert!((1..=self.most_outputs().min(out.len())).contains(&outputs) && weights.len() == offsets.len() * outputs);
        assert!(base + reach + TILE <= source.len());
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

    /// Transforms sixteen tiles for [`winograd`](super::winograd): the 6×6 pixels of each become 36 frequencies, at
    /// `to + frequency · step`.
    pub fn spread(self, pixels: &Window, out: &mut [f32], [to, step]: [usize; 2]) {
        assert!(to + 35 * step + TILE <= out.len());
        // SAFETY: a variant is only made after its features were found; a window holds all pixels, stores were checked above.
        unsafe {
            let (pixels, out) = (pixels.0.as_flattened().as_ptr(), out.as_mut_ptr().add(to));
            match self {
                #[cfg(target_arch = "x86_64")]
                Self::Avx512 => avx512::spread(pixels, out, step),
                #[cfg(target_arch = "x86_64")]
                Self::Avx2 => avx2::spread(pixels, out, step),
                #[cfg(target_arch = "aarch64")]
                Self::Neon => neon::spread(pixels, out, step),
                Self::Portable => portable::spread(pixels, out, step),
            }
        }
    }

    /// Transforms 4×4 results of sixteen channels, the gradient of [`Self::gather`]'s: they become 36 frequencies, `step` apart.
    pub fn spread_results(self, results: &[Outputs; 16], out: &mut [Outputs], step: usize) {
        assert!(35 * step < out.len());
        // SAFETY: a variant is only made after its features were found; `results` is whole, stores were checked above.
        unsafe {
            let (results, out, step) = (results.as_flattened().as_ptr(), out.as_flattened_mut().as_mut_ptr(), step * TILE);
            match self {
                #[cfg(target_arch = "x86_64")]
                Self::Avx512 => avx512::spread_results(results, out, step),
                #[cfg(target_arch = "x86_64")]
                Self::Avx2 => avx2::spread_results(results, out, step),
                #[cfg(target_arch = "aarch64")]
                Self::Neon => neon::spread_results(results, out, step),
                Self::Portable => portable::spread_results(results, out, step),
            }
        }
    }

    /// Transforms the sums of 36 frequencies, `step` apart, into four rows of results of sixteen neighbouring tiles.
    pub fn gather(self, sums: &[f32], step: usize) -> [[f32; 4 * TILE]; 4] {
        assert!(35 * step + TILE <= sums.len());
        let mut out = [[0.0; 4 * TILE]; 4];
        let (sums, to) = (sums.as_ptr(), out.as_flattened_mut().as_mut_ptr());
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

/// Asks the memory for `length` numbers from `start` on, as far as there are so many, that are read soon; nothing depends on it.
pub fn prefetch(data: &[f32], start: usize, length: usize) {
    #[cfg(target_arch = "x86_64")]
    for line in data[start.min(data.len())..].chunks(LINE).take(length.div_ceil(LINE)) {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        // SAFETY: every x86-64 processor has it, and it reads nothing.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(line.as_ptr().cast()) };
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (data, start, length);
}

/// Numbers that memory delivers together.
#[cfg(target_arch = "x86_64")]
const LINE: usize = 16;

/// Chains of multiply-adds that [`Instructions::multiply_adds`] runs: enough to hide the latency of one.
const CHAINS: usize = 10;

fn portable_correlate(
    outputs: usize,
    source: &[f32],
    base: usize,
    offsets: &[usize],
    weights: &[f32],
    out: &mut [[f32; TILE]],
) {
    for (r, out) in out[..outputs].iter_mut().enumerate() {
        let mut acc = [0.0; TILE];
        for (&offset, w) in offsets.iter().zip(weights.chunks_exact(outputs)) {
            acc.iter_mut().zip(&source[base + offset..][..TILE]).for_each(|(acc, x)| *acc += w[r] * x);
        }
        out.iter_mut().zip(acc).for_each(|(sum, acc)| *sum += acc);
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
        [$(#[$features:meta])*], $vector:ident, $zero:expr, $splat:ident, $load:ident, $store:ident, $tiles:path, $rows:path,
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
        /// Needs the module's features, a whole window, and stores as `Instructions::spread` has them.
        $(#[$features])*
        pub unsafe fn spread(pixels: *const f32, to: *mut f32, step: usize) {
            // SAFETY: the caller's promise.
            unsafe {
                for i in (0..TILE).step_by(LANES) {
                    let mut lines = [[$zero; 6]; 6];
                    for (y, line) in lines.iter_mut().enumerate() {
                        *line = spread_row($tiles(pixels.add(y * Window::WIDTH + Window::SECOND + 4 * i)));
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

        /// The gradient of [`gather_row`].
        #[inline]
        $(#[$features])*
        unsafe fn spread_results_row([a, b, c, d]: [$vector; 4]) -> [$vector; 6] {
            // SAFETY: the module's features are there.
            unsafe {
                let (near_even, near_odd) = (plus(a, A * A, c), plus(b, A * A, d));
                let (far_even, far_odd) = (plus(a, B * B, c), plus(b, B * B, d));
                [
                    a,
                    plus(near_even, A, near_odd),
                    plus(near_even, -A, near_odd),
                    plus(far_even, B, far_odd),
                    plus(far_even, -B, far_odd),
                    d,
                ]
            }
        }

        /// # Safety
        /// Needs the module's features, and loads and stores as `Instructions::spread_results` has them.
        $(#[$features])*
        pub unsafe fn spread_results(results: *const f32, to: *mut f32, step: usize) {
            // SAFETY: the caller's promise.
            unsafe {
                for i in (0..TILE).step_by(LANES) {
                    let mut lines = [[$zero; 6]; 4];
                    for (y, line) in lines.iter_mut().enumerate() {
                        let mut row = [$zero; 4];
                        for (x, result) in row.iter_mut().enumerate() {
                            *result = $load(results.add((y * 4 + x) * TILE + i));
                        }
                        *line = spread_results_row(row);
                    }
                    for u in 0..6 {
                        let column = [lines[0][u], lines[1][u], lines[2][u], lines[3][u]];
                        for (v, frequency) in spread_results_row(column).into_iter().enumerate() {
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
                        for (x, results) in $rows(gather_row(line)).into_iter().enumerate() {
                            $store(to.add((y * TILE + i) * 4 + x * LANES), results);
                        }
                    }
                }
            }
        }
    };
}

/// The same for one number at a time.
mod portable {
    use super::{TILE, Window};

    const LANES: usize = 1;

    winograd_loops!([], f32, 0.0, identity, load, store, tile, identity, |sum, a, b| *sum + a * b);

    fn identity<T>(value: T) -> T {
        value
    }

    /// The pixels in a row of the tile whose second one is at `from`.
    ///
    /// # Safety
    /// Needs all six.
    unsafe fn tile(from: *const f32) -> [f32; 6] {
        // SAFETY: the caller's promise.
        std::array::from_fn(|x| unsafe { from.add(x).sub(1).read() })
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

/// The pixels in a row of sixteen neighbouring tiles whose second ones start at `from`, four apart: `[x][tile]`.
///
/// # Safety
/// Needs AVX-512, 64 pixels there, one before and one behind.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f")]
unsafe fn sixteen_tiles(from: *const f32) -> [std::arch::x86_64::__m512; 6] {
    use std::arch::x86_64::*;
    // SAFETY: the caller's promise.
    let (parts, before, behind): ([__m512; 4], _, _) = unsafe {
        (
            std::array::from_fn(|i| _mm512_loadu_ps(from.add(16 * i))),
            _mm512_set1_ps(*from.sub(1)),
            _mm512_set1_ps(*from.add(64)),
        )
    };
    // Two of every four pixels, of 32 pixels at a time, then of all.
    let first = _mm512_setr_epi32(0, 4, 8, 12, 16, 20, 24, 28, 1, 5, 9, 13, 17, 21, 25, 29);
    let second = _mm512_add_epi32(first, _mm512_set1_epi32(2));
    let low = _mm512_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7, 16, 17, 18, 19, 20, 21, 22, 23);
    let high = _mm512_add_epi32(low, _mm512_set1_epi32(8));
    let pick = |a, b, which| _mm512_permutex2var_ps(a, which, b);
    let [near, far] = [first, second].map(|which| [pick(parts[0], parts[1], which), pick(parts[2], parts[3], which)]);
    let (one, two) = (pick(near[0], near[1], low), pick(near[0], near[1], high));
    let (three, four) = (pick(far[0], far[1], low), pick(far[0], far[1], high));
    let shifted = |a, b| _mm512_castsi512_ps(_mm512_alignr_epi32::<1>(_mm512_castps_si512(a), _mm512_castps_si512(b)));
    let zero = _mm512_castsi512_ps(_mm512_alignr_epi32::<15>(_mm512_castps_si512(four), _mm512_castps_si512(before)));
    [zero, one, two, three, four, shifted(behind, one)]
}

/// Four results in a row of sixteen neighbouring tiles, `[x][tile]`, as they follow each other.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f")]
fn sixteen_rows([one, two, three, four]: [std::arch::x86_64::__m512; 4]) -> [std::arch::x86_64::__m512; 4] {
    use std::arch::x86_64::*;
    let pairs = [(one, two), (three, four)].map(|(a, b)| (_mm512_unpacklo_ps(a, b), _mm512_unpackhi_ps(a, b)));
    // Quarter `q` has the four results of tile 4·q + i.
    let tiles = |low: __m512, high: __m512| {
        let (low, high) = (_mm512_castps_pd(low), _mm512_castps_pd(high));
        [_mm512_unpacklo_pd(low, high), _mm512_unpackhi_pd(low, high)].map(|v| _mm512_castpd_ps(v))
    };
    let ([a, b], [c, d]) = (tiles(pairs[0].0, pairs[1].0), tiles(pairs[0].1, pairs[1].1));
    let halves = |a, b| (_mm512_shuffle_f32x4::<0x88>(a, b), _mm512_shuffle_f32x4::<0xdd>(a, b));
    let ((ab_even, ab_odd), (cd_even, cd_odd)) = (halves(a, b), halves(c, d));
    let whole = |ab, cd| [_mm512_shuffle_f32x4::<0x88>(ab, cd), _mm512_shuffle_f32x4::<0xdd>(ab, cd)];
    let ([zeroth, second], [first, third]) = (whole(ab_even, cd_even), whole(ab_odd, cd_odd));
    [zeroth, first, second, third]
}

/// The same for eight tiles.
///
/// # Safety
/// Needs AVX2, 32 pixels there, one before and one behind.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
unsafe fn eight_tiles(from: *const f32) -> [std::arch::x86_64::__m256; 6] {
    use std::arch::x86_64::*;
    // Four pixels of tile `i` and of tile `i + 4`.
    // SAFETY: the caller's promise.
    let [a, b, c, d] = std::array::from_fn(|i| unsafe { _mm256_loadu2_m128(from.add(4 * i + 16), from.add(4 * i)) });
    // SAFETY: the caller's promise.
    let (before, behind) = unsafe { (_mm256_set1_ps(*from.sub(1)), _mm256_set1_ps(*from.add(32))) };
    let [(a, b), (c, d)] = [(a, b), (c, d)].map(|(a, b)| (_mm256_unpacklo_ps(a, b), _mm256_unpackhi_ps(a, b)));
    let [(one, two), (three, four)] =
        [(a, c), (b, d)].map(|(a, b)| (_mm256_shuffle_ps::<0x44>(a, b), _mm256_shuffle_ps::<0xee>(a, b)));
    // A vector's last `4 − n / 4` numbers in each half, and the first ones of another's.
    let joined = |a, b| (_mm256_castps_si256(a), _mm256_castps_si256(b));
    let (a, b) = joined(four, _mm256_insertf128_ps::<1>(before, _mm256_castps256_ps128(four)));
    let zero = _mm256_castsi256_ps(_mm256_alignr_epi8::<12>(a, b));
    let (a, b) = joined(_mm256_permute2f128_ps::<0x21>(one, behind), one);
    [zero, one, two, three, four, _mm256_castsi256_ps(_mm256_alignr_epi8::<4>(a, b))]
}

/// See [`sixteen_rows`].
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn eight_rows([one, two, three, four]: [std::arch::x86_64::__m256; 4]) -> [std::arch::x86_64::__m256; 4] {
    use std::arch::x86_64::*;
    let [(a, b), (c, d)] = [(one, two), (three, four)].map(|(a, b)| (_mm256_unpacklo_ps(a, b), _mm256_unpackhi_ps(a, b)));
    // Each half has the four results of tile `i` or `i + 4`.
    let [(zero, one), (two, three)] =
        [(a, c), (b, d)].map(|(a, b)| (_mm256_shuffle_ps::<0x44>(a, b), _mm256_shuffle_ps::<0xee>(a, b)));
    let (low, high) = (|a, b| _mm256_permute2f128_ps::<0x20>(a, b), |a, b| _mm256_permute2f128_ps::<0x31>(a, b));
    [low(zero, one), low(two, three), high(zero, one), high(two, three)]
}

/// The same for four tiles.
///
/// # Safety
/// Needs NEON, 16 pixels there, one before and one behind.
#[cfg(target_arch = "aarch64")]
#[target_feature(enable = "neon")]
unsafe fn four_tiles(from: *const f32) -> [std::arch::aarch64::float32x4_t; 6] {
    use std::arch::aarch64::*;
    // SAFETY: the caller's promise.
    let (float32x4x4_t(one, two, three, four), before, behind) =
        unsafe { (vld4q_f32(from), vdupq_n_f32(*from.sub(1)), vdupq_n_f32(*from.add(16))) };
    [vextq_f32::<3>(before, four), one, two, three, four, vextq_f32::<1>(one, behind)]
}

/// See [`sixteen_rows`].
#[cfg(target_arch = "aarch64")]
#[target_feature(enable = "neon")]
fn four_rows([one, two, three, four]: [std::arch::aarch64::float32x4_t; 4]) -> [std::arch::aarch64::float32x4_t; 4] {
    use std::arch::aarch64::*;
    let pairs = |a, b| [vtrn1q_f32(a, b), vtrn2q_f32(a, b)].map(|v| vreinterpretq_f64_f32(v));
    let ([zero, one], [two, three]) = (pairs(one, two), pairs(three, four));
    let whole = [vtrn1q_f64(zero, two), vtrn1q_f64(one, three), vtrn2q_f64(zero, two), vtrn2q_f64(one, three)];
    whole.map(|v| vreinterpretq_f32_f64(v))
}

/// The loops for one kind of vector. `$outputs` counts the output channels of a tile up to the most.
macro_rules! vector_loops {
    (
        $module:ident, $features:tt, $vector:ident, $lanes:literal, $most:literal, [$($outputs:literal)*], $taps:literal,
        $zero:expr, $splat:ident, $load:ident, $store:ident, $tiles:ident, $rows:ident,
        |$sum:ident, $a:ident, $b:ident| $multiply_add:expr
    ) => {
        mod $module {
            #[cfg(target_arch = "aarch64")]
            use std::arch::aarch64::*;
            #[cfg(target_arch = "x86_64")]
            use std::arch::x86_64::*;

            use super::{CHAINS, Outputs, TILE, Window};

            const LANES: usize = $lanes;
            const VECTORS: usize = TILE / LANES;
            pub const MOST_OUTPUTS: usize = $most;
            pub const TAPS: usize = $taps;

            /// # Safety
            /// Needs the module's features, `base + offset + TILE <= source.len()` for every offset, and `outputs` rows of `out` and
            /// weights per offset, 1 to [`MOST_OUTPUTS`].
            #[target_feature(enable = $features)]
            pub unsafe fn correlate(
                outputs: usize,
                source: &[f32],
                base: usize,
                offsets: &[usize],
                weights: &[f32],
                out: &mut [[f32; TILE]],
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
                offsets: &[usize],
                weights: &[f32],
                out: &mut [[f32; TILE]],
            ) {
                // SAFETY: `correlate`'s promise covers every load and the `R` whole rows of `out`.
                unsafe {
                    let start = source.as_ptr().add(base);
                    let mut weight = weights.as_ptr();
                    let mut acc: [[$vector; VECTORS]; R] = [[$zero; VECTORS]; R];
                    for &offset in offsets {
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
                    add_rows(out, acc);
                }
            }

            /// Adds sums to sums: over thousands of terms, one running sum would lose digits.
            #[inline]
            #[target_feature(enable = $features)]
            unsafe fn add_rows<const R: usize>(sums: &mut [Outputs], acc: [[$vector; VECTORS]; R]) {
                // SAFETY: the module's features are there; rows are whole.
                unsafe {
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
                    add_rows(sums, acc);
                }
            }

            winograd_loops!([#[target_feature(enable = $features)]], $vector, $zero, $splat, $load, $store, super::$tiles, super::$rows, |$sum, $a, $b| $multiply_add);

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
    avx512, "avx512f", __m512, 16, 16, [1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16], 8,
    _mm512_setzero_ps(), _mm512_set1_ps, _mm512_loadu_ps, _mm512_storeu_ps, sixteen_tiles, sixteen_rows,
    |sum, a, b| _mm512_fmadd_ps(a, b, *sum)
);
// 6 × 16 accumulators fill twelve of sixteen registers.
#[cfg(target_arch = "x86_64")]
vector_loops!(
    avx2, "avx2,fma", __m256, 8, 6, [1 2 3 4 5 6], 6,
    _mm256_setzero_ps(), _mm256_set1_ps, _mm256_loadu_ps, _mm256_storeu_ps, eight_tiles, eight_rows,
    |sum, a, b| _mm256_fmadd_ps(a, b, *sum)
);
// 6 × 16 accumulators fill 24 of 32 registers.
#[cfg(target_arch = "aarch64")]
vector_loops!(
    neon, "neon", float32x4_t, 4, 6, [1 2 3 4 5 6], 6,
    vdupq_n_f32(0.0), vdupq_n_f32, vld1q_f32, vst1q_f32, four_tiles, four_rows,
    |sum, a, b| vfmaq_f32(*sum, a, b)
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
                let mut found = [[0.25; TILE]; 16];
                for (taps, weights) in offsets.chunks(3).zip(weights.chunks(3 * outputs)) {
                    route.correlate(outputs, &source, 5, taps, weights, &mut found);
                }
                for (r, p) in (0..outputs * TILE).map(|i| (i / TILE, i % TILE)) {
                    let term = |k: usize| weights[k * outputs + r] * source[5 + offsets.at(k) + p];
                    let expected = 0.25 + (0..offsets.len()).map(term).sum::<f32>();
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
    fn all_routes_transform_alike() {
        let mut window = Window::default();
        window.0.as_flattened_mut().iter_mut().enumerate().for_each(|(i, pixel)| *pixel = (i as f32 * 0.37).sin());
        let results: [Outputs; 16] = std::array::from_fn(|i| std::array::from_fn(|o| ((i * 16 + o) as f32).cos()));
        let step = TILE + 3;
        let all = |route: Instructions| {
            let mut frequencies = vec![0.0; 36 * step];
            route.spread(&window, &mut frequencies, [1, step]);
            let mut of_results = vec![[0.0; TILE]; 72];
            route.spread_results(&results, &mut of_results, 2);
            [frequencies.clone(), of_results.into_flattened(), route.gather(&frequencies, step).as_flattened().to_vec()]
        };
        let expected = all(Instructions::Portable);
        for route in Instructions::available() {
            for (found, expected) in all(route).iter().zip(&expected) {
                let close = found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-5 * b.abs().max(10.0));
                assert!(found.len() == expected.len() && close, "{route:?}");
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
