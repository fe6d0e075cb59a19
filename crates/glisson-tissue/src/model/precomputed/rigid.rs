//! Which parts of a cut body still bear a load: rigid clusters and what holds them.
//!
//! Linear tetrahedra connected by faces have no motion without strain except the six rigid ones: they form a cluster. A
//! cluster is held when three of its points that do not lie on a line are fixed or belong to held clusters; this is
//! iterated. The remaining clusters may still be held jointly, as in a closed ring of hinged clusters. So the rigid
//! motions of all of them that agree in their common points and vanish in held points are computed, and a cluster that
//! takes part in none is held. This is exact up to rounding: K of the held clusters is not singular.

use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::topology::Topology;
use glisson_mesh::mesh::{NodeId, TetId};

const NONE: u32 = u32::MAX;

/// Points count as collinear when the height of their triangle is below this share of its base: a choice. The stiffness
/// against rotation falls with the square of this ratio.
const LEAST_HEIGHT: f64 = 1e-3;

/// Largest number of clusters among which jointly held ones are looked for (a dense elimination of six times as many
/// unknowns). With more, clusters that are not held one by one count as loose.
const MOST_JOINT: usize = 40;

/// A combination of rigid motions below this share of its largest part counts as zero.
const LEAST_ROW: f64 = 1e-9;

/// Clusters of the tetrahedra that count.
pub(super) struct Clusters {
    /// Cluster of each tetrahedron.
    of_tet: Vec<u32>,
    pub(super) count: usize,
}

impl Clusters {
    /// Groups of counting tetrahedra connected by faces, numbered by their first tetrahedron.
    pub(super) fn of(topology: &Topology, counts: &[bool]) -> Self {
        let mut of_tet = vec![NONE; counts.len()];
        let mut count = 0;
        let mut stack = Vec::new();
        for start in (0..counts.len()).filter(|&t| counts[t]) {
            if of_tet[start] != NONE {
                continue;
            }
            of_tet[start] = count;
            stack.push(TetId::from_index(start));
            while let Some(tet) = stack.pop() {
                for next in topology.tet_neighbours(tet).into_iter().filter_map(|n| n.get()) {
                    if counts[next.index()] && of_tet[next.index()] == NONE {
                        of_tet[next.index()] = count;
                        stack.push(next);
                    }
                }
            }
            count += 1;
        }
        Self { of_tet, count: count as usize }
    }

    pub(super) fn of_tet(&self, tet: usize) -> Option<usize> {
        (self.of_tet[tet] != NONE).then_some(self.of_tet[tet] as usize)
    }

    /// Nodes of each cluster, ascending.
    pub(super) fn nodes(&self, topology: &Topology) -> Vec<Vec<NodeId>> {
        let mut nodes = vec![Vec::new(); self.count];
        for t in 0..self.of_tet.len() {
            if let Some(cluster) = self.of_tet(t) {
                nodes[cluster].extend(topology.tet_nodes(TetId::from_index(t)));
            }
        }
        for list in &mut nodes {
            list.sort_unstable();
            list.dedup();
        }
        nodes
    }
}

/// Three of `points` that span the largest triangle over the line between the first and its farthest, unless all lie
/// on a line.
pub(super) fn span(points: &[NodeId], rest_m: &[DVec3]) -> Option<[NodeId; 3]> {
    let at = |n: NodeId| rest_m[n.index()];
    let &first = points.first()?;
    let far = |n: &&NodeId| at(**n).distance_squared(at(first));
    let &second = points.iter().max_by(|a, b| far(a).total_cmp(&far(b)))?;
    let base = at(second) - at(first);
    let area = |n: &&NodeId| base.cross(at(**n) - at(first)).length();
    let &third = points.iter().max_by(|a, b| area(a).total_cmp(&area(b)))?;
    (area(&&third) > LEAST_HEIGHT * base.length_squared()).then_some([first, second, third])
}

