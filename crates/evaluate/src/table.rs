//! Tables as CSV and Markdown.

use dataset::material::texture::Texture;

use crate::report::{Figures, Row};

/// Columns that the Markdown table shows, with their headings.
const COLUMNS: [(&str, &str); 11] = [
    ("adjacent_epe_ratio", "flow / zero"),
    ("adjacent_homography_ratio", "homography / zero"),
    ("alignment_valid_rate", "valid rate"),
    ("alignment_pixel_error", "pixel error"),
    ("alignment_within_20px", "within 20 px"),
    ("identity_pixel_error", "identity error"),
    ("diffuse_l1", "diffuse"),
    ("normal_l1", "normal"),
    ("specular_l1", "specular"),
    ("roughness_l1", "roughness"),
    ("render_l1", "render"),
];

/// All figures of all rows, comma-separated, one line per material.
pub fn csv(rows: &[Row]) -> String {
    let names: std::collections::BTreeSet<&String> = rows.iter().flat_map(|r| r.figures.keys()).collect();
    let mut text = format!("material,texture,{}\n", names.iter().map(|n| n.as_str()).collect::<Vec<_>>().join(","));
    for row in rows {
        let cells: Vec<String> =
            names.iter().map(|n| row.figures.get(*n).map_or_else(String::new, |v| format!("{v:.6}"))).collect();
        // Material names come from folder names and may hold anything.
        text += &format!("\"{}\",{},{}\n", row.material.replace('"', "\"\""), name(row.texture), cells.join(","));
    }
    text
}

/// The main figures as a Markdown table, with the summary's lines at the end.
pub fn markdown(rows: &[Row], summary: &Figures) -> String {
    let mut text = String::from("| material | texture |");
    COLUMNS.iter().for_each(|(_, heading)| text += &format!(" {heading} |"));
    text += "\n|---|---|";
    text += &"---|".repeat(COLUMNS.len());
    text.push('\n');
    let cells = |get: &dyn Fn(&str) -> Option<f64>| -> String {
        COLUMNS.iter().map(|(name, _)| get(name).map_or_else(|| " – |".into(), |v| format!(" {v:.4} |"))).collect()
    };
    for row in rows {
        let texture = name(row.texture);
        let material = row.material.replace('|', "\\|");
        text += &format!("| {material} | {texture} |{}\n", cells(&|n| row.figures.get(n).copied()));
    }
    let groups = [
        ("**textured or low**", ""),
        ("**textured**", "_textured"),
        ("**low texture**", "_low_texture"),
        ("**featureless**", "_featureless"),
    ];
    for (label, ending) in groups {
        let get = |n: &str| summary.get(&format!("{n}{ending}")).copied();
        text += &format!("| {label} | |{}\n", cells(&get));
    }
    text += &format!("\nMaps: {}. Distances in pixels at a width of 1024.\n", ratios(summary));
    text
}

fn name(texture: Texture) -> &'static str {
    match texture {
        Texture::Rich => "yes",
        Texture::Faint => "low",
        Texture::Absent => "none",
    }
}

fn ratios(summary: &Figures) -> String {
    let ratio = |name: &str| summary.get(name).map_or_else(|| "–".into(), |v| format!("{v:.3}"));
    format!(
        "sum of the four map errors over the constant maps' {} (exact warps {}), re-rendering {} (exact warps {})",
        ratio("maps_l1_ratio"),
        ratio("maps_l1_ratio_exact_warps"),
        ratio("render_l1_ratio"),
        ratio("render_l1_ratio_exact_warps")
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_hold_every_material_and_quote_names() {
        let figures = Figures::from([("diffuse_l1".into(), 0.125), ("other".into(), 2.0)]);
        let rows = vec![Row { material: "a|b, \"c\"".into(), texture: Texture::Rich, figures: figures.clone() }];
        let text = csv(&rows);
        assert_eq!(text, "material,texture,diffuse_l1,other\n\"a|b, \"\"c\"\"\",yes,0.125000,2.000000\n");
        let text = markdown(&rows, &figures);
        assert!(text.contains("| a\\|b, \"c\" | yes |") && text.contains(" 0.1250 |"));
        assert_eq!(
            text.lines().filter(|l| l.starts_with('|')).map(|l| l.replace("\\|", "").matches('|').count()).max(),
            Some(14)
        );
    }
}
