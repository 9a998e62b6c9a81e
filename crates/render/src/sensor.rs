//! The camera's sensor: clipping, encoding and quantisation (paper §4).

use ops::colour::GAMMA;
use ops::planes::Planes;
use rayon::prelude::*;

/// Linear light to the frame a program reads: clip to [0, 1], power 1/2.2, 8 bits. Noise is light and is added before.
///
/// Values come back as multiples of 1/255.
pub fn expose(linear: &Planes) -> Planes {
    let mut frame = Planes::new(linear.channels, linear.height, linear.width);
    let encoder = Encoder::shared();
    let rows = frame.data.par_chunks_mut(linear.width).zip(linear.data.par_chunks(linear.width));
    rows.for_each(|(out, light)| out.iter_mut().zip(light).for_each(|(value, &x)| *value = encoder.encode(x)));
    frame
}

/// Linear value to 8-bit code without a power or a branch per pixel: by a table over √x, in which the codes' thresholds lie
/// almost evenly, and one comparison.
struct Encoder {
    /// The code at the lower end of each bin.
    guess: Vec<u8>,
    /// The light from which on the code is at least k; code 256 is never reached.
    threshold: [f32; 257],
    /// The code as a share of 255.
    share: [f32; 256],
}

impl Encoder {
    /// Bins over √x from 0 to 1: narrower than the distance between two thresholds, so that none holds two.
    const BINS: usize = 1024;

    fn shared() -> &'static Self {
        static ENCODER: std::sync::OnceLock<Encoder> = std::sync::OnceLock::new();
        ENCODER.get_or_init(Self::new)
    }

    fn new() -> Self {
        let mut threshold = [f32::INFINITY; 257];
        for (k, t) in threshold.iter_mut().enumerate().take(256) {
            *t = if k == 0 { 0.0 } else { ((k as f32 - 0.5) / 255.0).powf(GAMMA) };
        }
        // A root that was rounded up may reach a bin's lower end from below.
        let lower = |bin: usize| ((bin as f32 - 0.01) / Self::BINS as f32).max(0.0).powi(2);
        let code = |x: f32| threshold[1..256].partition_point(|t| *t <= x) as u8;
        let guess = (0..=Self::BINS).map(|bin| code(lower(bin))).collect();
        Self { guess, threshold, share: std::array::from_fn(|k| k as f32 / 255.0) }
    }

    /// round(255·clip(x)^(1/2.2)).
    #[inline]
    fn code(&self, x: f32) -> usize {
        let x = x.clamp(0.0, 1.0);
        let guess = usize::from(self.guess[(x.sqrt() * Self::BINS as f32) as usize]);
        guess + usize::from(x >= self.threshold[guess + 1])
    }

    /// The code as a share of 255.
    #[inline]
    fn encode(&self, x: f32) -> f32 {
        self.share[self.code(x)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ops::colour::gamma_encode;

    #[test]
    fn codes_are_the_rounded_encoding() {
        let encoder = Encoder::new();
        for i in 0..=100_000 {
            let x = i as f32 / 100_000.0;
            let exact = f64::from(x).powf(1.0 / 2.2) * 255.0;
            assert!((encoder.code(x) as f64 - exact).abs() < 0.5001, "{x}");
        }
        // At every threshold and the numbers beside it, where the guess could be two codes off.
        for (k, &t) in encoder.threshold[1..256].iter().enumerate() {
            assert_eq!((encoder.code(t.next_down()), encoder.code(t)), (k, k + 1));
        }
        assert_eq!(encoder.code(-3.0), 0);
        assert_eq!(encoder.code(7.0), 255);
    }

    #[test]
    fn frames_hold_multiples_of_a_code() {
        let light = Planes::from_vec(3, 1, 2, vec![0.2, -1.0, 0.5, 2.0, 0.0, 1.0]);
        let grey = |x: f32| (gamma_encode(x) * 255.0).round() / 255.0;
        assert_eq!(expose(&light).data, [grey(0.2), 0.0, grey(0.5), 1.0, 0.0, 1.0]);
    }
}
