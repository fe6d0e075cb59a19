//! The compliance of a body from which tetrahedra were removed, as a history of low-rank updates.
//!
//! Removing a tetrahedron takes U U^T from K, where U has 12 rows that are not zero and 6 columns: U = sqrt(V) B^T R
//! with the strain-displacement matrix B and R R^T = the elasticity matrix. With S = I - U^T C U (the capacitance
//! matrix) and its factor S = G G^T, the formula of Sherman, Morrison and Woodbury reads C' = C + w w^T with
//! w = C q, q = U G^-T (Hager 1989, Updating the inverse of a matrix, doi 10.1137/1031049). S has no unit: its least
//! eigenvalue is the share of a tetrahedron's stiffness that the rest of the body bears, and zero where the removal
//! sets a mechanism free.
//!
//! Holding unknowns E for good is the same with S = E^T C E, q = E G^-T and a minus sign.
//!
//! q is nonzero only on the unknowns of few nodes, which then all have a column of the compliance. So the columns w are
//! stored only over the nodes that ever had one ("known" nodes). The column c of another node starts from the factor of
//! the uncut body; for each change in turn, a = q^T c, then c += w a. a is that node's part of w.

use crate::solve::P1Gradients;
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::NodeId;

/// Marks a node that is not known.
const NONE: u32 = u32::MAX;

/// Columns whose pivot in a capacitance is below this are left out: without that share of a tetrahedron's stiffness a mechanism
/// would be free, or nearly, and a few such in a row would lead out of the numbers' range. The error's estimate shows it.
const LEAST_PIVOT: f64 = 1e-9;

/// Three columns over the known unknowns: the responses to unit forces on a node.
pub(super) type NodeColumns = [Vec<f64>; 3];

/// Displacement of one node along each axis (first index) for unit gravity along each axis (second).
pub(super) type NodeWeight = [[f64; 3]; 3];

/// A change C' = C + sign w w^T, w = C q.
#[derive(Clone, Debug)]
pub(super) struct Change {
    sign: f64,
    /// 3 place + axis of the rows of q.
    unknowns: Vec<u32>,
    /// One row of `unknowns.len()` numbers a column of w.
    q: Vec<f64>,
    /// Columns over the known unknowns.
    w: Vec<Vec<f64>>,
    /// q^T times the response to weight from before the change.
    of_weight: Vec<[f64; 3]>,
}

impl Change {
    pub(super) fn sign(&self) -> f64 {
        self.sign
    }

    pub(super) fn columns(&self) -> &[Vec<f64>] {
        &self.w
    }

    pub(super) fn of_weight(&self) -> &[[f64; 3]] {
        &self.of_weight
    }
}

#[derive(Clone, Debug)]
enum Event {
    Change(Change),
    /// Removed masses [kg] at known nodes.
    Lighter(Vec<(u32, f64)>),
}

/// All changes so far.
#[derive(Clone, Debug)]
pub(super) struct History {
    known: Vec<NodeId>,
    place_of: Vec<u32>,
    events: Vec<Event>,
    n_columns: usize,
}

impl History {
    /// A history without changes; `known` are the nodes whose columns are in the table.
    pub(super) fn new(known: Vec<NodeId>, n_nodes: usize) -> Self {
        let mut place_of = vec![NONE; n_nodes];
        for (place, node) in known.iter().enumerate() {
            place_of[node.index()] = place as u32;
        }
        Self { known, place_of, events: Vec::new(), n_columns: 0 }
    }

    pub(super) fn known(&self) -> &[NodeId] {
        &self.known
    }

    pub(super) fn n_unknowns(&self) -> usize {
        3 * self.known.len()
    }

    /// Columns of all changes together.
    pub(super) fn n_columns(&self) -> usize {
        self.n_columns
    }

    pub(super) fn place(&self, node: NodeId) -> Option<usize> {
        let place = self.place_of[node.index()];
        (place != NONE).then_some(place as usize)
    }

    /// Makes a node known; returns whether it was not.
    pub(super) fn admit(&mut self, node: NodeId) -> bool {
        let is_new = self.place(node).is_none();
        if is_new {
            self.place_of[node.index()] = self.known.len() as u32;
            self.known.push(node);
        }
        is_new
    }

