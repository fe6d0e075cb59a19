//! The projected tangent at some past state, factored: the preconditioner.
//!
//! A new factor is made at once ([`Lagged::refresh`]), or ordered for a state and made in slices of about equal work, one a
//! step, while the old one serves ([`Lagged::order`], [`Lagged::advance`]). Both have the same bits. What a slice does follows
//! from counts alone: tetrahedra and the pattern of the factor.

use super::direct::Direct;
use super::elements::Elements;
use super::lagged_state::{Edited, LaggedState, NodeTerms};
use super::late::Late;
use super::params::Preconditioner;
use crate::model::NodalForce;
use crate::solve::{
    BoundaryConditions, FreeSystem, Given, LOCAL_EDGES, MeshEdges, SolveError, StiffnessTensors, TwoGrid,
};
use crate::workers::Workers;
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

/// Bodies of at least so many nodes that move take two grids: a choice from measurements (docs/bench.md).
const TWO_GRID_NODES: usize = 3_000;
/// Two grids solve in no more than so many iterations.
const MOST_ITERATIONS: u32 = 60;

/// What answers for the matrix.
#[derive(Clone)]
pub(super) enum Solver {
    Direct(Box<Direct>),
    TwoGrid(Box<TwoGrid>),
}

impl Preconditioner {
    /// Whether bodies with these axes take two grids.
    pub(super) fn is_two_grid(self, free_axes: &[DVec3]) -> bool {
        let n_moving = || free_axes.iter().filter(|free| **free != DVec3::ZERO).count();
        match self {
            Self::BySize => n_moving() >= TWO_GRID_NODES,
            Self::Factor => false,
            // Nothing moves in a body of fixed nodes.
            Self::TwoGrid => n_moving() > 0,
        }
    }
}

/// An inverse of per_mass M + per_stiffness K at a [`LaggedState`], exactly or about.
#[derive(Clone)]
pub(super) struct Lagged {
    pub(super) state: LaggedState,
    edges: MeshEdges,
    /// Edge of each of the six local edges, tetrahedron after tetrahedron as in [`Elements::tetrahedra`].
    tensors: StiffnessTensors,
    solver: Solver,
    next: Next,
    slice_work_ns: u64,
    /// What edits have changed since.
    late: Late,
}

/// What is being made in slices.
#[derive(Clone)]
struct Next {
    /// What it depends on; the slices done, zero while none is ordered.
    of: Pending,
    /// Tetrahedra whose stiffness is assembled.
    n_tets: usize,
    /// Whether they all are, and the solver has begun.
    is_assembled: bool,
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
    /// Pattern, order and values at a state.
    pub(super) fn new(of: &Edited<'_>, state: LaggedState) -> Result<Self, SolveError> {
        let edges = of.edges();
        let solver = if of.preconditioner.is_two_grid(of.free_axes) {
            Solver::TwoGrid(Box::new(TwoGrid::new(of.terms.rest_m, &edges, of.free_axes)?))
        } else {
            let system = system_of(&edges, of.free_axes)?;
            let pattern = system.pattern_of_factor()?;
            Solver::Direct(Box::new(Direct::new(system, pattern)?))
        };
        let mut lagged = Self::without_values(edges, solver, of.elements, state);
        lagged.fill(of.elements, of.terms, true)?;
        lagged.complete();
        Ok(lagged)
    }

    /// One whose values are still to be made for `state`.
    pub(super) fn without_values(
        edges: MeshEdges,
        solver: Solver,
        elements: &Elements,
        state: LaggedState,
    ) -> Self {
        let n_nodes = state.displacement_m.len();
        let tensors = StiffnessTensors::zeros(n_nodes, &edges);
        let next = Next { of: Pending { state: state.clone(), n_slices: 0 }, n_tets: 0, is_assembled: false };
        let of_solver_ns = match &solver {
            Solver::Direct(direct) => direct.work_ns(),
            Solver::TwoGrid(grids) => grids.work_ns(),
        };
        let work_ns = of_solver_ns
            + elements.tets().len() as u64 * elements.projection_work_ns()
            + n_nodes as u64 * NODE_WORK_NS;
        let slice_work_ns = work_ns.div_ceil(work_ns.div_ceil(SLICE_WORK_NS).clamp(1, MOST_SLICES));
        Self { state, edges, tensors, solver, next, slice_work_ns, late: Late::default() }
    }

    /// Once it has values: makes room for others, and for what a factor tells.
    pub(super) fn complete(&mut self) {
        match &mut self.solver {
            Solver::Direct(direct) => direct.complete(self.state.displacement_m.len()),
            Solver::TwoGrid(grids) => grids.complete(),
        }
    }

    /// Takes all of it, and leaves what solutions need, with the same values.
    pub(super) fn retire(&mut self) -> Self {
        let of_solutions = Self {
            state: self.state.clone(),
            edges: MeshEdges::default(),
            tensors: StiffnessTensors::default(),
            solver: match &self.solver {
                Solver::Direct(direct) => Solver::Direct(Box::new(direct.for_solutions())),
                Solver::TwoGrid(grids) => Solver::TwoGrid(Box::new(grids.for_solutions())),
            },
            next: Next {
                of: Pending { state: LaggedState::of_size(0, 0), n_slices: 0 },
                n_tets: 0,
                is_assembled: false,
            },
            slice_work_ns: self.slice_work_ns,
            late: self.late.clone(),
        };
        std::mem::replace(self, of_solutions)
    }

