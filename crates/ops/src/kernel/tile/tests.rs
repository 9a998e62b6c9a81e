//! Every processor's loops against the definition, and against each other.

use super::*;

#[test]
fn all_routes_agree() {
    let source: Vec<f32> = (0..200).map(|i| (i as f32 * 0.37).sin()).collect();
    let offsets = Offsets::new([0, 120, 3, 90, 17].into_iter());
    for route in Instructions::available() {
        for outputs in 1..=route.most_outputs() {
            let weights: Vec<f32> = (0..offsets.len() * outputs).map(|i| (i as f32).cos()).collect();
            let mut found = [[0.25; TILE]; 16];
            for (taps, weights) in offsets.chunks(3).zip(weights.chunks(3 * outputs)) {
                route.correlate(outputs, &source, 5, taps, weights, &mut found);
            }
            for (r, p) in (0..outputs * TILE).map(|i| (i / TILE, i % TILE)) {
                let term = |k: usize| weights[k * outputs + r] * source[5 + offsets.at(k) + p];
                let expected = 0.25 + (0..offsets.len()).map(term).sum::<f32>();
                assert!((found[r][p] - expected).abs() < 1e-5, "{route:?}, {outputs} outputs");
            }
        }
        let starts: Vec<usize> = (0..route.taps()).map(|k| 15 * k).collect();
        let lines = [3, 0, 40];
        let gradient: Vec<Outputs> = (0..21).map(|p| std::array::from_fn(|o| ((7 * p + o) as f32).cos())).collect();
        let mut sums = vec![[0.5; TILE]; route.taps()];
        route.outer(&source, &starts, &lines, 7, &gradient, &mut sums);
        for (k, o) in (0..route.taps() * TILE).map(|i| (i / TILE, i % TILE)) {
            let term = |p: usize| gradient[p][o] * source[starts[k] + lines[p / 7] + p % 7];
            let expected = 0.5 + (0..21).map(term).sum::<f32>();
            assert!((sums[k][o] - expected).abs() < 1e-5, "{route:?}, tap {k}");
        }
    }
}

#[test]
fn all_routes_transform_alike() {
    let mut window = Window::default();
    window.0.as_flattened_mut().iter_mut().enumerate().for_each(|(i, pixel)| *pixel = (i as f32 * 0.37).sin());
    let results: [Outputs; 16] = std::array::from_fn(|i| std::array::from_fn(|o| ((i * 16 + o) as f32).cos()));
    let step = TILE + 3;
    let all = |route: Instructions| {
        let mut frequencies = vec![0.0; 36 * step];
        route.spread(&window, &mut frequencies, [1, step]);
        let mut of_results = vec![[0.0; TILE]; 72];
        route.spread_results(&results, &mut of_results, 2);
        [frequencies.clone(), of_results.into_flattened(), route.gather(&frequencies, step).as_flattened().to_vec()]
    };
    let expected = all(Instructions::Portable);
    for route in Instructions::available() {
        for (found, expected) in all(route).iter().zip(&expected) {
            let close = found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-5 * b.abs().max(10.0));
            assert!(found.len() == expected.len() && close, "{route:?}");
        }
    }
}

#[test]
fn chains_of_multiply_adds_end_at_their_fixed_point() {
    for route in Instructions::available() {
        let (sum, operations) = route.multiply_adds(0.5, 100);
        // x = x/2 + 1/2
        assert_eq!(sum, operations as f32 / 2.0, "{route:?}");
    }
}
