use super::*;
use crate::material::Wrap;

/// Varied but smooth-free texels: neighbours differ in every channel.
fn texel(x: usize, y: usize) -> Texel {
    let h = |k: usize| ((x * 31 + y * 57 + k * 97) * 7919 % 101) as f32 / 101.0;
    let normal = [h(0) - 0.5, h(1) - 0.5, 1.0];
    let length = normal.iter().map(|v| v * v).sum::<f32>().sqrt();
    Texel { normal: normal.map(|v| v / length), diffuse: [h(2), h(3), h(4)], roughness: h(5), specular: [h(6), h(7), h(8)] }
}

fn material(width: usize, height: usize, wrap: Wrap, precision: Precision) -> Material {
    Material::build(MaterialInfo { wrap, ..MaterialInfo::made_up("test") }, width, height, precision, texel).unwrap()
}

fn values(t: Texel) -> [f32; 10] {
    let ([nx, ny, nz], [a, b, c], [d, e, f]) = (t.normal, t.diffuse, t.specular);
    [nx, ny, nz, a, b, c, d, e, f, t.roughness]
}

fn close(a: Texel, b: Texel, tolerance: f32) -> bool {
    values(a).iter().zip(values(b)).all(|(x, y)| (x - y).abs() <= tolerance)
}

/// The tile's texel at any integer place, with mirrors, straight from the definition.
fn endless(width: i32, height: i32, wrap: Wrap, x: i32, y: i32) -> Texel {
    let fold = |i: i32, n: i32| match wrap {
        Wrap::Repeat => (i.rem_euclid(n), 1.0),
        Wrap::Mirror if i.div_euclid(n) % 2 == 0 => (i.rem_euclid(n), 1.0),
        Wrap::Mirror => (n - 1 - i.rem_euclid(n), -1.0),
    };
    let ((u, sign_x), (v, sign_y)) = (fold(x, width), fold(y, height));
    let mut t = texel(u as usize, v as usize);
    t.normal[0] *= sign_x;
    t.normal[1] *= sign_y;
    t
}

#[test]
fn texels_come_back_at_integers_in_every_copy_of_the_tile() {
    for wrap in [Wrap::Repeat, Wrap::Mirror] {
        for (width, height) in [(8, 8), (7, 5)] {
            let stored = material(width, height, wrap, Precision::Sixteen);
            for y in -12..17 {
                for x in -15..18 {
                    let expected = endless(width as i32, height as i32, wrap, x, y);
                    assert!(close(stored.sample(x as f32, y as f32, 1.0), expected, 2e-4), "{wrap:?} {x} {y}");
                }
            }
        }
    }
}

#[test]
fn between_texels_it_interpolates_across_seams_too() {
    for wrap in [Wrap::Repeat, Wrap::Mirror] {
        let stored = material(7, 5, wrap, Precision::Sixteen);
        for (x, y) in [(6.25f32, 1.5f32), (-0.75, 4.125), (13.5, -5.5), (3.3, 2.7), (6.5, 4.5)] {
            let (fx, fy) = (x - x.floor(), y - y.floor());
            let mut expected = [0.0; 10];
            for (dx, dy, weight) in
                [(0, 0, (1.0 - fx) * (1.0 - fy)), (1, 0, fx * (1.0 - fy)), (0, 1, (1.0 - fx) * fy), (1, 1, fx * fy)]
            {
                let tap = values(endless(7, 5, wrap, x.floor() as i32 + dx, y.floor() as i32 + dy));
                expected.iter_mut().zip(tap).for_each(|(e, t)| *e += weight * t);
            }
            expected[2] = (1.0 - expected[0].powi(2) - expected[1].powi(2)).sqrt();
            let found = values(stored.sample(x, y, 0.3));
            for k in 0..10 {
                assert!((found[k] - expected[k]).abs() < 3e-4, "{wrap:?} ({x}, {y}) value {k}: {} {}", found[k], expected[k]);
            }
        }
    }
}

#[test]
fn a_wide_footprint_sees_the_mean() {
    for precision in [Precision::Eight, Precision::Sixteen] {
        let stored = material(64, 64, Wrap::Repeat, precision);
        let mut mean = [0.0f64; 10];
        for i in 0..4096 {
            mean.iter_mut().zip(values(texel(i % 64, i / 64))).for_each(|(m, v)| *m += f64::from(v) / 4096.0);
        }
        let found = values(stored.sample(11.0, 40.0, 4096.0));
        for k in 3..10 {
            assert!((f64::from(found[k]) - mean[k]).abs() < 6e-3, "{precision:?} {k}: {} {}", found[k], mean[k]);
        }
    }
}

