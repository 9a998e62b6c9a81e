//! The zig-zag (boustrophedon): rows back and forth, for testing (Table 5) and for areas larger than a view (Fig. 9).

/// Half the length of a row, in template units.
const HALF_ROW: i32 = 12;

/// Distance of neighbouring rows, in template units: that of the spiral's turns.
const ROW_DISTANCE: i32 = 4;

/// `frames` points of a boustrophedon over ±12 template units: rows along x with unit steps, joined by unit steps along y.
///
/// As many rows are laid as the frames fill; they are centred on y = 0, so that a longer video scans a taller area.
pub fn zigzag(frames: usize) -> Vec<[f64; 2]> {
    let mut points = Vec::with_capacity(frames);
    let (mut x, mut y, mut direction) = (-HALF_ROW, 0, 1);
    while points.len() < frames {
        points.push([f64::from(x), f64::from(y)]);
        let row_is_done = x == direction * HALF_ROW;
        if !row_is_done {
            x += direction;
        } else {
            y += 1;
            // Arrived on the next row: it runs back from here.
            if y % ROW_DISTANCE == 0 {
                direction = -direction;
            }
        }
    }
    let middle = points.last().map_or(0.0, |p| p[1] / 2.0).round();
    points.iter_mut().for_each(|p| p[1] -= middle);
    points
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_go_back_and_forth_with_unit_steps() {
        let points = zigzag(141);
        assert_eq!(points.len(), 141);
        for pair in points.windows(2) {
            assert_eq!((pair[1][0] - pair[0][0]).abs() + (pair[1][1] - pair[0][1]).abs(), 1.0);
        }
        assert!(points.iter().all(|p| p[0].abs() <= 12.0));
        assert_eq!(points[24][0], 12.0);
        assert_eq!(points[28], [12.0, points[0][1] + 4.0]);
        assert_eq!(points[29][0], 11.0);
        assert_eq!(points[52], [-12.0, points[28][1]]);
    }

    #[test]
    fn rows_are_centred_and_a_longer_video_scans_a_taller_area() {
        let height = |frames| {
            let points = zigzag(frames);
            assert!((points[0][1] + points[frames - 1][1]).abs() <= 1.0);
            points[frames - 1][1] - points[0][1]
        };
        assert!(height(400) > 2.0 * height(141));
        assert!(zigzag(0).is_empty());
    }
}
