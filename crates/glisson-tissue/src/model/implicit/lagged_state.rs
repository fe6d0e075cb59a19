//! What a factor is made from: a state of the body, and the terms of its nodes.

use super::elements::Elements;
use super::ligaments::Ligaments;
use super::params::Preconditioner;
use crate::solve::{MeshEdges, TetStiffness};
use glisson_mesh::math::{DMat3, DVec3, outer};
use glisson_mesh::mesh::NodeId;

/// The state that the factored matrix depends on, besides the mesh and the material.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct LaggedState {
    /// Displacements at which it was made [m].
    pub(super) displacement_m: Vec<DVec3>,
    /// Nodes that a tool held then: they are decoupled from their neighbours.
    pub(super) held: Vec<bool>,
    /// Live tetrahedra that followed the stand-in law then.
    pub(super) strays: Vec<bool>,
    /// Factor of the mass: 1/h^2 + alpha/h.
    pub(super) per_mass: f64,
    /// Factor of the stiffness: 1 + beta/h.
    pub(super) per_stiffness: f64,
    /// Share of the elastic stiffness that viscosity leaves to a step.
    pub(super) viscous_share: f64,
}

impl LaggedState {
    /// The same step for the rest shape without tools.
    pub(super) fn at_rest(&self) -> Self {
        Self {
            displacement_m: vec![DVec3::ZERO; self.displacement_m.len()],
            held: vec![false; self.held.len()],
            strays: vec![false; self.strays.len()],
            ..*self
        }
    }

    /// Room for a state.
    pub(super) fn of_size(n_nodes: usize, n_tets: usize) -> Self {
        Self {
            displacement_m: vec![DVec3::ZERO; n_nodes],
            held: vec![false; n_nodes],
            strays: vec![false; n_tets],
            per_mass: 0.0,
            per_stiffness: 0.0,
            viscous_share: 1.0,
        }
    }

    /// Factors of the elastic stiffness and of that of the stress at rest.
    pub(super) fn factors(&self) -> [f64; 2] {
        [self.per_stiffness * self.viscous_share, self.per_stiffness]
    }

    /// Nodes and stiffness of a live tetrahedron, without negative eigenvalues.
    pub(super) fn stiffness(
        &self,
        elements: &Elements,
        t: usize,
        factors: [f64; 2],
    ) -> ([NodeId; 4], TetStiffness) {
        let (nodes, alpha, _) = elements.tetrahedron(t);
        let u = nodes.map(|n| self.displacement_m[n.index()]);
        let mut f = DMat3::IDENTITY;
        for k in 0..3 {
            f += outer(u[k + 1] - u[0], alpha[k]);
        }
        (nodes, elements.projected_stiffness(t, f, self.strays[t], factors))
    }

    /// All of it as numbers.
    pub(super) fn numbers(&self) -> impl Iterator<Item = f64> + '_ {
        let flags = self.held.iter().chain(&self.strays).map(|&flag| f64::from(u8::from(flag)));
        let vectors = self.displacement_m.iter().flat_map(|u| u.to_array());
        vectors.chain(flags).chain([self.per_mass, self.per_stiffness, self.viscous_share])
    }
}

/// What a preconditioner is made from, besides a state.
pub(super) struct Edited<'a> {
    pub(super) elements: &'a Elements,
    pub(super) terms: NodeTerms<'a>,
    /// 1 for each axis along which a node can move, 0 for the others.
    pub(super) free_axes: &'a [DVec3],
    pub(super) preconditioner: Preconditioner,
}

impl Edited<'_> {
    pub(super) fn edges(&self) -> MeshEdges {
        let n_tets = self.elements.tets().len();
        let tetrahedra: Vec<_> = (0..n_tets).map(|t| self.elements.tetrahedron(t).0).collect();
        MeshEdges::of_tetrahedra(self.free_axes.len(), &tetrahedra)
    }
}

/// Terms of the single nodes.
#[derive(Clone, Copy)]
pub(super) struct NodeTerms<'a> {
    /// Rest positions [m].
    pub(super) rest_m: &'a [DVec3],
    /// Mass of each node [kg].
    pub(super) mass_kg: &'a [f64],
    pub(super) ligaments: &'a Ligaments,
}

impl NodeTerms<'_> {
    pub(super) fn add_to(&self, vertex: &mut [DMat3], state: &LaggedState) {
        for (tensor, m) in vertex.iter_mut().zip(self.mass_kg) {
            *tensor += DMat3::from_diagonal(DVec3::splat(state.per_mass * m));
        }
        self.ligaments.add_to_vertices(self.rest_m, &state.displacement_m, vertex);
    }
}
