//! Laws of the procedural materials: what every family promises for every seed and size.

use std::collections::HashSet;

use dataset::material::maps::MaterialMaps;
use dataset::material::procedural::{Family, generate};
use dataset::material::{Material, MaterialInfo};

const SIZE: usize = 128;

/// Every family with a few seeds.
fn samples() -> impl Iterator<Item = (Family, u64, MaterialMaps)> {
    Family::ALL.iter().flat_map(|&f| [1, 2].map(move |seed| (f, seed, generate(f, seed, SIZE))))
}

#[test]
fn values_are_physical_and_normals_are_unit_vectors() {
    for (family, seed, maps) in samples() {
        let what = format!("{} {seed}", family.name());
        assert_eq!((maps.width(), maps.height()), (SIZE, SIZE), "{what}");
        for planes in [&maps.diffuse, &maps.specular, &maps.roughness] {
            assert!(planes.data.iter().all(|v| (0.0..=1.0).contains(v)), "{what}: outside [0, 1]");
        }
        assert!(maps.roughness.data.iter().all(|&r| r >= 0.01), "{what}: smoother than the renderer can show");
        for t in 0..SIZE * SIZE {
            let [x, y, z] = [0, 1, 2].map(|c| maps.normal.plane(c)[t]);
            assert!((x * x + y * y + z * z - 1.0).abs() < 1e-5, "{what}: texel {t}");
            assert!(z > 0.0, "{what}: texel {t} faces away");
        }
    }
}

/// What is reflected in all directions together can't exceed the light that arrives.
#[test]
fn layers_conserve_energy_and_keep_to_their_substance() {
    for (family, seed, maps) in samples() {
        for t in 0..SIZE * SIZE {
            for c in 0..3 {
                let (diffuse, specular) = (maps.diffuse.plane(c)[t], maps.specular.plane(c)[t]);
                assert!(diffuse + specular <= 1.0 + 1e-6, "{} {seed}: {diffuse} + {specular}", family.name());
                assert!(specular >= 0.015, "{} {seed}: specular {specular} is below any solid's", family.name());
            }
        }
    }
}

/// Nothing comes back from below the surface of a bare metal: exactly nothing, also when stored as 8-bit numbers.
#[test]
fn bare_metals_have_no_diffuse_reflection() {
    for family in [Family::BrushedMetal, Family::HammeredMetal, Family::PolishedMetal, Family::SheetMetal] {
        for seed in 0..6 {
            let maps = generate(family, seed, 64);
            assert!(maps.diffuse.data.iter().all(|&v| v == 0.0), "{} {seed} is no metal", family.name());
            let stored = Material::from_maps(MaterialInfo::made_up("metal"), &maps).expect("finite maps");
            let texel = stored.sample(20.3, 31.7, 1.0);
            assert_eq!(texel.diffuse, [0.0; 3], "{} {seed}", family.name());
        }
    }
    // The ground shows between the rings, and nothing else does.
    let maps = generate(Family::Chainmail, 1, SIZE);
    for t in 0..SIZE * SIZE {
        let diffuse = maps.diffuse.plane(1)[t];
        assert!(diffuse == 0.0 || maps.specular.plane(1)[t] < 0.03, "texel {t}: {diffuse}");
    }
}

/// Plain sheet and moulded plastic are often flat to the bit, and plastic has one colour and one roughness.
#[test]
fn manufactured_surfaces_are_even() {
    for family in [Family::SheetMetal, Family::Plastic] {
        let flat = |seed: &u64| generate(family, *seed, 32).normal.plane(2).iter().all(|&z| z == 1.0);
        let share = (0..60).filter(flat).count();
        assert!((20..55).contains(&share), "{}: {share} of 60 are flat", family.name());
    }
    for seed in 0..20 {
        let maps = generate(Family::Plastic, seed, 32);
        for plane in [maps.diffuse.plane(0), maps.specular.plane(0), maps.roughness.plane(0)] {
            assert!(plane.iter().all(|v| *v == plane[0]), "plastic {seed} isn't even");
        }
    }
}

