//! Which real materials lie within what is generated.

use crate::statistics::{Statistics, is_axis};

/// Materials are compared with the generated ones between these percentiles.
const RANGE: [f32; 2] = [1.0, 99.0];
/// A material is far when its nearest neighbour is further away than this percentile of the generated ones' neighbours of
/// another family.
const FAR: f32 = 95.0;

/// A generated neighbour.
pub struct Neighbour {
    /// Its position in the list.
    pub index: usize,
    /// Distance in units of the generated materials' standard deviation, over all axes.
    pub distance: f32,
}

/// How the real materials lie to the generated ones.
pub struct Coverage {
    /// Per value: the range of the generated materials.
    pub ranges: Vec<[f32; 2]>,
    /// Per real material: the values that leave their range.
    pub outside: Vec<Vec<usize>>,
    /// Per real material: the nearest generated one.
    pub nearest: Vec<Neighbour>,
    /// Per real material: the value in which it differs most from that one.
    pub farthest_value: Vec<usize>,
    /// Median distance of generated materials to the nearest other one.
    pub among_generated: f32,
    /// The same to the nearest of another family: how far a kind of material is from all other kinds.
    pub among_families: f32,
    /// Real materials further away than this are called far.
    pub far: f32,
}

impl Coverage {
    /// Compares.
    pub fn new(real: &[Statistics], generated: &[Statistics]) -> Self {
        let values: Vec<Vec<f32>> = generated.iter().map(Statistics::values).collect();
        let column = |v: usize| values.iter().map(|row| row[v]).collect::<Vec<_>>();
        let columns: Vec<Vec<f32>> = (0..values[0].len()).map(column).collect();
        let ranges: Vec<[f32; 2]> = columns.iter().map(|c| RANGE.map(|p| percentile(c, p))).collect();
        let scales: Vec<f32> = columns.iter().map(|c| deviation(c).max(1e-6)).collect();
        let space = Space { values: &values, scales: &scales };
        let near = |row: &[f32], allowed: &dyn Fn(usize) -> bool| space.nearest(row, allowed).distance;
        let others: Vec<f32> = (0..values.len()).map(|i| near(&values[i], &|j| j != i)).collect();
        let strangers: Vec<f32> =
            (0..values.len()).map(|i| near(&values[i], &|j| generated[j].source != generated[i].source)).collect();
        let rows: Vec<Vec<f32>> = real.iter().map(Statistics::values).collect();
        let nearest: Vec<Neighbour> = rows.iter().map(|row| space.nearest(row, &|_| true)).collect();
        let leaves = |row: &Vec<f32>| (0..row.len()).filter(|&v| row[v] < ranges[v][0] || row[v] > ranges[v][1]).collect();
        let most = |(row, neighbour): (&Vec<f32>, &Neighbour)| {
            let gap = |v: usize| space.gap(row, neighbour.index, v);
            (0..row.len()).filter(|&v| is_axis(v)).max_by(|&a, &b| gap(a).total_cmp(&gap(b))).unwrap_or(0)
        };
        Self {
            outside: rows.iter().map(leaves).collect(),
            farthest_value: rows.iter().zip(&nearest).map(most).collect(),
            nearest,
            among_generated: percentile(&others, 50.0),
            among_families: percentile(&strangers, 50.0),
            far: percentile(&strangers, FAR),
            ranges,
        }
    }

    /// Whether a real material is further from all generated ones than families are from each other.
    pub fn is_far(&self, material: usize) -> bool {
        self.nearest[material].distance > self.far
    }
}

/// Generated materials as points.
struct Space<'a> {
    values: &'a [Vec<f32>],
    scales: &'a [f32],
}

impl Space<'_> {
    fn gap(&self, row: &[f32], index: usize, value: usize) -> f32 {
        ((row[value] - self.values[index][value]) / self.scales[value]).abs()
    }

    fn nearest(&self, row: &[f32], allowed: &dyn Fn(usize) -> bool) -> Neighbour {
        let distance =
            |index: usize| (0..row.len()).filter(|&v| is_axis(v)).map(|v| self.gap(row, index, v).powi(2)).sum::<f32>().sqrt();
        let candidates = (0..self.values.len()).filter(|i| allowed(*i));
        let neighbours = candidates.map(|index| Neighbour { index, distance: distance(index) });
        let none = Neighbour { index: 0, distance: f32::INFINITY };
        neighbours.fold(none, |best, n| if n.distance < best.distance { n } else { best })
    }
}

/// The value that `percent` of the values lie below, between two of them where need be.
pub fn percentile(values: &[f32], percent: f32) -> f32 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f32::total_cmp);
    let place = percent / 100.0 * (sorted.len() - 1) as f32;
    let (low, high) = (place.floor() as usize, place.ceil() as usize);
    sorted[low] + (sorted[high] - sorted[low]) * place.fract()
}

fn deviation(values: &[f32]) -> f32 {
    let count = values.len() as f32;
    let mean = values.iter().sum::<f32>() / count;
    (values.iter().map(|v| (v - mean).powi(2)).sum::<f32>() / count).sqrt()
}
