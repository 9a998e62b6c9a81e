//! Relief under a light that travels with the camera.
//!
//! A flash that moves over relief makes slopes brighter that face it. To first order a pixel's brightness is linear in the
//! slopes of the light's direction u = (light − point)/height: A + B·u, with B ∝ the surface's slope. Where hollows are dark, as
//! in most materials, B resembles ∇A, and A + εh∇A·u is A displaced by εh·u: registration takes the change of shading for a
//! motion. The displacements of all frames are then too short (or too long) by the same share ε, consistently, so that no
//! comparison of links notices. It is most of what is left of the error on bark, pavers and plaster (0.4 to 1.2 % of the way).
//!
//! Two things tell ε. Colour differences relative to brightness hardly change with a slope's light: where a surface has colours,
//! they lie still at the right ε. And frames displaced by εh·u show B's gradient too, which is quadratic in u, so that the
//! brightness isn't what [`shading`] describes. The key frames are slid along their own displacements ([`Lights::slid`]) until
//! both fit best over the scan, and each is then registered to what the others predict for its light instead of to the guidance
//! frame as it was lit.

mod lights;
mod lowest;
mod shading;
#[cfg(test)]
mod tests;

use ops::homography::Homography;
use ops::planes::Planes;
use rayon::prelude::*;

use super::camera::ScanCamera;
use super::config::PhotometricConfig;
use super::contrast::{ContrastPyramid, blur, normalised};
use super::photometric::{register, warp};
use super::scan::Scan;
use super::size::{Size, resized};
use super::track::Placed;
use lights::Lights;
use lowest::{Estimate, LARGEST};
use shading::{Samples, brightness, colour};

/// With fewer key frames the lines through them prove nothing.
const FEWEST_KEY_FRAMES: usize = 10;
/// Shorter side in pixels of the level that is slid; the displacements are global.
const SIDE: usize = 256;
/// Standard deviation of what gloss does to the place where colours lie still, as a share of the relief's own: on a slope that
/// faces the light a coat shines white over them.
const COLOURS_MISLED: f64 = 0.4;
/// Rounds of sliding and registering.
const ROUNDS: usize = 2;
/// Standard deviation of the smoothing before images are slid.
const SMOOTH_PX: f32 = 0.8;
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
    let coarse = scan.pyramids[0].levels.iter().position(|l| l.height.min(l.width) <= SIDE).unwrap_or(0);
    let mut stack = Stack { scan, lights, homographies, planes: smoothed(scan, coarse) };
    let mut slid = 0.0;
    for round in 0..ROUNDS {
        slid += stack.slide(slid);
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
    /// The nodes' contrast-normalised luminance and colour differences on the level that is slid, smoothed.
    planes: Vec<Planes>,
}

/// The contrast-normalised images of a level with their colours, smoothed: an image read between its pixels loses some of its
/// noise, and a slide must not look better for that.
fn smoothed(scan: &Scan, level: usize) -> Vec<Planes> {
    let config = PhotometricConfig { chroma: 1.0, ..PhotometricConfig::default() };
    let planes = |(image, pyramid): (&Planes, &ContrastPyramid)| {
        let luminance = &pyramid.levels[level];
        let Size { height, width } = Size::of(luminance);
        let mut planes = normalised(&image.resize_area(height, width), &config);
        planes.plane_mut(0).copy_from_slice(luminance.plane(0));
        for plane in planes.data.chunks_mut(height * width) {
            let known: Vec<f32> = plane.iter().map(|v| if v.is_nan() { 0.0 } else { *v }).collect();
            let smooth = blur(&known, height, width, SMOOTH_PX);
            plane.iter_mut().zip(smooth).filter(|(v, _)| !v.is_nan()).for_each(|(v, smooth)| *v = smooth);
        }
        planes
    };
    scan.images.par_iter().zip(&scan.pyramids).map(planes).collect()
}

impl Stack<'_> {
    /// Slides all nodes to where brightness and colour fit their shading best, after they were slid by the share `slid` of the
    /// way, and returns by which share. When that is nowhere near, nothing is slid and the largest share returned: so much may
    /// be wrong.
    fn slide(&mut self, slid: f64) -> f64 {
        let plane = |channel: usize, longer: f64| self.samples(|node| (&self.planes[node], channel), longer);
        let estimate = |channel: usize| {
            let unmoved = plane(channel, 0.0);
            // With all terms, so that the noise of a colour doesn't count what displaces it.
            let deviation = (0..3).fold(f32::INFINITY, |deviation, _| unmoved.fit(brightness, deviation).deviation);
            if channel == 0 {
                return Estimate::lowest(|longer| plane(channel, longer).fit(brightness, deviation).loss);
            }
            let still = Estimate::lowest(|longer| plane(channel, longer).fit(colour, deviation).loss)?;
            Some(Estimate { deviation: still.deviation.hypot(COLOURS_MISLED * (slid + still.share)), ..still })
        };
        let Some(share) = Estimate::combined((0..3).filter_map(estimate)) else { return LARGEST };
        for (node, homography) in self.homographies.iter_mut().enumerate().skip(1) {
            *homography = homography.and_then(|h| self.lights.slid(node, &h, share));
        }
        share
    }

    /// Registers every node to what the lights of all predict for its own.
    fn register(&mut self, level: usize) {
        let samples = self.samples(|node| (&self.scan.pyramids[node].levels[level], 0), 0.0);
        let fit = samples.fit(brightness, samples.fit(brightness, f32::INFINITY).deviation);
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

    /// One plane of the nodes' images, as `image` gives them, after the nodes were slid.
    fn samples<'b>(&self, image: impl Fn(usize) -> (&'b Planes, usize) + Sync, longer: f64) -> Samples {
        let size = Size::of(image(0).0);
        let nodes = (0..self.homographies.len()).into_par_iter().filter_map(|node| {
            let homography = self.homographies[node]?;
            let light = self.lights.positions[node]?.map(|v| v as f32);
            let (source, channel) = image(node);
            let slid = if node == 0 { homography } else { self.lights.slid(node, &homography, longer)? };
            let at_level = resized(&slid, (self.scan.sizes[0], size), (self.scan.sizes[node], Size::of(source)));
            let mut warped = vec![0.0; size.height * size.width];
            warp(source, channel, &at_level, size.width, &mut warped);
            Some((light, warped))
        });
        let to_surface = self.lights.to_surface * size.resize_matrix(self.scan.sizes[0]);
        Samples { size, to_surface: to_surface.map(|v| v as f32), nodes: nodes.collect() }
    }
}
