//! Periodic cellular noise: which feature point is nearest, how far it is, and how far the border to its neighbour.

use super::field::TILE;
use super::noise::{hash, unit};

/// A grid of feature points over the tile, one in each cell.
#[derive(Clone, Debug)]
pub struct Worley {
    cells: [usize; 2],
    /// Reference texels per unit of distance.
    unit_texels: f32,
    /// Distance units per cell along x and y.
    metric: [f32; 2],
    /// Feature points in cell units and their identities, with a border of wrapped cells around the grid.
    points: Vec<([f32; 2], u32)>,
}

/// What a position sees of the feature points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CellSample {
    /// Identity of the nearest point.
    pub id: u32,
    /// Distance to the nearest point, in units of the mean cell edge.
    pub nearest: f32,
    /// Distance to the border with the next cell (the bisector to the second nearest point), same unit.
    pub border: f32,
    /// Offset from the nearest point, same unit, y down.
    pub offset: [f32; 2],
}

impl CellSample {
    /// Distance inwards from the cell's outline with its corners cut off `reach` from the feature point: a pebble's outline
    /// where [`CellSample::border`] is a shard's.
    #[inline]
    pub fn rounded(&self, reach: f32) -> f32 {
        const BLEND: f32 = 0.2;
        let cut = reach - self.nearest;
        let overlap = (BLEND - (self.border - cut).abs()).max(0.0) / BLEND;
        self.border.min(cut) - overlap * overlap * BLEND * 0.25
    }
}

impl Worley {
    /// Cells `cell` reference texels wide, stretched along x and y; distances are measured in the stretched frame.
    ///
    /// `jitter` in [0, 1] moves points away from the cell centres; beyond 0.9 far neighbours start to be missed.
    pub fn new(cell: f32, stretch: [f32; 2], jitter: f32, seed: u32) -> Self {
        let cells = stretch.map(|s| (TILE / (cell * s)).round().max(3.0) as usize);
        let unit_texels = TILE / ((cells[0] * cells[1]) as f32).sqrt();
        Self::place(cells, unit_texels, [1.0; 2], seed, |_, id| [0, 1].map(|k| 0.5 + jitter * (unit(id, k) - 0.5)))
    }

    /// A honeycomb of hexagons about `cell` reference texels wide, stretched a little so that it closes at the tile's edge.
    pub fn honeycomb(cell: f32, seed: u32) -> Self {
        let columns = (TILE / cell).round().max(3.0) as usize;
        let rows = 2 * (columns as f32 / 3f32.sqrt()).round() as usize;
        let unit_texels = TILE / columns as f32;
        let metric = [1.0, columns as f32 / rows as f32];
        Self::place([columns, rows], unit_texels, metric, seed, |row, _| [0.25 + 0.5 * (row % 2) as f32, 0.5])
    }

    fn place(cells: [usize; 2], unit_texels: f32, metric: [f32; 2], seed: u32, at: impl Fn(usize, u32) -> [f32; 2]) -> Self {
        let [columns, rows] = cells;
        let mut points = Vec::with_capacity((columns + 2) * (rows + 2));
        for j in 0..rows + 2 {
            let row = (j + rows - 1) % rows;
            for i in 0..columns + 2 {
                let column = (i + columns - 1) % columns;
                let id = hash(seed, column as u32, row as u32);
                let [x, y] = at(row, id);
                points.push(([i as f32 - 1.0 + x, j as f32 - 1.0 + y], id));
            }
        }
        Self { cells, unit_texels, metric, points }
    }

    /// Reference texels per unit of distance.
    pub fn unit_texels(&self) -> f32 {
        self.unit_texels
    }

