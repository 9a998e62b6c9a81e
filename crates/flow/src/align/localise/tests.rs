use nalgebra::Matrix3;

use super::*;
use crate::align::candidates::largest_shift;
use crate::align::scene::{Scene, between, view};

const FRAME: Size = Size { height: 128, width: 128 };
const LARGE: Size = Size { height: 360, width: 400 };

/// The scene from above, with `scale` of the frame's pixels per pixel, lit from the side and brighter.
fn photo(scene: &Scene, scale: f64) -> Planes {
    let full = scene.frame(&Homography::identity(), LARGE);
    let mut photo = full.resize_area((LARGE.height as f64 / scale) as usize, (LARGE.width as f64 / scale) as usize);
    let width = photo.width;
    for plane in photo.data.chunks_mut(width) {
        plane
            .iter_mut()
            .enumerate()
            .for_each(|(x, v)| *v = (*v * (0.5 + 0.6 * x as f32 / width as f32) + 0.08).clamp(0.0, 1.0));
    }
    photo
}

fn lit() -> Scene {
    Scene { highlight: 0.3, noise: 0.01, ..Scene::new(17) }
}

/// Looks for densities around `scale` only: the whole bank takes seconds.
fn locate(guidance: &Planes, frame: &Planes, scale: f64) -> Result<Located, NotLocated> {
    let config = LocaliseConfig { scale: [scale / 1.2, scale * 1.2], ..LocaliseConfig::default() };
    localise(guidance, frame, &config, &PhotometricConfig::default())
}

#[test]
fn a_frame_is_found_at_any_density_and_rotation() {
    for (scale, roll, x, y) in [(1.0, 0.1, 280.0, 130.0), (1.7, -1.4, 200.0, 240.0), (2.4, 2.9, 260.0, 190.0)] {
        let at = view(FRAME, x, y, roll, 1.0, 0.004);
        let (photo, frame) = (photo(&lit(), scale), lit().frame(&at, FRAME));
        let found = locate(&photo, &frame, scale).unwrap();
        let to_photo = LARGE.resize_matrix(Size::of(&photo));
        let truth = Homography::new((to_photo * at.matrix).try_inverse().unwrap());
        // In pixels of the frame, over the part of the photo that shows it.
        let error = largest_shift(&found.homography.after(&truth.inverse().unwrap()), &Homography::identity(), FRAME);
        assert!(error < 1.0 + scale, "{scale}, {roll}: {error} px, {found:?}");
        assert!((found.scale / scale - 1.0).abs() < 0.03 && found.runner_up < 0.8 && found.expected_px < 3.0, "{found:?}");
    }
}

#[test]
fn the_frame_itself_and_a_photo_that_shows_little_more_are_found_among_all_densities() {
    let at = view(FRAME, 200.0, 180.0, 0.3, 1.0, 0.0);
    let frame = lit().frame(&at, FRAME);
    for border in [0, 6] {
        let off = -(border as f64);
        let around = Homography::new(at.matrix * Homography::translation(off, off).matrix);
        let larger = Size { height: 128 + 2 * border, width: 128 + 2 * border };
        let photo = if border == 0 { frame.clone() } else { lit().frame(&around, larger) };
        let found = localise(&photo, &frame, &LocaliseConfig::default(), &PhotometricConfig::default()).unwrap();
        assert!(largest_shift(&found.homography, &Homography::translation(off, off), FRAME) < 1.0, "{border}: {found:?}");
    }
}

#[test]
fn a_frame_is_found_in_a_photo_ten_times_as_coarse() {
    let (fine, coarse) = (Size { height: 256, width: 256 }, Size { height: 100, width: 110 });
    let at = view(fine, 190.0, 160.0, 0.8, 0.25, 0.0);
    let around = view(coarse, 175.0, 180.0, -0.4, 2.5, 0.0);
    let (photo, frame) = (Scene::new(17).frame(&around, coarse), lit().frame(&at, fine));
    let found = localise(&photo, &frame, &LocaliseConfig::default(), &PhotometricConfig::default()).unwrap();
    let to_photo = found.homography.inverse().unwrap();
    // In pixels of the photo; a quarter is 2.5 pixels of the frame.
    let error = largest_shift(&to_photo, &between(&at, &around), fine);
    assert!(error < 0.25 && (found.scale - 10.0).abs() < 0.3, "{error}: {found:?}");
}

#[test]
fn a_photo_of_something_else_is_refused() {
    for seed in 0..3 {
        let frame = lit().frame(&view(FRAME, 200.0, 180.0, 0.0, 1.0, 0.0), FRAME);
        let other = photo(&Scene::new(40 + seed), 2.0);
        let refused = locate(&other, &frame, 2.0).unwrap_err();
        assert!(matches!(refused, NotLocated::NotFound { .. }) && refused.to_string().contains("not found"), "{refused:?}");
    }
}

#[test]
fn the_same_highlight_on_an_even_surface_is_no_place() {
    let glare = |contrast, seed, size| {
        Scene { highlight: 0.4, noise: 0.004, contrast, ..Scene::new(seed) }.frame(&Homography::identity(), size)
    };
    let (frame, photo) = (glare(0.004, 1, FRAME), glare(0.004, 2, Size { height: 160, width: 160 }));
    let refused = localise(&photo, &frame, &LocaliseConfig::default(), &PhotometricConfig::default());
    assert!(refused.is_err(), "{refused:?}");
}

