//! Computing the compliance: sparse Cholesky, then unit forces in blocks of right-hand sides.

use std::sync::atomic::{AtomicUsize, Ordering};

use super::table::{Numbers, Table, write_column};
use super::{Compliance, Precomputed, PrecomputedError, PrecomputedParams, StoredNodes, mesh_hash};
use crate::solve::{
    BoundaryConditions, Factorization, FreeSystem, MeshEdges, StiffnessTensors, add_gravity_forces,
    boundary_nodes, solve_columns_into,
};
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::NodeId;

/// Loadable nodes in a block of right-hand sides: a file keeps a checksum for each. Three columns a node make the
/// 48 that are solved at once, so that whole blocks have the same bits in memory and in a file, resumed or not.
pub(super) const NODES_IN_BLOCK: usize = 16;

/// The system, and which nodes are loaded and stored: all that is known before the first solution.
pub(super) struct Plan {
    pub(super) system: FreeSystem,
    /// Ascending.
    pub(super) fixed_nodes: Vec<NodeId>,
    /// Stored nodes: the loadable ones ascending, then the inner ones ascending.
    pub(super) rows: Vec<NodeId>,
    pub(super) n_loadable: usize,
}

/// A plan with its factor.
pub(super) struct Solver {
    factor: Factorization,
    /// Unknowns of each row.
    unknowns: Vec<[usize; 3]>,
    n_loadable: usize,
    done: AtomicUsize,
}

impl Plan {
    /// The plan for a body; refuses a body without a solution.
    pub(super) fn new(params: &PrecomputedParams<'_>) -> Result<Self, PrecomputedError> {
        let PrecomputedParams { mesh, material, stored, .. } = *params;
        let mut fixed_nodes = params.fixed_nodes.to_vec();
        fixed_nodes.sort_unstable();
        fixed_nodes.dedup();

        let edges = MeshEdges::of_mesh(mesh)?;
        let tensors = StiffnessTensors::assemble(mesh, &edges, material)?;
        let conditions = BoundaryConditions::fixed(&fixed_nodes);
        conditions.check(mesh, &edges)?;

        let surface = boundary_nodes(mesh);
        let is_fixed = |n: &NodeId| fixed_nodes.binary_search(n).is_ok();
        let mut rows: Vec<NodeId> = surface.iter().copied().filter(|n| !is_fixed(n)).collect();
        let n_loadable = rows.len();
        if n_loadable == 0 {
            return Err(PrecomputedError::NothingLoadable { n_surface: surface.len() });
        }
        if stored == StoredNodes::All {
            let inner = (0..mesh.positions_m.len())
                .map(NodeId::from_index)
                .filter(|n| !is_fixed(n) && surface.binary_search(n).is_err());
            rows.extend(inner);
        }
        let system = FreeSystem::for_many_solutions(&mesh.positions_m, &edges, &tensors, &conditions)?;
        Ok(Self { system, fixed_nodes, rows, n_loadable })
    }

    pub(super) fn factorize(&self) -> Result<Solver, PrecomputedError> {
        let factor = self.system.factorize()?;
        let unknown =
            |n: &NodeId| [0, 1, 2].map(|a| self.system.row_of(*n, a).expect("stored nodes are free"));
        let unknowns = self.rows.iter().map(unknown).collect();
        Ok(Solver { factor, unknowns, n_loadable: self.n_loadable, done: AtomicUsize::new(0) })
    }

    /// Displacements of the rows for the body's weight under gravity of 1 m/s2 along each axis.
    pub(super) fn weight_response_s2(&self, params: &PrecomputedParams<'_>, solver: &Solver) -> Vec<f64> {
        let n_free = self.system.n_free();
        let mut right = vec![0.0; 3 * n_free];
        let mut response = vec![0.0; Table::stride(self.rows.len())];
        let mut displacement = vec![DVec3::ZERO; params.mesh.positions_m.len()];
        for (axis, right) in right.chunks_exact_mut(n_free).enumerate() {
            let mut weight = vec![DVec3::ZERO; displacement.len()];
            add_gravity_forces(params.mesh, params.material, DVec3::AXES[axis], &mut weight);
            self.system.gather_into(&weight, right);
        }
        solver.factor.solve_in_place(&mut right, 3, &mut solver.factor.scratch(3));
        for (axis, solution) in right.chunks_exact(n_free).enumerate() {
            displacement.fill(DVec3::ZERO);
            self.system.add_scattered(solution, &mut displacement);
            let of_row = self.rows.iter().map(|node| displacement[node.index()].to_array());
            write_column(&mut response, axis, of_row, |u| u);
        }
        response
    }
}

impl Solver {
    /// Reports `n` more nodes as done.
    pub(super) fn skip(&self, n: usize, params: &PrecomputedParams<'_>) {
        self.done.fetch_add(n, Ordering::Relaxed);
        if let Some(progress) = params.progress {
            progress(n, self.n_loadable);
        }
    }

    /// Fills the columns of some loadable nodes, from `first` on, which starts a block: the responses to unit forces along
    /// each axis. Loadable nodes are the first of the rows.
    pub(super) fn fill<T: Send>(
        &self,
        params: &PrecomputedParams<'_>,
        first: usize,
        numbers: &mut [T],
        narrow: impl Fn(f64) -> T + Sync,
    ) {
        assert_eq!(first % NODES_IN_BLOCK, 0, "whole blocks");
        let n_free = self.factor.n_rows();
        solve_columns_into(
            &self.factor,
            3,
            numbers,
            Table::stride(self.unknowns.len()),
            |column, right| right[self.unknowns[first + column / 3][column % 3]] = 1.0,
            |_, solutions, target| {
                for (axis, solution) in solutions.chunks_exact(n_free).enumerate() {
                    let of_row = self.unknowns.iter().map(|free| free.map(|i| solution[i]));
                    write_column(target, axis, of_row, &narrow);
                }
                let finished = self.done.fetch_add(1, Ordering::Relaxed) + 1;
                if let Some(progress) = params.progress {
                    progress(finished, self.n_loadable);
                }
            },
        );
    }
}

impl Precomputed {
    /// Computes the compliance of a mesh. Runs on the threads of the rayon pool it is called in; the bits do
    /// not depend on their number.
    ///
    /// # Errors
    /// [`PrecomputedError::Solve`] for a mesh or support without solution (no fixed node, a floating piece),
    /// [`PrecomputedError::NothingLoadable`], [`PrecomputedError::Memory`].
    pub fn build(params: &PrecomputedParams<'_>) -> Result<Self, PrecomputedError> {
        let plan = Plan::new(params)?;
        let solver = plan.factorize()?;
        let (n_rows, n_loadable) = (plan.rows.len(), plan.n_loadable);
        let bytes = Table::bytes(params.precision, n_rows, n_loadable);
        let mut table = Table::zeros(params.precision, n_rows, n_loadable)
            .ok_or(PrecomputedError::Memory { n_loadable, n_rows, bytes })?;
        match &mut table.numbers {
            Numbers::F64(numbers) => solver.fill(params, 0, numbers, |u| u),
            Numbers::F32(numbers) => solver.fill(params, 0, numbers, |u| u as f32),
        }
        let weight_response_s2 = plan.weight_response_s2(params, &solver);
        let compliance = Compliance {
            material: *params.material,
            fixed_nodes: plan.fixed_nodes,
            rows: plan.rows,
            n_loadable,
            mesh_hash: mesh_hash(params.mesh),
            table,
            weight_response_s2,
        };
        Ok(Self::new(compliance, params.mesh))
    }
}