    /// What a position (reference texels, wraps around) sees.
    #[inline]
    pub fn at(&self, x: f32, y: f32) -> CellSample {
        let [columns, rows] = self.cells;
        let (x, y) = (x / TILE, y / TILE);
        let (x, y) = ((x - x.floor()) * columns as f32, (y - y.floor()) * rows as f32);
        let (i0, j0) = ((x as usize).min(columns - 1), (y as usize).min(rows - 1));
        let mut best = [(f32::MAX, 0u32, [0.0f32; 2]); 2];
        for row in j0..j0 + 3 {
            for &(p, id) in &self.points[row * (columns + 2) + i0..][..3] {
                let toward = [(p[0] - x) * self.metric[0], (p[1] - y) * self.metric[1]];
                let d = toward[0] * toward[0] + toward[1] * toward[1];
                if d < best[0].0 {
                    best[1] = best[0];
                    best[0] = (d, id, toward);
                } else if d < best[1].0 {
                    best[1] = (d, id, toward);
                }
            }
        }
        let [(d1, id, a), (d2, _, b)] = best;
        let apart = ((b[0] - a[0]).powi(2) + (b[1] - a[1]).powi(2)).sqrt().max(1e-6);
        CellSample { id, nearest: d1.sqrt(), border: (d2 - d1) / (2.0 * apart), offset: [-a[0], -a[1]] }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Nearest and second nearest distance over all points and their wrapped copies.
    fn brute_force(worley: &Worley, x: f32, y: f32) -> [f32; 2] {
        let [columns, rows] = worley.cells.map(|c| c as f32);
        let (x, y) = (x / TILE * columns, y / TILE * rows);
        let mut distances: Vec<f32> = Vec::new();
        let inner = |p: &[f32; 2]| (0.0..columns).contains(&p[0]) && (0.0..rows).contains(&p[1]);
        for (p, _) in worley.points.iter().filter(|(p, _)| inner(p)) {
            for (i, j) in (-1..=1).flat_map(|i| (-1..=1).map(move |j| (i as f32, j as f32))) {
                let dx = (p[0] + i * columns - x) * worley.metric[0];
                let dy = (p[1] + j * rows - y) * worley.metric[1];
                distances.push((dx * dx + dy * dy).sqrt());
            }
        }
        distances.sort_by(f32::total_cmp);
        [distances[0], distances[1]]
    }

    #[test]
    fn the_nearest_point_is_the_nearest_of_all() {
        for worley in
            [Worley::new(100.0, [1.0, 1.0], 0.85, 1), Worley::new(80.0, [2.0, 0.5], 0.8, 2), Worley::honeycomb(90.0, 3)]
        {
            for k in 0..2000 {
                let (x, y) = (unit(k, 0) * TILE, unit(k, 1) * TILE);
                let (sample, truth) = (worley.at(x, y), brute_force(&worley, x, y));
                assert!((sample.nearest - truth[0]).abs() < 1e-4, "{x} {y}: {} against {}", sample.nearest, truth[0]);
                let [dx, dy] = sample.offset;
                assert!(((dx * dx + dy * dy).sqrt() - sample.nearest).abs() < 1e-5);
                assert!(sample.border >= 0.0);
            }
        }
    }

    #[test]
    fn cells_wrap_around() {
        let worley = Worley::new(90.0, [1.0, 1.0], 0.85, 4);
        for k in 0..500 {
            let (x, y) = (unit(k, 0) * TILE, unit(k, 1) * TILE);
            let (here, there) = (worley.at(x, y), worley.at(x - TILE, y + 2.0 * TILE));
            assert!((here.nearest - there.nearest).abs() < 1e-3 && (here.border - there.border).abs() < 1e-2);
        }
    }

    /// In a regular hexagon the border is half a pitch away from the centre, on six sides.
    #[test]
    fn a_honeycomb_has_hexagons() {
        let comb = Worley::honeycomb(1024.0 / 12.0, 5);
        let centre = comb.at(0.25 * comb.unit_texels(), 0.5 * TILE / comb.cells[1] as f32);
        assert!(centre.nearest < 1e-4);
        assert!((centre.border - 0.5).abs() < 0.02, "{}", centre.border);
    }

    #[test]
    fn rounding_only_cuts() {
        let worley = Worley::new(90.0, [1.0, 1.0], 0.85, 6);
        for k in 0..500 {
            let cell = worley.at(unit(k, 0) * TILE, unit(k, 1) * TILE);
            assert!(cell.rounded(0.6) <= cell.border + 1e-6);
            assert!(cell.rounded(0.6) <= 0.6 - cell.nearest + 1e-6);
            assert!((cell.rounded(9.0) - cell.border).abs() < 1e-6);
        }
    }
}