    /// Applies all changes to a node's columns and response to weight of the uncut body. `is_new`: the node just became
    /// known and is the last one.
    pub(super) fn bring_up_to_date(
        &mut self,
        columns: &mut NodeColumns,
        weight: &mut NodeWeight,
        is_new: bool,
    ) {
        for event in &mut self.events {
            match event {
                Event::Change(change) => {
                    let n = change.unknowns.len();
                    // Every column of a change refers to the compliance before this change.
                    let part = |i: usize| -> [f64; 3] {
                        let q = &change.q[n * i..n * (i + 1)];
                        std::array::from_fn(|d| {
                            q.iter().zip(&change.unknowns).map(|(q, &k)| q * columns[d][k as usize]).sum()
                        })
                    };
                    let parts: Vec<[f64; 3]> = (0..change.w.len()).map(part).collect();
                    if is_new {
                        change.w.iter_mut().zip(&parts).for_each(|(w, a)| w.extend(a));
                    }
                    for ((w, a), of_weight) in change.w.iter().zip(&parts).zip(&change.of_weight) {
                        for d in 0..3 {
                            let factor = change.sign * a[d];
                            columns[d].iter_mut().zip(w).for_each(|(c, w)| *c += factor * w);
                            for axis in 0..3 {
                                weight[d][axis] += factor * of_weight[axis];
                            }
                        }
                    }
                }
                Event::Lighter(masses) => {
                    for &(place, mass_kg) in masses.iter() {
                        for d in 0..3 {
                            for axis in 0..3 {
                                weight[d][axis] -= mass_kg * columns[d][3 * place as usize + axis];
                            }
                        }
                    }
                }
            }
        }
    }

    pub(super) fn push(&mut self, change: Change) {
        self.n_columns += change.w.len();
        self.events.push(Event::Change(change));
    }

    /// Removed masses [kg] at known nodes.
    pub(super) fn push_lighter(&mut self, masses: Vec<(u32, f64)>) {
        self.events.push(Event::Lighter(masses));
    }
}

/// A node whose columns are changed in one edit.
pub(super) struct WorkingNode {
    pub(super) node: NodeId,
    pub(super) place: usize,
    pub(super) columns: NodeColumns,
    pub(super) weight: NodeWeight,
}

/// Columns of the nodes that an edit touches.
pub(super) struct Working {
    /// Ascending by node.
    pub(super) nodes: Vec<WorkingNode>,
}

impl Working {
    /// Place of a node, if it is touched.
    pub(super) fn find(&self, node: NodeId) -> Option<usize> {
        self.nodes.binary_search_by_key(&node, |n| n.node).ok()
    }

    /// Holds these touched nodes for good; their rows become exactly zero, and they leave the touched ones.
    ///
    /// # Panics
    /// When one of them is not touched.
    pub(super) fn hold(&mut self, nodes: &[NodeId]) -> Change {
        let places: Vec<usize> =
            nodes.iter().map(|&n| self.find(n).expect("what is held is touched")).collect();
        let unknowns: Vec<(usize, usize)> =
            places.iter().flat_map(|&at| [0, 1, 2].map(|axis| (at, axis))).collect();
        let n = unknowns.len();
        let mut u = vec![0.0; n * n];
        for i in 0..n {
            u[n * i + i] = 1.0;
        }
        let mut s = self.compliance_between(&unknowns);
        let (change, _) = self.change(-1.0, &unknowns, &u, n, &mut s);
        let held: Vec<usize> = places.iter().map(|&at| self.nodes[at].place).collect();
        for node in &mut self.nodes {
            for column in &mut node.columns {
                for &place in &held {
                    column[3 * place..3 * place + 3].fill(0.0);
                }
            }
        }
        self.nodes.retain(|n| !nodes.contains(&n.node));
        change
    }

    /// Removes tetrahedra; returns the smallest pivot of the capacitance (1 for a removal without effect, 0 for a mechanism).
    /// Corners that are not touched do not move; without any touched corner nothing changes.
    pub(super) fn remove(&mut self, tets: &[RemovedTet]) -> Option<(Change, f64)> {
        let mut touched: Vec<usize> =
            tets.iter().flat_map(|t| t.nodes).filter_map(|node| self.find(node)).collect();
        touched.sort_unstable();
        touched.dedup();
        if touched.is_empty() {
            return None;
        }
        let unknowns: Vec<(usize, usize)> =
            touched.iter().flat_map(|&at| [0, 1, 2].map(|axis| (at, axis))).collect();
        let rank = 6 * tets.len();
        let mut u = vec![0.0; unknowns.len() * rank];
        for (t, tet) in tets.iter().enumerate() {
            for (corner, &node) in tet.nodes.iter().enumerate() {
                let Some(at) = self.find(node) else { continue };
                let row = touched.binary_search(&at).expect("its corners were listed");
                for axis in 0..3 {
                    let first = (3 * row + axis) * rank + 6 * t;
                    u[first..first + 6].copy_from_slice(&tet.u[3 * corner + axis]);
                }
            }
        }
        let between = self.compliance_between(&unknowns);
        let n = unknowns.len();
        let mut cu = vec![0.0; n * rank];
        for i in 0..n {
            for k in 0..n {
                let c = between[n * i + k];
                for (x, u) in cu[rank * i..rank * (i + 1)].iter_mut().zip(&u[rank * k..rank * (k + 1)]) {
                    *x += c * u;
                }
            }
        }
        let mut s = vec![0.0; rank * rank];
        for i in 0..rank {
            s[rank * i + i] = 1.0;
        }
        for k in 0..n {
            for i in 0..rank {
                let f = u[rank * k + i];
                if f != 0.0 {
                    for j in 0..rank {
                        s[rank * i + j] -= f * cu[rank * k + j];
                    }
                }
            }
        }
        Some(self.change(1.0, &unknowns, &u, rank, &mut s))
    }

