//! The key frames and the links found between them: shortest paths from the guidance image, then a joint adjustment.

use nalgebra::{DMatrix, DVector, Matrix3};
use ops::homography::Homography;

use super::size::Size;

/// A measured homography between two nodes.
#[derive(Clone, Copy, Debug)]
pub struct Link {
    /// Node whose pixels are the target.
    pub target: usize,
    /// Node whose pixels are the source.
    pub source: usize,
    /// Target pixel to source pixel.
    pub homography: Homography,
    /// Expected error in pixels.
    pub error_px: f64,
}

/// A node's homography from the guidance image with its expected error.
#[derive(Clone, Copy, Debug)]
pub struct Place {
    /// Guidance pixel to pixel of the node.
    pub homography: Homography,
    /// Expected error in pixels.
    pub error_px: f64,
}

/// Places every node along the links with the smallest summed squared error from node 0, the guidance image; a node that no
/// link reaches stays `None`.
pub fn shortest_paths(nodes: usize, links: &[Link]) -> Vec<Option<Place>> {
    let mut places: Vec<Option<Place>> = vec![None; nodes];
    places[0] = Some(Place { homography: Homography::identity(), error_px: 0.0 });
    // Bellman–Ford: a few dozen nodes, so the simplest order-free method is the right one.
    for _ in 0..nodes {
        let mut changed = false;
        for link in links {
            changed |= extend(&mut places, link.target, link.source, Some(link.homography), link.error_px);
            changed |= extend(&mut places, link.source, link.target, link.homography.inverse(), link.error_px);
        }
        if !changed {
            break;
        }
    }
    places
}

fn extend(places: &mut [Option<Place>], from: usize, to: usize, step: Option<Homography>, error_px: f64) -> bool {
    let (Some(start), Some(step)) = (places[from], step) else { return false };
    let reached = start.error_px.hypot(error_px);
    if to == 0 || places[to].is_some_and(|p| p.error_px <= reached * (1.0 + 1e-9)) {
        return false;
    }
    places[to] = Some(Place { homography: step.after(&start.homography), error_px: reached });
    true
}

/// Positions per side at which a link is held.
const SIDE: usize = 4;
/// Gauss–Newton steps.
const STEPS: usize = 10;
/// No link is believed to be better than this, in pixels.
const SHARPEST_PX: f64 = 0.2;
/// Share of the links by which their disagreement is judged.
const MOST: f64 = 0.75;

/// Adjusts all placed nodes together so that the links agree; Cauchy weights keep a wrong link from bending the rest.
///
/// Each link counts at those positions of its target that it maps into its source, where it was measured.
pub fn adjust(places: &mut [Option<Place>], links: &[Link], sizes: &[Size]) {
    let order: Vec<Option<usize>> = places
        .iter()
        .enumerate()
        .scan(0, |next, (node, place)| {
            let free = node > 0 && place.is_some();
            *next += usize::from(free);
            Some(free.then(|| *next - 1))
        })
        .collect();
    let unknowns = 8 * order.iter().flatten().count();
    for _ in 0..STEPS {
        let mut matrix = DMatrix::<f64>::zeros(unknowns, unknowns);
        let mut vector = DVector::<f64>::zeros(unknowns);
        for link in links {
            add_link(link, places, sizes, &order, &mut matrix, &mut vector);
        }
        // A weak pull to the present estimate: directions that no link holds don't move.
        (0..unknowns).for_each(|i| matrix[(i, i)] += 1e-2);
        let Some(step) = matrix.cholesky().map(|c| c.solve(&-vector)) else { return };
        if step.iter().any(|v| !v.is_finite()) {
            return;
        }
        for (node, place) in places.iter_mut().enumerate() {
            if let (Some(block), Some(place)) = (order[node], place.as_mut()) {
                let p: Vec<f64> = step.rows(8 * block, 8).iter().copied().collect();
                place.homography = moved(&place.homography, &p, sizes[node]);
            }
        }
        if step.amax() < 1e-6 {
            break;
        }
    }
}

