//! The camera's sensor: clipping, encoding and quantisation (paper §4).

use ops::colour::GAMMA;
use ops::planes::Planes;
use rayon::prelude::*;

use crate::block::LANES;

/// Linear light to the frame a program reads: clip to [0, 1], power 1/2.2, 8 bits. Noise is light and is added before.
///
/// Values come back as multiples of 1/255.
pub fn expose(linear: &Planes) -> Planes {
    let mut frame = linear.clone();
    frame.data.par_chunks_mut(linear.width).for_each(expose_row);
    frame
}

/// [`expose`] in place.
#[inline]
pub fn expose_row(light: &mut [f32]) {
    let encoder = Encoder::shared();
    let (blocks, rest) = light.as_chunks_mut::<LANES>();
    blocks.iter_mut().for_each(|block| encoder.encode(block));
    for value in rest {
        let mut block = [*value; LANES];
        encoder.encode(&mut block);
        *value = block[0];
    }
}

/// Linear value to 8-bit code without a power or a branch per pixel: by a table over √x, in which the codes' thresholds lie
/// almost evenly, and one comparison.
struct Encoder {
    /// The code at the lower end of each bin, and the light from which on it is the next one.
    bins: [Bin; Self::BINS + 1],
    /// The code as a share of 255.
    share: [f32; 256],
}

#[derive(Clone, Copy)]
struct Bin {
    code: u32,
    next: f32,
}

impl Encoder {
    /// Bins over √x from 0 to 1, each around a multiple of 1/1024: narrower than the distance between two thresholds, so that none
    /// holds two.
    const BINS: usize = 1024;

    fn shared() -> &'static Self {
        static ENCODER: std::sync::OnceLock<Encoder> = std::sync::OnceLock::new();
        ENCODER.get_or_init(Self::new)
    }

    fn new() -> Self {
        let threshold = |code: u32| ((code as f32 - 0.5) / 255.0).powf(GAMMA);
        let thresholds: Vec<f32> = (1..256).map(threshold).collect();
        // A root that was rounded up may reach a bin's lower end from below.
        let lower = |bin: usize| ((bin as f32 - 0.51) / Self::BINS as f32).max(0.0).powi(2);
        let bin = |bin: usize| {
            let code = thresholds.partition_point(|t| *t <= lower(bin));
            Bin { code: code as u32, next: thresholds.get(code).copied().unwrap_or(f32::INFINITY) }
        };
        Self { bins: std::array::from_fn(bin), share: std::array::from_fn(|k| k as f32 / 255.0) }
    }

    /// round(255·clip(x)^(1/2.2)) of every value.
    #[inline(always)]
    fn codes(&self, light: &[f32; LANES]) -> [usize; LANES] {
        // 2²³: the last bits of a sum with it are the nearest whole number.
        const ROUND: f32 = 8_388_608.0;
        let (mut clipped, mut bins) = ([0.0; LANES], [0; LANES]);
        for k in 0..LANES {
            // NaN is dark.
            clipped[k] = if light[k] > 0.0 { light[k].min(1.0) } else { 0.0 };
            bins[k] = (clipped[k].sqrt() * Self::BINS as f32 + ROUND).to_bits() - ROUND.to_bits();
        }
        std::array::from_fn(|k| {
            let Bin { code, next } = self.bins[(bins[k] as usize).min(Self::BINS)];
            code as usize + usize::from(clipped[k] >= next)
        })
    }

    /// Codes as shares of 255.
    #[inline(always)]
    fn encode(&self, light: &mut [f32; LANES]) {
        let codes = self.codes(light);
        for k in 0..LANES {
            light[k] = self.share[codes[k].min(255)];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ops::colour::gamma_encode;

    #[test]
    fn codes_are_the_rounded_encoding() {
        let encoder = Encoder::new();
        let code = |x: f32| encoder.codes(&[x; LANES])[0];
        for i in 0..=100_000 {
            let x = i as f32 / 100_000.0;
            let exact = f64::from(x).powf(1.0 / 2.2) * 255.0;
            assert!((code(x) as f64 - exact).abs() < 0.5001, "{x}");
        }
        // At every threshold and the numbers beside it, where the guess could be two codes off.
        for k in 0..255 {
            let t = ((k as f32 + 0.5) / 255.0).powf(GAMMA);
            assert_eq!((code(t.next_down()), code(t)), (k, k + 1));
        }
        assert_eq!((code(-3.0), code(7.0), code(f32::NAN)), (0, 255, 0));
    }

    #[test]
    fn frames_hold_multiples_of_a_code() {
        let light = Planes::from_vec(3, 1, 2, vec![0.2, -1.0, 0.5, 2.0, 0.0, 1.0]);
        let grey = |x: f32| (gamma_encode(x) * 255.0).round() / 255.0;
        assert_eq!(expose(&light).data, [grey(0.2), 0.0, grey(0.5), 1.0, 0.0, 1.0]);
        // A row longer than a block.
        let ramp: Vec<f32> = (0..LANES + 5).map(|x| x as f32 / 20.0).collect();
        let expected: Vec<f32> = ramp.iter().map(|x| grey(x.min(1.0))).collect();
        assert_eq!(expose(&Planes::from_vec(1, 1, LANES + 5, ramp)).data, expected);
    }
}
