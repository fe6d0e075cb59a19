//! The non-linear forces and energy by the traversal of vertices, edges, triangles and tetrahedra (seed `002`,
//! appendix B; its index triples are derived anew from eq. 9, see [`super::numbers`]).
//!
//! The force that balances the deformation at p is dW/du_p, whose non-linear part is
//! sum_kl C_pkl (u_k . u_l) + 2 sum_jk u_k (u_j . C_jpk) + 4 sum_jkl D_jklp u_l (u_j . u_k); below, each sum is
//! split by which nodes occur in it. The report prints these as forces on the node; they are their opposites.

use super::numbers::{EdgeStiffness, MeshTriangles, TetScalars, TriangleStiffness, VertexStiffness};
use crate::model::explicit::{Padded, unpadded};
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::NodeId;

/// Which nodes get their non-linear force.
pub(super) trait Selection {
    fn has(&self, node: usize) -> bool;
}

/// Every node.
pub(super) struct Everywhere;

impl Selection for Everywhere {
    #[inline]
    fn has(&self, _: usize) -> bool {
        true
    }
}

/// The nodes with a flag.
impl Selection for &[bool] {
    #[inline]
    fn has(&self, node: usize) -> bool {
        self[node]
    }
}

/// The accumulated non-linear stiffness of a body.
#[derive(Clone, Debug)]
pub(super) struct NonlinearStiffness {
    pub(super) vertex: Vec<VertexStiffness>,
    pub(super) edge: Vec<EdgeStiffness>,
    pub(super) triangle: Vec<TriangleStiffness>,
    /// Zero for tetrahedra that were removed.
    pub(super) tet: Vec<TetScalars>,
    pub(super) triangles: MeshTriangles,
}

/// Additions and multiplications of one force evaluation, the penalty left out: counted in the expressions of this
/// file and of the linear part (9 multiplications, 6 additions and 3 to add up, for each product B u).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OperationCounts {
    /// The linear part: 18 a vertex, 36 an edge.
    pub linear: u64,
    /// The non-linear part: 26 a vertex, 108 an edge, 153 a triangle, 114 a tetrahedron.
    pub nonlinear: u64,
}

impl OperationCounts {
    /// For so many vertices, edges, triangles and tetrahedra.
    pub(super) fn of_counts([vertices, edges, triangles, tets]: [usize; 4]) -> Self {
        Self {
            linear: (18 * vertices + 36 * edges) as u64,
            nonlinear: (26 * vertices + 108 * edges + 153 * triangles + 114 * tets) as u64,
        }
    }
}

#[inline]
fn add(force: &mut Padded, f: DVec3) {
    force[0] += f.x;
    force[1] += f.y;
    force[2] += f.z;
}

impl NonlinearStiffness {
    /// Adds the non-linear forces that balance the displacements `u` to those nodes that are selected.
    pub(super) fn add_forces(
        &self,
        entities: &Entities<'_>,
        selected: &impl Selection,
        u: &[Padded],
        force: &mut [Padded],
    ) {
        let of = |n: NodeId| unpadded(&u[n.index()]);
        for (p, stiffness) in self.vertex.iter().enumerate() {
            if selected.has(p) {
                add(&mut force[p], vertex_force(stiffness, unpadded(&u[p])));
            }
        }
        for (nodes, stiffness) in entities.edge_nodes.iter().zip(&self.edge) {
            let at = nodes.map(NodeId::index);
            if at.iter().any(|&n| selected.has(n)) {
                add_selected(selected, force, at, edge_forces(stiffness, nodes.map(of)));
            }
        }
        for (nodes, stiffness) in self.triangles.nodes.iter().zip(&self.triangle) {
            let at = nodes.map(NodeId::index);
            if at.iter().any(|&n| selected.has(n)) {
                add_selected(selected, force, at, triangle_forces(stiffness, nodes.map(of)));
            }
        }
        for (nodes, scalars) in entities.tet_nodes.iter().zip(&self.tet) {
            let at = nodes.map(NodeId::index);
            if at.iter().any(|&n| selected.has(n)) {
                add_selected(selected, force, at, tet_forces(scalars, nodes.map(of)));
            }
        }
    }

