//! A curve in braille: two by four dots per character.

use evaluate::plot::{Axis, Point, Scale};

/// Dots of a character, by row and column, as bits of the braille block.
const DOTS: [[u32; 2]; 4] = [[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]];
const BLANK: u32 = 0x2800;
/// From this ratio of the largest to the smallest mean on, the logarithm is drawn.
const DECADES_FROM: f64 = 20.0;

/// A curve of the means.
pub struct Chart {
    /// Rows of characters, top first.
    pub rows: Vec<String>,
    /// Least and largest mean.
    pub range: [f64; 2],
    /// Whether the rows are spread by the logarithm.
    pub logarithmic: bool,
}

/// Draws the means over the steps in `columns` × `rows` characters; `None` where nothing is finite.
pub fn chart(points: &[Point], columns: usize, rows: usize) -> Option<Chart> {
    let points: Vec<&Point> = points.iter().filter(|point| point.mean.is_finite()).collect();
    let (first, last) = (points.first()?, points.last()?);
    let range = points.iter().fold([f64::MAX, f64::MIN], |[low, high], p| [low.min(p.mean), high.max(p.mean)]);
    let logarithmic = range[0] > 0.0 && range[1] / range[0] >= DECADES_FROM;
    let scale = if logarithmic { Scale::Logarithmic } else { Scale::Linear };
    let [low, high] = range;
    let room = if high > low { 0.0 } else { (high.abs() * 0.5).max(1e-12) };
    let (wide, tall) = (2 * columns, 4 * rows);
    let up = Axis::new(scale, [low - room, high + room], [tall as f64 - 1.0, 0.0]);
    let across = Axis::new(Scale::Linear, [first.step, last.step.max(first.step + 1.0)], [0.0, wide as f64 - 1.0]);
    let mut cells = vec![vec![0; columns]; rows];
    let mut dot = |x: usize, y: usize| cells[y / 4][x / 2] |= DOTS[y % 4][x % 2];
    let mut before: Option<(usize, usize)> = None;
    for point in points {
        let (x, y) = (across.place(point.step).round() as usize, up.place(point.mean).round() as usize);
        let (x0, y0) = before.unwrap_or((x, y));
        let length = x.abs_diff(x0).max(y.abs_diff(y0)).max(1);
        for i in 0..=length {
            let between = |a: usize, b: usize| (a as f64 + (b as f64 - a as f64) * i as f64 / length as f64).round() as usize;
            dot(between(x0, x), between(y0, y));
        }
        before = Some((x, y));
    }
    let row = |row: &Vec<u32>| row.iter().map(|bits| char::from_u32(BLANK + bits).unwrap_or(' ')).collect();
    Some(Chart { rows: cells.iter().map(row).collect(), range, logarithmic })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points(values: &[f64]) -> Vec<Point> {
        let point = |(i, &mean): (usize, &f64)| Point { step: i as f64, mean, low: mean, high: mean };
        values.iter().enumerate().map(point).collect()
    }

    #[test]
    fn a_falling_line_runs_from_the_upper_left_to_the_lower_right() {
        let drawn = chart(&points(&[7.0, 6.0, 5.0, 4.0, 3.0, 2.0, 1.0, 0.0]), 4, 2).unwrap();
        assert_eq!(drawn.rows, ["⠑⢄⠀⠀", "⠀⠀⠑⢄"]);
        assert_eq!((drawn.range, drawn.logarithmic), ([0.0, 7.0], false));
    }

    #[test]
    fn steep_lines_have_no_gaps_and_decades_are_seen() {
        let drawn = chart(&points(&[0.0, 1.0]), 1, 3).unwrap();
        assert!(drawn.rows.iter().all(|row| row != "⠀"), "{:?}", drawn.rows);
        assert!(chart(&points(&[100.0, 10.0, 1.0]), 3, 2).unwrap().logarithmic);
    }

    #[test]
    fn flat_single_and_missing_values_are_drawn_as_far_as_they_go() {
        assert_eq!(chart(&points(&[0.0, 0.0]), 2, 1).unwrap().rows.len(), 1);
        assert_eq!(chart(&points(&[5.0]), 2, 1).unwrap().range, [5.0, 5.0]);
        assert!(chart(&points(&[f64::NAN]), 2, 1).is_none());
    }
}
