//! The choice among every step's finalists that makes the smoothest motion: on a periodic pattern a step that is off by a
//! period looks as good as the right one, but it jumps.

use ops::homography::Homography;

use super::candidates::Finalist;
use super::size::Size;

/// Standard errors of evidence that a change of the motion by the frame's whole width costs.
const COST_PER_WIDTH: f64 = 40.0;
/// No change counts more than this share of the width: a scan may turn sharply.
const LARGEST_CHANGE: f64 = 0.2;

/// Which finalist of every step to take (`None` where there is none): most evidence, least change (Viterbi 1967).
pub fn smoothest(options: &[Vec<Finalist>], size: Size) -> Vec<Option<usize>> {
    let mut best: Vec<Vec<(f64, usize)>> = Vec::with_capacity(options.len());
    for (i, here) in options.iter().enumerate() {
        let reach = |finalist: &Finalist| {
            let before = i.checked_sub(1).map(|p| (&options[p], &best[p])).filter(|(o, _)| !o.is_empty());
            let Some((before, costs)) = before else { return (-evidence(finalist), 0) };
            let ways = before.iter().zip(costs).map(|(b, (cost, _))| cost + change(b, finalist, size));
            let (from, cost) = ways.enumerate().min_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or((0, 0.0));
            (cost - evidence(finalist), from)
        };
        best.push(here.iter().map(reach).collect());
    }
    let mut path = vec![None; options.len()];
    let mut next: Option<usize> = None;
    for i in (0..options.len()).rev() {
        let cheapest = || best[i].iter().enumerate().min_by(|a, b| a.1.0.total_cmp(&b.1.0)).map(|(k, _)| k);
        path[i] = next.filter(|&k| k < options[i].len()).or_else(cheapest);
        next = path[i].map(|k| best[i][k].1);
    }
    path
}

fn evidence(finalist: &Finalist) -> f64 {
    finalist.refined.consistency.significance()
}

/// What it costs to go from one motion to another between two steps.
fn change(before: &Finalist, after: &Finalist, size: Size) -> f64 {
    let centre = |h: &Homography| h.apply(0.5 * size.width as f64, 0.5 * size.height as f64);
    let share = match (centre(&before.refined.homography), centre(&after.refined.homography)) {
        (Some(a), Some(b)) => (a.0 - b.0).hypot(a.1 - b.1) / size.width as f64,
        _ => LARGEST_CHANGE,
    };
    COST_PER_WIDTH * share.min(LARGEST_CHANGE)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::candidates::Origin;
    use crate::align::photometric::{Consistency, Refined};

    const SIZE: Size = Size { height: 256, width: 256 };

    fn finalist(x: f64, zncc: f64) -> Finalist {
        let consistency = Consistency { zncc, overlap: 1.0, compared: 16 * 1024 };
        let refined = Refined { homography: Homography::translation(x, 0.0), consistency, converged: true, expected_px: 0.1 };
        Finalist { origin: Origin::PhaseCorrelation, refined }
    }

    #[test]
    fn a_jump_by_one_period_loses_against_slightly_less_evidence() {
        let options: Vec<Vec<Finalist>> =
            [10.0, 12.0, 14.0, 15.0, 13.0].iter().map(|&x| vec![finalist(x - 32.0, 0.62), finalist(x, 0.6)]).collect();
        let mut mixed = options.clone();
        mixed.iter_mut().step_by(2).for_each(|o| o[0] = finalist(0.0, 0.1));
        assert_eq!(smoothest(&mixed, SIZE), vec![Some(1); 5]);
    }

    #[test]
    fn clear_evidence_turns_sharply_and_gaps_split_the_scan() {
        let turn = vec![
            vec![finalist(0.0, 0.1), finalist(20.0, 0.7)],
            vec![],
            vec![finalist(20.0, 0.2), finalist(-20.0, 0.8)],
            vec![finalist(-20.0, 0.2), finalist(20.0, 0.8)],
        ];
        assert_eq!(smoothest(&turn, SIZE), vec![Some(1), None, Some(1), Some(1)]);
        assert!(smoothest(&[], SIZE).is_empty());
    }
}
