//! The projected tangent at some past state, factored: the preconditioner.
//!
//! A new factor is made at once ([`Lagged::refresh`]), or ordered for a state and made in slices of about equal work, one a
//! step, while the old one serves ([`Lagged::order`], [`Lagged::advance`]). Both have the same bits. What a slice does follows
//! from counts alone: tetrahedra and the pattern of the factor.

use super::elements::Elements;
use super::lagged_state::{LaggedState, NodeTerms};
use super::late::Late;
use super::patch_inverse::{Factored, PatchInverse};
use crate::model::LocalModel;
use crate::model::kernel::KernelPath;
use crate::solve::{
    BoundaryConditions, FactorPattern, FactorScratch, Factorization, FreeSystem, LOCAL_EDGES, MeshEdges,
    NextFactor, SolveError, StiffnessTensors,
};
use glisson_mesh::math::{DMat3, DVec3};
use glisson_mesh::mesh::NodeId;
use std::ops::Range;

/// Work of a slice [ns], see [`Factorization::work_ns`]: half of the 2 ms that scenes give a step. A choice.
const SLICE_WORK_NS: u64 = 1_000_000;
/// Slices of a large body's factor do more, so that there are no more than these (but for what units of work leave over):
/// what is made for a state of long ago does not serve. A choice.
const MOST_SLICES: u64 = 16;
/// Work to write the values of a node's tensors into the system [ns].
const NODE_WORK_NS: u64 = 60;

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
    /// None for a matrix that is nothing but its diagonal, and before there are values.
    inverse: Option<PatchInverse>,
    next: Next,
    slice_work_ns: u64,
    /// What edits have changed since.
    late: Late,
}

/// The factor that is being made in slices.
#[derive(Clone)]
struct Next {
    /// What it depends on; the slices done, zero while none is ordered.
    of: Pending,
    /// Tetrahedra whose stiffness is assembled.
    n_tets: usize,
    factor: NextFactor,
}

/// What a factor that is being made depends on.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Pending {
    /// The state that it was ordered for.
    pub(super) state: LaggedState,
    /// Slices done.
    pub(super) n_slices: u32,
}

/// What a slice came to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Slice {
    /// More slices are to come.
    Underway,
    /// The new factor serves from now on.
    Serves,
    /// The matrix has no factor: the old one goes on serving.
    Failed,
}

impl Lagged {
    /// Pattern, order and factor at a state.
    pub(super) fn new(
        edges: MeshEdges,
        free_axes: &[DVec3],
        elements: &Elements,
        nodes: NodeTerms<'_>,
        state: LaggedState,
    ) -> Result<Self, SolveError> {
        let system = system_of(&edges, free_axes)?;
        let pattern = system.pattern_of_factor()?;
        let mut lagged = Self::without_values(edges, (system, pattern), elements, state)?;
        lagged.fill(elements, nodes);
        lagged.factor.refactor(&lagged.system)?;
        lagged.complete();
        Ok(lagged)
    }

    /// A factor whose values are still to be made for `state`.
    pub(super) fn without_values(
        edges: MeshEdges,
        (system, pattern): (FreeSystem, FactorPattern),
        elements: &Elements,
        state: LaggedState,
    ) -> Result<Self, SolveError> {
        let factor = system.factor_for_slices(pattern)?;
        let n_nodes = state.displacement_m.len();
        let tensors = StiffnessTensors::zeros(n_nodes, &edges);
        let scratch = factor.scratch(1);
        let free = vec![0.0; system.n_free()];
        let next = Next {
            of: Pending { state: state.clone(), n_slices: 0 },
            n_tets: 0,
            factor: NextFactor::default(),
        };
        let work_ns = factor.work_ns()
            + elements.tets().len() as u64 * elements.projection_work_ns()
            + n_nodes as u64 * NODE_WORK_NS;
        let slice_work_ns = work_ns.div_ceil(work_ns.div_ceil(SLICE_WORK_NS).clamp(1, MOST_SLICES));
        Ok(Self {
            state,
            edges,
            tensors,
            system,
            factor,
            scratch,
            eliminated: free.clone(),
            free,
            inverse: None,
            next,
            slice_work_ns,
            late: Late::default(),
        })
    }

    /// Once it has values: makes room for entries of the inverse, and for the next factor.
    pub(super) fn complete(&mut self) {
        let n_nodes = self.state.displacement_m.len();
        self.inverse = self.factor.is_supernodal().then(|| PatchInverse::new(&self.factor, n_nodes));
        self.factor.make_room(&mut self.next.factor);
    }

    /// Takes all of it, and leaves what solutions need, with the same values of the factor.
    pub(super) fn retire(&mut self) -> Self {
        let of_solutions = Self {
            state: self.state.clone(),
            edges: MeshEdges::default(),
            tensors: StiffnessTensors::default(),
            system: self.system.numbering(),
            factor: self.factor.for_solutions(),
            scratch: self.scratch.clone(),
            free: self.free.clone(),
            eliminated: Vec::new(),
            inverse: None,
            next: Next {
                of: Pending { state: LaggedState::of_size(0, 0), n_slices: 0 },
                n_tets: 0,
                factor: NextFactor::default(),
            },
            slice_work_ns: self.slice_work_ns,
            late: self.late.clone(),
        };
        std::mem::replace(self, of_solutions)
    }

    /// The matrix at `self.state`.
    fn fill(&mut self, elements: &Elements, nodes: NodeTerms<'_>) {
        let all = 0..elements.tets().len();
        assemble(&mut self.tensors, &self.edges, elements, &self.state, all);
        nodes.add_to(&mut self.tensors.vertex, &self.state);
        self.system.refill(&self.tensors);
    }

