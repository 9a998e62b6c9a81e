//! The specular lobe D·G/(4 n·wi n·wo) and its derivatives, branch-free.

use crate::brdf::masking::smith_factor;
use crate::brdf::{masking, ndf};

/// What the lobe depends on at one pixel.
#[derive(Clone, Copy)]
pub struct LobeInput {
    /// alpha = r², r already at least [`crate::brdf::ROUGHNESS_MIN`].
    pub alpha: f32,
    /// n·wi before clamping.
    pub nl: f32,
    /// n·wo before clamping.
    pub nv: f32,
    /// n·h.
    pub nh: f32,
    /// |n×h|².
    pub sin2: f32,
}

/// The lobe and its derivatives with respect to each field of [`LobeInput`].
#[derive(Clone, Copy)]
pub struct LobeSlope {
    /// The lobe.
    pub value: f32,
    /// ∂/∂alpha.
    pub alpha: f32,
    /// ∂/∂n·wi.
    pub nl: f32,
    /// ∂/∂n·wo.
    pub nv: f32,
    /// ∂/∂n·h.
    pub nh: f32,
    /// ∂/∂|n×h|².
    pub sin2: f32,
}

#[inline(always)]
fn positive(x: f32) -> f32 {
    if x > 0.0 { 1.0 } else { 0.0 }
}

/// The lobe's value: `ggx` or, if `CLAMPED`, `ggx-clamped`.
#[inline(always)]
pub fn value<const CLAMPED: bool>(i: LobeInput) -> f32 {
    let (nl, nv) = (i.nl.max(0.0), i.nv.max(0.0));
    if CLAMPED {
        0.25 * ndf::ggx_clamped(i.alpha, i.nh) * masking::clamped_factor(i.alpha, nl) * masking::clamped_factor(i.alpha, nv)
    } else {
        let alpha2 = i.alpha * i.alpha;
        ndf::ggx(alpha2, i.nh, i.sin2) * smith_factor(alpha2, nl) * smith_factor(alpha2, nv) * positive(i.nv)
    }
}

/// The lobe with its derivatives.
#[inline(always)]
pub fn slope<const CLAMPED: bool>(i: LobeInput) -> LobeSlope {
    if CLAMPED { clamped_slope(i) } else { ggx_slope(i) }
}

#[inline(always)]
fn ggx_slope(i: LobeInput) -> LobeSlope {
    let value = value::<false>(i);
    let alpha2 = i.alpha * i.alpha;
    // ln D = ln alpha² − 2 ln t + const, t = alpha²(n·h)² + |n×h|².
    let inverse_t = 1.0 / (alpha2 * i.nh * i.nh + i.sin2);
    // ln(factor) = −ln(c + q), q = √(alpha² + (1 − alpha²)c²).
    let wane = |cosine: f32| {
        let c = cosine.max(0.0);
        let q = (alpha2 + (1.0 - alpha2) * c * c).sqrt();
        let inverse_q = 1.0 / q;
        let inverse_sum = 1.0 / (c + q);
        let by_alpha2 = -0.5 * (1.0 - c * c) * inverse_q * inverse_sum;
        let by_cosine = -(1.0 + (1.0 - alpha2) * c * inverse_q) * inverse_sum;
        (by_alpha2, by_cosine * positive(cosine))
    };
    let (l_alpha2, l_cosine) = wane(i.nl);
    let (v_alpha2, v_cosine) = wane(i.nv);
    let by_alpha2 = 1.0 / alpha2 - 2.0 * i.nh * i.nh * inverse_t + l_alpha2 + v_alpha2;
    LobeSlope {
        value,
        alpha: value * by_alpha2 * 2.0 * i.alpha,
        nl: value * l_cosine,
        nv: value * v_cosine,
        nh: value * -4.0 * alpha2 * i.nh * inverse_t,
        sin2: value * -2.0 * inverse_t,
    }
}

#[inline(always)]
fn clamped_slope(i: LobeInput) -> LobeSlope {
    let value = value::<true>(i);
    let a = i.alpha;
    let nh = i.nh.max(0.0);
    let bracket = nh * nh * (a * a - 1.0) + 1.0;
    let free = if bracket > ndf::CLAMP { 1.0 / bracket } else { 0.0 };
    // ln D = 2 ln alpha − 2 ln max(bracket, 1e-3).
    let d_alpha = 2.0 / a - 4.0 * a * nh * nh * free;
    let d_nh = -4.0 * nh * (a * a - 1.0) * free;
    // ln(factor) = −ln max(c(1 − k) + k, 1e-3), k = alpha/2.
    let wane = |cosine: f32| {
        let (c, k) = (cosine.max(0.0), 0.5 * a);
        let sum = c * (1.0 - k) + k;
        let free = if sum > masking::CLAMP { 1.0 / sum } else { 0.0 };
        (-0.5 * (1.0 - c) * free, -(1.0 - k) * free * positive(cosine))
    };
    let (l_alpha, l_cosine) = wane(i.nl);
    let (v_alpha, v_cosine) = wane(i.nv);
    LobeSlope {
        value,
        alpha: value * (d_alpha + l_alpha + v_alpha),
        nl: value * l_cosine,
        nv: value * v_cosine,
        nh: value * d_nh * positive(i.nh),
        sin2: 0.0,
    }
}
