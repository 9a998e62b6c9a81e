//! The figures of `report.json` as a table: what each is, and the main job's goal for it.

use scan::html::escape;
use serde_json::{Map, Value};

/// Endings of figures that were measured on a class of materials alone, with the headings of their columns.
const CLASSES: [(&str, &str); 4] =
    [("", "all"), ("_textured", "textured"), ("_low_texture", "low texture"), ("_featureless", "featureless")];

/// A figure: name, what it is, and the largest value that reaches the main job's goal.
struct Figure(&'static str, &'static str, Option<f64>);

/// In the order of the table; figures that aren't named here stand at its end.
const FIGURES: [Figure; 42] = [
    Figure("minutes", "whole run, compile time apart", Some(30.0)),
    Figure("peak_rss_mib", "most memory held, in MiB", Some(6144.0)),
    Figure("materials", "held-out materials that were scanned", None),
    Figure("adjacent_epe_px", "end-point error of the adjacent net, in pixels of its frames", None),
    Figure("adjacent_epe_ratio", "end-point error of the adjacent net over that of no motion", Some(0.45)),
    Figure("adjacent_homography_ratio", "… after the robust homography", Some(0.30)),
    Figure("distant_epe_px", "end-point error of the distant net, in pixels of its frames", None),
    Figure("distant_epe_ratio", "end-point error of the distant net over that of no motion", None),
    Figure("distant_homography_ratio", "… after the robust homography", None),
    Figure("alignment_valid_rate", "predicted and truly valid pixels over truly valid ones", None),
    Figure("alignment_pixel_error", "mean alignment error over pixels valid in both", None),
    Figure("alignment_pixel_error_median", "its median over key frames", None),
    Figure("alignment_penalised_error", "alignment error with lost pixels counted", None),
    Figure("alignment_within_4px", "share of key frames within 4 pixels", None),
    Figure("alignment_within_20px", "share of key frames within 20 pixels; goal: 0.60 or more where there is texture", None),
    Figure("alignment_diverged", "share of scans more than 10 pixels off or half lost", None),
    Figure("alignment_dropped", "share of key frames left out", None),
    Figure("identity_pixel_error", "alignment error if nothing is aligned", None),
    Figure("identity_within_20px", "share of key frames within 20 pixels if nothing is aligned", None),
    Figure("maps_l1_ratio", "sum of the four map errors over that of constant maps", Some(0.85)),
    Figure("maps_l1_ratio_exact_warps", "… with exact warps instead of the alignment", None),
    Figure("render_l1_ratio", "error of 18 re-renderings over that of constant maps", Some(0.80)),
    Figure("render_l1_ratio_exact_warps", "… with exact warps instead of the alignment", None),
    Figure("diffuse_l1", "mean error of the diffuse albedo", None),
    Figure("specular_l1", "mean error of the specular albedo", None),
    Figure("roughness_l1", "mean error of the roughness", None),
    Figure("normal_l1", "mean error of the normals", None),
    Figure("normal_deg", "mean angle between normals, in degrees", None),
    Figure("render_l1", "mean error of the re-renderings", None),
    Figure("dssim", "structural dissimilarity of the re-renderings", None),
    Figure("spike_share", "spikes: share of isolated high values that the truth lacks, mean of the four maps", None),
    Figure("spike_share_diffuse", "spikes in the diffuse albedo", None),
    Figure("spike_share_specular", "spikes in the specular albedo", None),
    Figure("spike_share_roughness", "spikes in the roughness", None),
    Figure("spike_share_normal", "spikes in the tilt of the normals", None),
    Figure("spike_excess", "how far pixels stand out of their surroundings more than the truth does", None),
    Figure("constant_diffuse_l1", "diffuse error of constant maps", None),
    Figure("constant_specular_l1", "specular error of constant maps", None),
    Figure("constant_roughness_l1", "roughness error of constant maps", None),
    Figure("constant_normal_l1", "normal error of constant maps", None),
    Figure("constant_render_l1", "re-rendering error of constant maps", None),
    Figure("constant_dssim", "structural dissimilarity of constant maps", None),
];
/// The part of the report that is about costs, not results.
const ELSEWHERE: [&str; 2] = ["_data_wait_share", "skipped_batches"];