    /// The matrix at `self.state`, and its inverse.
    fn fill(
        &mut self,
        elements: &Elements,
        nodes: NodeTerms<'_>,
        is_checked: bool,
    ) -> Result<(), SolveError> {
        let all = 0..elements.tets().len();
        assemble(&mut self.tensors, &self.edges, elements, &self.state, all);
        nodes.add_to(&mut self.tensors.vertex, &self.state);
        match &mut self.solver {
            Solver::Direct(direct) => direct.fill(&self.tensors, is_checked),
            Solver::TwoGrid(grids) => grids.fill(&given(&self.tensors, nodes, &self.state)),
        }
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

    /// Recomputes the values at `self.state`, without allocation; drops those that are being made. False when the matrix has no
    /// factor.
    pub(super) fn refresh(&mut self, elements: &Elements, nodes: NodeTerms<'_>) -> bool {
        self.drop_pending();
        self.fill(elements, nodes, false).is_ok()
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
        self.next.is_assembled = false;
        match &mut self.solver {
            Solver::Direct(direct) => direct.restart(),
            Solver::TwoGrid(grids) => grids.restart(),
        }
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
        }
        if !std::mem::replace(&mut next.is_assembled, true) {
            nodes.add_to(&mut self.tensors.vertex, &next.of.state);
            if let Solver::Direct(direct) = &mut self.solver {
                direct.refill(&self.tensors);
            }
            work_ns = work_ns.saturating_sub(self.tensors.vertex.len() as u64 * NODE_WORK_NS);
        }
        let made = match &mut self.solver {
            Solver::Direct(direct) => direct.advance(&mut work_ns),
            Solver::TwoGrid(grids) => {
                grids.advance(&given(&self.tensors, nodes, &next.of.state), &mut work_ns)
            }
        };
        match made {
            Ok(false) => return Slice::Underway,
            Ok(true) => {}
            Err(_) => {
                self.drop_pending();
                return Slice::Failed;
            }
        }
        std::mem::swap(&mut self.state, &mut next.of.state);
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

    /// Overwrites `solution` with the inverse of the matrix times `right`, or about that, zero for components that are not free,
    /// and adds the answers of single nodes where edits have changed it since ([`Late`]): what preconditions.
    pub(super) fn apply_into(&mut self, workers: &dyn Workers, right: &[DVec3], solution: &mut [DVec3]) {
        self.with_late(right, solution, |grids, solution| grids.apply_into(workers, right, solution));
    }

    /// Whether a whole step by [`Self::apply_into`] leaves neither a net force nor a net moment on the body, but for what has changed
    /// since. A sum with the answers of single nodes is too long a step.
    pub(super) fn leaves_no_net_force(&self) -> bool {
        matches!(self.solver, Solver::TwoGrid(_)) && self.late.is_empty()
    }

    /// [`Self::apply_into`], with the inverse to a residual of this share of `right`; false where two grids did not reach that.
    pub(super) fn solve_into(
        &mut self,
        workers: &dyn Workers,
        right: &[DVec3],
        solution: &mut [DVec3],
        residual_share: f64,
    ) -> bool {
        let mut is_solved = true;
        self.with_late(right, solution, |grids, solution| {
            is_solved = grids.solve_into(workers, right, solution, (residual_share, MOST_ITERATIONS));
        });
        is_solved
    }

    /// By a factor, [`Self::solve_into`] for `right` that holds these forces, right at their nodes alone; false where there is none.
    pub(super) fn solve_at_into(
        &mut self,
        forces: &[NodalForce],
        right: &[DVec3],
        solution: &mut [DVec3],
    ) -> bool {
        let Solver::Direct(direct) = &mut self.solver else { return false };
        direct.solve_at_into(forces, right, solution);
        self.late.add_answers(right, solution);
        true
    }

    fn with_late(
        &mut self,
        right: &[DVec3],
        solution: &mut [DVec3],
        by_grids: impl FnOnce(&mut TwoGrid, &mut [DVec3]),
    ) {
        match &mut self.solver {
            Solver::Direct(direct) => direct.solve_into(right, solution),
            Solver::TwoGrid(grids) => {
                solution.fill(DVec3::ZERO);
                by_grids(grids, solution);
            }
        }
        self.late.add_answers(right, solution);
    }

    /// The factor, where there is one.
    pub(super) fn direct(&mut self) -> Option<&mut Direct> {
        match &mut self.solver {
            Solver::Direct(direct) => Some(direct),
            Solver::TwoGrid(_) => None,
        }
    }
}

/// What two grids are made from.
fn given<'a>(tensors: &'a StiffnessTensors, nodes: NodeTerms<'a>, state: &'a LaggedState) -> Given<'a> {
    Given { tensors, rest_m: nodes.rest_m, displacement_m: &state.displacement_m, is_held: &state.held }
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