/// By how much the links disagree more than their expected errors let expect, at least 1: what all of them take for the surface
/// may move otherwise, as glints do. The ratio that most links stay below, with the share of the links that only place nodes
/// counted out (the variance factor a posteriori of an adjustment; here robust).
pub fn disagreement(places: &[Option<Place>], links: &[Link], sizes: &[Size]) -> f64 {
    let ratio = |link: &Link| {
        let now = residuals(link, &places[link.target]?.homography, &places[link.source]?.homography, sizes)?;
        // Two values per position.
        let mean = 2.0 * now.iter().map(|r| r * r).sum::<f64>() / now.len().max(1) as f64;
        (!now.is_empty()).then(|| mean.sqrt() / link.error_px.max(SHARPEST_PX))
    };
    let mut ratios: Vec<f64> = links.iter().filter_map(ratio).collect();
    let placing = places.iter().skip(1).flatten().count();
    if ratios.len() <= placing {
        return 1.0;
    }
    ratios.sort_by(f64::total_cmp);
    let most = ratios[((ratios.len() - 1) as f64 * MOST) as usize];
    let freedom = ratios.len() as f64 / (ratios.len() - placing) as f64;
    (most * freedom.sqrt()).max(1.0)
}

/// `homography` followed by the small map with parameters `p` of its source, in units of half the source's side.
fn moved(homography: &Homography, p: &[f64], size: Size) -> Homography {
    let half = 0.5 * size.height.max(size.width) as f64;
    let (cx, cy) = (0.5 * (size.width as f64 - 1.0), 0.5 * (size.height as f64 - 1.0));
    let from_unit = Matrix3::new(half, 0.0, cx, 0.0, half, cy, 0.0, 0.0, 1.0);
    let to_unit = Matrix3::new(1.0 / half, 0.0, -cx / half, 0.0, 1.0 / half, -cy / half, 0.0, 0.0, 1.0);
    let small = Matrix3::new(1.0 + p[0], p[1], p[2], p[3], 1.0 + p[4], p[5], p[6], p[7], 1.0);
    Homography::new(from_unit * small * to_unit * homography.matrix)
}

/// Residuals of a link at its positions: predicted minus measured source position.
fn residuals(link: &Link, target: &Homography, source: &Homography, sizes: &[Size]) -> Option<Vec<f64>> {
    let relative = source.after(&target.inverse()?);
    let mut values = Vec::with_capacity(2 * SIDE * SIDE);
    for (x, y) in sizes[link.target].grid(SIDE) {
        let Some(measured) = link.homography.apply(x, y).filter(|&p| sizes[link.source].contains(p)) else { continue };
        let predicted = relative.apply(x, y)?;
        values.extend([predicted.0 - measured.0, predicted.1 - measured.1]);
    }
    Some(values)
}

