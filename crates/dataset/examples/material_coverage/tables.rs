//! The comparison as Markdown.

use std::fmt::Write;

use crate::coverage::{Coverage, percentile};
use crate::statistics::{Histogram, QUANTITIES, Statistics, value_names};

const PERCENTILES: [f32; 5] = [5.0, 25.0, 50.0, 75.0, 95.0];

/// Everything that is said in words and numbers.
pub fn markdown(real: &[Statistics], generated: &[Statistics], coverage: &Coverage) -> String {
    let mut text = format!(
        "# {} real materials beside {} generated ones\n\n\
         Luminances are gamma-encoded (0.23 is a reflectance of 0.04); saturation is that of diffuse + specular; tilt is in \
         degrees; contrast is the standard deviation within a material; the slope is that of log power over log frequency of \
         the brightness of diffuse + specular.\n\n",
        real.len(),
        generated.len()
    );
    pooled(&mut text, real, generated);
    by_material(&mut text, real, generated);
    ranges(&mut text, real, coverage);
    neighbours(&mut text, real, generated, coverage);
    text
}

fn line(text: &mut String, cells: &[String]) {
    let _ = writeln!(text, "| {} |", cells.join(" | "));
}

fn header(text: &mut String, title: &str, columns: &[&str]) {
    let _ = writeln!(text, "## {title}\n\n| {} |\n|{}", columns.join(" | "), "---|".repeat(columns.len()));
}

fn number(value: f32) -> String {
    if value.abs() < 9.995 { format!("{value:.2}") } else { format!("{value:.1}") }
}

/// All texels of all materials.
fn pooled(text: &mut String, real: &[Statistics], generated: &[Statistics]) {
    header(text, "Texels", &["", "materials", "5 %", "25 %", "50 %", "75 %", "95 %"]);
    for (c, quantity) in QUANTITIES.iter().enumerate() {
        for (set, materials) in [("real", real), ("generated", generated)] {
            let pooled = Histogram::pooled(materials.iter().map(|m| &m.histograms[c]));
            let cells = PERCENTILES.map(|p| number(pooled.percentile(p)));
            line(text, &[&[(*quantity).to_string(), set.into()], &cells[..]].concat());
        }
    }
    text.push('\n');
}

/// One value per material.
fn by_material(text: &mut String, real: &[Statistics], generated: &[Statistics]) {
    header(text, "Materials", &["", "materials", "5 %", "25 %", "50 %", "75 %", "95 %"]);
    for (v, name) in value_names().into_iter().enumerate().filter(|(_, name)| !name.ends_with("percentile")) {
        for (set, materials) in [("real", real), ("generated", generated)] {
            let values: Vec<f32> = materials.iter().map(|m| m.values()[v]).collect();
            let cells = PERCENTILES.map(|p| number(percentile(&values, p)));
            line(text, &[&[name.clone(), set.into()], &cells[..]].concat());
        }
    }
    text.push('\n');
}

fn ranges(text: &mut String, real: &[Statistics], coverage: &Coverage) {
    let columns = ["", "generated, 1st to 99th percentile", "real inside", "below", "above"];
    header(text, "Real materials within the range of the generated ones", &columns);
    for (v, name) in value_names().into_iter().enumerate() {
        let [low, high] = coverage.ranges[v];
        let values = || real.iter().map(|m| m.values()[v]);
        let (below, above) = (values().filter(|x| *x < low).count(), values().filter(|x| *x > high).count());
        let inside = percent(real.len() - below - above, real.len());
        let range = format!("{} to {}", number(low), number(high));
        line(text, &[name, range, inside, below.to_string(), above.to_string()]);
    }
    let whole = coverage.outside.iter().filter(|values| values.is_empty()).count();
    let _ = writeln!(text, "\nInside in everything: {} of the real materials.\n", percent(whole, real.len()));
}

fn neighbours(text: &mut String, real: &[Statistics], generated: &[Statistics], coverage: &Coverage) {
    let distances: Vec<f32> = coverage.nearest.iter().map(|n| n.distance).collect();
    let near = (0..real.len()).filter(|&i| !coverage.is_far(i)).count();
    let _ = writeln!(
        text,
        "## Nearest generated neighbour\n\n\
         Distances over means, contrasts and slope, in standard deviations of the generated materials. Median from a generated \
         material to the nearest other: {}; to the nearest of another family: {}; from a real one to the nearest generated one: \
         {}. {} of the real materials are nearer than {}, the 95th percentile between families.\n",
        number(coverage.among_generated),
        number(coverage.among_families),
        number(percentile(&distances, 50.0)),
        percent(near, real.len()),
        number(coverage.far),
    );
    let columns = ["real material", "distance", "nearest generated", "differs most in", "out of range"];
    header(text, "Real materials that are far, or out of range in something", &columns);
    let names = value_names();
    let mut order: Vec<usize> = (0..real.len()).collect();
    order.sort_by(|a, b| distances[*b].total_cmp(&distances[*a]));
    for i in order.into_iter().filter(|&i| coverage.is_far(i) || !coverage.outside[i].is_empty()) {
        let values = real[i].values();
        let neighbour = &generated[coverage.nearest[i].index];
        let most = coverage.farthest_value[i];
        let differs = format!("{} ({}, not {})", names[most], number(values[most]), number(neighbour.values()[most]));
        let outside: Vec<String> = coverage.outside[i].iter().map(|&v| format!("{} {}", names[v], number(values[v]))).collect();
        let distance = format!("{}{}", number(distances[i]), if coverage.is_far(i) { " (far)" } else { "" });
        line(text, &[real[i].name.clone(), distance, neighbour.name.clone(), differs, outside.join("; ")]);
    }
}

fn percent(part: usize, whole: usize) -> String {
    format!("{:.0} % ({part})", 100.0 * part as f32 / whole as f32)
}
