use super::*;
use crate::material::{MaterialInfo, Precision, Wrap};
use crate::stream::Stream;

fn material(specular: f32, wrap: Wrap) -> Arc<Material> {
    let texel = |x: usize, y: usize| {
        let h = |k: usize| ((x * 31 + y * 57 + k * 97) * 7919 % 101) as f32 / 101.0;
        let (nx, ny) = (0.6 * h(0) - 0.3, 0.6 * h(1) - 0.3);
        Texel {
            normal: [nx, ny, (1.0 - nx * nx - ny * ny).sqrt()],
            diffuse: [h(2), 0.5 * h(3), 0.8 * h(4)],
            roughness: h(5),
            specular: [specular * h(6), specular * h(7), specular * h(8)],
        }
    };
    Arc::new(
        Material::build(MaterialInfo { wrap, ..MaterialInfo::made_up("test") }, 33, 20, Precision::Sixteen, texel).unwrap(),
    )
}

/// Grid position of a world position, the contract of the whole workspace.
fn to_grid([x, y]: [f32; 2]) -> (f32, f32) {
    let span = GRID as f32;
    ((x + 1.0) / 2.0 * span - 0.5, (1.0 - y) / 2.0 * span - 0.5)
}

/// Every value a retro-reflecting renderer could compute from a texel seen from `view`: n·v, and the maps.
fn seen(texel: Texel, view: [f32; 3]) -> [f32; 8] {
    let cosine = (0..3).map(|c| texel.normal[c] * view[c]).sum();
    let ([a, b, c], [d, e, f]) = (texel.diffuse, texel.specular);
    [cosine, a, b, c, d, e, f, texel.roughness]
}

#[test]
fn an_augmented_material_looks_like_the_source_from_the_transformed_camera() {
    for wrap in [Wrap::Repeat, Wrap::Mirror] {
        let source = material(0.5, wrap);
        for code in 0..8 {
            let augmentation =
                Augmentation { flip_x: code & 1 > 0, flip_y: code & 2 > 0, transpose: code & 4 > 0, ..Augmentation::IDENTITY };
            let augmented = AugmentedMaterial { material: source.clone(), augmentation };
            // The isometry that takes the augmented world to the source's, written in world axes.
            let to_source = |[x, y]: [f32; 2]| {
                let [x, y] = if augmentation.transpose { [-y, -x] } else { [x, y] };
                [if augmentation.flip_x { -x } else { x }, if augmentation.flip_y { -y } else { y }]
            };
            for i in 0..200 {
                let place = [(i % 17) as f32 * 0.0113 - 0.09, (i / 17) as f32 * 0.0171 - 0.1];
                let eye = [0.03, -0.02, 0.2];
                let view = [eye[0] - place[0], eye[1] - place[1], eye[2]];
                let ([px, py], [vx, vy]) = (to_source(place), to_source([view[0], view[1]]));
                let footprint = 0.5 + (i % 5) as f32;
                let (tx, ty) = to_grid(place);
                let found = seen(augmented.sample(tx, ty, footprint), view);
                let (sx, sy) = to_grid([px, py]);
                let expected = seen(source.sample(sx, sy, footprint), [vx, vy, view[2]]);
                for k in 0..8 {
                    assert!((found[k] - expected[k]).abs() < 2e-3, "{wrap:?} {code} {place:?} value {k}");
                }
            }
        }
    }
}

#[test]
fn factors_and_the_roughness_floor_apply_to_their_own_map() {
    let source = material(0.5, Wrap::Repeat);
    let augmentation = Augmentation { diffuse: 0.81, specular: 1.2, roughness: [0.9 * 0.85, 0.1], ..Augmentation::IDENTITY };
    let augmented = AugmentedMaterial { material: source.clone(), augmentation };
    for i in 0..100 {
        let (tx, ty) = ((i % 10) as f32 * 1.7, (i / 10) as f32 * 1.3);
        let (found, texel) = (augmented.sample(tx, ty, 1.5), source.sample(tx, ty, 1.5));
        for c in 0..3 {
            assert!((found.diffuse[c] - 0.81 * texel.diffuse[c]).abs() < 1e-6);
            assert!((found.specular[c] - 1.2 * texel.specular[c]).abs() < 1e-6);
        }
        assert!((found.roughness - (0.9 * (0.85 * texel.roughness) + 0.1)).abs() < 1e-6);
        assert_eq!(found.normal, texel.normal);
    }
}

