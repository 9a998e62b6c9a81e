//! Sixty-four pixels of one row at a time, as arrays: loops over them hold no branch and no call, so that they vectorise.

use super::lobe::{self, LobeInput};
use crate::approximation::ln;
use crate::brdf::{ROUGHNESS_MIN, fresnel};
use crate::direction::{cross, dot, half, unit};
use crate::loss::LOG_OFFSET;
use crate::svbrdf::CHANNELS;
use crate::views::{Emission, LOSS_COSINE_MIN, View};

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
        if let Emission::Flash { .. } = view.emission {
            for k in 0..LANES {
                let wi = [self.wi[0][k], self.wi[1][k], self.wi[2][k]];
                self.irradiance[k] = view.irradiance(wi, x[k], y);
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
    (p.diffuse[c] * scale * std::f32::consts::FRAC_1_PI, fresnel::reflectance(p.specular[c], weight))
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
    let above = if p.input.nl > 0.0 { 1.0 } else { 0.0 };
    let nl = p.input.nl.max(0.0);
    let weight = g.weight[k];
    // R = E·nl·(diffuse + lobe·F); sums over channels of ∂L/∂R·E times diffuse and times F.
    let (mut by_diffuse, mut by_lobe, mut sum) = (0.0, 0.0, 0.0);
    for c in 0..3 {
        let (diffuse, reflectance) = terms::<INRIA>(&p, c, weight);
        let shifted = g.irradiance[k] * nl * (diffuse + lobe.value * reflectance) + LOG_OFFSET;
        let difference = ln(shifted) - ln(goal[c][k] + LOG_OFFSET);
        let sign = if difference > 0.0 { 1.0 } else { 0.0 } - if difference < 0.0 { 1.0 } else { 0.0 };
        sum += difference.abs();
        let slope = sign * g.irradiance[k] / shifted;
        by_diffuse += slope * diffuse;
        by_lobe += slope * reflectance;
        let scale = if INRIA { 1.0 - p.specular[c] } else { 1.0 };
        let shade = if INRIA { p.diffuse[c] } else { 0.0 };
        let inverse_pi = std::f32::consts::FRAC_1_PI;
        gradient[3 + c][k] += slope * nl * scale * inverse_pi;
        gradient[7 + c][k] += slope * nl * (lobe.value * (1.0 - weight) - shade * inverse_pi);
    }
    loss[k] += sum;
    let lobe_share = by_lobe * nl;
    let d_nl = (by_diffuse + by_lobe * lobe.value) * above + lobe_share * lobe.nl;
    let h = gather(&g.h, 0, k);
    let tilt = cross(h, p.sine);
    for c in 0..3 {
        let by_lobe_n = lobe.nv * g.wo[c][k] + lobe.nh * h[c] + 2.0 * lobe.sin2 * tilt[c];
        gradient[c][k] += d_nl * g.wi[c][k] + lobe_share * by_lobe_n;
    }
    let r = pred[6][k];
    let by_roughness = if r > ROUGHNESS_MIN { 2.0 * r } else { 0.0 };
    gradient[6][k] += lobe_share * lobe.alpha * by_roughness;
}
