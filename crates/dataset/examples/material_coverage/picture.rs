//! Histograms of both sets in one picture: filled for the generated materials, a line for the real ones.

use image::{Rgb, RgbImage};

use crate::coverage::percentile;
use crate::lettering;
use crate::spectrum::{LOWEST, RINGS};
use crate::statistics::{Histogram, QUANTITIES, SIDE, Statistics, value_names};

const COLUMNS: usize = 5;
const PANEL: [usize; 2] = [300, 210];
/// Around the area of a diagram.
const MARGIN: usize = 24;
const PAPER: [u8; 3] = [250, 250, 248];
const INK: [u8; 3] = [40, 40, 40];
const GENERATED: [u8; 3] = [150, 185, 220];
const REAL: [u8; 3] = [205, 70, 20];
/// Steps of a histogram of texels, and of one of materials.
const BINS: [usize; 2] = [60, 30];
/// Where the axis of the tilt ends.
///
/// # Units
/// Degrees.
const TILT_SHOWN: f32 = 60.0;

/// The whole picture: texels in the first row, contrasts within materials in the second, scales in the third.
pub fn draw(real: &[Statistics], generated: &[Statistics]) -> RgbImage {
    let [width, height] = [COLUMNS * PANEL[0], 3 * PANEL[1]].map(|side| side as u32);
    let mut picture = RgbImage::from_pixel(width, height, Rgb(PAPER));
    for (c, quantity) in QUANTITIES.iter().enumerate() {
        let highest = if *quantity == "tilt" { TILT_SHOWN } else { 1.0 };
        let shares = [real, generated].map(|set| {
            let pooled = Histogram::pooled(set.iter().map(|m| &m.histograms[c]));
            pooled.binned(BINS[0], highest)
        });
        let title = format!("{quantity} of texels");
        Diagram::new(&mut picture, c, 0, &title, [0.0, highest]).histograms(&shares);
    }
    let names = value_names();
    let by_material = names.iter().enumerate().filter(|(_, name)| name.ends_with("contrast") || name.ends_with("slope"));
    for (panel, (v, name)) in by_material.enumerate() {
        let values = [real, generated].map(|set| set.iter().map(|m| m.values()[v]).collect::<Vec<_>>());
        let ends = |percent: f32| values.iter().map(move |of_set| percentile(of_set, percent));
        let low = if name.ends_with("slope") { ends(0.0).fold(f32::INFINITY, f32::min) } else { 0.0 };
        let range = [low, ends(100.0).fold(f32::NEG_INFINITY, f32::max)];
        let shares = values.each_ref().map(|of_set| shares(of_set, range));
        Diagram::new(&mut picture, panel % COLUMNS, 1 + panel / COLUMNS, name, range).histograms(&shares);
    }
    spectra(&mut picture, real, generated);
    let legend = [2 * PANEL[0] + MARGIN, 2 * PANEL[1] + MARGIN];
    lettering::write(&mut picture, legend, "filled  generated materials", GENERATED);
    let lines = ["line  real materials", "", "height  root of the share", "brightness is gamma-encoded", "tilt in degrees"];
    for (i, text) in lines.into_iter().enumerate() {
        let place = [legend[0], legend[1] + (i + 1) * 2 * lettering::HEIGHT];
        lettering::write(&mut picture, place, text, if i == 0 { REAL } else { INK });
    }
    picture
}

/// Shares of materials per step of a range.
fn shares(values: &[f32], [low, high]: [f32; 2]) -> Vec<f32> {
    let mut shares = vec![0.0; BINS[1]];
    for value in values {
        let bin = ((value - low) / (high - low).max(1e-6) * BINS[1] as f32) as usize;
        shares[bin.min(BINS[1] - 1)] += 1.0 / values.len() as f32;
    }
    shares
}

/// Power over frequency: the band between the 5th and 95th percentile of the materials and their median.
fn spectra(picture: &mut RgbImage, real: &[Statistics], generated: &[Statistics]) {
    let bands = [real, generated].map(|set| {
        let ring = |r: usize| set.iter().map(|m| m.spectrum.rings[r]).collect::<Vec<_>>();
        (0..RINGS).map(|r| [5.0, 50.0, 95.0].map(|p| percentile(&ring(r), p))).collect::<Vec<_>>()
    });
    let all = || bands.iter().flatten().flatten().copied();
    let (low, high) = (all().fold(f32::INFINITY, f32::min), all().fold(f32::NEG_INFINITY, f32::max));
    let longest = SIDE as f32 / LOWEST;
    let shortest = longest / 2.0f32.powf(RINGS as f32 / 2.0);
    let mut diagram = Diagram::new(picture, 1, 2, "log power by period in texels", [longest, shortest]);
    let share = |v: f32| (v - low) / (high - low);
    let [of_real, of_generated] = &bands;
    diagram.band(&of_generated.iter().map(|b| [share(b[0]), share(b[2])]).collect::<Vec<_>>(), GENERATED);
    for p in 0..3 {
        diagram.line(&of_real.iter().map(|b| share(b[p])).collect::<Vec<_>>(), REAL);
    }
    diagram.line(&of_generated.iter().map(|b| share(b[1])).collect::<Vec<_>>(), INK);
}

