//! Adaptive refinement and decimation: more cells where the surface is curved or far from the data.
//!
//! Each cell has a weight, its area [m2] times the wanted density of cells, scaled so that all weights add up
//! to the wanted number of cells; a cell of weight 1 is as large as it should be. Density grows with the mean
//! curvature H of the cell, as 1 + |H| / mean |H| within a bound, because the gap between a surface and its
//! triangles is proportional to area times curvature; and with the distance to the data. Heavy cells are cut
//! (T2), light neighbours joined (T1), then edges are swapped towards six sides a cell.
//! The aim is that of H. Delingette 1999 (doi 10.1023/A:1008157432188); the weights are this crate's.

use super::edit::SimplexEdit;
use super::mesh::SimplexMesh;
use crate::math::DVec3;

/// Cells heavier than this are cut, while the number of cells allows it.
const HEAVY: f64 = 1.5;
/// Neighbours whose weights add up to less than this are joined.
const LIGHT_PAIR: f64 = 1.1;
/// Two halves of a joined cell count as this much heavier for each side above six.
const SIDE_PENALTY: f64 = 0.15;
/// A dual triangle may turn by at most this angle in one edit: its cosine.
const LEAST_NORMAL_COSINE: f64 = 0.5;
/// Rounds of joining, cutting and swapping; each halves the excess at least.
const MOST_ROUNDS: usize = 40;
/// Sweeps over all edges that swap.
const SWAP_SWEEPS: usize = 3;

/// How a mesh is adapted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AdaptParams {
    /// Cells wanted. Half the number of triangles of the dual, plus 2.
    pub target_cells: usize,
    /// Largest ratio of the densities of cells in curved and flat places, at least 1.
    pub contrast: f64,
    /// A cell this far from the data counts as twice as large [m].
    pub tolerance_m: f64,
}

/// What adaptation did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct AdaptReport {
    /// Cells cut in two.
    pub n_split: usize,
    /// Pairs of cells joined.
    pub n_merged: usize,
    /// Edges turned across.
    pub n_swapped: usize,
}

/// `mesh` with about `params.target_cells` cells, dense where the curvatures [1/m] and the distances to the
/// data [m], one a vertex, are large. The cells of `kept` vertices stay as they are. The number is missed only
/// where no more cells can be joined or cut.
///
/// # Panics
/// If there are not as many curvatures and distances as vertices.
pub fn adapt(
    mesh: SimplexMesh,
    curvatures_per_m: &[f64],
    offsets_m: &[f64],
    kept: &[u32],
    params: &AdaptParams,
) -> (SimplexMesh, AdaptReport) {
    assert_eq!([curvatures_per_m.len(), offsets_m.len()], [mesh.n_vertices(); 2], "one value a vertex");
    let mut frozen = vec![false; mesh.n_cells()];
    for &v in kept {
        mesh.cells()[v as usize].iter().for_each(|&c| frozen[c as usize] = true);
    }
    let mut work = Adaptation {
        weights: cell_weights(&mesh, curvatures_per_m, offsets_m, params),
        frozen,
        edit: SimplexEdit::new(mesh),
        report: AdaptReport::default(),
    };
    let target = params.target_cells.max(4);
    for _ in 0..MOST_ROUNDS {
        let merged = work.merge(LIGHT_PAIR, usize::MAX);
        let split = work.split(HEAVY, usize::MAX);
        work.swap();
        if merged + split == 0 {
            break;
        }
    }
    for _ in 0..MOST_ROUNDS {
        let n = work.edit.n_cells();
        let done =
            if n > target { work.merge(f64::INFINITY, n - target) } else { work.split(0.0, target - n) };
        work.swap();
        if done == 0 {
            break;
        }
    }
    (work.edit.finish(), work.report)
}

/// The weight of each cell; together `params.target_cells`.
fn cell_weights(
    mesh: &SimplexMesh,
    curvatures_per_m: &[f64],
    offsets_m: &[f64],
    params: &AdaptParams,
) -> Vec<f64> {
    let magnitudes: Vec<f64> = curvatures_per_m.iter().map(|h| h.abs()).collect();
    let squares: Vec<f64> = offsets_m.iter().map(|o| (o / params.tolerance_m).powi(2)).collect();
    let (curvatures, excess) = (mesh.cell_means(&magnitudes), mesh.cell_means(&squares));
    let areas_m2 = mesh.cell_areas_m2();
    let area_m2: f64 = areas_m2.iter().sum();
    let mean = areas_m2.iter().zip(&curvatures).map(|(a, h)| a * h).sum::<f64>() / area_m2;
    let most = params.contrast.max(1.0);
    let density = |h: f64| if mean > 0.0 { (1.0 + h / mean).min(most) } else { 1.0 };
    let raw: Vec<f64> = (0..areas_m2.len())
        .map(|c| areas_m2[c] * density(curvatures[c]) * (1.0 + excess[c].min(3.0)))
        .collect();
    let scale = params.target_cells as f64 / raw.iter().sum::<f64>();
    raw.into_iter().map(|w| scale * w).collect()
}

