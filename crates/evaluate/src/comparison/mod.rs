//! Variants of a method side by side: means over seeds, differences to a reference on the same materials, and how they stand
//! to published figures (the form of the paper's Table 2).

mod markdown;
mod plot;

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::report::{Figures, Row};
use crate::statistics::{Mean, signed_rank};

pub use markdown::markdown;
pub use plot::svg;

/// A difference is called certain below this probability.
const SIGNIFICANT: f64 = 0.05;

/// Figures that can be compared, with their headings. Smaller is better except for rates.
pub const FIGURES: [(&str, &str); 21] = [
    ("diffuse_l1", "Diffuse L1"),
    ("normal_l1", "Normal L1"),
    ("normal_deg", "Normal, degrees"),
    ("specular_l1", "Specular L1"),
    ("roughness_l1", "Roughness L1"),
    ("maps_l1_ratio", "Maps / constant maps"),
    ("maps_l1_ratio_exact_warps", "Maps / constant maps, exact warps"),
    ("render_l1", "Re-rendering L1"),
    ("dssim", "Re-rendering DSSIM"),
    ("render_l1_ratio", "Re-rendering / constant maps"),
    ("render_l1_ratio_exact_warps", "Re-rendering / constant maps, exact warps"),
    ("spike_share", "Spikes, share of pixels"),
    ("spike_excess", "Spikes, mean excess"),
    ("alignment_valid_rate", "Valid rate"),
    ("alignment_pixel_error", "Pixel error"),
    ("alignment_penalised_error", "Penalised error"),
    ("alignment_within_20px", "Within 20 px"),
    ("adjacent_epe_ratio", "Adjacent flow / zero"),
    ("adjacent_homography_ratio", "Adjacent homography / zero"),
    ("distant_epe_ratio", "Distant flow / zero"),
    ("distant_homography_ratio", "Distant homography / zero"),
];

/// The columns of the paper's Table 2.
pub const TABLE_2: [&str; 8] = [
    "diffuse_l1",
    "normal_l1",
    "specular_l1",
    "roughness_l1",
    "render_l1",
    "dssim",
    "alignment_valid_rate",
    "alignment_pixel_error",
];

/// What one run measured.
#[derive(Clone, Debug)]
pub struct Measured {
    /// The variant that it is a run of.
    pub variant: String,
    /// Its seed.
    pub seed: u64,
    /// Over all materials.
    pub figures: Figures,
    /// Material by material.
    pub materials: Vec<Row>,
}

/// Figures of variants that others have published.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Published {
    /// Where they stand.
    pub source: String,
    /// By variant.
    pub figures: BTreeMap<String, Figures>,
}

/// What to compare with what.
#[derive(Clone, Debug)]
pub struct Question {
    /// Names and titles of the variants, in the order of the table.
    pub variants: Vec<(String, String)>,
    /// The variant that the others are compared with.
    pub reference: String,
    /// Names of the figures, in the order of the table.
    pub figures: Vec<String>,
    /// Published figures.
    pub published: Option<Published>,
}

/// The answer: one cell per variant and figure.
#[derive(Clone, Debug)]
pub struct Comparison {
    /// What was asked.
    pub question: Question,
    /// `[variant][figure]`; `None` where no run measured it.
    pub cells: Vec<Vec<Option<Cell>>>,
}

/// A figure of a variant.
#[derive(Clone, Debug)]
pub struct Cell {
    /// By seed.
    pub seeds: Vec<(u64, f64)>,
    /// Over the seeds.
    pub mean: Mean,
    /// To the reference; `None` for the reference itself.
    pub difference: Option<Difference>,
}

/// A variant minus the reference.
#[derive(Clone, Copy, Debug)]
pub struct Difference {
    /// Over the seeds that both have.
    pub mean: Mean,
    /// Probability of pairs as different as these, or more, if there were no difference: signed ranks of all pairs of the same
    /// material and seed. `None` when no pair differs.
    pub p: Option<f64>,
    /// How many such pairs there are.
    pub pairs: usize,
}

/// How a measured difference stands to the published one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// The same sign, certainly.
    Confirmed,
    /// The same sign, but it may be chance.
    SameSign,
    /// No difference at all.
    Equal,
    /// The other sign, but it may be chance.
    OtherSign,
    /// The other sign, certainly.
    Contradicted,
}

impl Difference {
    /// Whether it can hardly be chance: neither of the materials (the pairs' test) nor of the seeds (the interval).
    pub fn is_certain(&self) -> bool {
        self.mean.is_certain() && self.p.is_some_and(|p| p < SIGNIFICANT)
    }
}

