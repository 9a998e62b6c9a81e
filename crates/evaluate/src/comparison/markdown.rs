//! A comparison as Markdown.

use super::{Cell, Comparison, Verdict, heading};
use crate::statistics::Mean;

/// Three tables: means, differences to the reference, and how these stand to published ones.
pub fn markdown(comparison: &Comparison) -> String {
    let question = &comparison.question;
    let reference = question.variants.iter().find(|(name, _)| *name == question.reference).map_or("", |(_, title)| title);
    let seeds = comparison.cells.iter().flatten().flatten().map(|cell| cell.seeds.len());
    let (fewest, most) = (seeds.clone().min().unwrap_or(0), seeds.max().unwrap_or(0));
    let seeds = match (fewest, most) {
        (1, 1) => "1 seed".to_string(),
        (fewest, most) if fewest == most => format!("{most} seeds"),
        (fewest, most) => format!("{fewest} to {most} seeds"),
    };
    let mut text = format!("Mean ± half the 95 % interval (Student's t) over {seeds}:\n\n");
    text += &table(comparison, |row, column| comparison.cells[row][column].as_ref().map(|cell| mean(&cell.mean)));
    let pairs = comparison.cells.iter().flatten().flatten().filter_map(|cell| cell.difference).map(|d| d.pairs).max();
    text += &format!(
        "\nDifference to *{reference}*, ± half the 95 % interval over seeds; p by Wilcoxon's signed ranks of {} pairs (same material, same seed). Bold: p < 0.05 and the interval leaves 0 out.\n\n",
        pairs.unwrap_or(0)
    );
    text += &table(comparison, |row, column| comparison.cells[row][column].as_ref().and_then(difference));
    if let Some(published) = &question.published {
        text += &format!(
            "\nAgainst {}: measured / published difference to *{reference}*, relative to its own *{reference}*. ✓ same sign, bold as above; (✓) same sign, may be chance; = no difference; (✗) other sign, may be chance; ✗ other sign, bold as above.\n\n",
            published.source
        );
        text += &table(comparison, |row, column| against(comparison, row, column));
        text += &format!("\n{}\n", counts(comparison));
    }
    text
}

fn table(comparison: &Comparison, cell: impl Fn(usize, usize) -> Option<String>) -> String {
    let figures = &comparison.question.figures;
    let mut text = String::from("| |");
    figures.iter().for_each(|figure| text += &format!(" {} |", heading(figure)));
    text += &format!("\n|---|{}\n", "---|".repeat(figures.len()));
    for (row, (_, title)) in comparison.question.variants.iter().enumerate() {
        text += &format!("| {} |", title.replace('|', "\\|"));
        (0..figures.len()).for_each(|column| text += &format!(" {} |", cell(row, column).unwrap_or_else(|| "–".into())));
        text.push('\n');
    }
    text
}

fn mean(mean: &Mean) -> String {
    match mean.half_width {
        Some(half) => format!("{:.4} ± {half:.4}", mean.value),
        None => format!("{:.4}", mean.value),
    }
}

fn difference(cell: &Cell) -> Option<String> {
    let difference = cell.difference?;
    let Some(p) = difference.p else {
        return Some(if difference.mean.value == 0.0 { "=".into() } else { format!("{:+.4}", difference.mean.value) });
    };
    let interval = difference.mean.half_width.map_or_else(String::new, |half| format!(" ± {half:.4}"));
    let p = if p < 0.001 { "p < 0.001".into() } else { format!("p = {p:.3}") };
    let text = format!("{:+.4}{interval}", difference.mean.value);
    Some(if difference.is_certain() { format!("**{text}** ({p})") } else { format!("{text} ({p})") })
}

fn against(comparison: &Comparison, row: usize, column: usize) -> Option<String> {
    let (expected, verdict) = comparison.verdict(row, column)?;
    let question = &comparison.question;
    let base = question.variants.iter().position(|(name, _)| *name == question.reference)?;
    let ours =
        comparison.cells[row][column].as_ref()?.difference?.mean.value / comparison.cells[base][column].as_ref()?.mean.value;
    let theirs = expected / question.published.as_ref()?.figures.get(&question.reference)?.get(&question.figures[column])?;
    let mark = match verdict {
        Verdict::Confirmed => "✓",
        Verdict::SameSign => "(✓)",
        Verdict::Equal => "=",
        Verdict::OtherSign => "(✗)",
        Verdict::Contradicted => "✗",
    };
    Some(format!("{:+.0} % / {:+.0} % {mark}", 100.0 * ours, 100.0 * theirs))
}

fn counts(comparison: &Comparison) -> String {
    let places =
        (0..comparison.cells.len()).flat_map(|row| (0..comparison.question.figures.len()).map(move |column| (row, column)));
    let verdicts: Vec<Verdict> = places.filter_map(|(row, column)| Some(comparison.verdict(row, column)?.1)).collect();
    let count = |wanted| verdicts.iter().filter(|verdict| **verdict == wanted).count();
    format!(
        "Of {} published differences {} are confirmed, {} have the same sign but may be chance, {} vanish, {} have the other sign but may be chance, {} are contradicted.",
        verdicts.len(),
        count(Verdict::Confirmed),
        count(Verdict::SameSign),
        count(Verdict::Equal),
        count(Verdict::OtherSign),
        count(Verdict::Contradicted)
    )
}
