//! Which instructions the processor has, and the loops by them.

#[cfg(target_arch = "aarch64")]
use super::neon;
use super::{Outputs, TILE, Taps, Window, portable};
#[cfg(target_arch = "x86_64")]
use super::{avx2, avx512};

/// What the module of some instructions calls so.
macro_rules! of {
    ($instructions:expr, $($item:tt)*) => {
        match $instructions {
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => avx512::$($item)*,
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => avx2::$($item)*,
            #[cfg(target_arch = "aarch64")]
            Self::Neon => neon::$($item)*,
            Self::Portable => portable::$($item)*,
        }
    };
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
        of!(self, MOST_OUTPUTS)
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
        unsafe { of!(self, correlate(outputs, source, base, offsets, weights, out)) }
    }

    /// Taps of a weight-gradient tile.
    pub fn taps(self) -> usize {
        of!(self, TAPS)
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
        unsafe { of!(self, outer(source, offsets, lines, length, gradient, sums)) }
    }

    /// Transforms sixteen tiles for [`winograd`](crate::kernel::winograd): the 6×6 pixels of each become 36 frequencies, at
    /// `to + frequency · step`.
    pub fn spread(self, pixels: &Window, out: &mut [f32], [to, step]: [usize; 2]) {
        assert!(to + 35 * step + TILE <= out.len());
        // SAFETY: a variant is only made after its features were found; a window holds all pixels, stores were checked above.
        unsafe {
            let (pixels, out) = (pixels.0.as_flattened().as_ptr(), out.as_mut_ptr().add(to));
            of!(self, spread(pixels, out, step))
        }
    }

    /// Transforms 4×4 results of sixteen channels, the gradient of [`Self::gather`]'s: they become 36 frequencies, `step` apart.
    pub fn spread_results(self, results: &[Outputs; 16], out: &mut [Outputs], step: usize) {
        assert!(35 * step < out.len());
        // SAFETY: a variant is only made after its features were found; `results` is whole, stores were checked above.
        unsafe {
            let (results, out, step) = (results.as_flattened().as_ptr(), out.as_flattened_mut().as_mut_ptr(), step * TILE);
            of!(self, spread_results(results, out, step))
        }
    }

    /// Transforms the sums of 36 frequencies, `step` apart, into four rows of results of sixteen neighbouring tiles.
    pub fn gather(self, sums: &[f32], step: usize) -> [[f32; 4 * TILE]; 4] {
        assert!(35 * step + TILE <= sums.len());
        let mut out = [[0.0; 4 * TILE]; 4];
        let (sums, to) = (sums.as_ptr(), out.as_flattened_mut().as_mut_ptr());
        // SAFETY: a variant is only made after its features were found; loads were checked above, stores fill `out`.
        unsafe { of!(self, gather(sums, step, to)) }
        out
    }

    /// Runs ten chains of multiply-adds; what they sum up to, and operations per round.
    pub fn multiply_adds(self, factor: f32, rounds: usize) -> (f32, usize) {
        // SAFETY: a variant is only made after its features were found.
        unsafe { of!(self, multiply_adds(factor, rounds)) }
    }
}