    /// Goes on after an edit that changed these nodes, their tetrahedra or the places of either, with the factor of what was
    /// there before. `now` is the state of the elements as they are.
    pub(super) fn serve_on(
        &mut self,
        nodes: impl Iterator<Item = NodeId>,
        elements: &Elements,
        terms: NodeTerms<'_>,
        now: &LaggedState,
    ) {
        self.drop_pending();
        nodes.for_each(|node| self.late.add(node));
        self.late.update(elements, terms, now);
    }

    /// What edits have changed since the factor was made.
    pub(super) fn late(&self) -> &Late {
        &self.late
    }

    /// Recomputes the factor at `self.state`, without allocation; drops the one that is being made. False when the matrix has
    /// no factor.
    pub(super) fn refresh(&mut self, elements: &Elements, nodes: NodeTerms<'_>) -> bool {
        self.drop_pending();
        self.fill(elements, nodes);
        if let Some(inverse) = &mut self.inverse {
            inverse.forget();
        }
        self.factor.refactor_definite(&self.system).is_ok()
    }

    /// Orders a factor: its first slice is the next call of [`Lagged::advance`]. The caller overwrites the state that it is
    /// for.
    pub(super) fn order(&mut self) -> &mut LaggedState {
        self.drop_pending();
        &mut self.next.of.state
    }

    /// The factor that is being made, if there is one.
    pub(super) fn pending(&self) -> Option<&Pending> {
        (self.next.of.n_slices > 0).then_some(&self.next.of)
    }

    /// Gives up the factor that is being made.
    pub(super) fn drop_pending(&mut self) {
        self.next.of.n_slices = 0;
        self.next.n_tets = 0;
        self.next.factor.restart();
    }

    /// Makes the next slice of the factor that was ordered, without allocation.
    pub(super) fn advance(&mut self, elements: &Elements, nodes: NodeTerms<'_>) -> Slice {
        let next = &mut self.next;
        next.of.n_slices += 1;
        let mut work_ns = self.slice_work_ns;
        let n_tets = elements.tets().len();
        if next.n_tets < n_tets {
            let n_affordable = (work_ns / elements.projection_work_ns()).max(1) as usize;
            let end = n_tets.min(next.n_tets + n_affordable);
            assemble(&mut self.tensors, &self.edges, elements, &next.of.state, next.n_tets..end);
            work_ns = work_ns.saturating_sub((end - next.n_tets) as u64 * elements.projection_work_ns());
            next.n_tets = end;
            if end < n_tets {
                return Slice::Underway;
            }
            nodes.add_to(&mut self.tensors.vertex, &next.of.state);
            self.system.refill(&self.tensors);
            work_ns = work_ns.saturating_sub(self.tensors.vertex.len() as u64 * NODE_WORK_NS);
        }
        match self.factor.advance(&mut next.factor, &self.system, &mut work_ns) {
            Ok(false) => return Slice::Underway,
            Ok(true) => {}
            Err(_) => {
                self.drop_pending();
                return Slice::Failed;
            }
        }
        self.factor.exchange(&mut next.factor);
        std::mem::swap(&mut self.state, &mut next.of.state);
        if let Some(inverse) = &mut self.inverse {
            inverse.forget();
        }
        self.drop_pending();
        Slice::Serves
    }

    /// Makes the slices of a saved factor again, or gives up what is being made where none was then.
    pub(super) fn resume(&mut self, saved: Option<&Pending>, elements: &Elements, nodes: NodeTerms<'_>) {
        self.drop_pending();
        if let Some(saved) = saved {
            self.order().clone_from(&saved.state);
            for _ in 0..saved.n_slices {
                self.advance(elements, nodes);
            }
        }
    }

    /// Overwrites `solution` with the inverse of the factored matrix times `right`, zero for components that are not free, and
    /// adds the answers of single nodes where edits have changed it since ([`Late`]).
    pub(super) fn solve_into(&mut self, right: &[DVec3], solution: &mut [DVec3]) {
        self.system.gather_into(right, &mut self.free);
        self.factor.solve_in_place(&mut self.free, 1, &mut self.scratch);
        solution.fill(DVec3::ZERO);
        self.system.add_scattered(&self.free, solution);
        self.late.add_answers(right, solution);
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

/// Order and pattern of a matrix of zeros. `free_axes`: 1 for each axis along which a node can move, 0 for the others.
pub(super) fn system_of(edges: &MeshEdges, free_axes: &[DVec3]) -> Result<FreeSystem, SolveError> {
    let zeros = StiffnessTensors::zeros(free_axes.len(), edges);
    let mut conditions = BoundaryConditions::new();
    for (n, free) in free_axes.iter().enumerate() {
        for axis in (0..3).filter(|&axis| free[axis] == 0.0) {
            conditions.impose(NodeId::from_index(n), axis, 0.0);
        }
    }
    FreeSystem::new(edges, &zeros, &conditions)
}

/// Adds the stiffness of the tetrahedra of a range; the first range starts from zero.
fn assemble(
    tensors: &mut StiffnessTensors,
    edges: &MeshEdges,
    elements: &Elements,
    state: &LaggedState,
    tets: Range<usize>,
) {
    let factors = state.factors();
    if tets.start == 0 {
        tensors.vertex.fill(DMat3::ZERO);
        tensors.edge.fill(DMat3::ZERO);
    }
    for t in tets {
        let (nodes, stiffness) = state.stiffness(elements, t, factors);
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
