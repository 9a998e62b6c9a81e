//! Whole frames of a textured plane against Mitsuba 3, which made the files in goldens/ by the script beside them: texture
//! addressing, camera, flash, normal map and reflectance together.

use std::f64::consts::TAU;
use std::sync::Arc;

use dataset::material::{AugmentedMaterial, Material, MaterialInfo, Precision};
use dataset::path::{CameraPath, PathConfig};
use dataset::sequence::Sequence;
use dataset::sequence::lights::VideoLights;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use render::camera::Camera;
use render::direction::unit;
use render::texel::Texel;

const SIZE: usize = 512;
const RES: usize = 48;

/// The maps of goldens/plane.py.
fn waves() -> Arc<Material> {
    let info = MaterialInfo { texels: SIZE, ..MaterialInfo::made_up("waves") };
    let texel = |x: usize, y: usize| {
        let wave = |a: i32, b: i32| (TAU * (f64::from(a) * x as f64 + f64::from(b) * y as f64) / SIZE as f64).sin() as f32;
        Texel {
            normal: unit([0.25 * wave(21, 5), 0.2 * wave(7, -17), 1.0]),
            diffuse: [16, 17, 18].map(|a| 0.4 + 0.3 * wave(a, 9)),
            roughness: 0.5 + 0.2 * wave(11, 13),
            specular: [5, 7, 9].map(|a| 0.3 + 0.2 * wave(a, 19)),
        }
    };
    Arc::new(Material::build(info, SIZE, SIZE, Precision::Sixteen, texel).expect("finite maps"))
}

/// What Mitsuba saw: pose and flash, and the file of its picture.
struct Shot {
    position: [f64; 3],
    target: [f64; 3],
    intensity: f32,
    golden: &'static [u8],
}

/// A texel covers several pixels.
const NEAR: Shot = Shot {
    position: [0.12, -0.08, 0.25],
    target: [0.1, -0.05, 0.0],
    intensity: 0.08,
    golden: include_bytes!("goldens/near.f32"),
};
/// A pixel covers 1.3 × 1.3 texels, as in the videos (0.8 to 1.6 of 4096² texels at 256²).
const FRAME: Shot = Shot {
    position: [0.05, 0.1, 0.45],
    target: [0.1, 0.02, 0.0],
    intensity: 0.26,
    golden: include_bytes!("goldens/frame.f32"),
};
/// A pixel covers 4 × 4 texels.
const FAR: Shot =
    Shot { position: [-0.2, 0.15, 1.4], target: [-0.1, 0.05, 0.0], intensity: 2.5, golden: include_bytes!("goldens/far.f32") };

impl Shot {
    /// Mean of |ours − Mitsuba's| over the mean of Mitsuba's, for a frame of `pixels`² pixels per pixel of Mitsuba's.
    fn mean_relative_error(&self, pixels: usize) -> f64 {
        let camera = Camera::look_at(self.position, self.target, [0.05, 1.0, 0.0], 30f64.to_radians());
        let path = PathConfig::default().draw(&mut ChaCha8Rng::seed_from_u64(1));
        let path = CameraPath { cameras: vec![camera], ..path };
        // Exponent 0 has no cone: a point light.
        let lights = VideoLights { intensity: self.intensity, exponent: 0.0, resting: vec![] };
        let video = Sequence::from_parts(AugmentedMaterial::plain(waves()), path, lights);
        let frame = video.radiance(0, RES * pixels).resize_area(RES, RES);
        let theirs = self.golden.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
        assert_eq!(theirs.len(), RES * RES * 3);
        let (mut error, mut total) = (0.0, 0.0);
        for (i, theirs) in theirs.enumerate() {
            let (pixel, c) = (i / 3, i % 3);
            error += f64::from((frame.at(c, pixel / RES, pixel % RES) - theirs).abs());
            total += f64::from(theirs);
        }
        error / total
    }
}

/// Measured 0.0018; averaged from 8 × 8 pixels each 0.0003.
#[test]
fn a_frame_that_magnifies_texels_is_mitsubas() {
    assert_error_within(0.01, NEAR.mean_relative_error(1));
    assert_error_within(0.001, NEAR.mean_relative_error(8));
}

/// A whole image with texels and pixels of the sizes that videos have. Measured 0.0091 from mip levels; averaged from 8 × 8 pixels
/// each 0.0004, so the rest is filtering.
#[test]
fn a_frame_as_videos_have_them_is_mitsubas() {
    assert_error_within(0.01, FRAME.mean_relative_error(1));
    assert_error_within(0.001, FRAME.mean_relative_error(8));
}

/// Mitsuba averages the light of 1024 points of each pixel. Averaged light from 8 × 8 pixels is the same (measured 0.0012);
/// a single pixel shades the averaged maps instead, which isn't (measured 0.086 with waves of 4 to 10 pixels in every map).
#[test]
fn a_frame_of_many_texels_per_pixel_differs_by_filtering_alone() {
    assert_error_within(0.002, FAR.mean_relative_error(8));
    assert_error_within(0.09, FAR.mean_relative_error(1));
}

fn assert_error_within(bound: f64, error: f64) {
    assert!(error <= bound, "mean relative error {error}, expected at most {bound}");
}
