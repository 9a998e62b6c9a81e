//! Branch-free `f32` polynomials for ln and 2^x: unlike the standard library's calls they vectorise.

/// Natural logarithm of a positive, finite, normal number; relative error of ln below 3e-7 away from 1, absolute below
/// 1e-7 near it.
///
/// # Source
/// Cephes `logf` (Moshier), its polynomial on [√½, √2).
#[inline(always)]
pub fn ln(x: f32) -> f32 {
    let bits = x.to_bits();
    // Shift so that the mantissa lies in [√½, √2) and the exponent is rounded accordingly.
    let shifted = bits.wrapping_sub(0x3f35_04f3);
    let exponent = (shifted as i32) >> 23;
    let mantissa = f32::from_bits((shifted & 0x007f_ffff).wrapping_add(0x3f35_04f3));
    let e = exponent as f32;
    let f = mantissa - 1.0;
    let z = f * f;
    let mut p = 7.037_683_6e-2;
    for c in [
        -1.151_461e-1,
        1.167_699_9e-1,
        -1.242_014_1e-1,
        1.424_932_3e-1,
        -1.666_805_7e-1,
        2.000_071_4e-1,
        -2.499_999_4e-1,
        3.333_333e-1,
    ] {
        p = p * f + c;
    }
    let tail = f * z * p - 2.121_944_4e-4 * e - 0.5 * z;
    f + tail + 0.693_359_4 * e
}

/// 2^x for x in [−126, 127] (clamped to it); relative error below 3e-7.
#[inline(always)]
pub fn exp2(x: f32) -> f32 {
    // 1.5·2²³: the last bits of a sum with it are the nearest whole number. A cast saturates, which vectors can't.
    const ROUND: f32 = 12_582_912.0;
    let sum = x.clamp(-126.0, 127.0) + ROUND;
    let whole = sum.to_bits().wrapping_sub(ROUND.to_bits());
    let f = (x.clamp(-126.0, 127.0) - (sum - ROUND)) * std::f32::consts::LN_2; // |f| ≤ ln 2 / 2
    let mut p = 1.0 / 5040.0;
    for c in [1.0 / 720.0, 1.0 / 120.0, 1.0 / 24.0, 1.0 / 6.0, 0.5, 1.0, 1.0] {
        p = p * f + c;
    }
    p * f32::from_bits(whole.wrapping_add(127) << 23)
}

/// x^p for x ≥ 0 (0 where x = 0); relative error below 1e-6 for |p| ≤ 2.2 and x in [1e-6, 1e6].
#[inline(always)]
pub fn power(x: f32, p: f32) -> f32 {
    let value = exp2(ln(x.max(1e-30)) * std::f32::consts::LOG2_E * p);
    if x > 0.0 { value } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn polynomials_match_the_standard_library() {
        for i in 0..40_000 {
            let x = (1e-6f64 * 1.001f64.powi(i)).min(1e12) as f32;
            let exact = f64::from(x).ln();
            assert!((f64::from(ln(x)) - exact).abs() < 2e-7 * exact.abs().max(1.0), "ln {x}");
            let y = (i as f32 - 20_000.0) / 200.0;
            let exact = f64::from(y).exp2();
            assert!((f64::from(exp2(y)) / exact - 1.0).abs() < 4e-7, "2^{y}");
        }
        assert_eq!(ln(1.0), 0.0);
        assert_eq!(power(0.0, 0.45), 0.0);
        assert!((power(0.18, 1.0 / 2.2) - 0.18f32.powf(1.0 / 2.2)).abs() < 1e-6);
    }
}
