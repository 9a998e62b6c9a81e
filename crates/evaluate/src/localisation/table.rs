//! The cases as a table.

use std::path::Path;

use dataset::image_io::{Overwrite, write_bytes};
use dataset::material::texture::Texture;

use crate::EvaluateError;

use super::{Case, Light, Outcome};

/// Writes `cases.json` and `table.md` into an existing folder.
///
/// # Errors
/// If a file can't be written, or exists and may not be replaced.
pub fn write(cases: &[Case], folder: &Path, overwrite: Overwrite) -> Result<(), EvaluateError> {
    write_bytes(&folder.join("table.md"), markdown(cases).as_bytes(), overwrite)?;
    let json = serde_json::to_vec_pretty(cases).expect("plain values");
    Ok(write_bytes(&folder.join("cases.json"), &json, overwrite)?)
}

/// Shares of the outcomes by scale, by light and by what the materials show.
pub fn markdown(cases: &[Case]) -> String {
    let mut text = String::from(
        "| photos | cases | within 16 px | refused: not found | refused: repeats | wrong, accepted | mean error px | seconds |\n\
         |---|---|---|---|---|---|---|---|\n",
    );
    let shown: Vec<&Case> = cases.iter().filter(|c| !c.foreign && c.texture != Texture::Absent).collect();
    let mut scales: Vec<f64> = shown.iter().map(|c| c.scale).collect();
    scales.sort_by(f64::total_cmp);
    scales.dedup();
    let of = |keep: &dyn Fn(&Case) -> bool| shown.iter().copied().filter(|c| keep(c)).collect::<Vec<&Case>>();
    text += &row("all, textured or low texture", &shown);
    scales.iter().for_each(|&s| text += &row(&format!("… scale {s}"), &of(&|c| c.scale == s)));
    for (name, light) in [("flash", Light::Flash), ("flash and environment", Light::Mixed), ("environment", Light::Environment)]
    {
        text += &row(&format!("… {name}"), &of(&|c| c.light == light));
    }
    text += &row("… textured", &of(&|c| c.texture == Texture::Rich));
    text += &row("… low texture", &of(&|c| c.texture == Texture::Faint));
    text += &row("featureless", &cases.iter().filter(|c| !c.foreign && c.texture == Texture::Absent).collect::<Vec<_>>());
    text += &row("of another material", &cases.iter().filter(|c| c.foreign).collect::<Vec<_>>());
    text + "\nErrors in pixels at a frame width of 1024, of accepted places.\n"
}

fn row(name: &str, cases: &[&Case]) -> String {
    if cases.is_empty() {
        return String::new();
    }
    let n = cases.len() as f64;
    let share = |outcome| cases.iter().filter(|c| c.outcome == outcome).count() as f64 / n;
    let found: Vec<f64> = cases.iter().filter(|c| c.outcome == Outcome::Found).filter_map(|c| c.error_px).collect();
    let error = if found.is_empty() { "–".into() } else { format!("{:.2}", found.iter().sum::<f64>() / found.len() as f64) };
    let seconds = cases.iter().map(|c| c.seconds).sum::<f64>() / n;
    let [good, refused, repeats, wrong] = [Outcome::Found, Outcome::Refused, Outcome::Repeats, Outcome::Wrong].map(share);
    format!("| {name} | {} | {good:.3} | {refused:.3} | {repeats:.3} | {wrong:.3} | {error} | {seconds:.1} |\n", cases.len())
}