    fn compliance_between(&self, unknowns: &[(usize, usize)]) -> Vec<f64> {
        let n = unknowns.len();
        let mut c = vec![0.0; n * n];
        for (i, &(at, axis)) in unknowns.iter().enumerate() {
            let row = 3 * self.nodes[at].place + axis;
            for (j, &(by, d)) in unknowns.iter().enumerate() {
                c[n * i + j] = self.nodes[by].columns[d][row];
            }
        }
        c
    }

    /// Computes the change of `u` (rows of `rank` numbers) and the capacitance `s`, and applies it to all touched nodes.
    fn change(
        &mut self,
        sign: f64,
        unknowns: &[(usize, usize)],
        u: &[f64],
        rank: usize,
        s: &mut [f64],
    ) -> (Change, f64) {
        // The capacitance of a removal has no unit, that of a hold is a compliance.
        let least_pivot = cholesky(s, rank, |diagonal| if sign > 0.0 { 1.0 } else { diagonal });
        let n = unknowns.len();
        let mut q = vec![0.0; rank * n];
        let mut z = vec![0.0; rank];
        for k in 0..n {
            for i in 0..rank {
                let solved: f64 = (0..i).map(|j| s[rank * i + j] * z[j]).sum();
                z[i] = (u[rank * k + i] - solved) / s[rank * i + i];
                q[n * i + k] = z[i];
            }
        }
        let n_known = self.nodes.first().map_or(0, |node| node.columns[0].len());
        let mut change = Change {
            sign,
            unknowns: unknowns.iter().map(|&(at, axis)| (3 * self.nodes[at].place + axis) as u32).collect(),
            q,
            w: Vec::with_capacity(rank),
            of_weight: Vec::with_capacity(rank),
        };
        for i in 0..rank {
            let q = &change.q[n * i..n * (i + 1)];
            let mut w = vec![0.0; n_known];
            let mut of_weight = [0.0; 3];
            for (&factor, &(at, d)) in q.iter().zip(unknowns) {
                if factor == 0.0 {
                    continue;
                }
                let node = &self.nodes[at];
                w.iter_mut().zip(&node.columns[d]).for_each(|(w, c)| *w += factor * c);
                for axis in 0..3 {
                    of_weight[axis] += factor * node.weight[d][axis];
                }
            }
            change.w.push(w);
            change.of_weight.push(of_weight);
        }
        for node in &mut self.nodes {
            for (w, of_weight) in change.w.iter().zip(&change.of_weight) {
                for d in 0..3 {
                    let factor = sign * w[3 * node.place + d];
                    node.columns[d].iter_mut().zip(w).for_each(|(c, w)| *c += factor * w);
                    for axis in 0..3 {
                        node.weight[d][axis] += factor * of_weight[axis];
                    }
                }
            }
        }
        (change, least_pivot)
    }
}

/// A removed tetrahedron: its corners and the rows of U.
#[derive(Clone, Copy, Debug)]
pub(super) struct RemovedTet {
    pub(super) nodes: [NodeId; 4],
    u: [[f64; 6]; 12],
}

impl RemovedTet {
    /// U of a tetrahedron: U U^T is its stiffness matrix [N/m]. Strain in the order xx, yy, zz, xy, yz, zx.
    pub(super) fn new(nodes: [NodeId; 4], corners_m: [DVec3; 4], lambda_pa: f64, mu_pa: f64) -> Self {
        let P1Gradients { alpha_per_m, volume_m3 } = P1Gradients::new(corners_m);
        // The root of 2 mu I + lambda 1 1^T is again a multiple of I plus one of 1 1^T.
        let root_v = volume_m3.sqrt();
        let deviatoric = (2.0 * mu_pa).sqrt();
        let shared = ((2.0 * mu_pa + 3.0 * lambda_pa).max(0.0).sqrt() - deviatoric) / 3.0;
        let shear = mu_pa.sqrt() * root_v;
        let mut u = [[0.0; 6]; 12];
        for (corner, alpha) in alpha_per_m.into_iter().enumerate() {
            for axis in 0..3 {
                let row = &mut u[3 * corner + axis];
                for (c, x) in row[..3].iter_mut().enumerate() {
                    let root = shared + if c == axis { deviatoric } else { 0.0 };
                    *x = root_v * root * alpha[axis];
                }
            }
            for (c, [a, b]) in [[0, 1], [1, 2], [2, 0]].into_iter().enumerate() {
                u[3 * corner + a][3 + c] = shear * alpha[b];
                u[3 * corner + b][3 + c] = shear * alpha[a];
            }
        }
        Self { nodes, u }
    }

