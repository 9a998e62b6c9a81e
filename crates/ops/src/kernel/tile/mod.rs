//! The two inner loops of every convolution pass, written once for vectors of any length ([`loops`], [`transforms`]) and once for
//! any processor ([`portable`]); [`Instructions`] chooses.
//!
//! Both read *rows of pixels*: for each of `K` taps (an input channel at one kernel offset) a run of consecutive pixels at
//! `base + offsets[k]`. Vectors run along the pixels, so no layout change is needed anywhere.

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
mod instructions;
mod loops;
#[cfg(target_arch = "aarch64")]
mod neon;
mod portable;
#[cfg(test)]
mod tests;
mod transforms;

pub use instructions::Instructions;

/// Pixels per register tile.
pub const TILE: usize = 16;

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

/// Winograd's points, beside 0 and infinity, are ±A and ±B. These lose less than a digit, the usual ±1 and ±2 four times as much;
/// all factors are exact.
pub const POINTS: [f32; 2] = [0.75, 1.5];
