//! A comparison as a picture: one panel per figure, one line per variant.

use scan::html::escape;

use super::{Cell, Comparison, heading};
use crate::plot::{Axis, GRID, MAIN as REFERENCE, SOFT as UNCERTAIN, Scale};

/// Panels beside each other.
const COLUMNS: usize = 2;
const LINE: f64 = 24.0;
const PANEL_WIDTH: f64 = 360.0;
const LABELS: f64 = 270.0;
const TOP: f64 = 34.0;
const BOTTOM: f64 = 34.0;
const MARGIN: f64 = 24.0;
/// Least difference that an axis shows, as a share of its values: smaller ones are rounding.
const LEAST_ROOM: f64 = 0.02;
/// Dark enough on white for everyone, told apart from the reference by lightness too.
const CERTAIN: &str = "#b3361b";

/// Means with their intervals, single seeds as small dots, the reference's mean as a line through all variants.
pub fn svg(comparison: &Comparison) -> String {
    let shown: Vec<usize> =
        (0..comparison.question.figures.len()).filter(|&f| comparison.cells.iter().any(|row| row[f].is_some())).collect();
    let rows = comparison.question.variants.len() as f64;
    let panel = TOP + rows * LINE + BOTTOM;
    let height = 2.0 * MARGIN + shown.len().div_ceil(COLUMNS) as f64 * panel + LINE;
    let width = 2.0 * MARGIN + LABELS + COLUMNS as f64 * PANEL_WIDTH;
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width:.0} {height:.0}\" width=\"{width:.0}\" height=\"{height:.0}\" font-family=\"Helvetica, Arial, sans-serif\" font-size=\"13\">\n<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n"
    );
    for (place, &figure) in shown.iter().enumerate() {
        let y = MARGIN + (place / COLUMNS) as f64 * panel;
        let x = MARGIN + LABELS + (place % COLUMNS) as f64 * PANEL_WIDTH;
        if place % COLUMNS == 0 {
            text += &labels(comparison, y);
        }
        text += &panel_of(comparison, figure, x, y);
    }
    text += &format!(
        "<text x=\"{:.1}\" y=\"{:.1}\" fill=\"{UNCERTAIN}\" font-size=\"12\">bar: 95 % interval over seeds (arrow: goes on) · small dots: single seeds · <tspan fill=\"{REFERENCE}\">blue: reference</tspan> · <tspan fill=\"{CERTAIN}\">red: differs from it (paired test and interval)</tspan></text>\n</svg>\n",
        MARGIN,
        height - MARGIN + 6.0
    );
    text
}

fn labels(comparison: &Comparison, y: f64) -> String {
    let label = |(row, (name, title)): (usize, &(String, String))| {
        let colour = if *name == comparison.question.reference { REFERENCE } else { "#222222" };
        format!("<text x=\"{MARGIN}\" y=\"{:.1}\" fill=\"{colour}\">{}</text>\n", centre(y, row) + 4.5, escape(title))
    };
    comparison.question.variants.iter().enumerate().map(label).collect()
}

