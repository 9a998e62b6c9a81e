//! Isolated high values: the "small high value artifacts" that instance normalisation leaves in the maps (paper §6, §8.3).

use ops::planes::Planes;
use rayon::prelude::*;
use render::svbrdf::SvbrdfImage;
use serde::{Deserialize, Serialize};

/// A spot is isolated when a square ring of at most this radius around it, in pixels, lies lower all the way round.
pub const RADIUS: usize = 4;
/// A pixel is a spike when it stands out by this much more than the truth does, in units of the maps (albedo, roughness, sine of
/// the normal's tilt; all in [0, 1]).
pub const MARGIN: f32 = 0.1;

/// Isolated high values that the truth doesn't have.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Spikes {
    /// Share of the pixels whose normal tilts away from its surroundings.
    pub normal: f64,
    /// Share of spikes in the diffuse albedo, in any channel.
    pub diffuse: f64,
    /// Share of spikes in the specular albedo, in any channel.
    pub specular: f64,
    /// Share of spikes in the roughness.
    pub roughness: f64,
    /// How far pixels stand out more than the truth does: mean over all pixels and the four maps, without a margin.
    pub excess: f64,
}

impl Spikes {
    /// Compares maps; `None` when the sizes differ or there is no pixel.
    ///
    /// A pixel stands out by its value less the highest value of the ring of radius 1 … [`RADIUS`] for which that is most, and
    /// not below zero: spots narrower than the ring stand out by their whole height, lines, edges and slopes by nothing. What
    /// stands out in the truth within [`RADIUS`] is taken off, so that speckles which are a little displaced aren't counted.
    pub fn between(predicted: &SvbrdfImage, reference: &SvbrdfImage) -> Option<Self> {
        let size = |i: &SvbrdfImage| (i.height(), i.width());
        if size(predicted) != size(reference) || size(reference).0 * size(reference).1 == 0 {
            return None;
        }
        let of = |map: fn(&SvbrdfImage) -> Planes| share_and_excess(&map(predicted), &map(reference));
        let (normal, diffuse) = (of(|i| tilt(&i.normal)), of(|i| i.diffuse.clone()));
        let (specular, roughness) = (of(|i| i.specular.clone()), of(|i| i.roughness.clone()));
        Some(Self {
            normal: normal.0,
            diffuse: diffuse.0,
            specular: specular.0,
            roughness: roughness.0,
            excess: (normal.1 + diffuse.1 + specular.1 + roughness.1) / 4.0,
        })
    }

    /// Mean of the four maps' shares.
    pub fn share(&self) -> f64 {
        (self.normal + self.diffuse + self.specular + self.roughness) / 4.0
    }

    /// Mean of several materials; `None` for none.
    pub fn mean(spikes: &[Self]) -> Option<Self> {
        let mean = |f: fn(&Self) -> f64| spikes.iter().map(f).sum::<f64>() / spikes.len() as f64;
        (!spikes.is_empty()).then(|| Self {
            normal: mean(|s| s.normal),
            diffuse: mean(|s| s.diffuse),
            specular: mean(|s| s.specular),
            roughness: mean(|s| s.roughness),
            excess: mean(|s| s.excess),
        })
    }
}

/// Sine of the angle between each normal and the view axis: 0 flat, 1 grazing.
fn tilt(normal: &Planes) -> Planes {
    let [x, y, z] = [0, 1, 2].map(|c| normal.plane(c));
    let sine = |i: usize| {
        let across = x[i].hypot(y[i]);
        if across > 0.0 { across / across.hypot(z[i]) } else { 0.0 }
    };
    Planes::from_vec(1, normal.height, normal.width, (0..normal.area()).map(sine).collect())
}

/// Share of the pixels that are spikes in any channel, and the mean excess over the channels.
fn share_and_excess(predicted: &Planes, reference: &Planes) -> (f64, f64) {
    let found = standing_out(predicted);
    let allowed = over_pixels(&standing_out(reference), |plane, y, x| {
        (0..=RADIUS).map(|r| highest_of_ring(plane, y, x, r).unwrap_or(0.0)).fold(0.0, f32::max)
    });
    let excess: Vec<f32> = found.data.iter().zip(&allowed.data).map(|(found, allowed)| (found - allowed).max(0.0)).collect();
    let area = found.area();
    let spike = |i: &usize| excess[*i..].iter().step_by(area).any(|&e| e > MARGIN);
    let share = (0..area).filter(spike).count() as f64 / area as f64;
    (share, excess.iter().map(|&e| f64::from(e)).sum::<f64>() / excess.len() as f64)
}