struct Adaptation {
    edit: SimplexEdit,
    /// Of each cell, removed ones included.
    weights: Vec<f64>,
    /// Cells that stay, of those of the start.
    frozen: Vec<bool>,
    report: AdaptReport,
}

impl Adaptation {
    fn is_frozen(&self, cell: u32) -> bool {
        self.frozen.get(cell as usize).is_some_and(|&f| f)
    }

    /// Joins up to `most` pairs of cells that together weigh less than `limit`, the lightest first, no cell
    /// twice. Answers how many.
    fn merge(&mut self, limit: f64, most: usize) -> usize {
        let mesh = self.edit.mesh();
        let sides = side_counts(mesh);
        let mut waiting: Vec<(f64, u32, usize)> = Vec::new();
        for v in 0..mesh.n_vertices() as u32 {
            for side in 0..3 {
                if !self.edit.has_vertex(v) || mesh.neighbours[v as usize][side] < v {
                    continue;
                }
                let [a, b] = [1, 2].map(|step| mesh.cells[v as usize][(side + step) % 3] as usize);
                let beyond_six = (sides[a] + sides[b]).saturating_sub(10) as f64;
                let weight = (self.weights[a] + self.weights[b]) * (1.0 + SIDE_PENALTY * beyond_six);
                if weight < limit {
                    waiting.push((weight, v, side));
                }
            }
        }
        waiting.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
        let mut touched = vec![false; self.weights.len()];
        let mut done = 0;
        for (_, v, side) in waiting {
            if done == most {
                break;
            }
            if !self.edit.has_vertex(v) {
                continue;
            }
            let cells = self.edit.mesh().cells[v as usize];
            let [a, b] = [1, 2].map(|step| cells[(side + step) % 3]);
            if self.is_frozen(a) || self.is_frozen(b) {
                continue;
            }
            if touched[a as usize] || touched[b as usize] || !self.edit.can_remove_edge(v, side) {
                continue;
            }
            if !self.keeps_normals(v, side, a, b) {
                continue;
            }
            if let Some(merged) = self.edit.remove_edge(v, side) {
                self.weights[merged.kept as usize] += self.weights[merged.removed as usize];
                touched[merged.kept as usize] = true;
                // The cells at the ends lost a side each.
                for c in self.edit.cells_around(merged.kept) {
                    touched[c as usize] = true;
                }
                done += 1;
            }
        }
        self.report.n_merged += done;
        done
    }

    /// Whether the dual's triangles around cells `a` and `b` keep their side when both become one.
    fn keeps_normals(&self, vertex: u32, side: usize, a: u32, b: u32) -> bool {
        let mesh = self.edit.mesh();
        let other = mesh.neighbours[vertex as usize][side];
        let [contour_a, contour_b] = [a, b].map(|c| mesh.contour(c));
        let gone = |v: &u32| *v == vertex || *v == other;
        let ring: Vec<u32> = contour_a.iter().chain(&contour_b).copied().filter(|v| !gone(v)).collect();
        let centre = ring.iter().map(|&v| mesh.positions_m[v as usize]).sum::<DVec3>() / ring.len() as f64;
        ring.iter().all(|&v| {
            let cells = mesh.cells[v as usize];
            let old = cells.map(|c| centre_m(mesh, c));
            let new: Vec<DVec3> =
                (0..3).map(|k| if cells[k] == a || cells[k] == b { centre } else { old[k] }).collect();
            let normal = |p: &[DVec3]| (p[1] - p[0]).cross(p[2] - p[0]).normalize_or_zero();
            normal(&old).dot(normal(&new)) > LEAST_NORMAL_COSINE
        })
    }

