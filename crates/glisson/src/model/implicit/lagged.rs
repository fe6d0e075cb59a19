//! The projected tangent at some past state, factored: the preconditioner.

use super::elements::Elements;
use super::projected::projected_stiffness;
use crate::math::{DMat3, DVec3, outer};
use crate::mesh::{NodeId, TetMesh};
use crate::solve::{
    BoundaryConditions, FactorScratch, Factorization, FreeSystem, LOCAL_EDGES, MeshEdges, SolveError,
    StiffnessTensors,
};

/// What the factored matrix depends on, besides the mesh and the material.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct LaggedState {
    /// Displacements at which it was made [m].
    pub(super) displacement_m: Vec<DVec3>,
    /// Nodes that were held by a tool then: they are cut off from their neighbours.
    pub(super) held: Vec<bool>,
    /// Factor of the mass: 1/h^2 + alpha/h.
    pub(super) per_mass: f64,
    /// Factor of the stiffness: 1 + beta/h.
    pub(super) per_stiffness: f64,
}

/// A sparse factor of per_mass M + per_stiffness K at a [`LaggedState`].
#[derive(Clone)]
pub(super) struct Lagged {
    pub(super) state: LaggedState,
    lame_pa: [f64; 2],
    edges: MeshEdges,
    /// Edge of each of the six local edges, tetrahedron after tetrahedron as in [`Elements::tetrahedra`].
    tensors: StiffnessTensors,
    system: FreeSystem,
    factor: Factorization,
    scratch: FactorScratch,
    free: Vec<f64>,
}

/// What [`Lagged::new`] needs.
pub(super) struct LaggedParams<'a> {
    /// The live tetrahedra with all nodes.
    pub(super) mesh: &'a TetMesh,
    /// Nodes that never move: fixed ones and those without a tetrahedron.
    pub(super) immobile: &'a [bool],
    /// Mass of each node [kg].
    pub(super) mass_kg: &'a [f64],
    /// lambda and mu [Pa] of the preconditioner.
    pub(super) lame_pa: [f64; 2],
}

impl Lagged {
    /// Pattern, order and factor for a mesh of live tetrahedra, in their order in `elements`.
    pub(super) fn new(
        params: &LaggedParams<'_>,
        elements: &Elements,
        state: LaggedState,
    ) -> Result<Self, SolveError> {
        let edges = MeshEdges::of_mesh(params.mesh)?;
        let mut tensors = StiffnessTensors {
            vertex: vec![DMat3::ZERO; params.mesh.positions_m.len()],
            edge: vec![DMat3::ZERO; edges.nodes.len()],
        };
        assemble(&mut tensors, &edges, elements, params.lame_pa, &state);
        add_mass(&mut tensors, params.mass_kg, state.per_mass);
        let mut conditions = BoundaryConditions::new();
        for n in (0..params.immobile.len()).filter(|&n| params.immobile[n]) {
            conditions.fix_node(NodeId::from_index(n));
        }
        let system = FreeSystem::new(&edges, &tensors, &conditions)?;
        let factor = system.factorize()?;
        let scratch = factor.scratch(1);
        let free = vec![0.0; system.n_free()];
        Ok(Self { state, lame_pa: params.lame_pa, edges, tensors, system, factor, scratch, free })
    }

    /// Makes the factor anew at `self.state`, without allocation. False when the numbers are not usable.
    pub(super) fn refresh(&mut self, elements: &Elements, mass_kg: &[f64]) -> bool {
        assemble(&mut self.tensors, &self.edges, elements, self.lame_pa, &self.state);
        add_mass(&mut self.tensors, mass_kg, self.state.per_mass);
        self.system.refill(&self.tensors);
        self.factor.refactor_definite(&self.system).is_ok()
    }

    /// Overwrites `solution` with the factored matrix' inverse times `right`, zero where nothing is free.
    pub(super) fn solve_into(&mut self, right: &[DVec3], solution: &mut [DVec3]) {
        self.system.gather_into(right, &mut self.free);
        self.factor.solve_in_place(&mut self.free, 1, &mut self.scratch);
        solution.fill(DVec3::ZERO);
        self.system.add_scattered(&self.free, solution);
    }
}

fn assemble(
    tensors: &mut StiffnessTensors,
    edges: &MeshEdges,
    elements: &Elements,
    lame_pa: [f64; 2],
    state: &LaggedState,
) {
    tensors.vertex.fill(DMat3::ZERO);
    tensors.edge.fill(DMat3::ZERO);
    for (t, (nodes, alpha, volume_m3)) in elements.tetrahedra().enumerate() {
        let u = nodes.map(|n| state.displacement_m[n.index()]);
        let mut f = DMat3::IDENTITY;
        for k in 0..3 {
            f += outer(u[k + 1] - u[0], alpha[k]);
        }
        let stiffness = projected_stiffness(f, alpha, state.per_stiffness * volume_m3, lame_pa);
        for j in 0..4 {
            if !state.held[nodes[j].index()] {
                tensors.vertex[nodes[j].index()] += stiffness.vertex[j];
            } else {
                // Cut off from its neighbours, a held node only has to stay definite.
                let size = stiffness.vertex[j].col(0).x.abs();
                tensors.vertex[nodes[j].index()] += DMat3::from_diagonal(DVec3::splat(size));
            }
        }
        for (e, [j, k]) in LOCAL_EDGES.into_iter().enumerate() {
            if state.held[nodes[j].index()] || state.held[nodes[k].index()] {
                continue;
            }
            let along = if nodes[j] < nodes[k] { stiffness.edge[e] } else { stiffness.edge[e].transpose() };
            tensors.edge[edges.of_tet[t][e] as usize] += along;
        }
    }
}

fn add_mass(tensors: &mut StiffnessTensors, mass_kg: &[f64], per_mass: f64) {
    for (tensor, m) in tensors.vertex.iter_mut().zip(mass_kg) {
        *tensor += DMat3::from_diagonal(DVec3::splat(per_mass * m));
    }
}