/// Roofs and corrugated sheet are steep nearly everywhere, as no plain is.
#[test]
fn roofs_and_corrugated_sheet_are_steep() {
    let tilt = |family: Family, seed: u64| {
        let maps = generate(family, seed, 256);
        maps.normal.plane(2).iter().map(|z| z.acos().to_degrees()).sum::<f32>() / (256.0 * 256.0)
    };
    for family in [Family::RoofTiles, Family::CorrugatedSheet] {
        let mean = (0..8).map(|seed| tilt(family, seed)).sum::<f32>() / 8.0;
        assert!((12.0..40.0).contains(&mean), "{}: {mean} degrees", family.name());
    }
}

#[test]
fn the_same_arguments_give_the_same_bits_on_any_thread() {
    for &family in Family::ALL {
        let here = generate(family, 9, 64);
        let there = std::thread::spawn(move || generate(family, 9, 64)).join().expect("the generator doesn't panic");
        assert_eq!(here, there, "{}", family.name());
    }
}

#[test]
fn seeds_and_families_give_different_materials() {
    let mut seen: HashSet<Vec<u32>> = HashSet::new();
    for &family in Family::ALL {
        for seed in 0..3 {
            let maps = generate(family, seed, 32);
            let bits = maps.diffuse.data.iter().chain(&maps.specular.data).map(|v| v.to_bits()).collect();
            assert!(seen.insert(bits), "{} {seed} equals another material", family.name());
        }
    }
    let names: HashSet<&str> = Family::ALL.iter().map(|f| f.name()).collect();
    assert_eq!(names.len(), Family::ALL.len());
    assert!(names.len() >= 20);
    for &family in Family::ALL {
        assert_eq!(Family::from_name(family.name()), Some(family));
    }
    assert_eq!(Family::from_name("velvet"), None);
}

/// The step over the tile's edge is no larger than steps between neighbouring rows and columns inside.
#[test]
fn materials_tile_without_a_seam() {
    for (family, seed, maps) in samples() {
        let height = maps.height_field.as_ref().expect("procedural materials have a height");
        for planes in [height, &maps.diffuse, &maps.roughness, &maps.specular, &maps.normal] {
            let at = |c: usize, along: usize, across: usize, rows: bool| {
                if rows { planes.at(c, across, along) } else { planes.at(c, along, across) }
            };
            for rows in [false, true] {
                let step = |a: usize, b: usize| -> f32 {
                    let texels = (0..planes.channels).flat_map(|c| (0..SIZE).map(move |k| (c, k)));
                    texels.map(|(c, k)| (at(c, k, a, rows) - at(c, k, b, rows)).abs()).sum()
                };
                let seam = step(SIZE - 1, 0);
                let inside = (1..SIZE).map(|k| step(k - 1, k)).fold(0.0, f32::max);
                assert!(
                    seam <= 1.25 * inside + 1e-4,
                    "{} {seed}: {seam} over the edge, at most {inside} inside",
                    family.name()
                );
            }
        }
    }
}

/// Normal maps come from the height by central differences: +x right, +y up, whatever the resolution.
#[test]
fn normals_follow_the_height() {
    for size in [64, 96] {
        for (family, seed) in [(Family::Cobbles, 3), (Family::Knit, 4), (Family::Rock, 5)] {
            let maps = generate(family, seed, size);
            let height = maps.height_field.as_ref().expect("procedural materials have a height");
            let texel = 1024.0 / size as f32;
            for y in 0..size {
                for x in 0..size {
                    let h = |dx: usize, dy: usize| height.at(0, (y + dy) % size, (x + dx) % size);
                    let dx = (h(1, 0) - h(size - 1, 0)) / (2.0 * texel);
                    let down = (h(0, 1) - h(0, size - 1)) / (2.0 * texel);
                    let [nx, ny, nz] = [0, 1, 2].map(|c| maps.normal.at(c, y, x));
                    assert!((nx / nz + dx).abs() < 1e-3, "{} at {x}, {y}", family.name());
                    assert!((ny / nz - down).abs() < 1e-3, "{} at {x}, {y}", family.name());
                }
            }
        }
    }
}