    /// The cubic and quartic part of the energy [J].
    pub(super) fn energy_j(&self, entities: &Entities<'_>, u: &[Padded]) -> f64 {
        let of = |n: NodeId| unpadded(&u[n.index()]);
        let vertices =
            self.vertex.iter().zip(u).map(|(stiffness, u)| vertex_energy_j(stiffness, unpadded(u)));
        let edges = entities.edge_nodes.iter().zip(&self.edge);
        let triangles = self.triangles.nodes.iter().zip(&self.triangle);
        let tets = entities.tet_nodes.iter().zip(&self.tet);
        vertices.sum::<f64>()
            + edges.map(|(nodes, stiffness)| edge_energy_j(stiffness, nodes.map(of))).sum::<f64>()
            + triangles.map(|(nodes, stiffness)| triangle_energy_j(stiffness, nodes.map(of))).sum::<f64>()
            + tets.map(|(nodes, scalars)| tet_energy_j(scalars, nodes.map(of))).sum::<f64>()
    }
}

/// The nodes of edges and tetrahedra.
pub(super) struct Entities<'a> {
    pub(super) edge_nodes: &'a [[NodeId; 2]],
    pub(super) tet_nodes: &'a [[NodeId; 4]],
}

#[inline]
fn add_selected<const N: usize>(
    selected: &impl Selection,
    force: &mut [Padded],
    at: [usize; N],
    forces_n: [DVec3; N],
) {
    for (n, force_n) in at.into_iter().zip(forces_n) {
        if selected.has(n) {
            add(&mut force[n], force_n);
        }
    }
}

/// [2 (u (x) u) + (u . u) Id] C_ppp + 4 D_pppp (u . u) u.
#[inline]
fn vertex_force(stiffness: &VertexStiffness, u: DVec3) -> DVec3 {
    let square = u.dot(u);
    stiffness.c * square + u * (2.0 * u.dot(stiffness.c) + 4.0 * stiffness.d * square)
}

fn vertex_energy_j(stiffness: &VertexStiffness, u: DVec3) -> f64 {
    let square = u.dot(u);
    (u.dot(stiffness.c) + stiffness.d * square) * square
}

/// On p: 2 (p . j) C_ppj + (j . j) C_pjj + 2 p (j . C_jpp) + 2 j (p . C_ppj + j . C_jjp)
///     + 4 p (2 D_jppp (p . j) + D_jjpp (j . j)) + 4 j (D_jppp (p . p) + (D_jpjp + D_pjjp)(p . j) + D_jjjp (j . j)),
/// with p and j for their displacements; on j the same with p and j exchanged, where the factor of the other node
/// is the same number.
#[inline]
fn edge_forces(stiffness: &EdgeStiffness, [p, j]: [DVec3; 2]) -> [DVec3; 2] {
    let [c_ppj, c_pjj, c_jpp, c_jjp] = stiffness.c;
    let [d_jppp, d_jjjp, d_jjpp, d_jpjp, d_pjjp] = stiffness.d;
    let (pp, pj, jj) = (p.dot(p), p.dot(j), j.dot(j));
    let across =
        2.0 * (p.dot(c_ppj) + j.dot(c_jjp)) + 4.0 * (d_jppp * pp + (d_jpjp + d_pjjp) * pj + d_jjjp * jj);
    let at_p = 2.0 * j.dot(c_jpp) + 4.0 * (2.0 * d_jppp * pj + d_jjpp * jj);
    let at_j = 2.0 * p.dot(c_pjj) + 4.0 * (2.0 * d_jjjp * pj + d_jjpp * pp);
    [
        c_ppj * (2.0 * pj) + c_pjj * jj + p * at_p + j * across,
        c_jjp * (2.0 * pj) + c_jpp * pp + j * at_j + p * across,
    ]
}

fn edge_energy_j(stiffness: &EdgeStiffness, [p, j]: [DVec3; 2]) -> f64 {
    let [c_ppj, c_pjj, c_jpp, c_jjp] = stiffness.c;
    let [d_jppp, d_jjjp, d_jjpp, d_jpjp, d_pjjp] = stiffness.d;
    let (pp, pj, jj) = (p.dot(p), p.dot(j), j.dot(j));
    2.0 * pj * (p.dot(c_ppj) + j.dot(c_jjp))
        + jj * p.dot(c_pjj)
        + pp * j.dot(c_jpp)
        + 4.0 * pj * (d_jppp * pp + d_jjjp * jj)
        + 2.0 * (d_jjpp * pp * jj + (d_jpjp + d_pjjp) * pj * pj)
}