/// One row per figure, one column per class of materials that was measured.
pub fn table(report: &Map<String, Value>) -> String {
    let measured = |(ending, _): &&(&str, &str)| ending.is_empty() || report.keys().any(|name| name.ends_with(ending));
    let classes: Vec<_> = CLASSES.iter().filter(measured).collect();
    let values = |name: &str| -> Vec<Option<f64>> {
        classes.iter().map(|(ending, _)| report.get(&format!("{name}{ending}")).and_then(Value::as_f64)).collect()
    };
    let mut rows = String::new();
    for Figure(name, what, goal) in &FIGURES {
        rows += &row(name, what, *goal, &values(name));
    }
    for name in report.keys().filter(|name| !is_shown(name)) {
        let mut alone = vec![None; classes.len()];
        alone[0] = report.get(name).and_then(Value::as_f64);
        rows += &row(name, "", None, &alone);
    }
    let heads: String = classes.iter().map(|(_, heading)| format!("<th class=\"number\">{heading}</th>")).collect();
    format!(
        "<div class=\"scroll\"><table>\n<tr><th>figure</th>{heads}<th class=\"number\">goal</th><th>what it is</th></tr>\n{rows}</table></div>\n"
    )
}

/// Whether a figure has a row of its own, or its place elsewhere on the page.
fn is_shown(name: &str) -> bool {
    let own = |base: &str| CLASSES.iter().any(|(ending, _)| name.strip_suffix(ending) == Some(base));
    ELSEWHERE.iter().any(|part| name.ends_with(part)) || FIGURES.iter().any(|Figure(base, ..)| own(base))
}

/// Empty where nothing was measured.
fn row(name: &str, what: &str, goal: Option<f64>, values: &[Option<f64>]) -> String {
    if values.iter().all(Option::is_none) {
        return String::new();
    }
    let number = |value: f64| if name == "materials" { format!("{value:.0}") } else { number(value) };
    let cell = |(column, value): (usize, &Option<f64>)| match (value, goal) {
        (None, _) => "<td></td>".to_string(),
        // The goals are of all materials together.
        (Some(value), Some(goal)) if column == 0 => {
            format!("<td class=\"number {}\">{}</td>", if *value <= goal { "met" } else { "missed" }, number(*value))
        }
        (Some(value), _) => format!("<td class=\"number\">{}</td>", number(*value)),
    };
    let cells: String = values.iter().enumerate().map(cell).collect();
    let goal =
        goal.map_or(String::new(), |goal| format!("≤ {}", if goal < 1.0 { format!("{goal:.2}") } else { goal.to_string() }));
    format!("<tr><td><code>{}</code></td>{cells}<td class=\"number\">{goal}</td><td>{}</td></tr>\n", escape(name), escape(what))
}

/// Three digits after the point for shares and ratios, fewer for larger numbers.
fn number(value: f64) -> String {
    // A sum of nothing is −0 in IEEE arithmetic; nobody wants to read that.
    let value = value + 0.0;
    match value.abs() {
        size if size >= 1000.0 || (value.fract() == 0.0 && size >= 2.0) => format!("{value:.0}"),
        size if size >= 10.0 => format!("{value:.1}"),
        size if size >= 0.1 || value == 0.0 => format!("{value:.3}"),
        size if size >= 1e-3 => format!("{value:.4}"),
        _ => format!("{value:.2e}"),
    }
}

#[cfg(test)]
mod tests {
    use super::number;

    #[test]
    fn numbers_have_the_digits_that_matter_and_zero_has_no_sign() {
        let written = [-0.0, 0.25, 12.34, 2.0, 4321.0, 0.012_34, 1.5e-5].map(number);
        assert_eq!(written, ["0.000", "0.250", "12.3", "2", "4321", "0.0123", "1.50e-5"]);
    }
}