/// The counting tetrahedra whose clusters are not held, ascending.
pub(super) fn fragment_tets(
    topology: &Topology,
    rest_m: &[DVec3],
    counts: &[bool],
    is_fixed: &[bool],
) -> Vec<TetId> {
    let clusters = Clusters::of(topology, counts);
    let nodes = clusters.nodes(topology);
    let mut is_held = vec![false; clusters.count];
    let mut is_support = is_fixed.to_vec();
    loop {
        let mut changed = false;
        for (cluster, nodes) in nodes.iter().enumerate().filter(|(_, nodes)| !nodes.is_empty()) {
            if is_held[cluster] {
                continue;
            }
            let points: Vec<NodeId> = nodes.iter().copied().filter(|n| is_support[n.index()]).collect();
            if span(&points, rest_m).is_some() {
                is_held[cluster] = true;
                changed = true;
                for node in nodes {
                    is_support[node.index()] = true;
                }
            }
        }
        if !changed {
            break;
        }
    }
    let open: Vec<usize> = (0..clusters.count).filter(|&c| !is_held[c]).collect();
    if open.len() > 1 && open.len() <= MOST_JOINT {
        let lists: Vec<&[NodeId]> = open.iter().map(|&c| &nodes[c][..]).collect();
        for (place, is_rigid) in jointly_held(&lists, rest_m, &is_support).into_iter().enumerate() {
            is_held[open[place]] |= is_rigid;
        }
    }
    (0..counts.len())
        .filter(|&t| clusters.of_tet(t).is_some_and(|c| !is_held[c]))
        .map(TetId::from_index)
        .collect()
}

/// Which of these clusters take part in no common rigid motion that vanishes in the supports.
fn jointly_held(clusters: &[&[NodeId]], rest_m: &[DVec3], is_support: &[bool]) -> Vec<bool> {
    let mut at_node: Vec<(NodeId, usize)> =
        clusters.iter().enumerate().flat_map(|(c, nodes)| nodes.iter().map(move |&n| (n, c))).collect();
    at_node.sort_unstable();
    let n_points = at_node.len().max(1) as f64;
    let centre_m = at_node.iter().map(|(n, _)| rest_m[n.index()]).sum::<DVec3>() / n_points;
    let size_m = at_node
        .iter()
        .map(|(n, _)| rest_m[n.index()].distance(centre_m))
        .fold(0.0, f64::max)
        .max(f64::MIN_POSITIVE);
    let n = 6 * clusters.len();
    let mut elimination = Elimination { n, rows: Vec::new(), pivots: Vec::new() };
    for group in at_node.chunk_by(|a, b| a.0 == b.0) {
        let node = group[0].0;
        let r = (rest_m[node.index()] - centre_m) / size_m;
        // Motion t + w x r of a cluster's point along `axis`.
        let motion = |row: &mut [f64], cluster: usize, axis: usize, sign: f64| {
            row[6 * cluster + axis] += sign;
            for k in 0..3 {
                row[6 * cluster + 3 + k] += sign * DVec3::AXES[k].cross(r)[axis];
            }
        };
        for (i, &(_, cluster)) in group.iter().enumerate() {
            if i == 0 && !is_support[node.index()] {
                continue;
            }
            for axis in 0..3 {
                let mut row = vec![0.0; n];
                motion(&mut row, cluster, axis, 1.0);
                if !is_support[node.index()] {
                    motion(&mut row, group[0].1, axis, -1.0);
                }
                elimination.add(row);
            }
        }
    }
    elimination.zero_groups(clusters.len())
}

/// Reduced row echelon form, row by row.
struct Elimination {
    n: usize,
    rows: Vec<Vec<f64>>,
    pivots: Vec<usize>,
}