/// How far each pixel stands out of its surroundings.
fn standing_out(image: &Planes) -> Planes {
    over_pixels(image, |plane, y, x| {
        let lowest = (1..=RADIUS).filter_map(|r| highest_of_ring(plane, y, x, r)).fold(f32::INFINITY, f32::min);
        (plane.at(0, y, x) - lowest).max(0.0)
    })
}

/// Applies a function of a plane and a pixel to every pixel of every plane.
fn over_pixels(image: &Planes, f: impl Fn(&Planes, usize, usize) -> f32 + Sync) -> Planes {
    let (height, width) = (image.height, image.width);
    let planes = (0..image.channels).flat_map(|c| {
        let plane = Planes::from_vec(1, height, width, image.plane(c).to_vec());
        let rows = (0..height).into_par_iter();
        rows.flat_map_iter(|y| (0..width).map(move |x| (y, x))).map(|(y, x)| f(&plane, y, x)).collect::<Vec<_>>()
    });
    let data = planes.collect();
    Planes::from_vec(image.channels, height, width, data)
}

/// The highest value at Chebyshev distance `radius`, inside the image; `None` where that ring lies outside.
fn highest_of_ring(plane: &Planes, y: usize, x: usize, radius: usize) -> Option<f32> {
    let (rows, columns) = (around(y, radius, plane.height), around(x, radius, plane.width));
    let ends = |at: usize, length: usize| [at.checked_sub(radius), Some(at + radius).filter(|&p| p < length)];
    let across = ends(y, plane.height).into_iter().flatten().flat_map(|row| columns.clone().map(move |column| (row, column)));
    let down = ends(x, plane.width).into_iter().flatten().flat_map(|column| rows.clone().map(move |row| (row, column)));
    across.chain(down).map(|(row, column)| plane.at(0, row, column)).reduce(f32::max)
}

fn around(at: usize, radius: usize, length: usize) -> std::ops::Range<usize> {
    at.saturating_sub(radius)..(at + radius + 1).min(length)
}

#[cfg(test)]
mod tests {
    use super::*;
    use render::texel::Texel;

    const SIDE: usize = 24;

    fn flat() -> SvbrdfImage {
        let texel = Texel { normal: [0.0, 0.0, 1.0], diffuse: [0.25; 3], roughness: 0.5, specular: [0.125; 3] };
        SvbrdfImage::constant(SIDE, SIDE, &texel)
    }

    /// Flat maps with roughness by a formula.
    fn rough(f: impl Fn(usize, usize) -> f32) -> SvbrdfImage {
        let data = (0..SIDE * SIDE).map(|i| f(i / SIDE, i % SIDE)).collect();
        SvbrdfImage { roughness: Planes::from_vec(1, SIDE, SIDE, data), ..flat() }
    }

    fn block(y: usize, x: usize, side: usize) -> SvbrdfImage {
        let inside = move |at: usize, first: usize| (first..first + side).contains(&at);
        rough(|row, column| if inside(row, y) && inside(column, x) { 0.75 } else { 0.5 })
    }

    fn of(maps: &SvbrdfImage) -> Spikes {
        Spikes::between(maps, &flat()).unwrap()
    }

    #[test]
    fn a_spot_counts_by_its_pixels_and_its_height() {
        let pixels = (SIDE * SIDE) as f64;
        for (y, x) in [(9, 12), (0, 0), (SIDE - 1, 7)] {
            let one = of(&block(y, x, 1));
            assert_eq!(one, Spikes { roughness: 1.0 / pixels, excess: 0.25 / pixels / 4.0, ..Spikes::default() }, "{y}, {x}");
        }
        // The ring of radius 4 goes round a square of 4 from any of its pixels, round one of 7 only from its middle.
        assert_eq!(of(&block(9, 12, 4)).roughness, 16.0 / pixels);
        assert_eq!(of(&block(9, 12, 7)).roughness, 1.0 / pixels);
        assert_eq!(of(&block(9, 12, 8)).roughness, 0.0);
    }