fn add_link(
    link: &Link,
    places: &[Option<Place>],
    sizes: &[Size],
    order: &[Option<usize>],
    matrix: &mut DMatrix<f64>,
    vector: &mut DVector<f64>,
) {
    let (Some(target), Some(source)) = (places[link.target], places[link.source]) else { return };
    let (target, source) = (target.homography, source.homography);
    let Some(now) = residuals(link, &target, &source, sizes).filter(|r| !r.is_empty()) else { return };
    let variance = link.error_px.max(SHARPEST_PX).powi(2);
    let mean = now.iter().map(|r| r * r).sum::<f64>() / now.len() as f64;
    let weight = 1.0 / (variance * (1.0 + mean / (9.0 * variance)));
    // One block of eight columns per free end, by central differences: the parameters are of order one by construction.
    const STEP: f64 = 1e-5;
    let mut columns: Vec<(usize, Vec<f64>)> = Vec::new();
    for (node, is_source) in [(link.target, false), (link.source, true)] {
        let Some(block) = order[node] else { continue };
        for k in 0..8 {
            let at = |value: f64| {
                let mut p = [0.0; 8];
                p[k] = value;
                let changed = moved(if is_source { &source } else { &target }, &p, sizes[node]);
                let (t, s) = if is_source { (&target, &changed) } else { (&changed, &source) };
                residuals(link, t, s, sizes)
            };
            let (Some(ahead), Some(behind)) = (at(STEP), at(-STEP)) else { return };
            columns.push((8 * block + k, ahead.iter().zip(&behind).map(|(a, b)| (a - b) / (2.0 * STEP)).collect()));
        }
    }
    for (i, a) in &columns {
        vector[*i] += weight * a.iter().zip(&now).map(|(a, r)| a * r).sum::<f64>();
        for (j, b) in &columns {
            matrix[(*i, *j)] += weight * a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: Size = Size { height: 100, width: 120 };

    fn link(target: usize, source: usize, homography: Homography, error_px: f64) -> Link {
        Link { target, source, homography, error_px }
    }

    fn error(place: &Option<Place>, truth: &Homography) -> f64 {
        super::super::candidates::largest_shift(&place.unwrap().homography, truth, SIZE)
    }

    #[test]
    fn the_more_certain_path_wins_and_unreached_nodes_stay_open() {
        let shift = |x: f64| Homography::translation(x, 0.0);
        let links = [link(0, 1, shift(5.0), 0.5), link(1, 2, shift(5.0), 0.5), link(2, 0, shift(-13.0), 3.0)];
        let places = shortest_paths(4, &links);
        assert!(error(&places[2], &shift(10.0)) < 1e-9);
        assert!((places[2].unwrap().error_px - 0.5f64.sqrt()).abs() < 1e-9);
        assert!(places[3].is_none());
        let places = shortest_paths(3, &[links[0], links[2]]);
        assert!(error(&places[2], &shift(13.0)) < 1e-9, "the reversed link is used");
    }

    #[test]
    fn exact_links_stay_and_a_loop_spreads_its_error() {
        let tilt = Homography::new(Matrix3::new(1.02, 0.01, 4.0, -0.01, 0.99, -3.0, 1e-4, -5e-5, 1.0));
        let truth = [Homography::identity(), tilt, tilt.after(&tilt), tilt.after(&tilt).after(&tilt)];
        let off = Homography::translation(0.8, 0.0);
        let mut links: Vec<Link> = (0..3).map(|i| link(i, i + 1, off.after(&tilt), 0.5)).collect();
        links.push(link(0, 3, truth[3], 0.2));
        let sizes = [SIZE; 4];
        let chained = shortest_paths(4, &links[..3]);
        let mut adjusted = chained.clone();
        adjust(&mut adjusted, &links, &sizes);
        assert!(error(&chained[3], &truth[3]) > 2.0);
        assert!(error(&adjusted[3], &truth[3]) < 0.8, "{}", error(&adjusted[3], &truth[3]));
        assert!(error(&adjusted[2], &truth[2]) < error(&chained[2], &truth[2]));

        let exact: Vec<Link> = (0..3).map(|i| link(i, i + 1, tilt, 0.5)).collect();
        let mut places = shortest_paths(4, &exact);
        adjust(&mut places, &exact, &sizes);
        assert!((1..4).all(|i| error(&places[i], &truth[i]) < 1e-6));
    }

    #[test]
    fn a_wrong_link_is_outvoted() {
        let shift = |x: f64| Homography::translation(x, 0.0);
        let mut links: Vec<Link> = (0..4).map(|i| link(i, i + 1, shift(5.0), 0.3)).collect();
        links.push(link(0, 2, shift(10.0), 0.3));
        links.push(link(1, 3, shift(10.0), 0.3));
        links.push(link(1, 4, shift(55.0), 0.5));
        let mut places = shortest_paths(5, &links);
        adjust(&mut places, &links, &[SIZE; 5]);
        assert!(error(&places[4], &shift(20.0)) < 0.3, "{}", error(&places[4], &shift(20.0)));
        assert!(error(&places[3], &shift(15.0)) < 0.1);
    }

    #[test]
    fn links_that_disagree_by_more_than_they_claim_are_noticed() {
        // Every node is linked to the three before it, each link off by 0.9 px in one of four directions.
        let off = |i: usize| [(0.9, 0.0), (0.0, 0.9), (-0.9, 0.0), (0.0, -0.9)][i % 4];
        let shift = |nodes: usize, (x, y): (f64, f64)| Homography::translation(5.0 * nodes as f64 + x, y);
        let pairs = (1..12).flat_map(|s: usize| (s.saturating_sub(3)..s).map(move |t| (t, s)));
        let measured = |claimed: f64| {
            let all = pairs.clone().enumerate().map(|(i, (t, s))| link(t, s, shift(s - t, off(i * i + t)), claimed));
            let links: Vec<Link> = all.collect();
            let mut places = shortest_paths(12, &links);
            adjust(&mut places, &links, &[SIZE; 12]);
            disagreement(&places, &links, &[SIZE; 12])
        };
        assert_eq!(measured(3.0), 1.0, "no more than claimed");
        let larger = measured(0.3);
        assert!(larger > 1.5 && larger < 6.0, "0.9 px where 0.3 px were claimed: {larger}");
        let exact: Vec<Link> = pairs.clone().map(|(t, s)| link(t, s, shift(s - t, (0.0, 0.0)), 0.3)).collect();
        assert_eq!(disagreement(&shortest_paths(12, &exact), &exact, &[SIZE; 12]), 1.0);
        let tree = [link(0, 1, shift(1, (0.0, 0.0)), 0.3)];
        assert_eq!(disagreement(&shortest_paths(2, &tree), &tree, &[SIZE; 2]), 1.0, "nothing to disagree with");
    }
}