impl Elimination {
    fn add(&mut self, mut row: Vec<f64>) {
        let before = row.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
        for (pivot_row, &pivot) in self.rows.iter().zip(&self.pivots) {
            let factor = row[pivot];
            if factor != 0.0 {
                row.iter_mut().zip(pivot_row).for_each(|(x, p)| *x -= factor * p);
            }
        }
        let Some(pivot) = (0..self.n).max_by(|&i, &j| row[i].abs().total_cmp(&row[j].abs())) else { return };
        if row[pivot].abs() <= LEAST_ROW * before {
            return;
        }
        let inverse = 1.0 / row[pivot];
        row.iter_mut().for_each(|x| *x *= inverse);
        for other in &mut self.rows {
            let factor = other[pivot];
            if factor != 0.0 {
                other.iter_mut().zip(&row).for_each(|(x, p)| *x -= factor * p);
            }
        }
        self.rows.push(row);
        self.pivots.push(pivot);
    }

    /// For each group of six unknowns: whether all of them are zero in every solution.
    fn zero_groups(&self, n_groups: usize) -> Vec<bool> {
        let mut is_zero = vec![false; self.n];
        for (row, &pivot) in self.rows.iter().zip(&self.pivots) {
            is_zero[pivot] = (0..self.n).all(|i| i == pivot || row[i].abs() <= LEAST_ROW);
        }
        (0..n_groups).map(|g| (6 * g..6 * g + 6).all(|i| is_zero[i])).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glisson_mesh::mesh::TetMesh;

    /// Two tetrahedra that share node 0 in the origin; two nodes of each are fixed. The second one's fixed edge runs
    /// along `edge`.
    fn n_loose(edge: DVec3) -> usize {
        let mut positions_m = vec![DVec3::ZERO];
        positions_m.extend([DVec3::new(-1.0, -1.0, -1.0), DVec3::new(-1.0, 1.0, -1.0)]);
        positions_m.push(DVec3::new(-1.0, 0.0, 1.0));
        let middle = DVec3::new(1.0, 0.0, -1.0);
        positions_m.extend([middle - edge, middle + edge, DVec3::new(1.0, 0.3, 1.0)]);
        let mut mesh = TetMesh {
            positions_m,
            tetrahedra: vec![[0, 1, 2, 3], [0, 4, 5, 6]].into_iter().map(|t| t.map(NodeId)).collect(),
            ..TetMesh::default()
        };
        for t in 0..2 {
            if mesh.tet_volume_m3(TetId(t)) < 0.0 {
                mesh.tetrahedra[t as usize].swap(1, 2);
            }
        }
        let topology = Topology::build(&mesh).unwrap();
        let is_fixed = [false, true, true, false, true, true, false];
        fragment_tets(&topology, &mesh.positions_m, &[true; 2], &is_fixed).len()
    }

    #[test]
    fn clusters_that_hold_each_other_are_held() {
        // Each alone turns about its fixed edge. Their common node can go one way only if both edges let it.
        assert_eq!(n_loose(DVec3::new(0.3, 1.0, 0.2)), 0);
        // Both turn about parallel edges through the plane of the common node: it could go up or down only.
        let mut positions_m = vec![DVec3::ZERO];
        positions_m.extend([-1.0, 1.0].map(|y| DVec3::new(-1.0, y, 0.0)));
        positions_m.push(DVec3::new(-0.5, 0.0, 1.0));
        positions_m.extend([1.0, -1.0].map(|y| DVec3::new(1.0, y, 0.0)));
        positions_m.push(DVec3::new(0.5, 0.0, 1.0));
        let mut mesh = TetMesh {
            positions_m,
            tetrahedra: vec![[0, 1, 2, 3].map(NodeId), [0, 4, 5, 6].map(NodeId)],
            ..TetMesh::default()
        };
        for t in 0..2 {
            if mesh.tet_volume_m3(TetId(t)) < 0.0 {
                mesh.tetrahedra[t as usize].swap(1, 2);
            }
        }
        let topology = Topology::build(&mesh).unwrap();
        let is_fixed = [false, true, true, false, true, true, false];
        assert_eq!(fragment_tets(&topology, &mesh.positions_m, &[true; 2], &is_fixed).len(), 2);
    }
}
