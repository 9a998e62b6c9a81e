//! What sampling leaves of single frequencies: gratings are read at the distance of a pixel and compared with what an area
//! filter, the mean over the pixel, would leave of them. Frequencies are in units of the pixel grid's Nyquist frequency, half
//! a wave per pixel; whatever is seen of higher ones is an alias.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;

/// Texels of the tile: eight waves at the Nyquist frequency of a pixel of 16 texels.
const SIDE: usize = 256;
/// How many pictures of a grating are taken, each from another place, and how many pixels wide they are.
const PICTURES: usize = 10;
const PIXELS: usize = 24;
/// Height of the first side lobe of sin(πx)/πx: an area filter never blocks more above its first zero, two Nyquist frequencies.
const SIDE_LOBE: f64 = 0.2172;

/// A plane wave of so many waves over the tile along x and along y.
#[derive(Clone, Copy, Debug)]
struct Grating {
    waves: [f64; 2],
}

impl Grating {
    /// The grating of a frequency, or little less, and an orientation; `None` where texels can't hold it.
    fn of(frequency: f64, footprint: f64, angle: f64) -> Option<Self> {
        let length = frequency * SIDE as f64 / (2.0 * footprint);
        let waves = [length * angle.cos(), length * angle.sin()].map(f64::trunc);
        (waves.iter().all(|w| *w < 0.49 * SIDE as f64)).then_some(Self { waves })
    }

    fn frequency(&self, footprint: f64) -> f64 {
        self.waves[0].hypot(self.waves[1]) / SIDE as f64 * 2.0 * footprint
    }

    fn phase(&self, x: f64, y: f64) -> f64 {
        std::f64::consts::TAU * (self.waves[0] * x + self.waves[1] * y) / SIDE as f64
    }

    /// The wave in a colour, in the roughness and in the normal.
    fn material(&self) -> Material {
        Material::build(MaterialInfo::made_up("test"), SIDE, SIDE, Precision::Sixteen, |x, y| {
            let wave = self.phase(x as f64, y as f64).cos() as f32;
            let tilt = 0.3 * wave;
            Texel {
                normal: [tilt, 0.0, (1.0 - tilt * tilt).sqrt()],
                diffuse: [0.5 + 0.4 * wave, 0.5, 0.5],
                roughness: 0.5 + 0.4 * wave,
                specular: [0.04; 3],
            }
        })
        .unwrap()
    }

    /// What is left of the wave, as shares of its amplitude: all that is seen, and the part that has its own frequency; for
    /// colour, roughness and normal.
    fn seen(&self, footprint: f64) -> [[f64; 2]; 3] {
        let (material, mut rng) = (self.material(), ChaCha8Rng::seed_from_u64(5));
        let (mut squares, mut cosine, mut sine) = ([0.0; 3], [0.0; 3], [0.0; 3]);
        for _ in 0..PICTURES {
            let corner: [f64; 2] = std::array::from_fn(|_| rng.random_range(0.0..SIDE as f64));
            for i in 0..PIXELS * PIXELS {
                let [x, y] = [corner[0] + (i % PIXELS) as f64 * footprint, corner[1] + (i / PIXELS) as f64 * footprint];
                let texel = material.sample(x as f32, y as f32, footprint as f32);
                let waves = [(texel.diffuse[0] - 0.5) / 0.4, (texel.roughness - 0.5) / 0.4, texel.normal[0] / 0.3];
                let (s, c) = self.phase(x, y).sin_cos();
                for (k, wave) in waves.map(f64::from).into_iter().enumerate() {
                    squares[k] += wave * wave;
                    cosine[k] += wave * c;
                    sine[k] += wave * s;
                }
            }
        }
        let pixels = (PICTURES * PIXELS * PIXELS) as f64;
        std::array::from_fn(|k| [(2.0 * squares[k] / pixels).sqrt(), 2.0 * cosine[k].hypot(sine[k]) / pixels])
    }

    /// What the mean over a square pixel leaves of the wave.
    fn mean_over_pixel(&self, footprint: f64) -> f64 {
        self.waves.iter().map(|w| cardinal_sine(w / SIDE as f64 * footprint)).product()
    }
}

/// sin(πx)/πx.
fn cardinal_sine(x: f64) -> f64 {
    let angle = std::f64::consts::PI * x;
    if angle == 0.0 { 1.0 } else { angle.sin() / angle }
}

fn gratings(frequencies: &[f64], footprint: f64) -> Vec<Grating> {
    let angles = [0.0f64, 26.6, 45.0, 90.0].map(f64::to_radians);
    let all = frequencies.iter().flat_map(|f| angles.map(|angle| Grating::of(*f, footprint, angle)));
    all.flatten().collect()
}

#[test]
fn frequencies_well_below_nyquist_keep_nine_tenths_of_their_amplitude() {
    for footprint in [1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 10.0, 16.0] {
        for grating in gratings(&[0.25], footprint) {
            for [_, kept] in grating.seen(footprint) {
                assert!((0.9..1.01).contains(&kept), "footprint {footprint}, {grating:?}: {kept}");
            }
        }
    }
}

#[test]
fn frequencies_above_nyquist_leave_no_more_alias_than_the_mean_over_a_pixel() {
    for footprint in [1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 10.0, 16.0] {
        let (mut found, mut expected) = ([0.0; 3], 0.0);
        for grating in gratings(&[1.125, 1.25, 1.5, 1.75, 2.0, 2.5, 3.0, 4.0], footprint) {
            let frequency = grating.frequency(footprint);
            let limit = cardinal_sine(0.5 * frequency).max(SIDE_LOBE);
            let seen = grating.seen(footprint);
            for [alias, _] in seen {
                assert!(alias < limit + 0.05, "footprint {footprint}, frequency {frequency}, {grating:?}: {alias}");
            }
            (0..3).for_each(|k| found[k] += seen[k][0].powi(2));
            expected += grating.mean_over_pixel(footprint).powi(2);
        }
        assert!(found.iter().all(|energy| *energy <= expected), "footprint {footprint}: {found:?} beside {expected}");
    }
}

#[test]
fn a_coarse_material_stays_sharp_until_a_pixel_covers_a_texel() {
    let texel = |x: usize, y: usize| Texel::matte([((x * 7 + y * 3) % 11) as f32 / 10.0; 3]);
    let info = MaterialInfo { texels: GRID / 4, ..MaterialInfo::made_up("test") };
    let coarse = Material::build(info, 16, 16, Precision::Sixteen, texel).unwrap();
    for i in 0..256 {
        let (x, y) = (i % 16, i / 16);
        let centre = |k: usize| (k as f32 + 0.5) * 4.0 - 0.5;
        for footprint in [0.3, 1.0, 2.5, 4.0] {
            let found = coarse.sample(centre(x), centre(y), footprint).diffuse[0];
            assert!((found - texel(x, y).diffuse[0]).abs() < 1e-4, "({x}, {y}) at footprint {footprint}: {found}");
        }
    }
}
