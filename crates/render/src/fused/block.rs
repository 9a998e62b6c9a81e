//! Sixty-four pixels of one row at a time, as arrays: loops over them hold no branch and no call, so that they vectorise.

#![allow(clippy::needless_range_loop, reason = "lockstep loops over a dozen arrays are plainest with one index")]

use std::f32::consts::FRAC_1_PI;

use super::lobe::{self, LobeInput};
use crate::approximation::ln;
use crate::brdf::{ROUGHNESS_MIN, fresnel};
use crate::direction::{cross, dot, half, unit};
use crate::loss::LOG_OFFSET;
use crate::svbrdf::CHANNELS;
use crate::views::{Emission, LOSS_COSINE_MIN, Origin, View, flash_irradiance};

/// Pixels per block.
pub const LANES: usize = 64;
/// One value per pixel.
pub type Lane = [f32; LANES];

/// The ten channels of the maps: normal 0–2, diffuse 3–5, roughness 6, specular 7–9.
pub type Maps = [Lane; CHANNELS];

/// Directions and light of one view at the block's pixels.
pub struct Geometry {
    wi: [Lane; 3],
    wo: [Lane; 3],
    h: [Lane; 3],
    weight: Lane,
    irradiance: Lane,
}

impl Geometry {
    /// Memory to be filled for each view.
    pub fn empty() -> Self {
        let zero = [0.0; LANES];
        Self { wi: [zero; 3], wo: [zero; 3], h: [zero; 3], weight: zero, irradiance: zero }
    }

    #[inline(always)]
    fn fill<const CLAMPED: bool>(&mut self, view: &View, x: &Lane, y: f32) {
        let (light, light_near) = view.light.position();
        let (camera, camera_near) = view.camera.position();
        let intensity = match view.emission {
            Emission::Even { intensity } | Emission::Flash { intensity, .. } => intensity,
        };
        for k in 0..LANES {
            let wi = unit([light[0] - light_near * x[k], light[1] - light_near * y, light[2]]);
            let wo = unit([camera[0] - camera_near * x[k], camera[1] - camera_near * y, camera[2]]);
            let h = half(wi, wo);
            for c in 0..3 {
                self.wi[c][k] = wi[c];
                self.wo[c][k] = wo[c];
                self.h[c][k] = h[c];
            }
            let vh = dot(wo, h);
            self.weight[k] = if CLAMPED { fresnel::gaussian_weight(vh) } else { fresnel::schlick_weight(vh) };
            self.irradiance[k] = intensity / wi[2].max(LOSS_COSINE_MIN);
        }
        match (view.emission, view.light) {
            (Emission::Even { .. }, _) => {}
            (Emission::Flash { .. }, Origin::Direction(_)) => self.irradiance = [intensity; LANES],
            (Emission::Flash { exponent, .. }, Origin::Point(position)) => {
                for k in 0..LANES {
                    let wi = gather(&self.wi, 0, k);
                    self.irradiance[k] = flash_irradiance(intensity, exponent, position, wi, [x[k], y]);
                }
            }
        }
    }
}

/// One pixel's maps, cosines and tilt against one view.
struct Pixel {
    input: LobeInput,
    sine: [f32; 3],
    diffuse: [f32; 3],
    specular: [f32; 3],
}

#[inline(always)]
fn gather(lanes: &[Lane], first: usize, k: usize) -> [f32; 3] {
    [lanes[first][k], lanes[first + 1][k], lanes[first + 2][k]]
}

#[inline(always)]
fn pixel(maps: &Maps, g: &Geometry, k: usize) -> Pixel {
    let n = gather(maps, 0, k);
    let h = gather(&g.h, 0, k);
    let sine = cross(n, h);
    let r = maps[6][k].max(ROUGHNESS_MIN);
    let input = LobeInput {
        alpha: r * r,
        nl: dot(n, gather(&g.wi, 0, k)),
        nv: dot(n, gather(&g.wo, 0, k)),
        nh: dot(n, h),
        sin2: dot(sine, sine),
    };
    Pixel { input, sine, diffuse: gather(maps, 3, k), specular: gather(maps, 7, k) }
}

/// (diffuse term, Fresnel term) of a channel.
#[inline(always)]
fn terms<const INRIA: bool>(p: &Pixel, c: usize, weight: f32) -> (f32, f32) {
    let scale = if INRIA { 1.0 - p.specular[c] } else { 1.0 };
    (p.diffuse[c] * scale * FRAC_1_PI, fresnel::reflectance(p.specular[c], weight))
}

/// Linear radiance of the block in one view, into `out` (RGB).
#[inline(always)]
pub fn radiance<const CLAMPED: bool, const INRIA: bool>(
    maps: &Maps,
    view: &View,
    (x, y): (&Lane, f32),
    g: &mut Geometry,
    out: &mut [Lane; 3],
) {
    g.fill::<CLAMPED>(view, x, y);
    for k in 0..LANES {
        let p = pixel(maps, g, k);
        let light = p.input.nl.max(0.0) * g.irradiance[k];
        let lobe = lobe::value::<CLAMPED>(p.input);
        for c in 0..3 {
            let (diffuse, reflectance) = terms::<INRIA>(&p, c, g.weight[k]);
            out[c][k] = light * (diffuse + lobe * reflectance);
        }
    }
}