#[test]
fn a_pattern_that_repeats_is_refused() {
    let tile = lit().frame(&Homography::identity(), Size { height: 96, width: 96 });
    let mut photo = Planes::new(3, 288, 384);
    for (i, v) in photo.data.iter_mut().enumerate() {
        let (c, y, x) = (i / (288 * 384), i / 384 % 288, i % 384);
        *v = tile.at(c, y % 96, x % 96);
    }
    let frame = photo.crop(70, 50, 128, 128);
    let refused = locate(&photo, &frame, 1.0).unwrap_err();
    assert!(matches!(refused, NotLocated::Ambiguous { .. }) && refused.to_string().contains("repeats"), "{refused:?}");
}

/// A wall of one tile again and again, with noise of the image's own; if so wished, the tile in column and row 2 has marks.
fn wall(view: &Homography, size: Size, marked: bool, seed: u64) -> Planes {
    const TILE: f64 = 64.0;
    let marks = Scene::new(3).frame(&Homography::identity(), Size { height: 64, width: 64 });
    let mut image = Scene { contrast: 0.0, noise: 0.01, ..Scene::new(seed) }.frame(view, size);
    for i in 0..image.area() {
        let (u, v) = view.apply((i % size.width) as f64, (i / size.width) as f64).unwrap();
        let wave = |k: i32| {
            let [along, across] = [f64::from(k % 3 + 1), f64::from(k % 5 - 2)];
            (std::f64::consts::TAU * (along * u + across * v) / TILE + 2.4 * f64::from(k * k)).sin()
        };
        let ornament = 0.05 * (0..12).map(wave).sum::<f64>();
        let mark = if marked && (u / TILE).floor() == 2.0 && (v / TILE).floor() == 2.0 {
            marks.sample_bilinear(0, u.rem_euclid(TILE).min(63.0) as f32, v.rem_euclid(TILE).min(63.0) as f32).unwrap() - 0.4
        } else {
            0.0
        };
        (0..3).for_each(|c| image.data[c * size.height * size.width + i] += ornament as f32 + 0.5 * mark);
    }
    image
}

#[test]
fn a_tile_of_its_own_tells_the_places_of_a_pattern_apart_and_noise_does_not() {
    for (roll, zoom) in [(0.0, 1.0), (0.8, 1.3), (0.0, 1.7)] {
        let (at, size) = (
            view(FRAME, 170.0, 150.0, 0.0, 1.0, 0.0),
            Size { height: (320.0 / zoom) as usize, width: (340.0 / zoom) as usize },
        );
        let around = view(size, 180.0, 170.0, roll, zoom, 0.0);
        let seen = |marked| locate(&wall(&around, size, marked, 1), &wall(&at, FRAME, marked, 2), zoom);
        let refused = seen(false).unwrap_err();
        assert!(matches!(refused, NotLocated::Ambiguous { .. }), "{roll} {zoom}: {refused:?}");
        let found = seen(true).unwrap();
        let error = largest_shift(&found.homography.inverse().unwrap(), &between(&at, &around), FRAME);
        assert!(error < 0.5, "{roll} {zoom}: {error} px of the photo, {found:?}");
    }
}

#[test]
fn nothing_to_see_and_impossible_sizes_are_named() {
    let frame = lit().frame(&view(FRAME, 200.0, 180.0, 0.0, 1.0, 0.0), FRAME);
    let even = Planes::constant(300, 300, &[0.5; 3]);
    assert_eq!(locate(&even, &frame, 1.0).unwrap_err(), NotLocated::NoTexture { image: "the guidance photo" });
    let photo = photo(&lit(), 1.0);
    assert_eq!(locate(&photo, &even, 1.0).unwrap_err(), NotLocated::NoTexture { image: "the first frame" });
    let tiny = photo.resize_area(20, 20);
    assert!(matches!(locate(&tiny, &frame, 1.0).unwrap_err(), NotLocated::Sizes { .. }));
}

#[test]
fn impossible_settings_are_named() {
    LocaliseConfig::default().validate().unwrap();
    for scale in [[0.0, 12.5], [2.0, 1.0], [1.0, f64::NAN], [1.0, 1e9]] {
        let refused = LocaliseConfig { scale, ..LocaliseConfig::default() }.validate().unwrap_err();
        assert_eq!(refused.name, "localise.scale", "{refused:?}");
    }
    for rotation_deg in [-1.0, 181.0, f64::NAN] {
        let refused = LocaliseConfig { rotation_deg, ..LocaliseConfig::default() }.validate().unwrap_err();
        assert_eq!(refused.name, "localise.rotation_deg", "{refused:?}");
    }
}

#[test]
fn a_box_drawn_by_hand_is_refined_or_refused() {
    let at = view(FRAME, 240.0, 180.0, 0.0, 1.0, 0.0);
    let (photo, frame) = (photo(&lit(), 2.0), lit().frame(&at, FRAME));
    let near = |y: f64, x: f64| localise_near(&photo, &frame, [y, y + 64.0, x, x + 64.0], &PhotometricConfig::default());
    // The frame's outermost pixel centres are 63.5 pixels from its middle, and the photo's pixels are two wide.
    let found = near((180.0 - 63.5) / 2.0 + 2.0, (240.0 - 63.5) / 2.0 - 1.5).unwrap();
    let truth = between(&Homography::new(Matrix3::new(2.0, 0.0, 0.5, 0.0, 2.0, 0.5, 0.0, 0.0, 1.0)), &at);
    let middle = (120.0, 90.0);
    let (a, b) = (found.homography.apply(middle.0, middle.1).unwrap(), truth.apply(middle.0, middle.1).unwrap());
    assert!((a.0 - b.0).hypot(a.1 - b.1) < 1.5, "{a:?} {b:?}");
    assert!(matches!(near(10.0, 20.0), Err(NotLocated::NotFound { .. })));
}