/// The heading of a figure.
pub fn heading(figure: &str) -> &str {
    FIGURES.iter().find(|(name, _)| *name == figure).map_or(figure, |(_, heading)| heading)
}

impl Comparison {
    /// Compares runs. Runs of variants that the question doesn't name take no part.
    pub fn new(question: Question, runs: &[Measured]) -> Self {
        let of = |variant: &str| runs.iter().filter(|run| run.variant == variant).collect::<Vec<_>>();
        let reference = of(&question.reference);
        let row = |(name, _): &(String, String)| {
            let runs = of(name);
            let others = (*name != question.reference).then_some(reference.as_slice());
            question.figures.iter().map(|figure| Cell::new(figure, &runs, others)).collect()
        };
        let cells = question.variants.iter().map(row).collect();
        Self { question, cells }
    }

    /// How a cell stands to what was published of its variant and the reference; `None` where nothing was.
    pub fn verdict(&self, variant: usize, figure: usize) -> Option<(f64, Verdict)> {
        let name = &self.question.figures[figure];
        let published = |variant: &str| self.question.published.as_ref()?.figures.get(variant)?.get(name).copied();
        let expected = published(&self.question.variants[variant].0)? - published(&self.question.reference)?;
        let difference = self.cells[variant][figure].as_ref()?.difference?;
        let verdict = match (difference.mean.value * expected, difference.is_certain()) {
            (0.0, _) => Verdict::Equal,
            (product, true) if product > 0.0 => Verdict::Confirmed,
            (product, false) if product > 0.0 => Verdict::SameSign,
            (_, true) => Verdict::Contradicted,
            (_, false) => Verdict::OtherSign,
        };
        Some((expected, verdict))
    }
}

impl Cell {
    fn new(figure: &str, runs: &[&Measured], reference: Option<&[&Measured]>) -> Option<Self> {
        let value = |run: &Measured| run.figures.get(figure).map(|value| (run.seed, *value));
        let seeds: Vec<(u64, f64)> = runs.iter().filter_map(|run| value(run)).collect();
        let mean = Mean::of(&seeds.iter().map(|(_, value)| *value).collect::<Vec<_>>())?;
        Some(Self { seeds, mean, difference: reference.and_then(|others| Difference::new(figure, runs, others)) })
    }
}

impl Difference {
    fn new(figure: &str, runs: &[&Measured], reference: &[&Measured]) -> Option<Self> {
        let (mut seeds, mut pairs) = (Vec::new(), Vec::new());
        for run in runs {
            let Some(other) = reference.iter().find(|other| other.seed == run.seed) else {
                continue;
            };
            seeds.extend(run.figures.get(figure).zip(other.figures.get(figure)).map(|(a, b)| a - b));
            for row in &run.materials {
                let same = other.materials.iter().find(|o| o.material == row.material);
                pairs.extend(same.and_then(|o| Some(row.figures.get(figure)? - o.figures.get(figure)?)));
            }
        }
        Some(Self { mean: Mean::of(&seeds)?, p: signed_rank(&pairs), pairs: pairs.len() })
    }
}

/// All cells as CSV, one line per variant and figure; the values of single seeds are in the last column.
pub fn csv(comparison: &Comparison) -> String {
    let mut text = String::from(
        "variant,figure,seeds,mean,interval_95,difference,difference_interval_95,pairs,p_signed_rank,published_difference,values\n",
    );
    let number = |value: Option<f64>| value.map_or_else(String::new, |value| format!("{value:.6e}"));
    let Question { variants, figures, .. } = &comparison.question;
    for (row, (name, _)) in variants.iter().enumerate() {
        for (column, figure) in figures.iter().enumerate() {
            let Some(cell) = &comparison.cells[row][column] else { continue };
            let difference = cell.difference;
            let columns = [
                number(Some(cell.mean.value)),
                number(cell.mean.half_width),
                number(difference.map(|d| d.mean.value)),
                number(difference.and_then(|d| d.mean.half_width)),
                difference.map_or_else(String::new, |d| d.pairs.to_string()),
                number(difference.and_then(|d| d.p)),
                number(comparison.verdict(row, column).map(|(expected, _)| expected)),
            ];
            let seeds = cell.seeds.iter().map(|(seed, value)| format!("{seed}:{value:.6e}")).collect::<Vec<_>>().join(" ");
            text += &format!("{name},{figure},{},{},{seeds}\n", cell.seeds.len(), columns.join(","));
        }
    }
    text
}

#[cfg(test)]
mod tests;