/// Adds the sum over views and channels of |ln(R + 0.1) − ln(R* + 0.1)| to `loss` and its derivatives with respect to the
/// predicted maps to `gradient`.
#[inline(always)]
pub fn accumulate<const CLAMPED: bool, const INRIA: bool>(
    pred: &Maps,
    target: &Maps,
    views: &[View],
    (x, y): (&Lane, f32),
    loss: &mut Lane,
    gradient: &mut Maps,
) {
    let mut g = Geometry::empty();
    let mut goal = [[0.0; LANES]; 3];
    for view in views {
        radiance::<CLAMPED, INRIA>(target, view, (x, y), &mut g, &mut goal);
        for k in 0..LANES {
            differentiate::<CLAMPED, INRIA>(pred, &g, &goal, k, loss, gradient);
        }
    }
}

/// What one colour channel of one pixel contributes.
struct ChannelSlope {
    difference: f32,
    by_diffuse: f32,
    by_lobe: f32,
    diffuse_albedo: f32,
    specular_albedo: f32,
}

/// Light that reaches a pixel and leaves it in one view.
struct Lit {
    nl: f32,
    irradiance: f32,
    weight: f32,
    lobe: f32,
}

/// |ln(R + 0.1) − ln(R* + 0.1)| with R = E·nl·(diffuse + lobe·F), and its derivatives.
#[inline(always)]
fn channel<const INRIA: bool>(p: &Pixel, c: usize, lit: &Lit, goal: f32) -> ChannelSlope {
    let (diffuse, reflectance) = terms::<INRIA>(p, c, lit.weight);
    let shifted = lit.irradiance * lit.nl * (diffuse + lit.lobe * reflectance) + LOG_OFFSET;
    let (wanted, inverse) = (goal + LOG_OFFSET, 1.0 / shifted);
    let sign = if shifted > wanted { 1.0 } else { 0.0 } - if shifted < wanted { 1.0 } else { 0.0 };
    // The one division serves the slope and, as a quotient under one logarithm, the difference.
    let difference = -sign * ln(wanted * inverse);
    let slope = sign * lit.irradiance * inverse;
    let (scale, shade) = if INRIA { (1.0 - p.specular[c], p.diffuse[c]) } else { (1.0, 0.0) };
    ChannelSlope {
        difference,
        by_diffuse: slope * diffuse,
        by_lobe: slope * reflectance,
        diffuse_albedo: slope * lit.nl * scale * FRAC_1_PI,
        specular_albedo: slope * lit.nl * (lit.lobe * (1.0 - lit.weight) - shade * FRAC_1_PI),
    }
}

#[inline(always)]
fn differentiate<const CLAMPED: bool, const INRIA: bool>(
    pred: &Maps,
    g: &Geometry,
    goal: &[Lane; 3],
    k: usize,
    loss: &mut Lane,
    gradient: &mut Maps,
) {
    let p = pixel(pred, g, k);
    let lobe = lobe::slope::<CLAMPED>(p.input);
    let lit = Lit { nl: p.input.nl.max(0.0), irradiance: g.irradiance[k], weight: g.weight[k], lobe: lobe.value };
    // Spelt out: a loop over channels would stay a loop and keep the one over pixels from being vectorised.
    let red = channel::<INRIA>(&p, 0, &lit, goal[0][k]);
    let green = channel::<INRIA>(&p, 1, &lit, goal[1][k]);
    let blue = channel::<INRIA>(&p, 2, &lit, goal[2][k]);
    loss[k] += red.difference + green.difference + blue.difference;
    gradient[3][k] += red.diffuse_albedo;
    gradient[4][k] += green.diffuse_albedo;
    gradient[5][k] += blue.diffuse_albedo;
    gradient[7][k] += red.specular_albedo;
    gradient[8][k] += green.specular_albedo;
    gradient[9][k] += blue.specular_albedo;

    let by_diffuse = red.by_diffuse + green.by_diffuse + blue.by_diffuse;
    let by_lobe = red.by_lobe + green.by_lobe + blue.by_lobe;
    let above = if p.input.nl > 0.0 { 1.0 } else { 0.0 };
    let share = by_lobe * lit.nl;
    let by_nl = (by_diffuse + by_lobe * lobe.value) * above + share * lobe.nl;
    let (wi, wo, h) = (gather(&g.wi, 0, k), gather(&g.wo, 0, k), gather(&g.h, 0, k));
    let tilt = cross(h, p.sine);
    let (by_nv, by_nh, by_tilt) = (share * lobe.nv, share * lobe.nh, 2.0 * share * lobe.sin2);
    gradient[0][k] += by_nl * wi[0] + by_nv * wo[0] + by_nh * h[0] + by_tilt * tilt[0];
    gradient[1][k] += by_nl * wi[1] + by_nv * wo[1] + by_nh * h[1] + by_tilt * tilt[1];
    gradient[2][k] += by_nl * wi[2] + by_nv * wo[2] + by_nh * h[2] + by_tilt * tilt[2];
    let r = pred[6][k];
    let by_roughness = if r > ROUGHNESS_MIN { 2.0 * r } else { 0.0 };
    gradient[6][k] += share * lobe.alpha * by_roughness;
}