    #[test]
    fn every_map_is_looked_at() {
        let pixels = (SIDE * SIDE) as f64;
        let mut maps = flat();
        maps.diffuse.set(1, 5, 5, 1.0);
        maps.specular.set(0, 5, 5, 0.5);
        maps.specular.set(2, 5, 5, 0.5);
        maps.specular.set(2, 9, 9, 0.5);
        maps.normal.set(0, 3, 4, 3.0);
        maps.normal.set(2, 3, 4, 4.0);
        let spikes = of(&maps);
        assert_eq!((spikes.normal, spikes.diffuse, spikes.specular), (1.0 / pixels, 1.0 / pixels, 2.0 / pixels));
        let heights = 0.6 + 0.75 / 3.0 + 3.0 * 0.375 / 3.0;
        assert!((spikes.excess - heights / pixels / 4.0).abs() < 1e-9);
        assert!((spikes.share() - 1.0 / pixels).abs() < 1e-12);
    }

    #[test]
    fn lines_edges_slopes_holes_and_low_spots_are_no_spikes() {
        let shapes: [fn(usize, usize) -> f32; 6] = [
            |_, x| if x == 9 { 0.9 } else { 0.1 },
            |y, x| if y == x { 0.9 } else { 0.1 },
            |y, _| if y < 9 { 0.9 } else { 0.1 },
            |y, x| (y + 2 * x) as f32 / 80.0,
            |y, x| if (y, x) == (9, 9) { 0.1 } else { 0.9 },
            |y, x| if (y, x) == (9, 9) { 0.59 } else { 0.5 },
        ];
        for (i, shape) in shapes.into_iter().enumerate() {
            assert_eq!(of(&rough(shape)).share(), 0.0, "shape {i}");
        }
    }

    #[test]
    fn spots_of_the_truth_are_allowed_where_they_are() {
        let truth = block(9, 12, 2);
        let between = |maps: &SvbrdfImage| Spikes::between(maps, &truth).unwrap();
        assert_eq!(between(&truth), Spikes::default());
        assert_eq!(between(&block(7, 14, 2)), Spikes::default(), "displaced by two pixels");
        assert_eq!(between(&flat()), Spikes::default(), "too smooth is another error");
        assert!(between(&block(18, 3, 2)).roughness > 0.0, "elsewhere");
        let higher = rough(|y, x| if (y, x) == (9, 12) { 1.0 } else { 0.5 });
        assert_eq!(between(&higher).roughness, 1.0 / (SIDE * SIDE) as f64, "twice as high");
    }

    #[test]
    fn a_turned_image_has_the_same_spikes() {
        let spots = |y: usize, x: usize| if (y * 7 + x * 5).is_multiple_of(41) { 0.5 + (y + x) as f32 / 96.0 } else { 0.5 };
        let (found, turned) = (of(&rough(spots)), of(&rough(|y, x| spots(x, SIDE - 1 - y))));
        assert!(found.roughness > 0.0);
        assert_eq!(found.roughness, turned.roughness);
        assert!((found.excess - turned.excess).abs() < 1e-12);
    }

    #[test]
    fn sizes_must_agree_and_one_pixel_stands_out_of_nothing() {
        let texel = Texel { normal: [0.0, 0.0, 1.0], diffuse: [0.9; 3], roughness: 0.9, specular: [0.9; 3] };
        let one = SvbrdfImage::constant(1, 1, &texel);
        assert!(Spikes::between(&one, &flat()).is_none());
        assert_eq!(Spikes::between(&one, &one), Some(Spikes::default()));
        assert!(Spikes::mean(&[]).is_none());
        let mean = Spikes::mean(&[Spikes { diffuse: 0.5, excess: 0.25, ..Spikes::default() }, Spikes::default()]).unwrap();
        assert_eq!((mean.diffuse, mean.share(), mean.excess), (0.25, 0.0625, 0.125));
    }
}
