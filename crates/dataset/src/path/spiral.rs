//! The square spiral, the paper's main template (Fig. 4): the scan grows outwards around its first frames.

/// Corners of the square spiral in template units; consecutive corners are joined by unit steps.
///
/// # Source
/// Fig. 4; the corner coordinates are those of the authors' released code.
const CORNERS: [(i32, i32); 12] =
    [(0, 0), (0, 4), (4, 4), (4, -4), (-4, -4), (-4, 8), (8, 8), (8, -8), (-8, -8), (-8, 12), (12, 12), (12, -8)];

/// How many points the spiral has.
pub const POINTS: usize = 141;

/// The 141 points of the square spiral, in template units (12 units are half the width of a frame's view).
pub fn spiral() -> Vec<[f64; 2]> {
    let mut points = vec![[0.0, 0.0]];
    for corner in CORNERS.windows(2) {
        let (from, to) = (corner[0], corner[1]);
        let step = ((to.0 - from.0).signum(), (to.1 - from.1).signum());
        let steps = (to.0 - from.0).abs().max((to.1 - from.1).abs());
        points.extend((1..=steps).map(|k| [f64::from(from.0 + k * step.0), f64::from(from.1 + k * step.1)]));
    }
    points
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_spiral_has_its_141_golden_points() {
        let points = spiral();
        assert_eq!(points.len(), POINTS);
        let golden = [
            (0, [0.0, 0.0]),
            (4, [0.0, 4.0]),
            (8, [4.0, 4.0]),
            (9, [4.0, 3.0]),
            (16, [4.0, -4.0]),
            (24, [-4.0, -4.0]),
            (36, [-4.0, 8.0]),
            (48, [8.0, 8.0]),
            (64, [8.0, -8.0]),
            (80, [-8.0, -8.0]),
            (100, [-8.0, 12.0]),
            (120, [12.0, 12.0]),
            (140, [12.0, -8.0]),
        ];
        for (index, point) in golden {
            assert_eq!(points[index], point, "point {index}");
        }
    }

    #[test]
    fn every_step_has_length_one_and_no_point_is_visited_twice_in_a_row() {
        for pair in spiral().windows(2) {
            assert_eq!((pair[1][0] - pair[0][0]).abs() + (pair[1][1] - pair[0][1]).abs(), 1.0);
        }
    }

    #[test]
    fn guidance_frames_stay_within_four_units() {
        assert!(spiral()[..20].iter().all(|p| p[0].abs() <= 4.0 && p[1].abs() <= 4.0));
    }
}
