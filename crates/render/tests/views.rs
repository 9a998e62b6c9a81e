//! The laws of distribution of the loss renderings' views, against the numbers of the paper's §6 and of Deschaintre et al. 2018
//! written out here.

#[path = "../../../tests/statistics/laws.rs"]
mod laws;

use std::f64::consts::PI;

use laws::{column, normal, uniform, unrelated};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use render::views::{Emission, LossViews, Origin, View};

fn rng(seed: u64) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(seed)
}

fn draws() -> Vec<LossViews> {
    let mut rng = rng(1);
    (0..20_000).map(|_| LossViews::draw(&mut rng)).collect()
}

fn direction(origin: Origin) -> [f64; 3] {
    let Origin::Direction(d) = origin else { panic!("{origin:?} is near") };
    d.map(f64::from)
}

fn point(origin: Origin) -> [f64; 3] {
    let Origin::Point(p) = origin else { panic!("{origin:?} is far") };
    p.map(f64::from)
}

fn azimuth([x, y, _]: &[f64; 3]) -> f64 {
    y.atan2(*x)
}

/// r1 of z = √(1 − r1).
fn r1([_, _, z]: &[f64; 3]) -> f64 {
    1.0 - z * z
}

fn norm(v: [f64; 3]) -> f64 {
    v.iter().map(|c| c * c).sum::<f64>().sqrt()
}

#[test]
fn there_are_nine_and_six_renderings_under_an_even_light() {
    for views in draws().iter().take(100) {
        assert_eq!((views.rendering.len(), views.top.len(), views.all().count()), (9, 6, 15));
        let even = Emission::Even { intensity: (1.5 * PI) as f32 };
        assert!(views.all().all(|view| view.emission == even));
    }
    assert_eq!(LossViews::draw(&mut rng(9)), LossViews::draw(&mut rng(9)));
}

#[test]
fn diffuse_views_have_independent_directions_up_to_71_degrees() {
    let views: Vec<View> = draws().into_iter().flat_map(|v| v.rendering.into_iter().take(3)).collect();
    let [cameras, lights] = [|v: &View| v.camera, |v: &View| v.light].map(|of| -> Vec<[f64; 3]> {
        let directions: Vec<_> = views.iter().map(|view| direction(of(view))).collect();
        assert!(directions.iter().all(|d| (norm(*d) - 1.0).abs() < 1e-5));
        uniform(&column(&directions, r1), [0.001, 0.9]).expect("height");
        uniform(&column(&directions, azimuth), [-PI, PI]).expect("azimuth");
        directions
    });
    let columns = [column(&cameras, r1), column(&cameras, azimuth), column(&lights, r1), column(&lights, azimuth)];
    unrelated(&columns.each_ref().map(Vec::as_slice)).expect("own draws");
}

#[test]
fn specular_views_are_mirrored_at_own_distances_about_a_common_shift() {
    let views: Vec<View> = draws().into_iter().flat_map(|v| v.rendering.into_iter().skip(3)).collect();
    let (mut shifts, mut directions, mut distances) = (vec![], vec![], vec![]);
    for view in &views {
        let (v, l) = (point(view.camera), point(view.light));
        // The line between the two is mirrored by the plane where (v − s)/v.z = −(l − s)/l.z.
        let shift = [0, 1].map(|k| (v[k] * l[2] + l[k] * v[2]) / (v[2] + l[2]));
        let [to_view, to_light] = [v, l].map(|p| [p[0] - shift[0], p[1] - shift[1], p[2]]);
        let [near, far] = [norm(to_view), norm(to_light)];
        let mirrored = to_view.iter().zip(to_light).zip([-1.0, -1.0, 1.0]).map(|((v, l), sign)| v / near - sign * l / far);
        assert!(mirrored.into_iter().all(|d| d.abs() < 1e-4), "{view:?}");
        shifts.push(shift);
        directions.push(to_view.map(|c| c / near));
        distances.push([near.ln(), far.ln()]);
    }
    let (r1, azimuth) = (column(&directions, r1), column(&directions, azimuth));
    uniform(&r1, [0.001, 0.9]).expect("height");
    uniform(&azimuth, [-PI, PI]).expect("azimuth");
    let [x, y] = [0, 1].map(|k| column(&shifts, |s| s[k]));
    let [near, far] = [0, 1].map(|k| column(&distances, |d| d[k]));
    uniform(&x, [-1.0, 1.0]).expect("shift along x");
    uniform(&y, [-1.0, 1.0]).expect("shift along y");
    normal(&near, 0.5, 0.75).expect("distance of the viewer");
    normal(&far, 0.5, 0.75).expect("distance of the light");
    unrelated(&[&r1, &azimuth, &x, &y, &near, &far]).expect("own draws");
}

#[test]
fn top_views_have_the_light_at_the_camera_and_the_fields_of_view_of_the_videos() {
    let views: Vec<View> = draws().into_iter().flat_map(|v| v.top).collect();
    assert!(views.iter().all(|view| view.camera == view.light));
    let places: Vec<[f64; 3]> = views.iter().map(|view| point(view.camera)).collect();
    let [x, y] = [0, 1].map(|k| column(&places, |p| p[k]));
    let fov = column(&places, |p| 2.0 * (1.0 / p[2]).atan().to_degrees());
    uniform(&x, [-1.0, 1.0]).expect("place along x");
    uniform(&y, [-1.0, 1.0]).expect("place along y");
    uniform(&fov, [25.0, 35.0]).expect("field of view");
    unrelated(&[&x, &y, &fov]).expect("own draws");
}
