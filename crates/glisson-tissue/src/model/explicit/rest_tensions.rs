//! Stress at rest in models of links.
//!
//! With F = sum x_k alpha_k^T and sum alpha_k = 0, the forces V F S0 alpha_j of a tetrahedron are exactly those of links
//! along its edges with the constant tension per length
//!
//! s_jk = -V alpha_j . S0 alpha_k,   force on j: s_jk (x_k - x_j),
//!
//! so the stress turns with the tetrahedron and costs a step nothing: the tensions of all tetrahedra at an edge are
//! summed once. Its energy is V/2 S0 : (C - Id) = 1/2 sum s_jk (|x_k - x_j|^2 - the same at rest).

use super::{Insertions, keep};
use crate::solve::{MeshEdges, P1Gradients, RestStress};
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::NodeId;

/// Tension per length [N/m] that the stress at rest gives to edges; empty without any.
#[derive(Clone, Debug, Default)]
pub(in crate::model) struct RestTensions {
    of_tet: Vec<[f64; 6]>,
    on_edge: Vec<f64>,
}

impl RestTensions {
    /// Of the stress of each tetrahedron; none for no stress at all.
    pub(in crate::model) fn new(
        edges: &MeshEdges,
        gradients: impl Iterator<Item = P1Gradients>,
        rest_stress_pa: &[RestStress],
    ) -> Self {
        if rest_stress_pa.is_empty() {
            return Self::default();
        }
        let of_edges = |(g, &s): (P1Gradients, &RestStress)| g.stress_stiffness_n_per_m(s).1.map(|s| -s);
        let of_tet: Vec<[f64; 6]> = gradients.zip(rest_stress_pa).map(of_edges).collect();
        let mut on_edge = vec![0.0; edges.nodes.len()];
        for (tensions, edges) in of_tet.iter().zip(&edges.of_tet) {
            tensions.iter().zip(edges).for_each(|(s, &e)| on_edge[e as usize] += s);
        }
        Self { of_tet, on_edge }
    }

    /// Overwrites the tension of each edge.
    pub(in crate::model) fn write_into(&self, tension_n_per_m: &mut [f64]) {
        if self.on_edge.is_empty() {
            tension_n_per_m.fill(0.0);
        } else {
            tension_n_per_m.copy_from_slice(&self.on_edge);
        }
    }

    /// Tension of an edge.
    #[inline]
    pub(in crate::model) fn on_edge(&self, edge: usize) -> f64 {
        self.on_edge.get(edge).copied().unwrap_or(0.0)
    }

    /// Tensions of a tetrahedron.
    pub(in crate::model) fn of_tet(&self, t: usize) -> [f64; 6] {
        self.of_tet.get(t).copied().unwrap_or_default()
    }

    /// Takes a tetrahedron from one of its edges; an edge that does not stay has exactly none.
    pub(in crate::model) fn remove(&mut self, t: usize, local: usize, edge: usize, stays: bool) {
        if let Some(tension) = self.on_edge.get_mut(edge) {
            *tension = if stays { *tension - self.of_tet[t][local] } else { 0.0 };
        }
    }

    /// Room for what an edit brings in.
    pub(in crate::model) fn grow(&mut self, new_edges: &Insertions, n_tets: usize) {
        if !self.on_edge.is_empty() {
            new_edges.spread(&mut self.on_edge, 0.0);
            self.of_tet.resize(n_tets, [0.0; 6]);
        }
    }

    /// Adds the tensions of a tetrahedron, new or taken out before.
    pub(in crate::model) fn add_tet(
        &mut self,
        t: usize,
        edges: &[u32; 6],
        gradients: &P1Gradients,
        stress_pa: RestStress,
    ) {
        self.of_tet[t] = gradients.stress_stiffness_n_per_m(stress_pa).1.map(|s| -s);
        for (tension, &edge) in self.of_tet[t].iter().zip(edges) {
            self.on_edge[edge as usize] += tension;
        }
    }

    /// Energy at these positions over that at rest [J].
    pub(in crate::model) fn energy_j(
        &self,
        edges: &[[NodeId; 2]],
        positions_m: &[DVec3],
        rest_m2: impl Fn(usize) -> f64,
    ) -> f64 {
        let of_edge = |(e, (s, &[a, b])): (usize, (&f64, &[NodeId; 2]))| {
            let now_m2 = (positions_m[b.index()] - positions_m[a.index()]).length_squared();
            0.5 * s * (now_m2 - rest_m2(e))
        };
        self.on_edge.iter().zip(edges).enumerate().map(of_edge).sum()
    }

    pub(in crate::model) fn compact(&mut self, live_edges: &[bool], live_tets: &[bool]) {
        if !self.on_edge.is_empty() {
            keep(&mut self.on_edge, live_edges);
            keep(&mut self.of_tet, live_tets);
        }
    }
}