#[test]
fn sampling_is_continuous_in_the_footprint() {
    let stored = material(64, 48, Wrap::Mirror, Precision::Eight);
    let mut before = stored.sample(20.3, 9.1, 0.5);
    for step in 1..2000 {
        let now = stored.sample(20.3, 9.1, 0.5 * 1.005f32.powi(step));
        assert!(close(before, now, 0.01), "step {step}: {before:?} {now:?}");
        before = now;
    }
}

/// Blocks at every footprint, on both sides of mirrors, and where footprints within a block read different levels.
#[test]
fn a_block_has_the_bits_of_its_samples() {
    for (wrap, precision) in
        [(Wrap::Repeat, Precision::Eight), (Wrap::Mirror, Precision::Eight), (Wrap::Mirror, Precision::Sixteen)]
    {
        let stored = material(64, 48, wrap, precision);
        for (step, footprint) in [(0.37, 0.5), (0.9, 1.0), (1.3, 1.4), (2.2, 2.5), (5.0, 7.0), (0.6, 1.9)] {
            for row in 0..40 {
                let places = |from: f32, by: f32| std::array::from_fn(|k| from + by * k as f32);
                let (tx, ty) = (places(1.7 * row as f32 - 30.0, step), places(40.0 - 2.3 * row as f32, 0.4 * step));
                let widths = places(footprint, if row % 4 == 0 { 0.05 } else { 0.0 });
                let block = stored.sample_block(&tx, &ty, &widths);
                for k in 0..render::block::LANES {
                    assert_eq!(block.at(k), stored.sample(tx[k], ty[k], widths[k]), "footprint {}, pixel {k}", widths[k]);
                }
            }
        }
        let far = stored.sample_block(&[-1e30; 16], &[1e30; 16], &[f32::INFINITY; 16]);
        assert!(far.roughness.iter().all(|r| r.is_finite()));
    }
}

#[test]
fn a_denser_material_shows_more_texels_over_the_same_ground() {
    let mut dense = MaterialInfo::made_up("test");
    dense.texels = 2 * GRID;
    let stored = Material::build(dense, 16, 16, Precision::Sixteen, texel).unwrap();
    // Texels 0 and 1 of the tile lie under texel 0 of the grid, their common edge at its centre.
    let (a, b) = (texel(4, 6), texel(5, 7));
    let (c, d) = (texel(5, 6), texel(4, 7));
    let found = stored.sample(2.0, 3.0, 0.25);
    let mean = [a, b, c, d].iter().map(|t| t.roughness).sum::<f32>() / 4.0;
    assert!((found.roughness - mean).abs() < 1e-4);
}

#[test]
fn a_4096_material_fits_the_budget() {
    assert!(bytes(4096, 4096, 1) <= MAX_BYTES, "{}", bytes(4096, 4096, 1));
    let small = material(256, 128, Wrap::Repeat, Precision::Eight);
    assert_eq!(small.bytes(), bytes(256, 128, 1));
    assert_eq!(material(16, 16, Wrap::Repeat, Precision::Sixteen).bytes(), bytes(16, 16, 2));
}

#[test]
fn bad_texels_are_refused_and_bad_places_survived() {
    let nan = |x: usize, y: usize| Texel { roughness: if (x, y) == (3, 2) { f32::NAN } else { 0.5 }, ..texel(x, y) };
    assert!(matches!(
        Material::build(MaterialInfo::made_up("test"), 4, 4, Precision::Eight, nan),
        Err(MaterialError::NonFinite { .. })
    ));
    assert!(matches!(
        Material::build(MaterialInfo::made_up("test"), 0, 4, Precision::Eight, texel),
        Err(MaterialError::Size { .. })
    ));
    let stored = material(4, 4, Wrap::Mirror, Precision::Eight);
    for place in [f32::NAN, f32::INFINITY, -f32::INFINITY, 1e30, -1e30] {
        for footprint in [1.0, f32::NAN, f32::INFINITY, -1.0, 1e30] {
            stored.sample(place, 0.0, footprint);
            stored.sample(0.0, place, footprint);
        }
    }
}

#[test]
fn maxima_are_those_of_the_stored_maps() {
    let maxima = material(32, 32, Wrap::Repeat, Precision::Eight).maxima();
    for (found, channels) in [(maxima.diffuse, 3..6), (maxima.specular, 6..9), (maxima.roughness, 9..10)] {
        let all = (0..1024).flat_map(|i| values(texel(i % 32, i / 32))[channels.clone()].to_vec());
        assert!((found - all.fold(0.0, f32::max)).abs() < 0.01);
    }
}