fn panel_of(comparison: &Comparison, figure: usize, x: f64, y: f64) -> String {
    let cells: Vec<(usize, &Cell)> =
        comparison.cells.iter().enumerate().filter_map(|(row, cells)| Some((row, cells[figure].as_ref()?))).collect();
    let axis = axis_over(cells.iter().map(|(_, cell)| *cell), [x + 18.0, x + PANEL_WIDTH - 18.0]);
    let (top, bottom) = (y + TOP - 6.0, y + TOP + comparison.cells.len() as f64 * LINE + 2.0);
    let title = escape(heading(&comparison.question.figures[figure]));
    let mut text = format!("<text x=\"{:.1}\" y=\"{:.1}\" font-weight=\"bold\">{title}</text>\n", axis.ends[0], y + 16.0);
    for (value, label) in axis.ticks() {
        let at = axis.place(value);
        text += &format!(
            "<line x1=\"{at:.1}\" y1=\"{top:.1}\" x2=\"{at:.1}\" y2=\"{bottom:.1}\" stroke=\"{GRID}\"/><text x=\"{at:.1}\" y=\"{:.1}\" text-anchor=\"middle\" font-size=\"11\" fill=\"{UNCERTAIN}\">{label}</text>\n",
            bottom + 14.0
        );
    }
    let is_reference = |row: usize| comparison.question.variants[row].0 == comparison.question.reference;
    for (_, cell) in cells.iter().filter(|(row, _)| is_reference(*row)) {
        let at = axis.place(cell.mean.value);
        text += &format!(
            "<line x1=\"{at:.1}\" y1=\"{top:.1}\" x2=\"{at:.1}\" y2=\"{bottom:.1}\" stroke=\"{REFERENCE}\" stroke-dasharray=\"3 3\"/>\n"
        );
    }
    for (row, cell) in cells {
        let colour = match cell.difference {
            _ if is_reference(row) => REFERENCE,
            Some(difference) if difference.is_certain() => CERTAIN,
            _ => UNCERTAIN,
        };
        text += &marks(cell, &axis, centre(y, row), colour);
    }
    text
}

fn marks(cell: &Cell, axis: &Axis, y: f64, colour: &str) -> String {
    let mut text = String::new();
    let mean = cell.mean.value;
    if let Some(half) = cell.mean.half_width {
        let (left, right) = (axis.place(mean - half), axis.place(mean + half));
        text += &format!(
            "<line x1=\"{left:.1}\" y1=\"{y:.1}\" x2=\"{right:.1}\" y2=\"{y:.1}\" stroke=\"{colour}\" stroke-width=\"2.5\" stroke-linecap=\"round\"/>\n"
        );
        // Arrows where the paper ends before the interval does.
        for (end, way) in [(mean - half, -1.0), (mean + half, 1.0)] {
            if !axis.covers(end) {
                let tip = axis.place(end) + 4.0 * way;
                let back = tip - 6.0 * way;
                text += &format!(
                    "<path d=\"M{back:.1} {:.1}L{tip:.1} {y:.1}L{back:.1} {:.1}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"2\"/>\n",
                    y - 4.0,
                    y + 4.0
                );
            }
        }
    }
    for (_, value) in &cell.seeds {
        text += &format!(
            "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"2\" fill=\"{colour}\" fill-opacity=\"0.45\"/>\n",
            axis.place(*value),
            y - 6.5
        );
    }
    text + &format!("<circle cx=\"{:.1}\" cy=\"{y:.1}\" r=\"4.5\" fill=\"{colour}\" stroke=\"white\"/>\n", axis.place(mean))
}

fn centre(y: f64, row: usize) -> f64 {
    y + TOP + (row as f64 + 0.5) * LINE
}

/// Covers means, single seeds, and intervals as far as they don't dwarf everything else.
fn axis_over<'a>(cells: impl Iterator<Item = &'a Cell> + Clone, ends: [f64; 2]) -> Axis {
    let values = cells.clone().flat_map(|cell| cell.seeds.iter().map(|(_, value)| *value));
    let (low, high) = values.fold((f64::MAX, f64::MIN), |(low, high), value| (low.min(value), high.max(value)));
    let room = (high - low).max(LEAST_ROOM * high.abs()).max(1e-9);
    let intervals = cells.flat_map(|cell| {
        let half = cell.mean.half_width.unwrap_or(0.0);
        [cell.mean.value - half, cell.mean.value + half]
    });
    let (first, last) = intervals.fold((low, high), |(low, high), value| (low.min(value), high.max(value)));
    let (low, high) = (first.max(low - 0.5 * room), last.min(high + 0.5 * room));
    let margin = 0.04 * room + (room - (high - low)).max(0.0) / 2.0;
    Axis::new(Scale::Linear, [low - margin, high + margin], ends)
}
