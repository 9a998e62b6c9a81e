//! The straight up-down line, the paper's second template (Fig. 4); it trains the SVBRDF net only.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How far the line reaches to either side, in template units.
pub const REACH: f64 = 22.0;

/// In which order the points of the line are visited.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum LineOrder {
    /// A scan that a hand can do: from 0 up to +22, down to −22, back to 0.
    #[default]
    Scan,
    /// The order of the authors' released code: 0, +1, −1, +2, −2 …, which jumps from side to side.
    Interleaved,
}

/// `frames` points along y over ±22 template units, starting at 0, with steps of one length.
pub fn line(frames: usize, order: LineOrder) -> Vec<[f64; 2]> {
    let last = frames.saturating_sub(1).max(1) as f64;
    let at = |i: usize| match order {
        LineOrder::Scan => {
            let way = 4.0 * REACH * i as f64 / last;
            if way <= REACH {
                way
            } else if way <= 3.0 * REACH {
                2.0 * REACH - way
            } else {
                way - 4.0 * REACH
            }
        }
        LineOrder::Interleaved => {
            let rung = i.div_ceil(2) as f64 * REACH / (last / 2.0);
            if i % 2 == 1 { rung } else { -rung }
        }
    };
    (0..frames).map(|i| [0.0, at(i)]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_scan_starts_at_zero_and_reaches_both_ends_in_equal_steps() {
        let points = line(141, LineOrder::Scan);
        assert_eq!(points.len(), 141);
        assert_eq!((points[0], points[35], points[70], points[105]), ([0.0, 0.0], [0.0, 22.0], [0.0, 0.0], [0.0, -22.0]));
        assert!(points[140][1].abs() < 1e-12);
        for pair in points.windows(2) {
            assert!(((pair[1][1] - pair[0][1]).abs() - 88.0 / 140.0).abs() < 1e-9);
        }
    }

    #[test]
    fn the_interleaved_order_alternates_as_the_released_code_does() {
        let points = line(141, LineOrder::Interleaved);
        let expected = |k: f64| k * 22.0 / 70.0;
        for (i, k) in [(0, 0.0), (1, 1.0), (2, -1.0), (3, 2.0), (4, -2.0), (139, 70.0), (140, -70.0)] {
            assert!((points[i][1] - expected(k)).abs() < 1e-12, "point {i}");
        }
    }

    #[test]
    fn a_single_frame_is_the_start() {
        assert_eq!(line(1, LineOrder::Scan), vec![[0.0, 0.0]]);
        assert!(line(0, LineOrder::Scan).is_empty());
    }
}
