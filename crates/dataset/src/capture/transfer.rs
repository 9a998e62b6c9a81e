//! Transfer functions of video: what light a stored value of an HDR video stands for.

use super::collect::light_table;

/// Encoded value of reference white in hybrid log-gamma (ITU-R BT.2408).
const HLG_WHITE: f64 = 0.75;
/// Luminance of reference white in PQ video (ITU-R BT.2408), in cd/m².
const PQ_WHITE_NITS: f64 = 203.0;

/// How a video encodes light.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Transfer {
    /// Gamma-like, for a display: sRGB, BT.709 and everything untagged.
    Display,
    /// Hybrid log-gamma (iPhone HDR).
    Hlg,
    /// Perceptual quantiser (SMPTE ST 2084).
    Pq,
}

impl Transfer {
    /// From ffprobe's `color_transfer`.
    pub(super) fn from_name(name: &str) -> Self {
        match name {
            "arib-std-b67" => Self::Hlg,
            "smpte2084" => Self::Pq,
            _ => Self::Display,
        }
    }

    /// Light of every integer up to `max`; reference white is 1, and brighter light is kept for the caller to clip.
    pub(super) fn table(self, max: usize) -> Vec<f32> {
        let of = |f: fn(f64) -> f64| (0..=max).map(|i| f(i as f64 / max as f64) as f32).collect();
        match self {
            Self::Display => light_table(max),
            Self::Hlg => of(|v| hlg(v) / hlg(HLG_WHITE)),
            Self::Pq => of(|v| pq_nits(v) / PQ_WHITE_NITS),
        }
    }
}

/// Light in the primaries of HDR video (BT.2020) to those of frames (BT.709, sRGB), from ITU-R BT.2407.
const BT2020_TO_BT709: [[f32; 3]; 3] =
    [[1.660_5, -0.587_6, -0.072_8], [-0.124_6, 1.132_9, -0.008_3], [-0.018_2, -0.100_6, 1.118_7]];

impl Transfer {
    /// The matrix that takes the video's primaries to those of frames, where they differ.
    pub(super) fn primaries(self) -> Option<[[f32; 3]; 3]> {
        (self != Self::Display).then_some(BT2020_TO_BT709)
    }
}

/// Inverse of the HLG transfer (ITU-R BT.2100, table 5): scene light in \[0, 1\].
fn hlg(v: f64) -> f64 {
    const A: f64 = 0.178_832_77;
    const B: f64 = 1.0 - 4.0 * A;
    let c = 0.5 - A * (4.0 * A).ln();
    if v <= 0.5 { v * v / 3.0 } else { (((v - c) / A).exp() + B) / 12.0 }
}

/// The PQ transfer (ITU-R BT.2100, table 4).
///
/// # Units
/// cd/m².
fn pq_nits(v: f64) -> f64 {
    const M1: f64 = 2610.0 / 16384.0;
    const M2: f64 = 2523.0 / 4096.0 * 128.0;
    const C1: f64 = 3424.0 / 4096.0;
    const C2: f64 = 2413.0 / 4096.0 * 32.0;
    const C3: f64 = 2392.0 / 4096.0 * 32.0;
    let root = v.powf(1.0 / M2);
    10_000.0 * ((root - C1).max(0.0) / (C2 - C3 * root)).powf(1.0 / M1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_values() {
        assert!((hlg(0.5) - 1.0 / 12.0).abs() < 1e-9 && (hlg(1.0) - 1.0).abs() < 1e-6);
        // BT.2408: 203 cd/m² is 58 % PQ.
        assert!((pq_nits(0.5807) - 203.0).abs() < 1.0 && (pq_nits(1.0) - 10_000.0).abs() < 1e-6);
        assert!((Transfer::Hlg.table(100)[75] - 1.0).abs() < 1e-6);
        for row in BT2020_TO_BT709 {
            assert!((row.iter().sum::<f32>() - 1.0).abs() < 2e-4, "white stays white");
        }
        assert_eq!(Transfer::from_name("bt709"), Transfer::Display);
        assert!(Transfer::Display.table(255)[255] == 1.0);
    }
}