/// One diagram of the picture.
struct Diagram<'a> {
    picture: &'a mut RgbImage,
    /// Top left corner and size of the area inside the axes.
    corner: [usize; 2],
    size: [usize; 2],
}

impl<'a> Diagram<'a> {
    fn new(picture: &'a mut RgbImage, column: usize, row: usize, title: &str, range: [f32; 2]) -> Self {
        let corner = [column * PANEL[0] + MARGIN, row * PANEL[1] + MARGIN];
        let size = PANEL.map(|side| side - 2 * MARGIN);
        lettering::write(picture, [corner[0], corner[1] - 2 * lettering::HEIGHT], title, INK);
        let bottom = corner[1] + size[1];
        for x in 0..size[0] {
            picture.put_pixel((corner[0] + x) as u32, bottom as u32, Rgb(INK));
        }
        let label = |v: f32| if v.abs() >= 10.0 || v == 0.0 { format!("{v:.0}") } else { format!("{v:.2}") };
        let [first, last] = range.map(label);
        lettering::write(picture, [corner[0], bottom + 4], &first, INK);
        lettering::write(picture, [corner[0] + size[0] - lettering::width(&last), bottom + 4], &last, INK);
        Self { picture, corner, size }
    }

    /// Real and generated shares per step; square roots, so that rare values are seen beside common ones.
    fn histograms(&mut self, [real, generated]: &[Vec<f32>; 2]) {
        let highest = real.iter().chain(generated).copied().fold(0.0, f32::max).max(1e-6);
        let heights = |shares: &[f32]| shares.iter().map(|s| (s / highest).sqrt()).collect::<Vec<_>>();
        for (x, height) in self.spread(&heights(generated)).into_iter().enumerate() {
            self.column(x, [0.0, height], GENERATED);
        }
        let outline = self.spread(&heights(real));
        let mut before = 0.0;
        for (x, height) in outline.into_iter().enumerate() {
            self.column(x, [f32::min(before, height), f32::max(before, height)], REAL);
            before = height;
        }
    }

    fn line(&mut self, heights: &[f32], colour: [u8; 3]) {
        let mut before = heights[0];
        for (x, height) in self.between(heights).into_iter().enumerate() {
            self.column(x, [before.min(height), before.max(height)], colour);
            before = height;
        }
    }

    fn band(&mut self, bands: &[[f32; 2]], colour: [u8; 3]) {
        let [low, high] = [0, 1].map(|end| self.between(&bands.iter().map(|b| b[end]).collect::<Vec<_>>()));
        for (x, ends) in low.into_iter().zip(high).enumerate() {
            self.column(x, [ends.0, ends.1], colour);
        }
    }

    /// The step that each column of pixels shows.
    fn spread(&self, steps: &[f32]) -> Vec<f32> {
        (0..self.size[0]).map(|x| steps[x * steps.len() / self.size[0]]).collect()
    }

    /// Points joined by straight lines.
    fn between(&self, points: &[f32]) -> Vec<f32> {
        let place = |x: usize| x as f32 / (self.size[0] - 1) as f32 * (points.len() - 1) as f32;
        let value = |x: usize| {
            let first = (place(x) as usize).min(points.len() - 2);
            points[first] + (points[first + 1] - points[first]) * (place(x) - first as f32)
        };
        (0..self.size[0]).map(value).collect()
    }

    /// A vertical stroke, two pixels high at least, between shares of the height.
    fn column(&mut self, x: usize, [low, high]: [f32; 2], colour: [u8; 3]) {
        let height = |share: f32| (share.clamp(0.0, 1.0) * (self.size[1] - 2) as f32) as usize;
        for y in height(low)..=height(high) + 1 {
            let [px, py] = [self.corner[0] + x, self.corner[1] + self.size[1] - 1 - y].map(|v| v as u32);
            self.picture.put_pixel(px, py, Rgb(colour));
        }
    }
}
