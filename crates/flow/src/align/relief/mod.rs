//! Relief under a light that travels with the camera.
//!
//! A flash that moves over relief makes slopes brighter that face it. To first order a pixel's brightness is linear in the
//! slopes of the light's direction u = (light − point)/height: A + B·u, with B ∝ the surface's slope. Where hollows are dark, as
//! in most materials, B resembles ∇A, and A + εh∇A·u is A displaced by εh·u: registration takes the change of shading for a
//! motion. The displacements of all frames are then too short (or too long) by the same share ε, consistently, so that no
//! comparison of links notices. It is most of what is left of the error on bark, pavers and plaster (0.4 to 1.2 % of the way).
//!
//! What tells ε is the second order: frames displaced by εh·u show B's gradient too, which is quadratic in u. So the key frames
//! are slid along their own displacements ([`Lights::slid`]) until every pixel of the guidance image is linear in u over the
//! scan, as well as can be, and each is then registered to what the others predict for its light instead of to the guidance
//! frame as it was lit.

mod lights;
mod shading;
#[cfg(test)]
mod tests;

use ops::homography::Homography;
use ops::planes::Planes;
use rayon::prelude::*;

use super::camera::ScanCamera;
use super::photometric::{register, warp};
use super::scan::Scan;
use super::size::{Size, resized};
use super::track::Placed;
use lights::Lights;
use shading::Samples;

/// With fewer key frames the lines through them prove nothing.
const FEWEST_KEY_FRAMES: usize = 10;
/// Shorter side in pixels of the level that is slid; the displacements are global.
const SIDE: usize = 256;
/// Displacements are looked for up to this share of the way …
const LARGEST: f64 = 0.02;
/// … in so many steps.
const SEARCH_STEPS: usize = 11;
/// Refinements of the best one, each with half the step.
const REFINEMENTS: usize = 2;
/// Rounds of sliding and registering.
const ROUNDS: usize = 2;
/// Registrations per round.
const REGISTRATIONS: usize = 2;
/// A registration may move a frame by this share of its width; more is another place.
const LARGEST_MOVE: f64 = 0.02;
/// Standard deviation of the share of the way that remains after sliding: about half of what was slid, in either direction …
const REMAINING: f64 = 0.5;
/// … and this much in any case (0.05 to 0.5 % remain on scans of nine materials).
const LEAST_REMAINING: f64 = 5e-4;

/// Slides the placed key frames, and the links between them, to where relief explains the change of light, and registers each
/// to what the others predict. Expected errors grow by what sliding can't tell. Scans of a few key frames and with a guidance
/// image that was lit in its own way stay as they are.
pub(super) fn settle(scan: &Scan, placed: &mut Placed, camera: Option<&ScanCamera>) {
    if !scan.guidance_filmed() {
        return;
    }
    let Some(lights) = camera.map_or_else(|| Lights::under_frames(scan, placed), |c| Lights::of(scan, c)) else { return };
    let before: Vec<Option<Homography>> = placed.places.iter().map(|p| p.map(|p| p.homography)).collect();
    let lit = before.iter().zip(&lights.positions).map(|(h, light)| h.filter(|_| light.is_some()));
    let homographies: Vec<Option<Homography>> = lit.collect();
    if homographies.iter().skip(1).flatten().count() < FEWEST_KEY_FRAMES {
        return;
    }
    let mut stack = Stack { scan, lights, homographies };
    let coarse = scan.pyramids[0].levels.iter().position(|l| l.height.min(l.width) <= SIDE).unwrap_or(0);
    let mut slid = 0.0;
    for round in 0..ROUNDS {
        slid += stack.slide(coarse);
        let last = round + 1 == ROUNDS;
        for again in 0..REGISTRATIONS {
            stack.register(if last && again + 1 == REGISTRATIONS { 0 } else { coarse });
        }
    }
    let remaining = LEAST_REMAINING + REMAINING * slid.abs();
    let Stack { lights, homographies: after, .. } = stack;
    // How far each node's own pixels moved.
    let moved = |node: usize| Some(after[node].or(before[node])?.after(&before[node]?.inverse()?));
    for link in &mut placed.links {
        if let (Some(source), Some(back)) = (moved(link.source), moved(link.target).and_then(|h| h.inverse())) {
            link.homography = source.after(&link.homography).after(&back);
            link.error_px = link.error_px.hypot(remaining * lights.way_px(link.target, link.source));
        }
    }
    for (node, (place, homography)) in placed.places.iter_mut().zip(&after).enumerate().skip(1) {
        if let (Some(place), Some(homography)) = (place, homography) {
            place.homography = *homography;
            place.error_px = place.error_px.hypot(remaining * lights.way_px(0, node));
        }
    }
}

