//! The projected tangent at some past state, factored: the preconditioner.

use super::elements::Elements;
use super::ligaments::Ligaments;
use super::patch_inverse::{Factored, PatchInverse};
use crate::model::LocalModel;
use crate::model::kernel::KernelPath;
use crate::solve::{
    BoundaryConditions, FactorScratch, Factorization, FreeSystem, LOCAL_EDGES, MeshEdges, SolveError,
    StiffnessTensors,
};
use glisson_mesh::math::{DMat3, DVec3, outer};
use glisson_mesh::mesh::{NodeId, TetMesh};

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
}

/// A sparse factor of per_mass M + per_stiffness K at a [`LaggedState`].
#[derive(Clone)]
pub(super) struct Lagged {
    pub(super) state: LaggedState,
    edges: MeshEdges,
    /// Edge of each of the six local edges, tetrahedron after tetrahedron as in [`Elements::tetrahedra`].
    tensors: StiffnessTensors,
    system: FreeSystem,
    factor: Factorization,
    scratch: FactorScratch,
    free: Vec<f64>,
    eliminated: Vec<f64>,
    /// None for a matrix that is nothing but its diagonal.
    inverse: Option<PatchInverse>,
}

/// What [`Lagged::new`] needs.
pub(super) struct LaggedParams<'a> {
    /// The live tetrahedra with all nodes.
    pub(super) mesh: &'a TetMesh,
    /// 1 for each axis along which a node can move, 0 for the others.
    pub(super) free_axes: &'a [DVec3],
    pub(super) nodes: NodeTerms<'a>,
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
        assemble(&mut tensors, &edges, elements, &state);
        params.nodes.add_to(&mut tensors, &state);
        let mut conditions = BoundaryConditions::new();
        for (n, free) in params.free_axes.iter().enumerate() {
            for axis in (0..3).filter(|&axis| free[axis] == 0.0) {
                conditions.impose(NodeId::from_index(n), axis, 0.0);
            }
        }
        let system = FreeSystem::new(&edges, &tensors, &conditions)?;
        let factor = system.factorize()?;
        let scratch = factor.scratch(1);
        let free = vec![0.0; system.n_free()];
        let n_nodes = params.free_axes.len();
        let inverse = factor.is_supernodal().then(|| PatchInverse::new(&factor, n_nodes));
        Ok(Self { state, edges, tensors, system, factor, scratch, eliminated: free.clone(), free, inverse })
    }

    /// Recomputes the factor at `self.state`, without allocation. False when the matrix has no factor.
    pub(super) fn refresh(&mut self, elements: &Elements, nodes: NodeTerms<'_>) -> bool {
        assemble(&mut self.tensors, &self.edges, elements, &self.state);
        nodes.add_to(&mut self.tensors, &self.state);
        self.system.refill(&self.tensors);
        if let Some(inverse) = &mut self.inverse {
            inverse.forget();
        }
        self.factor.refactor_definite(&self.system).is_ok()
    }

    /// Overwrites `solution` with the inverse of the factored matrix times `right`, zero for components that are not free.
    pub(super) fn solve_into(&mut self, right: &[DVec3], solution: &mut [DVec3]) {
        self.system.gather_into(right, &mut self.free);
        self.factor.solve_in_place(&mut self.free, 1, &mut self.scratch);
        solution.fill(DVec3::ZERO);
        self.system.add_scattered(&self.free, solution);
    }

    /// Whether it tells entries of the inverse.
    pub(super) fn tells_entries(&self) -> bool {
        self.inverse.is_some()
    }

    /// Overwrites C of a local model with entries of the inverse; the bits are the same on every path.
    pub(super) fn fill_compliance(&mut self, path: KernelPath, out: &mut LocalModel) {
        let with = Factored { factor: &self.factor, system: &self.system, path };
        let Some(inverse) = &mut self.inverse else { return };
        inverse.hold(&out.nodes, &with);
        for j in 0..out.nodes.len() {
            for i in 0..=j {
                let tensor = inverse.tensor(out.nodes[i], out.nodes[j], &with);
                out.set_tensor(i, j, tensor);
                out.set_tensor(j, i, tensor.transpose());
            }
        }
    }

    /// Overwrites the drift of a local model, after its C, with the inverse times `right`.
    pub(super) fn fill_drift(&mut self, right: &[DVec3], path: KernelPath, out: &mut LocalModel) {
        let Some(inverse) = &mut self.inverse else { return };
        self.system.gather_into(right, &mut self.free);
        self.factor.solve_lower_into(&self.free, &mut self.eliminated, &mut self.scratch);
        let with = Factored { factor: &self.factor, system: &self.system, path };
        for (node, drift_m) in out.nodes.iter().zip(&mut out.drift_m) {
            *drift_m = DVec3::from_array(inverse.product(*node, &self.eliminated, &with));
        }
    }
}

fn assemble(tensors: &mut StiffnessTensors, edges: &MeshEdges, elements: &Elements, state: &LaggedState) {
    let factors = [state.per_stiffness * state.viscous_share, state.per_stiffness];
    tensors.vertex.fill(DMat3::ZERO);
    tensors.edge.fill(DMat3::ZERO);
    for (t, (nodes, alpha, _)) in elements.tetrahedra().enumerate() {
        let u = nodes.map(|n| state.displacement_m[n.index()]);
        let mut f = DMat3::IDENTITY;
        for k in 0..3 {
            f += outer(u[k + 1] - u[0], alpha[k]);
        }
        let stiffness = elements.projected_stiffness(t, f, state.strays[t], factors);
        for j in 0..4 {
            if !state.held[nodes[j].index()] {
                tensors.vertex[nodes[j].index()] += stiffness.vertex[j];
            } else {
                // A held node is decoupled; its block only has to be positive definite.
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

impl NodeTerms<'_> {
    fn add_to(&self, tensors: &mut StiffnessTensors, state: &LaggedState) {
        for (tensor, m) in tensors.vertex.iter_mut().zip(self.mass_kg) {
            *tensor += DMat3::from_diagonal(DVec3::splat(state.per_mass * m));
        }
        self.ligaments.add_to_vertices(self.rest_m, &state.displacement_m, &mut tensors.vertex);
    }
}
