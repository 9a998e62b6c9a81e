//! Lights of the videos: the flash, the resting second light, and the share of an environment.

use dataset::sequence::lights::{LightConfig, VideoLights};
use dataset::sequence::{Sequence, SequenceConfig};
use dataset::stream::Stream;
use render::light::Light;

use crate::laws::{column, normal, uniform, unrelated};
use crate::{painted, rng};

fn draws(config: &LightConfig, height: f64, count: usize) -> Vec<VideoLights> {
    let mut rng = rng(6);
    (0..count).map(|_| VideoLights::draw(config, height, &mut rng)).collect()
}

#[test]
fn the_flash_of_svbrdf_videos_follows_height_and_its_cone_is_log_normal() {
    let drawn = draws(&SequenceConfig::svbrdf().light, 0.21, 100_000);
    normal(&column(&drawn, |l| f64::from(l.exponent).ln()), 1.6, 0.35).expect("exponent");
    let expected = 0.1 * (0.21f64 / 0.28).powi(2);
    assert!(drawn.iter().all(|l| (f64::from(l.intensity) / expected - 1.0).abs() < 1e-6 && l.resting.is_empty()));
}

#[test]
fn a_video_is_lit_for_the_height_of_its_own_path() {
    let material = painted(|_, _| 0.5);
    for video in 0..40 {
        let video = Sequence::new(material.clone(), &SequenceConfig::svbrdf(), &Stream::new(1), video);
        let expected = 0.1 * (video.path().height / 0.28).powi(2);
        assert!((f64::from(video.lights().intensity) / expected - 1.0).abs() < 1e-6);
    }
}

#[test]
fn flow_videos_have_a_random_flash_and_a_second_light_without_fall_off() {
    let drawn = draws(&SequenceConfig::flow().light, 0.21, 100_000);
    let exponent = column(&drawn, |l| f64::from(l.exponent).ln());
    // The spread of the flash's factor is this program's: §4 only calls it random.
    let factor = column(&drawn, |l| (f64::from(l.intensity) / 0.1).ln());
    let second: Vec<([f64; 3], f64)> = drawn
        .iter()
        .map(|lights| match lights.resting[..] {
            [Light::Point { position, irradiance: [red, green, blue] }] if red == green && green == blue => {
                (position.map(f64::from), f64::from(red))
            }
            _ => panic!("{:?} instead of one white point light", lights.resting),
        })
        .collect();
    let far = |p: [f64; 3]| p.iter().map(|v| v * v).sum::<f64>().sqrt();
    let distance = column(&second, |(p, _)| far(*p).ln());
    // An irradiance of π makes a white surface as bright as an intensity of 1.
    let strength = column(&second, |(_, irradiance)| (irradiance / std::f64::consts::PI).ln());
    let azimuth = column(&second, |(p, _)| p[1].atan2(p[0]));
    let slope = column(&second, |(p, _)| p[2] / far(*p));
    normal(&exponent, 1.6, 0.35).expect("exponent");
    normal(&factor, 0.0, 0.3).expect("factor of the flash");
    normal(&distance, 2.25f64.ln(), 0.2).expect("distance of the second light");
    normal(&strength, 0.1f64.ln(), 0.2).expect("intensity of the second light");
    uniform(&azimuth, [-std::f64::consts::PI, std::f64::consts::PI]).expect("azimuth of the second light");
    uniform(&slope, [0.3, 1.0]).expect("height of the second light over the horizon");
    unrelated(&[&exponent, &factor, &distance, &strength, &azimuth, &slope]).expect("own draws");
}

#[test]
fn an_environment_has_a_uniform_share_of_the_flash() {
    let config = LightConfig { ambient: [0.0, 0.2], ..SequenceConfig::svbrdf().light };
    let height = 0.21;
    let drawn = draws(&config, height, 2000);
    let shares = column(&drawn, |lights| {
        let on_plane = |light: &Light| {
            let incident = light.incident([0.0; 3]);
            f64::from(incident.wi[2] * incident.irradiance.iter().sum::<f32>() / 3.0)
        };
        let flash = f64::from(lights.intensity) / (height * height);
        lights.resting.iter().map(on_plane).sum::<f64>() / flash
    });
    uniform(&shares, [0.0, 0.2]).expect("share of the environment");
    assert!(draws(&SequenceConfig::svbrdf().light, height, 100).iter().all(|l| l.resting.is_empty()), "a dark room");
}
