//! The sensor's noise as frames show it: its strength per frame, and its law in linear light.

use dataset::sequence::{Sequence, SequenceConfig};
use dataset::stream::Stream;
use rand::RngExt;

use crate::laws::{normal, normal_distribution, uniform};
use crate::{painted, rng};

/// A pixel's linear light and the interval that its 8-bit code stands for.
struct Reading {
    light: f64,
    code: [f64; 2],
}

fn readings(video: &Sequence, frame: usize, res: usize) -> Vec<Reading> {
    let (light, read) = (video.radiance(frame, res), video.frame(frame, res));
    light
        .data
        .iter()
        .zip(&read.data)
        .map(|(&light, &value)| {
            let code = f64::from(value * 255.0).round();
            let edge = |c: f64| (c / 255.0).powf(2.2);
            // Codes 0 and 255 also hold what was clipped.
            let low = if code == 0.0 { f64::NEG_INFINITY } else { edge(code - 0.5) };
            let high = if code == 255.0 { f64::INFINITY } else { edge(code + 0.5) };
            Reading { light: light.into(), code: [low, high] }
        })
        .collect()
}

/// Standard deviation of the noise, with Sheppard's correction for the width of the codes.
fn sigma<'a>(readings: impl Iterator<Item = &'a Reading>) -> f64 {
    let (mut squares, mut count) = (0.0, 0.0);
    for Reading { light, code: [low, high] } in readings {
        let (low, high) = (low.max(0.0), high.min(1.0));
        squares += (0.5 * (low + high) - light).powi(2) - (high - low).powi(2) / 12.0;
        count += 1.0;
    }
    (squares / count).sqrt()
}

#[test]
fn every_frame_has_its_own_log_normal_strength() {
    let material = painted(|_, _| 0.3);
    let (res, videos) = (16, 30);
    let logs: Vec<f64> = (0..videos)
        .flat_map(|video| {
            let video = Sequence::new(material.clone(), &SequenceConfig::svbrdf(), &Stream::new(2), video);
            (0..video.len()).map(move |frame| {
                let readings = readings(&video, frame, res);
                // Dark enough for codes no wider than the noise, bright enough not to be clipped.
                sigma(readings.iter().filter(|r| (0.06..0.2).contains(&r.light))).ln()
            })
        })
        .collect();
    // The estimate from n readings has a standard error of √(1/2n) itself.
    let spread = (0.3f64.powi(2) + 0.5 / (3 * res * res) as f64).sqrt();
    normal(&logs, 0.005f64.ln(), spread).expect("strength of the noise");
}

#[test]
fn the_noise_is_gaussian_in_linear_light_whatever_the_brightness() {
    let material = painted(|x, y| 0.02 + 0.9 * (x + y) as f32 / 126.0);
    let video = Sequence::new(material, &SequenceConfig::svbrdf(), &Stream::new(2), 3);
    let mut rng = rng(7);
    for frame in [0, 30, 60] {
        let readings = readings(&video, frame, 128);
        let sigma = sigma(readings.iter().filter(|r| (0.04..0.2).contains(&r.light)));
        assert!((0.002..0.015).contains(&sigma), "{sigma}");
        // The probability integral transform, spread evenly over the numbers that a code stands for: U[0, 1] for the right law.
        let mut ranks = |wanted: std::ops::Range<f64>| -> Vec<f64> {
            let chosen = readings.iter().filter(|r| wanted.contains(&r.light));
            chosen
                .map(|r| {
                    let [low, high] = r.code.map(|edge| normal_distribution((edge - r.light) / sigma));
                    low + rng.random_range(0.0..=1.0) * (high - low)
                })
                .collect()
        };
        for brightness in [0.0..0.03, 0.03..0.1, 0.1..0.2, 0.2..0.4] {
            let ranks = ranks(brightness.clone());
            assert!(ranks.len() > 3000, "{} pixels of light {brightness:?}", ranks.len());
            uniform(&ranks, [0.0, 1.0]).unwrap_or_else(|e| panic!("frame {frame}, light {brightness:?}: {e}"));
        }
    }
}
