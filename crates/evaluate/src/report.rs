//! The figures that a training run ends with: `report.json`.

use std::collections::BTreeMap;

use dataset::material::texture::Texture;
use flow::align::metrics::{AlignmentMetrics, summarise};
use serde::{Deserialize, Serialize};
use svbrdf::metrics::{MapErrors, RenderErrors, Spikes};

use crate::synthetic::{Errors, MaterialResult};

/// Figures by name. A name that ends in `_textured`, `_low_texture` or `_featureless` is measured on those materials alone;
/// without such an ending, on all that show something to align by. A figure that can't be measured (no such material, no net)
/// is absent.
pub type Figures = BTreeMap<String, f64>;

/// One line of the table per material.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Row {
    /// Name of the material.
    pub material: String,
    /// What it shows to align by.
    pub texture: Texture,
    /// Its figures.
    #[serde(flatten)]
    pub figures: Figures,
}

/// The summary over all materials but featureless ones, and over each class.
pub fn summary(results: &[MaterialResult]) -> Figures {
    let mut figures = Figures::new();
    let groups: [(&str, &[Texture]); 4] = [
        ("", &[Texture::Rich, Texture::Faint]),
        ("_textured", &[Texture::Rich]),
        ("_low_texture", &[Texture::Faint]),
        ("_featureless", &[Texture::Absent]),
    ];
    for (ending, textures) in groups {
        let group: Vec<&MaterialResult> = results.iter().filter(|r| textures.contains(&r.texture)).collect();
        for (name, value) in group_figures(&group) {
            figures.insert(format!("{name}{ending}"), value);
        }
    }
    figures
}

/// The table's rows.
pub fn rows(results: &[MaterialResult]) -> Vec<Row> {
    let row = |r: &MaterialResult| Row {
        material: r.material.clone(),
        texture: r.texture,
        figures: group_figures(&[r]).into_iter().map(|(n, v)| (n.to_string(), v)).collect(),
    };
    results.iter().map(row).collect()
}

fn group_figures(group: &[&MaterialResult]) -> Vec<(&'static str, f64)> {
    if group.is_empty() {
        return Vec::new();
    }
    let mut figures = vec![("materials", group.len() as f64)];
    let adjacent: Vec<_> = group.iter().filter_map(|r| r.adjacent).collect();
    if !adjacent.is_empty() {
        let sum = |f: fn(&crate::adjacent::AdjacentErrors) -> f64| adjacent.iter().map(f).sum::<f64>();
        figures.push(("adjacent_epe_ratio", sum(|a| a.epe) / sum(|a| a.zero_flow)));
        figures.push(("adjacent_homography_ratio", sum(|a| a.homography) / sum(|a| a.zero_flow)));
    }
    figures.extend(alignment_figures(group));
    figures.extend(map_figures(group));
    figures
}

fn alignment_figures(group: &[&MaterialResult]) -> Vec<(&'static str, f64)> {
    let of = |f: fn(&MaterialResult) -> &flow::align::metrics::ScanErrors| -> AlignmentMetrics {
        summarise(&group.iter().map(|r| f(r).clone()).collect::<Vec<_>>())
    };
    let (automatic, identity) = (of(|r| &r.alignment), of(|r| &r.identity));
    let (dropped, keys) = group.iter().fold((0, 0), |(d, k), r| (d + r.dropped.0, k + r.dropped.1));
    vec![
        ("alignment_valid_rate", automatic.valid_rate),
        ("alignment_pixel_error", automatic.pixel_error),
        ("alignment_pixel_error_median", automatic.pixel_error_median),
        ("alignment_penalised_error", automatic.penalised_error),
        ("alignment_within_20px", automatic.within_20px),
        ("alignment_within_4px", automatic.within_4px),
        ("alignment_diverged", automatic.diverged),
        ("alignment_dropped", dropped as f64 / keys.max(1) as f64),
        ("identity_pixel_error", identity.pixel_error),
        ("identity_within_20px", identity.within_20px),
    ]
}

fn map_figures(group: &[&MaterialResult]) -> Vec<(&'static str, f64)> {
    let spikes = Spikes::mean(&group.iter().map(|r| r.automatic.spikes).collect::<Vec<_>>()).expect("a group isn't empty");
    let mean = |f: fn(&MaterialResult) -> &Errors| -> (MapErrors, RenderErrors) {
        let errors: Vec<&Errors> = group.iter().map(|r| f(r)).collect();
        let maps = MapErrors::mean(&errors.iter().map(|e| e.maps).collect::<Vec<_>>());
        let render = RenderErrors::mean(&errors.iter().map(|e| e.render).collect::<Vec<_>>());
        (maps.expect("a group isn't empty"), render.expect("a group isn't empty"))
    };
    let (automatic, exact, constant) = (mean(|r| &r.automatic), mean(|r| &r.exact), mean(|r| &r.constant));
    let mut figures = vec![
        ("maps_l1_ratio", automatic.0.sum_l1() / constant.0.sum_l1()),
        ("maps_l1_ratio_exact_warps", exact.0.sum_l1() / constant.0.sum_l1()),
        ("render_l1_ratio", automatic.1.l1 / constant.1.l1),
        ("render_l1_ratio_exact_warps", exact.1.l1 / constant.1.l1),
        ("diffuse_l1", automatic.0.diffuse_l1),
        ("normal_l1", automatic.0.normal_l1),
        ("normal_deg", automatic.0.normal_deg),
        ("specular_l1", automatic.0.specular_l1),
        ("roughness_l1", automatic.0.roughness_l1),
        ("render_l1", automatic.1.l1),
        ("spike_share", spikes.share()),
        ("spike_share_diffuse", spikes.diffuse),
        ("spike_share_normal", spikes.normal),
        ("spike_share_specular", spikes.specular),
        ("spike_share_roughness", spikes.roughness),
        ("spike_excess", spikes.excess),
        ("constant_diffuse_l1", constant.0.diffuse_l1),
        ("constant_normal_l1", constant.0.normal_l1),
        ("constant_specular_l1", constant.0.specular_l1),
        ("constant_roughness_l1", constant.0.roughness_l1),
        ("constant_render_l1", constant.1.l1),
    ];
    let pairs = [("dssim", automatic.1.dssim), ("constant_dssim", constant.1.dssim)];
    figures.extend(pairs.into_iter().filter_map(|(name, value)| value.map(|v| (name, v))));
    figures
}
