//! Exemplars of the SVBRDF net, and the generated pairs that the flow nets start with.

use std::collections::HashSet;
use std::convert::Infallible;

use dataset::chairs::{Chairs, ChairsConfig};
use dataset::exemplar::{Exemplar, ExemplarConfig, key_frames};
use dataset::sequence::{Sequence, SequenceConfig};
use dataset::stream::Stream;

use crate::laws::uniform_integers;
use crate::{painted, rng};

#[test]
fn there_are_four_to_sixteen_key_frames() {
    let config = ExemplarConfig { resolution: 16, ..ExemplarConfig::default() };
    let video = Sequence::new(painted(|_, _| 0.5), &SequenceConfig::svbrdf(), &Stream::new(3), 0);
    let mut rng = rng(8);
    let counts: Vec<i64> = (0..600)
        .map(|draw| {
            let exemplar = Exemplar::draw(&video, draw % 20, &config, &mut rng);
            assert_eq!((exemplar.indices[0], exemplar.frames.len()), (draw % 20, exemplar.flows.len() + 1));
            exemplar.flows.len() as i64
        })
        .collect();
    uniform_integers(&counts, 4..=16).expect("key frames");
}

#[test]
fn their_interval_is_one_of_those_that_span_60_to_120_frames() {
    let mut rng = rng(9);
    for (count, low, high) in [
        (4, 15, 30),
        (5, 12, 24),
        (6, 10, 20),
        (7, 8, 17),
        (8, 7, 15),
        (9, 6, 13),
        (10, 6, 12),
        (11, 5, 10),
        (12, 5, 10),
        (13, 4, 9),
        (14, 4, 8),
        (15, 4, 8),
        (16, 3, 7),
    ] {
        let intervals: Vec<i64> = (0..10_000)
            .map(|draw| {
                let guidance = draw % 20;
                let keys = key_frames(guidance, count, 141, &mut rng);
                let interval = keys[0] - guidance;
                assert!((0..count).all(|k| keys[k] == guidance + (k + 1) * interval), "{keys:?} after {guidance}");
                interval as i64
            })
            .collect();
        uniform_integers(&intervals, low..=high).unwrap_or_else(|e| panic!("{count} key frames: {e}"));
    }
}

#[test]
fn each_of_the_first_twenty_frames_of_a_video_is_the_guidance_image_of_one_exemplar() {
    let mixing = ExemplarConfig::default().mixing();
    let places: HashSet<(u64, u64)> = (0..1000).map(|index| mixing.place(index, &Stream::new(4))).collect();
    let expected = (0..50).flat_map(|video| (0..20).map(move |guidance| (video, guidance)));
    assert_eq!(places, expected.collect());
}

#[test]
fn five_to_twenty_shapes_move_in_a_generated_pair() {
    let chairs = Chairs::new(ChairsConfig { resolution: 32, ..ChairsConfig::default() }, Stream::new(5)).unwrap();
    let material = painted(|_, _| 0.5);
    let counts: Vec<i64> = (0..600)
        .map(|index| {
            let mut layers = 0;
            let drawn = chairs.pair::<Infallible>(index, |_| {
                layers += 1;
                Ok(material.clone())
            });
            assert!(drawn.is_ok());
            // One of them is the background.
            layers - 1
        })
        .collect();
    uniform_integers(&counts, 5..=20).expect("shapes");
}