    /// Cuts up to `most` cells heavier than `limit`, the heaviest first. Answers how many.
    fn split(&mut self, limit: f64, most: usize) -> usize {
        let mut waiting: Vec<u32> = (0..self.weights.len() as u32)
            .filter(|&c| self.edit.has_cell(c) && !self.is_frozen(c) && self.weights[c as usize] > limit)
            .collect();
        let weights = &self.weights;
        waiting.sort_by(|&a, &b| weights[b as usize].total_cmp(&weights[a as usize]));
        waiting.truncate(most);
        let mut done = 0;
        for cell in waiting {
            let (from, to) = shortest_halving(&self.edit, cell);
            if self.edit.split_cell(cell, from, to).is_some() {
                let half = 0.5 * self.weights[cell as usize];
                self.weights[cell as usize] = half;
                self.weights.push(half);
                done += 1;
            }
        }
        self.report.n_split += done;
        done
    }

    /// Swaps edges while that brings cells nearer to six sides.
    fn swap(&mut self) {
        let mut sides = side_counts(self.edit.mesh());
        let mut total = 0;
        for _ in 0..SWAP_SWEEPS {
            let mut done = 0;
            for v in 0..self.edit.mesh().n_vertices() as u32 {
                done += (0..3).filter(|&side| self.try_swap(v, side, &mut sides)).count();
            }
            total += done;
            if done == 0 {
                break;
            }
        }
        self.report.n_swapped += total;
    }

    /// Swaps an edge, seen from its lower vertex, if that brings `sides` nearer to six. Says whether it was done.
    fn try_swap(&mut self, v: u32, side: usize, sides: &mut [usize]) -> bool {
        let mesh = self.edit.mesh();
        if !self.edit.has_vertex(v) || mesh.neighbours[v as usize][side] < v {
            return false;
        }
        let (x, a, b, y) = self.edit.cells_at(v, side, mesh.neighbours[v as usize][side]);
        let (losing, gaining) = ([a, b], [x, y]);
        let off = |c: u32, change: i64| (sides[c as usize] as i64 - 6 + change).pow(2);
        let gain =
            |change: i64, cells: [u32; 2]| cells.iter().map(|&c| off(c, 0) - off(c, change)).sum::<i64>();
        let swapped = !losing.iter().chain(&gaining).any(|&c| self.is_frozen(c))
            && gain(-1, losing) + gain(1, gaining) > 0
            && swap_keeps_normals(mesh, losing, gaining)
            && self.edit.swap_edge(v, side);
        if swapped {
            losing.iter().for_each(|&c| sides[c as usize] -= 1);
            gaining.iter().for_each(|&c| sides[c as usize] += 1);
        }
        swapped
    }
}

/// Whether the two dual triangles of an edge face the same way before and after it is swapped.
fn swap_keeps_normals(mesh: &SimplexMesh, [a, b]: [u32; 2], [x, y]: [u32; 2]) -> bool {
    let [a, b, x, y] = [a, b, x, y].map(|c| centre_m(mesh, c));
    let normal = |p: DVec3, q: DVec3, r: DVec3| (q - p).cross(r - p).normalize_or_zero();
    let old = [normal(x, a, b), normal(y, b, a)];
    let new = [normal(x, a, y), normal(x, y, b)];
    old[0].dot(old[1]) > LEAST_NORMAL_COSINE
        && new[0].dot(new[1]) > LEAST_NORMAL_COSINE
        && new.iter().all(|n| old.iter().all(|o| n.dot(*o) > LEAST_NORMAL_COSINE))
}

/// The two edges of a cell's contour between which a cut is short and leaves halves of as many sides.
fn shortest_halving(edit: &SimplexEdit, cell: u32) -> (usize, usize) {
    let mesh = edit.mesh();
    let contour = mesh.contour(cell);
    let n = contour.len();
    let at_m = |i: usize| mesh.positions_m[contour[i % n] as usize];
    let middle_m = |i: usize| 0.5 * (at_m(i) + at_m(i + 1));
    let mut best = (f64::INFINITY, (0, n / 2));
    for from in 0..n {
        for to in [from + n / 2, from + n.div_ceil(2)] {
            let length_m = middle_m(from).distance(middle_m(to));
            if length_m < best.0 && to % n != from {
                best = (length_m, (from, to % n));
            }
        }
    }
    best.1
}

fn centre_m(mesh: &SimplexMesh, cell: u32) -> DVec3 {
    let contour = mesh.contour(cell);
    contour.iter().map(|&v| mesh.positions_m[v as usize]).sum::<DVec3>() / contour.len() as f64
}

/// Sides of each cell; 0 for removed ones.
fn side_counts(mesh: &SimplexMesh) -> Vec<usize> {
    let mut sides = vec![0; mesh.first_of_cell.len()];
    for &c in mesh.cells.iter().flatten() {
        if let Some(n) = sides.get_mut(c as usize) {
            *n += 1;
        }
    }
    sides
}