/// The nodes' images over the guidance image.
struct Stack<'a> {
    scan: &'a Scan,
    lights: Lights,
    /// Guidance pixel to pixel of every node, `None` for those that don't take part.
    homographies: Vec<Option<Homography>>,
}

impl Stack<'_> {
    /// Slides all nodes to where the pixels are most nearly linear in the light, and returns by which share of the way. When
    /// that is nowhere near, nothing is slid and the largest share returned: so much may be wrong.
    fn slide(&mut self, level: usize) -> f64 {
        let unmoved = self.samples(level, 0.0);
        let deviation = (0..3).fold(f32::INFINITY, |deviation, _| unmoved.fit(deviation).deviation);
        let loss = |longer: f64| self.samples(level, longer).fit(deviation).loss;
        let mut step = 2.0 * LARGEST / (SEARCH_STEPS - 1) as f64;
        let places: Vec<f64> = (0..SEARCH_STEPS).map(|i| step * i as f64 - LARGEST).collect();
        let losses: Vec<f64> = places.iter().map(|&p| loss(p)).collect();
        let best = (0..SEARCH_STEPS).min_by(|&a, &b| losses[a].total_cmp(&losses[b])).unwrap_or(0);
        if best == 0 || best + 1 == SEARCH_STEPS {
            return LARGEST;
        }
        let (mut at, mut around) = (places[best], [losses[best - 1], losses[best], losses[best + 1]]);
        for refinement in 0..=REFINEMENTS {
            let bend = around[0] + around[2] - 2.0 * around[1];
            at += if bend > 0.0 { (0.5 * step * (around[0] - around[2]) / bend).clamp(-step, step) } else { 0.0 };
            if refinement < REFINEMENTS {
                step *= 0.5;
                around = [loss(at - step), loss(at), loss(at + step)];
            }
        }
        for (node, homography) in self.homographies.iter_mut().enumerate().skip(1) {
            *homography = homography.and_then(|h| self.lights.slid(node, &h, at));
        }
        at
    }

    /// Registers every node to what the lights of all predict for its own.
    fn register(&mut self, level: usize) {
        let samples = self.samples(level, 0.0);
        let fit = samples.fit(samples.fit(f32::INFINITY).deviation);
        let moved: Vec<Option<Homography>> = (0..self.homographies.len())
            .into_par_iter()
            .map(|node| {
                let (homography, light) = (self.homographies[node]?, self.lights.positions[node]?);
                if node == 0 {
                    return Some(homography);
                }
                let predicted = samples.predicted(&fit.shading, light);
                let source = &self.scan.pyramids[node].levels[level];
                let sizes = ((self.scan.sizes[0], samples.size), (self.scan.sizes[node], Size::of(source)));
                let plane = Planes::from_vec(1, source.height, source.width, source.plane(0).to_vec());
                let refined = register(&predicted, &plane, &resized(&homography, sizes.0, sizes.1));
                let back = refined.map(|h| resized(&h, (sizes.0.1, sizes.0.0), (sizes.1.1, sizes.1.0)));
                let limit = LARGEST_MOVE * self.scan.sizes[node].width as f64;
                let near = |h: &Homography| super::candidates::largest_shift(h, &homography, self.scan.sizes[0]) <= limit;
                Some(back.filter(near).unwrap_or(homography))
            })
            .collect();
        self.homographies = moved;
    }

    /// The images on a level after the nodes were slid.
    fn samples(&self, level: usize, longer: f64) -> Samples {
        let guidance = &self.scan.pyramids[0].levels[level];
        let size = Size::of(guidance);
        let nodes = (0..self.homographies.len()).into_par_iter().filter_map(|node| {
            let homography = self.homographies[node]?;
            let light = self.lights.positions[node]?.map(|v| v as f32);
            let source = &self.scan.pyramids[node].levels[level];
            let slid = if node == 0 { homography } else { self.lights.slid(node, &homography, longer)? };
            let at_level = resized(&slid, (self.scan.sizes[0], size), (self.scan.sizes[node], Size::of(source)));
            let mut image = vec![0.0; guidance.area()];
            warp(source, 0, &at_level, size.width, &mut image);
            Some((light, image))
        });
        let to_surface = self.lights.to_surface * size.resize_matrix(self.scan.sizes[0]);
        Samples { size, to_surface: to_surface.map(|v| v as f32), nodes: nodes.collect() }
    }
}