/// A material is a function of the place in the tile: the same bricks lie in the same places at another resolution.
#[test]
fn resolutions_show_the_same_material() {
    for family in [Family::Bricks, Family::WoodPlanks, Family::Cobbles, Family::PrintedTiles, Family::Leaves, Family::Marble] {
        let (coarse, fine) = (generate(family, 6, 256), generate(family, 6, 512));
        let fine = fine.diffuse.resize_area(256, 256);
        let mean = fine.data.iter().sum::<f32>() / fine.data.len() as f32;
        let apart = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum::<f32>() / a.len() as f32;
        let spread = fine.data.iter().map(|v| (v - mean).abs()).sum::<f32>() / fine.data.len() as f32;
        let difference = apart(&coarse.diffuse.data, &fine.data);
        assert!(difference < 0.5 * spread, "{}: {difference} apart, {spread} from the mean", family.name());
    }
}

/// One height field drives all maps: where it is rough, albedo changes with it.
#[test]
fn albedo_and_roughness_follow_the_height() {
    let families =
        [Family::Bricks, Family::Cobbles, Family::CeramicTiles, Family::Knit, Family::Bark, Family::Leather, Family::Gravel];
    for family in families {
        let maps = generate(family, 2, 256);
        let height = &maps.height_field.as_ref().expect("procedural materials have a height").data;
        let diffuse: Vec<f32> = (0..256 * 256).map(|t| (0..3).map(|c| maps.diffuse.plane(c)[t]).sum()).collect();
        let (d, r) = (correlation(height, &diffuse).abs(), correlation(height, &maps.roughness.data).abs());
        assert!(d.max(r) > 0.2, "{}: height correlates {d} with albedo and {r} with roughness", family.name());
    }
}

fn correlation(a: &[f32], b: &[f32]) -> f64 {
    let n = a.len() as f64;
    let mean = |v: &[f32]| v.iter().map(|&x| x as f64).sum::<f64>() / n;
    let (ma, mb) = (mean(a), mean(b));
    let sum = |f: &dyn Fn(f64, f64) -> f64| a.iter().zip(b).map(|(&x, &y)| f(x as f64 - ma, y as f64 - mb)).sum::<f64>();
    sum(&|x, y| x * y) / (sum(&|x, _| x * x) * sum(&|_, y| y * y)).sqrt()
}

/// The two classes differ in what a camera can hold on to: local contrast of the reflectances and of the normals.
#[test]
fn textured_families_have_more_contrast_than_the_others() {
    let contrast = |family: Family| -> f32 {
        let scores = (0..5).map(|seed| {
            let maps = generate(family, seed, 512);
            let planes = [&maps.diffuse, &maps.specular];
            let albedo =
                |x: usize, y: usize| planes.iter().flat_map(|p| (0..3).map(move |c| p.at(c, y, x))).sum::<f32>() + 0.02;
            let steps = (0..64 * 64).map(|k| {
                let (x, y) = (k % 64 * 8, k / 64 * 8);
                let tone = (albedo(x, y) / albedo(x + 3, y + 3)).ln().abs();
                let tilt = (maps.normal.at(0, y, x) - maps.normal.at(0, y + 3, x + 3)).abs();
                tone + tilt
            });
            steps.sum::<f32>() / 4096.0
        });
        let mut scores: Vec<f32> = scores.collect();
        scores.sort_by(f32::total_cmp);
        scores[2]
    };
    let of = |textured: bool| Family::ALL.iter().filter(move |f| f.textured() == textured);
    let lowest = of(true).map(|&f| (contrast(f), f.name())).min_by(|a, b| a.0.total_cmp(&b.0)).expect("textured families");
    let highest = of(false).map(|&f| (contrast(f), f.name())).max_by(|a, b| a.0.total_cmp(&b.0)).expect("plain families");
    assert!(of(false).count() >= 4);
    assert!(lowest.0 > highest.0, "{lowest:?} (textured) is plainer than {highest:?}");
}