#[test]
fn draws_are_deterministic_within_range_and_cover_all_flips() {
    let source = material(0.9, Wrap::Repeat);
    let config = AugmentConfig::default();
    let mut flips = [0; 3];
    let stream = Stream::new(3);
    for video in 0..400 {
        let draw = || Augmentation::draw(&source, &mut stream.rng("augment", video), &config);
        let a = draw();
        assert_eq!(a, draw());
        flips.iter_mut().zip([a.flip_x, a.flip_y, a.transpose]).for_each(|(n, f)| *n += usize::from(f));
        let maxima = source.maxima();
        for (factor, v_max) in
            [(a.diffuse, maxima.diffuse), (a.specular, maxima.specular), (a.roughness[0] / 0.9, maxima.roughness)]
        {
            assert!((0.8 - 1e-6..=1.25).contains(&factor) && factor * v_max <= 1.0 + 1e-6);
        }
        assert_eq!(a.perlin, None, "specular is strong");
    }
    assert!(flips.iter().all(|n| (150..250).contains(n)), "{flips:?}");
}

#[test]
fn roughness_keeps_its_floor_and_the_perlin_layer_its_ranges() {
    let source = material(0.05, Wrap::Repeat);
    let config = AugmentConfig::default();
    let mut layers = 0;
    for video in 0..200 {
        let augmentation = Augmentation::draw(&source, &mut Stream::new(5).rng("augment", video), &config);
        let augmented = AugmentedMaterial { material: source.clone(), augmentation };
        let Some(layer) = augmentation.perlin else { continue };
        layers += 1;
        assert!((0.1..=0.4).contains(&layer.roughness));
        let (mut base, mut top) = (0, 0);
        for i in 0..400 {
            let (x, y) = ((i % 20) as f32 * 13.0, (i / 20) as f32 * 13.0);
            let texel = augmented.sample(x, y, 1.0);
            assert!((0.1 - 1e-6..=1.0).contains(&texel.roughness));
            let (sx, sy) = augmentation.to_source(x, y);
            let normal = augmentation.direction_from_source(source.sample(sx, sy, 1.0).normal);
            assert_eq!(texel.normal, normal, "the layer keeps normals");
            match layer.mask.value(sx, sy, 1.0) {
                0.0 => {
                    top += 1;
                    let found = (texel.specular, texel.diffuse, texel.roughness);
                    assert_eq!(found, (layer.specular, layer.diffuse, layer.roughness));
                }
                1.0 => {
                    base += 1;
                    assert!(texel.specular.iter().all(|&s| s < 0.1));
                }
                _ => {}
            }
        }
        assert!(base + top > 200);
    }
    assert!((70..130).contains(&layers), "{layers} of 200 videos have a layer");
    let without = AugmentConfig { perlin: 0.0, ..config };
    assert!((0..50).all(|v| Augmentation::draw(&source, &mut Stream::new(5).rng("augment", v), &without).perlin.is_none()));
}

#[test]
fn configs_are_strict() {
    assert_eq!(AugmentConfig::default().validate(), Ok(()));
    assert_eq!(AugmentConfig::none().validate(), Ok(()));
    let with = |change: fn(&mut AugmentConfig)| {
        let mut config = AugmentConfig::default();
        change(&mut config);
        config.validate().unwrap_err().key
    };
    assert_eq!(with(|c| c.flip = 1.5), "flip");
    assert_eq!(with(|c| c.perlin = f64::NAN), "perlin");
    assert_eq!(with(|c| c.scale = [1.2, 0.8]), "scale");
    assert_eq!(with(|c| c.roughness_floor = -0.1), "roughness_floor");
    assert_eq!(with(|c| c.perlin_wavelength = [0.0, 64.0]), "perlin_wavelength");
    assert_eq!(with(|c| c.perlin_masks = 0), "perlin_masks");
    let error = serde_json::from_str::<AugmentConfig>(r#"{"flips": 0.5}"#).unwrap_err().to_string();
    assert!(error.contains("unknown field `flips`"), "{error}");
}
