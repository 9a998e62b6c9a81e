//! What the numbers of map files mean: linear light, directions, shares.

use crate::image_io::Samples;

use super::stored::Precision;

/// Linear light of every stored value, so that decoding 16 million texels takes no powers.
pub(super) struct ColourTable(Vec<f32>);

impl ColourTable {
    /// `decode` turns an integer, as a share of the largest one, into linear light. Floats of an EXR are linear already.
    pub(super) fn new(samples: &Samples, decode: fn(f32) -> f32) -> Self {
        let steps = match samples {
            Samples::Eight(_) => 256,
            Samples::Sixteen(_) => 65536,
            Samples::Linear(_) => 0,
        };
        Self((0..steps).map(|i| decode(i as f32 / (steps - 1) as f32)).collect())
    }

    /// The colour whose red is number `first` and that has `channels` (1 or 3) numbers.
    pub(super) fn rgb(&self, samples: &Samples, first: usize, channels: usize) -> [f32; 3] {
        std::array::from_fn(|c| {
            let index = first + c.min(channels - 1);
            match samples {
                Samples::Eight(v) => self.0[usize::from(v[index])],
                Samples::Sixteen(v) => self.0[usize::from(v[index])],
                Samples::Linear(v) => v[index].clamp(0.0, 1.0),
            }
        })
    }
}

/// The normal whose x is number `first`; not of unit length. `signed`: floats hold −1…1 instead of 0…1.
pub(super) fn normal(samples: &Samples, first: usize, signed: bool) -> [f32; 3] {
    let [x, y, z] = std::array::from_fn(|c| {
        // 128 of 255 (32768 of 65535) is what every tool writes for "flat", so it is exactly 0 here.
        match samples {
            Samples::Eight(v) => (f32::from(v[first + c]) - 128.0) / 127.0,
            Samples::Sixteen(v) => (f32::from(v[first + c]) - 32768.0) / 32767.0,
            Samples::Linear(v) if signed => v[first + c],
            Samples::Linear(v) => 2.0 * v[first + c] - 1.0,
        }
    });
    // Two-channel normal maps leave blue empty.
    let z = if z > 0.0 { z } else { (1.0 - x * x - y * y).max(0.0).sqrt() };
    [x, y, z]
}

/// The precision that keeps all of these files' steps.
pub(super) fn precision<'a>(mut files: impl Iterator<Item = &'a Samples>) -> Precision {
    if files.all(|samples| matches!(samples, Samples::Eight(_))) { Precision::Eight } else { Precision::Sixteen }
}
