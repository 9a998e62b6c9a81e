//! What a frame has of a picture, block by block: many places must agree, and a strong one counts no more than the others.

use nalgebra::{SMatrix, SVector};
use ops::planes::Planes;

/// Blocks along a side into which the frame is divided, at most, and the least side of one in pixels.
const BLOCKS: usize = 16;
const LEAST_SIDE: usize = 6;
/// A block with fewer pixels than this has no vote.
const FEWEST_PIXELS: usize = 24;
/// Deviation of a picture, in a block, that gives half a vote: less than this tenth of the usual contrast may be the noise, or
/// what resampling left.
const HALF_VOTE: f64 = 0.1;

/// How much more the frame looks like one place than like another, both contrast-normalised on the frame's pixels (NaN is
/// unknown), in luminance or with the colours, whichever tells more: some 1 by chance where nothing tells the places apart.
///
/// What both places show, such as the pattern that repeats, is not in their difference. Nor counts what would make even the
/// same place look different: another contrast, a shift, another sharpness, as relief lit from another side, a refinement that
/// came to rest next to its end or pixels that lie otherwise in the pattern make them.
pub(super) fn preference(frame: &Planes, first: &Planes, second: &Planes) -> f64 {
    let width = frame.width;
    let [mean, difference]: [Planes; 2] = [(0.5, 0.5), (1.0, -1.0)].map(|(a, b)| {
        let data = first.data.iter().zip(&second.data).map(|(first, second)| a * first + b * second).collect();
        Planes::from_vec(first.channels, frame.height, width, data)
    });
    let explained = |channel: usize, i: usize| {
        let at = |index: usize| f64::from(mean.plane(channel)[index]);
        let (here, left, right, above, below) = (at(i), at(i - 1), at(i + 1), at(i - width), at(i + width));
        let twisted = at(i + width + 1) + at(i - width - 1) - at(i + width - 1) - at(i - width + 1);
        [1.0, here, right - left, below - above, left + right - 2.0 * here, above + below - 2.0 * here, twisted]
    };
    // The colours of a grey surface are noise.
    [1, frame.channels].map(|channels| votes(frame, &difference, channels, explained)).into_iter().fold(f64::MIN, f64::max)
}

/// How much the frame looks like a place, on the same scale: a highlight, which both images have in their middle wherever they
/// were taken, has few votes.
pub(super) fn agreement(frame: &Planes, place: &Planes) -> f64 {
    let width = frame.width;
    votes(frame, place, 1, |_, i| [1.0, (i % width) as f64 / width as f64, (i / width) as f64 / width as f64])
}

/// Sum over blocks of the frame's correlation with a picture, in the first so many planes, without the part of the picture that
/// `explained` explains, in units of the root of the sum of squares.
///
/// A sum of independent values whose signs are random exceeds z of these with a probability of exp(−z²/2) at most, however
/// they are distributed (Efron, Student's t-test under symmetry conditions, JASA 64, 1969). Neighbouring blocks depend on each
/// other a little: on noisy patterns that repeat exactly the deviation is about 1.
fn votes<const N: usize>(
    frame: &Planes,
    picture: &Planes,
    channels: usize,
    explained: impl Fn(usize, usize) -> [f64; N],
) -> f64 {
    let (height, width) = (frame.height, frame.width);
    let blocks = (height.min(width) / LEAST_SIDE).clamp(1, BLOCKS);
    let range = |block: usize, length: usize| (block * length / blocks).max(1)..((block + 1) * length / blocks).min(length - 1);
    let (mut sum, mut squares) = (0.0, 0.0);
    for (channel, block) in (0..channels).flat_map(|c| (0..blocks * blocks).map(move |b| (c, b))) {
        let mut normal = SMatrix::<f64, N, N>::zeros();
        let [mut with_picture, mut with_frame] = [SVector::<f64, N>::zeros(); 2];
        let [mut pixels, mut pp, mut ff, mut pf] = [0.0; 4];
        for y in range(block / blocks, height) {
            for x in range(block % blocks, width) {
                let i = y * width + x;
                let basis = SVector::<f64, N>::from(explained(channel, i));
                let [p, f] = [picture, frame].map(|image| f64::from(image.plane(channel)[i]));
                if (basis.sum() + p + f).is_nan() {
                    continue;
                }
                normal += basis * basis.transpose();
                with_picture += basis * p;
                with_frame += basis * f;
                [1.0, p * p, f * f, p * f].iter().zip([&mut pixels, &mut pp, &mut ff, &mut pf]).for_each(|(v, s)| *s += v);
            }
        }
        if pixels < FEWEST_PIXELS as f64 {
            continue;
        }
        let ridge = 1e-4 * normal.trace() / N as f64;
        let Some(cholesky) = (normal + SMatrix::identity() * ridge).cholesky() else { continue };
        let [of_picture, of_frame] = [with_picture, with_frame].map(|v| cholesky.solve(&v));
        let picture_left = (pp - of_picture.dot(&with_picture)).max(0.0);
        let frame_left = (ff - of_frame.dot(&with_frame)).max(0.0);
        // Even blocks have nothing left.
        let correlation = (pf - of_picture.dot(&with_frame)) / ((picture_left * frame_left).sqrt() + 1e-6 * pixels);
        let vote = picture_left / (picture_left + pixels * HALF_VOTE * HALF_VOTE);
        sum += vote * correlation;
        squares += vote * correlation * correlation;
    }
    if squares > 0.0 { sum / f64::sqrt(squares) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::config::PhotometricConfig;
    use crate::align::contrast::ContrastPyramid;
    use crate::align::scene::{Scene, view};
    use crate::align::size::Size;

    const SIZE: Size = Size { height: 160, width: 160 };

    fn seen(scene: &Scene, x: f64, zoom: f64) -> Planes {
        let image = scene.frame(&view(SIZE, x, 90.0, 0.1, zoom, 0.0), SIZE);
        ContrastPyramid::new(&image, &PhotometricConfig::default()).levels.swap_remove(0)
    }

    #[test]
    fn the_place_that_a_frame_shows_is_preferred_and_noise_prefers_none() {
        let scene = Scene { noise: 0.05, ..Scene::new(5) };
        let (frame, same) = (seen(&scene, 80.0, 1.0), seen(&scene, 80.000_001, 1.0));
        let other = seen(&Scene { seed: 6, ..scene }, 80.0, 1.0);
        assert!(preference(&frame, &same, &other) > 10.0);
        assert!(preference(&frame, &other, &same) < -10.0);
        assert!(agreement(&frame, &same) > 10.0 && agreement(&frame, &other).abs() < 4.0);
        for k in 1..20 {
            // Each view has noise of its own.
            let [a, b] = [2.0, 3.0].map(|v| seen(&scene, 80.0 + 1e-9 * v * f64::from(k), 1.0));
            let preference = preference(&frame, &a, &b);
            assert!(preference.abs() < 4.0, "{preference}");
        }
    }

    #[test]
    fn a_shift_or_another_sharpness_is_no_difference() {
        let scene = Scene::new(5);
        let frame = seen(&scene, 80.0, 1.0);
        for (x, zoom) in [(80.3, 1.0), (80.0, 1.003)] {
            let moved = seen(&scene, x, zoom);
            assert!(preference(&frame, &frame, &moved) < 8.0, "{x} {zoom}: {}", preference(&frame, &frame, &moved));
        }
    }
}
