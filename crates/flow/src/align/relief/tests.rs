use super::lights::Lights;
use super::shading::{Samples, brightness, colour, solve};
use crate::align::metrics::{ScanErrors, summarise};
use crate::align::scene::{Scene, between, view};
use crate::align::size::Size;
use crate::align::{AlignConfig, Aligner, Alignment};
use nalgebra::Matrix3;
use ops::homography::Homography;
use ops::planes::Planes;

const SIZE: Size = Size { height: 128, width: 128 };

/// A spiral of 61 frames with a hand's jitter.
fn views() -> Vec<Homography> {
    let place = |i: usize| {
        let t = i as f64;
        let (angle, radius) = (0.35 * t, 0.7 * t);
        let (x, y) = (radius * angle.cos() + 1.5 * (1.7 * t).sin(), radius * angle.sin() + 1.5 * (2.3 * t).cos());
        view(SIZE, x, y, 0.03 * (0.6 * t).sin(), 1.0 + 0.02 * (0.5 * t).sin(), 0.02 * (0.4 * t).sin())
    };
    (0..61).map(place).collect()
}

fn aligned(scene: &Scene, relief: bool) -> (Alignment, f64) {
    let views = views();
    let frames: Vec<Planes> = views.iter().map(|v| scene.frame(v, SIZE)).collect();
    let config = AlignConfig { relief, ..AlignConfig::default() };
    let alignment = Aligner { config, adjacent: None, distant: None }.align(&frames, None).unwrap();
    let truth: Vec<Homography> = alignment.key_frames.iter().map(|k| between(&views[0], &views[k.index])).collect();
    let error = summarise(&[ScanErrors::new(&alignment, &truth, SIZE)]).pixel_error;
    (alignment, error)
}

#[test]
fn the_shading_of_dark_hollows_is_told_from_motion_by_its_colours_or_without_any() {
    let coloured = Scene { relief: 6.0, noise: 0.01, ..Scene::new(31) };
    let flatter = Scene { relief: 3.0, ..coloured };
    let grey = Scene { colour: 0.0, ..flatter };
    for (scene, most, left) in [(coloured, 2.0, 0.5), (flatter, 1.2, 0.4), (grey, 1.2, 0.6)] {
        let ((_, biased), (_, settled)) = (aligned(&scene, false), aligned(&scene, true));
        assert!(biased > most && settled < left * biased, "{biased} px as registered, {settled} px settled");
    }
}

#[test]
fn a_slide_makes_the_expected_errors_larger_and_takes_the_links_along() {
    let scene = Scene { relief: 6.0, noise: 0.01, ..Scene::new(31) };
    let ((before, _), (after, _)) = (aligned(&scene, false), aligned(&scene, true));
    assert!(before.key_frames.iter().zip(&after.key_frames).all(|(a, b)| b.residual_px > a.residual_px));
    // The links went with the frames, so that the camera is found from the settled ones.
    let views = views();
    let off = |alignment: &Alignment| {
        let to = |node: usize| if node == 0 { views[0] } else { views[alignment.key_frames[node - 1].index] };
        let error = |l: &crate::align::graph::Link| {
            let exact = between(&to(l.target), &to(l.source));
            crate::align::candidates::largest_shift(&l.homography, &exact, SIZE)
        };
        alignment.links.iter().map(error).sum::<f64>() / alignment.links.len() as f64
    };
    assert!(off(&after) < 0.9 * off(&before), "{} {}", off(&before), off(&after));
}

#[test]
fn a_flat_print_stays_where_it_is() {
    let scene = Scene { noise: 0.01, ..Scene::new(31) };
    let ((_, before), (_, after)) = (aligned(&scene, false), aligned(&scene, true));
    assert!(before < 1.5 && after < before + 0.3, "{before} px as registered, {after} px settled");
}

#[test]
fn a_slide_lengthens_the_way_over_the_surface() {
    let lights = Lights {
        to_surface: Matrix3::identity(),
        positions: vec![Some([10.0, 20.0, 100.0]), Some([40.0, 20.0, 100.0]), Some([10.0, 20.0, 120.0])],
        focal_px: 100.0,
    };
    let place = Homography::translation(-30.0, 0.0);
    let slid = lights.slid(1, &place, 0.01).unwrap();
    assert_eq!(slid.apply(5.0, 6.0), Some((-24.7, 6.0)));
    assert!((lights.way_px(0, 1) - 30.0).abs() < 1e-9);
    // A higher light sees all slopes smaller: the slide is a change of scale about what is below it.
    let higher = lights.slid(2, &Homography::identity(), 0.06).unwrap();
    let (x, y) = higher.apply(10.0, 20.0).unwrap();
    assert!((x - 10.0).abs() < 1e-9 && (y - 20.0).abs() < 1e-9);
    assert!((higher.apply(11.0, 20.0).unwrap().0 - 11.01).abs() < 1e-9);
    assert!(lights.slid(1, &place, 0.0).unwrap().apply(5.0, 6.0) == place.apply(5.0, 6.0));
}

#[test]
fn shading_is_found_among_highlights() {
    let value = |u: f32, v: f32| 0.3 + 0.8 * u - 0.5 * v;
    let mut samples: Vec<[f32; 3]> = (0..24)
        .map(|i| {
            let reach = [0.15, 0.3][i % 2];
            let (u, v) = (reach * (i as f32 * 0.9).cos(), reach * (i as f32 * 0.9).sin());
            [u, v, value(u, v)]
        })
        .collect();
    samples[4][2] += 5.0;
    let lit: Vec<_> = samples.iter().map(|&[u, v, value]| (brightness(u, v), value)).collect();
    let found = solve(&lit, 0.05).unwrap();
    assert!((found[0] - 0.3).abs() < 0.02 && (found[1] - 0.8).abs() < 0.1 && (found[2] + 0.5).abs() < 0.1, "{found}");
    assert!(solve(&lit[..5], 0.05).is_none(), "too few lights");
    // What depends on the slope isn't explained as a colour.
    let coloured: Vec<_> = samples.iter().map(|&[u, v, value]| (colour(u, v), value)).collect();
    let found = solve(&coloured, 0.05).unwrap();
    let left = |i: usize| (samples[i][2] - found.dot(&coloured[i].0)).abs();
    assert!((0..24).filter(|i| *i != 4).map(left).fold(0.0, f32::max) > 0.1);

    // A ring of lights over a surface of 3 × 2 pixels; the place under a light and an unknown pixel don't take part.
    let nodes = samples.iter().map(|s| ([10.0 * s[0], 10.0 * s[1], 10.0], vec![0.5, 0.5, 0.5, 0.5, f32::NAN, 0.5])).collect();
    let all = Samples { size: Size { height: 2, width: 3 }, to_surface: Matrix3::identity(), nodes };
    let fit = all.fit(brightness, f32::INFINITY);
    assert!(fit.shading[4][0].is_nan() && (fit.shading[0][0] - 0.5).abs() < 1e-3);
    let predicted = all.predicted(&fit.shading, [0.0, 0.0, 10.0]);
    assert!((predicted.at(0, 0, 1) - 0.5).abs() < 1e-3 && predicted.at(0, 1, 1).is_nan());
}
