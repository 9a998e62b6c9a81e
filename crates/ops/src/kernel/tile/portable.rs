//! The loops as any processor runs them, vectorised as far as the compiler's baseline goes.

use super::transforms::winograd_transforms;
use super::{CHAINS, Outputs, TILE, Window};

/// Output channels of a register tile.
pub const MOST_OUTPUTS: usize = 6;
/// Taps of a weight-gradient tile.
pub const TAPS: usize = 8;
const LANES: usize = 1;

/// See `Instructions::correlate`.
pub fn correlate(outputs: usize, source: &[f32], base: usize, offsets: &[usize], weights: &[f32], out: &mut [[f32; TILE]]) {
    for (r, out) in out[..outputs].iter_mut().enumerate() {
        let mut acc = [0.0; TILE];
        for (&offset, w) in offsets.iter().zip(weights.chunks_exact(outputs)) {
            acc.iter_mut().zip(&source[base + offset..][..TILE]).for_each(|(acc, x)| *acc += w[r] * x);
        }
        out.iter_mut().zip(acc).for_each(|(sum, acc)| *sum += acc);
    }
}

/// See `Instructions::outer`.
pub fn outer(source: &[f32], offsets: &[usize], lines: &[usize], length: usize, gradient: &[Outputs], sums: &mut [Outputs]) {
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

/// See `Instructions::multiply_adds`.
pub fn multiply_adds(factor: f32, rounds: usize) -> (f32, usize) {
    let mut chains = [[1.0f32; 8]; CHAINS];
    for _ in 0..rounds {
        chains.as_flattened_mut().iter_mut().for_each(|lane| *lane = *lane * factor + 0.5);
    }
    (chains.as_flattened().iter().sum(), 2 * 8 * CHAINS)
}

winograd_transforms!([], f32, 0.0, identity, load, store, tile, identity, |sum, a, b| *sum + a * b);

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
