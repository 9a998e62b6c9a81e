//! One figure over the steps of a training stage.

use scan::html::escape;

use super::{Axis, GRID, MAIN, SOFT, Scale};

const WIDTH: f64 = 360.0;
const HEIGHT: f64 = 190.0;
const LEFT: f64 = 46.0;
const RIGHT: f64 = 12.0;
const TOP: f64 = 30.0;
const BOTTOM: f64 = 24.0;
/// From this ratio of the largest to the smallest value on, decades are shown.
const DECADES_FROM: f64 = 20.0;
/// Least room above and below, as a share of the values: smaller differences are rounding.
const LEAST_ROOM: f64 = 0.02;
/// Measurements of fewer points are marked one by one.
const MARKED: usize = 40;

/// A few neighbouring steps together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// The middle step.
    pub step: f64,
    /// Mean of the values.
    pub mean: f64,
    /// The least of them.
    pub low: f64,
    /// The largest of them.
    pub high: f64,
}

/// A panel with a title, the last value, the course of the mean and behind it the span of the values that it stands for.
/// Values of several decades, all above 0, get a logarithmic axis. Empty where there is no finite point.
pub fn curve(title: &str, points: &[Point]) -> String {
    let points: Vec<Point> =
        points.iter().copied().filter(|p| [p.mean, p.low, p.high].into_iter().all(f64::is_finite)).collect();
    let (Some(first), Some(last)) = (points.first(), points.last()) else { return String::new() };
    let across = Axis::new(Scale::Linear, [first.step.min(last.step - 1.0), last.step], [LEFT, WIDTH - RIGHT]);
    let up = upward(&points);
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" font-family=\"Helvetica, Arial, sans-serif\" font-size=\"11\"><title>{}</title>\n<text x=\"2\" y=\"15\" font-size=\"13\" font-weight=\"bold\">{}</text><text x=\"{:.1}\" y=\"15\" text-anchor=\"end\" font-size=\"13\" fill=\"{MAIN}\">{}</text>\n",
        escape(title),
        escape(title),
        WIDTH - RIGHT,
        short(last.mean)
    );
    for (value, label) in up.ticks() {
        let y = up.place(value);
        text += &format!(
            "<line x1=\"{LEFT}\" y1=\"{y:.1}\" x2=\"{:.1}\" y2=\"{y:.1}\" stroke=\"{GRID}\"/><text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\" fill=\"{SOFT}\">{label}</text>\n",
            WIDTH - RIGHT,
            LEFT - 5.0,
            y + 3.5
        );
    }
    for (value, label) in across.ticks() {
        let x = across.place(value);
        text +=
            &format!("<text x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\" fill=\"{SOFT}\">{label}</text>\n", HEIGHT - 8.0);
    }
    let path = |value: fn(&Point) -> f64| -> Vec<String> {
        points.iter().map(|p| format!("{:.1},{:.1}", across.place(p.step), up.place(value(p)))).collect()
    };
    let mut band = path(|p| p.high);
    band.extend(path(|p| p.low).into_iter().rev());
    text += &format!(
        "<polygon points=\"{}\" fill=\"{MAIN}\" fill-opacity=\"0.16\"/>\n<polyline points=\"{}\" fill=\"none\" stroke=\"{MAIN}\" stroke-width=\"1.6\" stroke-linejoin=\"round\"/>\n",
        band.join(" "),
        path(|p| p.mean).join(" ")
    );
    if points.len() < MARKED {
        for point in &points {
            let (x, y) = (across.place(point.step), up.place(point.mean));
            text += &format!("<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"2.4\" fill=\"{MAIN}\"/>\n");
        }
    }
    text + "</svg>\n"
}

fn upward(points: &[Point]) -> Axis {
    let low = points.iter().map(|p| p.low).fold(f64::MAX, f64::min);
    let high = points.iter().map(|p| p.high).fold(f64::MIN, f64::max);
    let ends = [HEIGHT - BOTTOM, TOP];
    if low > 0.0 && high / low >= DECADES_FROM {
        return Axis::new(Scale::Logarithmic, [low / 1.1, high * 1.1], ends);
    }
    let room = (0.06 * (high - low)).max(LEAST_ROOM * high.abs()).max(1e-9);
    Axis::new(Scale::Linear, [low - room, high + room], ends)
}

/// A value with four digits, whatever its size.
pub fn short(value: f64) -> String {
    match value.abs() {
        0.0 => "0".into(),
        size if !(1e-3..1e5).contains(&size) => format!("{value:.2e}"),
        size => format!("{value:.*}", (3 - size.log10().floor() as i32).clamp(0, 6) as usize),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn falling(values: &[f64]) -> Vec<Point> {
        let point = |(i, &v): (usize, &f64)| Point { step: i as f64 + 1.0, mean: v, low: v * 0.9, high: v * 1.1 };
        values.iter().enumerate().map(point).collect()
    }

    #[test]
    fn a_panel_shows_title_last_value_line_and_span() {
        let text = curve("loss <total>", &falling(&[1.0, 0.5, 0.25]));
        for part in ["loss &lt;total&gt;", ">0.2500<", "<polygon", "<polyline", "<circle", ">0.5<"] {
            assert!(text.contains(part), "{part}: {text}");
        }
        let all = curve("x", &falling(&[10.0, 1.0, 0.01]));
        assert!(all.contains(">0.1<") && all.contains(">10<"), "decades: {all}");
    }

    #[test]
    fn one_point_equal_points_and_no_number_are_no_fault() {
        assert!(!curve("one", &falling(&[0.3])).contains("NaN"));
        assert!(!curve("zero", &falling(&[0.0, 0.0])).contains("NaN"));
        assert_eq!(curve("none", &falling(&[f64::NAN])), "");
        assert!(curve("gap", &falling(&[1.0, f64::NAN, 2.0])).contains("<polyline"));
    }

    #[test]
    fn values_keep_four_digits() {
        assert_eq!(
            [0.0, 0.12345, 12.345, 1234.6, 2e-5, -0.5].map(short),
            ["0", "0.1235", "12.35", "1235", "2.00e-5", "-0.5000"]
        );
    }
}
