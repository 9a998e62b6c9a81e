//! Transfer functions between linear light and stored values.

/// Exponent of the display encoding that the paper's frames use (§4: power 1/2.2).
pub const GAMMA: f32 = 2.2;

/// Linear light to the gamma-encoded value of a frame; negative light becomes 0.
pub fn gamma_encode(linear: f32) -> f32 {
    linear.max(0.0).powf(1.0 / GAMMA)
}

/// Gamma-encoded frame value to linear light.
pub fn gamma_decode(encoded: f32) -> f32 {
    encoded.max(0.0).powf(GAMMA)
}

/// sRGB-encoded value to linear (IEC 61966-2-1), for colour maps of material libraries.
pub fn srgb_to_linear(encoded: f32) -> f32 {
    if encoded <= 0.04045 { encoded / 12.92 } else { ((encoded + 0.055) / 1.055).powf(2.4) }
}

/// Linear value to sRGB (IEC 61966-2-1).
pub fn linear_to_srgb(linear: f32) -> f32 {
    if linear <= 0.003_130_8 { linear * 12.92 } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn encodings_are_inverse_and_hit_known_values() {
        for i in 0..=100 {
            let v = i as f32 / 100.0;
            assert!((gamma_decode(gamma_encode(v)) - v).abs() < 1e-5);
            assert!((linear_to_srgb(srgb_to_linear(v)) - v).abs() < 1e-5);
        }
        assert!((srgb_to_linear(0.5) - 0.214_041).abs() < 1e-5);
        assert!((gamma_encode(0.18) - 0.458_66).abs() < 1e-4);
        assert_eq!(gamma_encode(-1.0), 0.0);
    }
}
