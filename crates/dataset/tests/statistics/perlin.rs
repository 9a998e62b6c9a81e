//! Perlin masks: what they are drawn from, how much they cover, and how long their waves are.

use dataset::material::AugmentConfig;
use dataset::material::perlin::PerlinMask;
use rand::RngExt;

use crate::laws::{column, uniform, uniform_integers, unrelated};
use crate::rng;

fn mask(octaves: u32, wavelength: f32) -> PerlinMask {
    PerlinMask { octaves, wavelength, offset: [311.25, 87.5], threshold: 0.0 }
}

/// A place on the 4096² grid.
fn place(rng: &mut impl rand::Rng) -> [f32; 2] {
    std::array::from_fn(|_| rng.random_range(0.0..4096.0))
}

#[test]
fn masks_are_drawn_from_the_ranges_of_the_paper() {
    let range = AugmentConfig::default().perlin_wavelength;
    let mut rng = rng(3);
    let drawn: Vec<PerlinMask> = (0..100_000).map(|_| PerlinMask::draw(&mut rng, range)).collect();
    uniform_integers(&drawn.iter().map(|m| i64::from(m.octaves)).collect::<Vec<_>>(), 1..=3).expect("octaves");
    let wavelength = column(&drawn, |m| m.wavelength);
    let [x, y]: [Vec<f64>; 2] = std::array::from_fn(|k| column(&drawn, |m| m.offset[k]));
    let threshold = column(&drawn, |m| m.threshold);
    uniform(&wavelength, [16.0, 64.0]).expect("wavelength");
    uniform(&x, [0.0, 1024.0]).expect("offset along x");
    uniform(&y, [0.0, 1024.0]).expect("offset along y");
    uniform(&threshold, [-0.3, 0.3]).expect("threshold");
    unrelated(&[&column(&drawn, |m| m.octaves), &wavelength, &x, &y, &threshold]).expect("own draws");
}

/// Share of ones over thresholds −0.3, −0.2 … 0.3, for 1, 2 and 3 octaves: `pnoise2` of the Python package noise 1.2.2
/// (persistence 0.5, lacunarity 2) at two million random places each.
const SHARES: [[f32; 7]; 3] = [
    [0.8891, 0.7841, 0.6505, 0.5009, 0.3507, 0.2158, 0.1087],
    [0.9476, 0.8600, 0.7077, 0.5005, 0.2930, 0.1393, 0.0514],
    [0.9705, 0.8909, 0.7319, 0.5007, 0.2684, 0.1083, 0.0293],
];

#[test]
fn the_mask_covers_as_much_as_classic_perlin_noise_does() {
    let mut rng = rng(4);
    for (octaves, shares) in (1..).zip(SHARES) {
        for (k, expected) in shares.into_iter().enumerate() {
            let threshold = 0.1 * k as f32 - 0.3;
            let (mut sharp, mut wide) = (0.0, 0.0);
            for _ in 0..400 {
                let drawn = PerlinMask { octaves, threshold, ..PerlinMask::draw(&mut rng, [16.0, 64.0]) };
                for _ in 0..200 {
                    let [tx, ty] = place(&mut rng);
                    sharp += drawn.value(tx, ty, 1.0) / 80_000.0;
                    wide += drawn.value(tx, ty, 4.0) / 80_000.0;
                }
            }
            assert!((sharp - expected).abs() < 0.008, "{octaves} octaves above {threshold}: {sharp} instead of {expected}");
            assert!((wide - expected).abs() < 0.02, "{octaves} octaves in wide pixels: {wide} instead of {expected}");
        }
    }
}

/// Gradient noise vanishes on its lattice and hardly anywhere else: the lattice's spacing is the wavelength.
#[test]
fn octaves_halve_in_wavelength_and_amplitude() {
    let mut rng = rng(5);
    let wavelength = 24.0;
    let noise = [1, 2, 3].map(|octaves| mask(octaves, wavelength));
    // What an octave adds: the sum so far is divided by 1, 1.5, 1.75.
    let added = |octave: usize, tx: f32, ty: f32| {
        let total = [1.0, 1.5, 1.75];
        let before = if octave == 0 { 0.0 } else { total[octave - 1] * noise[octave - 1].noise(tx, ty) };
        total[octave] * noise[octave].noise(tx, ty) - before
    };
    let root_mean_square = |octave: usize, at: &mut dyn FnMut() -> [f32; 2]| {
        let squares = (0..20_000).map(|_| at()).map(|[tx, ty]| added(octave, tx, ty).powi(2));
        (squares.sum::<f32>() / 20_000.0).sqrt()
    };
    let anywhere = [0, 1, 2].map(|octave| root_mean_square(octave, &mut || place(&mut rng)));
    assert!((anywhere[1] / anywhere[0] - 0.5).abs() < 0.015, "{anywhere:?}");
    assert!((anywhere[2] / anywhere[0] - 0.25).abs() < 0.0075, "{anywhere:?}");
    for (octave, spacing) in [(0, wavelength), (1, wavelength / 2.0), (2, wavelength / 4.0)] {
        let mut lattice = |half: f32| {
            root_mean_square(octave, &mut || {
                // Offsets of 311.25 and 87.5 count in wavelengths of the octave.
                let at = |offset: f32, k: i32| (k as f32 + half - offset.fract()) * spacing;
                [at(311.25, rng.random_range(0..60)), at(87.5, rng.random_range(0..60))]
            })
        };
        assert!(lattice(0.0) < 1e-4, "octave {octave} on its lattice: {}", lattice(0.0));
        assert!(lattice(0.5) > 0.8 * anywhere[octave], "octave {octave} between: {}", lattice(0.5));
    }
}