    /// U U^T x for displacements of the corners [m]: the force [N] that balances the tetrahedron.
    pub(super) fn forces_n(&self, displacement_m: [DVec3; 4]) -> [DVec3; 4] {
        let mut strain = [0.0; 6];
        for corner in 0..4 {
            for axis in 0..3 {
                for (e, u) in strain.iter_mut().zip(self.u[3 * corner + axis]) {
                    *e += u * displacement_m[corner][axis];
                }
            }
        }
        let row = |r: usize| -> f64 { self.u[r].iter().zip(strain).map(|(u, e)| u * e).sum() };
        std::array::from_fn(|corner| DVec3::new(row(3 * corner), row(3 * corner + 1), row(3 * corner + 2)))
    }
}

/// Computes the lower Cholesky factor in place (rows of `n`); returns the smallest pivot over its scale. Pivots below the
/// threshold become infinite: their columns come out as zero.
fn cholesky(a: &mut [f64], n: usize, scale_of_diagonal: impl Fn(f64) -> f64) -> f64 {
    let mut least = f64::INFINITY;
    for k in 0..n {
        let diagonal = a[n * k + k];
        let scale = scale_of_diagonal(diagonal).max(f64::MIN_POSITIVE);
        let sum: f64 = (0..k).map(|j| a[n * k + j] * a[n * k + j]).sum();
        let pivot = diagonal - sum;
        least = least.min(pivot / scale);
        let pivot = if pivot > LEAST_PIVOT * scale { pivot.sqrt() } else { f64::INFINITY };
        a[n * k + k] = pivot;
        for i in k + 1..n {
            let dot: f64 = (0..k).map(|j| a[n * i + j] * a[n * k + j]).sum();
            a[n * i + k] = (a[n * i + k] - dot) / pivot;
        }
    }
    least
}

#[cfg(test)]
mod tests {
    use super::*;
    use glisson_mesh::math::SeededRandom;

    #[test]
    fn u_times_its_transpose_is_the_stiffness() {
        let mut random = SeededRandom::new(3);
        let mut point = |s: f64| DVec3::new(random.normal(), random.normal(), random.normal()) * s;
        let corners_m = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z].map(|p| (p + point(0.1)) * 0.01);
        let (lambda_pa, mu_pa) = (15e3, 1.7e3);
        let tet = RemovedTet::new([0, 1, 2, 3].map(NodeId), corners_m, lambda_pa, mu_pa);
        let stiffness = P1Gradients::new(corners_m).stiffness(lambda_pa, mu_pa);
        let x = [0; 4].map(|_| point(1e-3));
        let mut expected = [DVec3::ZERO; 4];
        for j in 0..4 {
            expected[j] += stiffness.vertex[j] * x[j];
        }
        for (e, [a, b]) in crate::solve::LOCAL_EDGES.into_iter().enumerate() {
            expected[a] += stiffness.edge[e] * x[b];
            expected[b] += stiffness.edge[e].transpose() * x[a];
        }
        for (found, expected) in tet.forces_n(x).into_iter().zip(expected) {
            assert!((found - expected).length() < 1e-12 * (1e-3 + expected.length()), "{found} {expected}");
        }
    }

    /// A node that one tetrahedron alone holds: without it the node would be free. However often that is tried, its compliance stays
    /// in the numbers' range.
    #[test]
    fn a_removal_that_would_leave_a_mechanism_is_not_made_whole() {
        let corners_m = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z].map(|p| p * 0.01);
        let (lambda_pa, mu_pa) = (15e3, 1.7e3);
        let tet = RemovedTet::new([0, 1, 2, 3].map(NodeId), corners_m, lambda_pa, mu_pa);
        let own = P1Gradients::new(corners_m).stiffness(lambda_pa, mu_pa).vertex[3].inverse();
        let columns = [0, 1, 2].map(|d| own.col(d).to_array().to_vec());
        let node = WorkingNode { node: NodeId(3), place: 0, columns, weight: [[0.0; 3]; 3] };
        let mut working = Working { nodes: vec![node] };
        for _ in 0..30 {
            let (_, least_pivot) = working.remove(&[tet]).unwrap();
            assert!(least_pivot < LEAST_PIVOT, "{least_pivot}");
        }
        let largest = working.nodes[0].columns.iter().flatten().fold(0.0_f64, |most, c| most.max(c.abs()));
        assert!(largest < own.col(0).length() / LEAST_PIVOT, "{largest}");
    }
}