/// On p: 2 [C_pjk (j . k) + j (k . C_kjp) + k (j . C_jkp)] + 4 [2 D_jkpp p (j . k)
///     + (D_jpkp + D_pjkp)(j (k . p) + k (j . p)) + D_jjkp k (j . j) + (D_jkjp + D_kjjp) j (j . k)
///     + D_kkjp j (k . k) + (D_kjkp + D_jkkp) k (j . k)], and so on j and k by exchange.
///
/// The factor of node b's displacement on node a is the one of a's on b, so there are three of them.
#[inline]
fn triangle_forces(stiffness: &TriangleStiffness, [p, j, k]: [DVec3; 3]) -> [DVec3; 3] {
    let [c_p, c_j, c_k] = stiffness.c;
    let [[a_p, b_p, e_p], [a_j, b_j, e_j], [a_k, b_k, e_k]] = stiffness.d;
    let (b_p, b_j, b_k) = (b_p + e_p, b_j + e_j, b_k + e_k);
    let (pj, jk, kp) = (p.dot(j), j.dot(k), k.dot(p));
    let (pp, jj, kk) = (p.dot(p), j.dot(j), k.dot(k));
    let on_pj = 2.0 * k.dot(c_k) + 4.0 * (b_p * kp + b_j * jk + a_k * kk);
    let on_jk = 2.0 * p.dot(c_p) + 4.0 * (b_j * pj + b_k * kp + a_p * pp);
    let on_kp = 2.0 * j.dot(c_j) + 4.0 * (b_k * jk + b_p * pj + a_j * jj);
    [
        c_p * (2.0 * jk) + p * (8.0 * a_p * jk) + j * on_pj + k * on_kp,
        c_j * (2.0 * kp) + j * (8.0 * a_j * kp) + k * on_jk + p * on_pj,
        c_k * (2.0 * pj) + k * (8.0 * a_k * pj) + p * on_kp + j * on_jk,
    ]
}

fn triangle_energy_j(stiffness: &TriangleStiffness, [p, j, k]: [DVec3; 3]) -> f64 {
    let [c_p, c_j, c_k] = stiffness.c;
    let [[a_p, b_p, e_p], [a_j, b_j, e_j], [a_k, b_k, e_k]] = stiffness.d;
    let (pj, jk, kp) = (p.dot(j), j.dot(k), k.dot(p));
    2.0 * (p.dot(c_p) * jk + j.dot(c_j) * kp + k.dot(c_k) * pj)
        + 4.0 * (a_p * jk * p.dot(p) + a_j * kp * j.dot(j) + a_k * pj * k.dot(k))
        + 4.0 * ((b_p + e_p) * pj * kp + (b_j + e_j) * jk * pj + (b_k + e_k) * kp * jk)
}

/// On p: 4 [(D_jklp + D_kjlp) l (j . k) + (D_jlkp + D_ljkp) k (j . l) + (D_kljp + D_lkjp) j (k . l)], and so on the
/// others by exchange.
#[inline]
fn tet_forces(scalars: &TetScalars, [p, j, k, l]: [DVec3; 4]) -> [DVec3; 4] {
    let [jk_lp, jl_kp, kl_jp] = scalars.d.map(|[d, exchanged]| 4.0 * (d + exchanged));
    let (on_lp, on_jk) = (jk_lp * j.dot(k), jk_lp * l.dot(p));
    let (on_kp, on_jl) = (jl_kp * j.dot(l), jl_kp * k.dot(p));
    let (on_jp, on_kl) = (kl_jp * k.dot(l), kl_jp * j.dot(p));
    [
        j * on_jp + k * on_kp + l * on_lp,
        p * on_jp + k * on_jk + l * on_jl,
        p * on_kp + j * on_jk + l * on_kl,
        p * on_lp + j * on_jl + k * on_kl,
    ]
}

fn tet_energy_j(scalars: &TetScalars, [p, j, k, l]: [DVec3; 4]) -> f64 {
    let [jk_lp, jl_kp, kl_jp] = scalars.d.map(|[d, exchanged]| 4.0 * (d + exchanged));
    jk_lp * j.dot(k) * l.dot(p) + jl_kp * j.dot(l) * k.dot(p) + kl_jp * k.dot(l) * j.dot(p)
}
