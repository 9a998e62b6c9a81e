//! What stands still in the image while the surface moves: the mark of a light that travels with the camera.
//!
//! A glossy, even sample shows a bright highlight near the image centre in every frame, with more contrast than anything on
//! the surface. Over a whole scan the surface averages out and the highlight doesn't: its mean is subtracted from every frame,
//! and where it flickers, weight is taken away.

use ops::planes::Planes;
use rayon::prelude::*;

use super::contrast::ContrastPyramid;

/// With fewer frames the surface itself would be taken for what stands still.
pub const FEWEST_FRAMES: usize = 16;
/// When more than this share of all contrast stands still, the camera does.
const STILL_CAMERA: f64 = 0.8;

/// Mean and attenuation of every plane of every level.
#[derive(Clone, Debug)]
pub struct SteadyPattern {
    levels: Vec<(Planes, Planes)>,
}

impl SteadyPattern {
    /// The pattern of the frames of a scan, all of one size; `None` for a short scan or a camera that doesn't move.
    pub fn measure(frames: &[ContrastPyramid]) -> Option<Self> {
        if frames.len() < FEWEST_FRAMES {
            return None;
        }
        let levels: Vec<(Planes, Planes, f64)> =
            (0..frames[0].levels.len()).into_par_iter().map(|level| level_pattern(frames, level)).collect();
        let still = levels[0].2 > STILL_CAMERA;
        (!still).then(|| Self { levels: levels.into_iter().map(|(mean, weight, _)| (mean, weight)).collect() })
    }

    /// Takes the pattern out of a frame.
    pub fn remove(&self, frame: &mut ContrastPyramid) {
        for (planes, (mean, weight)) in frame.levels.iter_mut().zip(&self.levels) {
            let pattern = mean.data.iter().zip(&weight.data);
            planes.data.iter_mut().zip(pattern).for_each(|(v, (m, w))| *v = w * (*v - m));
        }
    }
}

/// Mean, attenuation and the share of the contrast that stands still.
fn level_pattern(frames: &[ContrastPyramid], level: usize) -> (Planes, Planes, f64) {
    let first = &frames[0].levels[level];
    let (mut mean, mut weight) = (first.clone(), first.clone());
    let (mut total, mut still) = (0.0f64, 0.0f64);
    for i in 0..first.data.len() {
        let known = || frames.iter().map(|f| f.levels[level].data[i]).filter(|v| !v.is_nan());
        let n = known().count().max(1) as f32;
        let average = known().sum::<f32>() / n;
        let square = known().map(|v| v * v).sum::<f32>() / n;
        total += f64::from(square);
        still += f64::from(average * average);
        mean.data[i] = average;
        weight.data[i] = (square - average * average).max(0.0).sqrt();
    }
    let area = first.area();
    for deviations in weight.data.chunks_mut(area) {
        let mut sorted = deviations.to_vec();
        let (_, &mut typical, _) = sorted.select_nth_unstable_by(area / 2, f32::total_cmp);
        // A pixel that varies as much as most keeps its weight.
        deviations.iter_mut().for_each(|d| *d = if *d > typical { typical / *d } else { 1.0 });
    }
    (mean, weight, if total > 0.0 { still / total } else { 1.0 })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::config::PhotometricConfig;
    use crate::align::photometric::consistency;
    use crate::align::scene::{Scene, between, view};
    use crate::align::size::Size;
    use ops::homography::Homography;

    const SIZE: Size = Size { height: 64, width: 64 };

    fn pyramids(scene: &Scene, views: &[Homography]) -> Vec<ContrastPyramid> {
        views.iter().map(|v| ContrastPyramid::new(&scene.frame(v, SIZE), &PhotometricConfig::default())).collect()
    }

    #[test]
    fn a_highlight_over_faint_texture_stops_to_look_like_stillness() {
        let scene = Scene { contrast: 0.03, highlight: 0.5, noise: 0.01, ..Scene::new(9) };
        let views: Vec<Homography> = (0..40).map(|i| view(SIZE, 9.0 * f64::from(i), 0.0, 0.0, 1.0, 0.0)).collect();
        let mut frames = pyramids(&scene, &views);
        let truth = between(&views[0], &views[1]);
        let margin = |frames: &[ContrastPyramid]| {
            let at = |h: &Homography| consistency(&frames[0], &frames[1], h, 0).zncc;
            at(&truth) - at(&Homography::identity())
        };
        let before = margin(&frames);
        let pattern = SteadyPattern::measure(&frames).unwrap();
        frames.iter_mut().for_each(|f| pattern.remove(f));
        assert!(margin(&frames) > before + 0.2, "{before} {}", margin(&frames));
    }

    #[test]
    fn short_scans_and_still_cameras_are_left_alone() {
        let scene = Scene::new(9);
        let frame = pyramids(&scene, &[Homography::identity()]).remove(0);
        assert!(SteadyPattern::measure(&vec![frame.clone(); 8]).is_none());
        assert!(SteadyPattern::measure(&vec![frame; 30]).is_none());
    }
}
