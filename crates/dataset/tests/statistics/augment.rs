//! Augmentation of materials: flips, factors and the Perlin specular layer.

use std::collections::HashMap;
use std::sync::Arc;

use dataset::material::augment::PerlinLayer;
use dataset::material::{AugmentConfig, Augmentation, Material};
use dataset::sequence::SequenceConfig;
use render::texel::Texel;

use crate::laws::{column, share, uniform, uniform_integers, unrelated};
use crate::{rng, stored};

/// An even material.
fn material(diffuse: [f32; 3], specular: [f32; 3], roughness: f32) -> Arc<Material> {
    stored(2, |_, _| Texel { normal: [0.0, 0.0, 1.0], diffuse, specular, roughness })
}

fn draws(material: &Material, config: &AugmentConfig, count: usize) -> Vec<Augmentation> {
    let mut rng = rng(2);
    (0..count).map(|_| Augmentation::draw(material, &mut rng, config)).collect()
}

#[test]
fn flips_and_transpose_come_with_probability_one_half_each() {
    let drawn = draws(&material([0.5; 3], [0.5; 3], 0.5), &AugmentConfig::default(), 40_000);
    let codes: Vec<i64> =
        drawn.iter().map(|a| i64::from(a.flip_x) + 2 * i64::from(a.flip_y) + 4 * i64::from(a.transpose)).collect();
    uniform_integers(&codes, 0..=7).expect("flips");
}

#[test]
fn every_map_has_an_own_factor_that_keeps_it_below_one() {
    // The largest value over the channels counts: 0.3 leaves the range whole, 0.9 and 1 cut it at 1/(v_max + 1e-4).
    let material = material([0.1, 0.3, 0.2], [0.9, 0.2, 0.4], 1.0);
    for config in [SequenceConfig::svbrdf().augment, SequenceConfig::flow().augment] {
        let drawn = draws(&material, &config, 100_000);
        let diffuse = column(&drawn, |a| a.diffuse);
        let specular = column(&drawn, |a| a.specular);
        let roughness = column(&drawn, |a| f64::from(a.roughness[0]) / 0.9);
        uniform(&diffuse, [0.8, 1.25]).expect("diffuse");
        uniform(&specular, [0.8, 1.0 / 0.9001]).expect("specular");
        uniform(&roughness, [0.8, 1.0 / 1.0001]).expect("roughness");
        unrelated(&[&diffuse, &specular, &roughness]).expect("own factors");
        assert!(drawn.iter().all(|a| a.roughness[1] == 0.1), "roughness starts at 0.1 for both nets");
        assert!(drawn.iter().all(|a| a.perlin.is_none()), "a strong specular has no second layer");
    }
}

#[test]
fn half_of_the_materials_whose_scaled_specular_stays_below_a_tenth_get_a_layer() {
    let material = material([0.5; 3], [0.02, 0.1, 0.05], 0.5);
    let drawn = draws(&material, &SequenceConfig::svbrdf().augment, 100_000);
    let (weak, strong): (Vec<&Augmentation>, Vec<_>) = drawn.iter().partition(|a| a.specular < 1.0);
    share(weak.len(), drawn.len(), 0.2 / 0.45).expect("weak materials");
    let layered: Vec<_> = weak.iter().filter(|a| a.perlin.is_some()).collect();
    share(layered.len(), weak.len(), 0.5).expect("layers");
    uniform(&column(&layered, |a| 0.1 * f64::from(a.specular)), [0.08, 0.1]).expect("scaled specular under a layer");
    // The stored 0.1 is a step of 16 bit off.
    assert!(strong.iter().all(|a| a.perlin.is_none() || a.specular < 1.0001));
    assert!(draws(&material, &SequenceConfig::flow().augment, 1000).iter().all(|a| a.perlin.is_none()));
}

fn layers() -> Vec<PerlinLayer> {
    let drawn = draws(&material([0.5; 3], [0.04; 3], 0.5), &AugmentConfig::default(), 100_000);
    drawn.iter().filter_map(|a| a.perlin).collect()
}

#[test]
fn the_layer_is_as_reflective_and_rough_as_the_paper_says() {
    let layers = layers();
    share(layers.len(), 100_000, 0.5).expect("layers");
    let [red, green, blue]: [Vec<f64>; 3] = std::array::from_fn(|c| column(&layers, |l| l.specular[c]));
    let roughness = column(&layers, |l| l.roughness);
    let brightest = |l: &PerlinLayer| (0..3).max_by(|a, b| l.specular[*a].total_cmp(&l.specular[*b])).unwrap_or(0);
    let factor = column(&layers, |l| l.diffuse[brightest(l)] / l.specular[brightest(l)]);
    for specular in [&red, &green, &blue] {
        uniform(specular, [0.0, 1.0]).expect("specular");
    }
    uniform(&roughness, [0.1, 0.4]).expect("roughness");
    uniform(&factor, [0.0, 0.1]).expect("diffuse per specular");
    unrelated(&[&red, &green, &blue, &roughness, &factor]).expect("own draws");
    for (layer, factor) in layers.iter().zip(&factor) {
        let close = |c: usize| (f64::from(layer.diffuse[c]) - factor * f64::from(layer.specular[c])).abs() < 1e-6;
        assert!((0..3).all(close), "one factor for all channels: {layer:?}");
    }
}

#[test]
fn the_layer_shows_through_one_of_a_hundred_masks() {
    let mut numbers = HashMap::new();
    let masks: Vec<i64> = layers()
        .iter()
        .map(|layer| {
            let next = numbers.len() as i64;
            *numbers.entry(format!("{:?}", layer.mask)).or_insert(next)
        })
        .collect();
    uniform_integers(&masks, 0..=99).expect("masks");
}
