//! Computing the compliance: sparse Cholesky, then unit forces in blocks of right-hand sides.

use std::sync::atomic::{AtomicUsize, Ordering};

use super::table::{Numbers, Table, write_column};
use super::{Compliance, Precomputed, PrecomputedError, PrecomputedParams, StoredNodes, mesh_hash};
use crate::math::DVec3;
use crate::mesh::NodeId;
use crate::solve::{
    BoundaryConditions, Factorization, FreeSystem, MeshEdges, StiffnessTensors, add_gravity_forces,
    boundary_nodes, solve_columns_into,
};

impl Precomputed {
    /// Computes the compliance of a mesh. Runs on the threads of the rayon pool it is called in; the bits do
    /// not depend on their number.
    ///
    /// # Errors
    /// [`PrecomputedError::Solve`] for a mesh or support without solution (no fixed node, a floating piece),
    /// [`PrecomputedError::NothingLoadable`], [`PrecomputedError::Memory`].
    pub fn build(params: &PrecomputedParams<'_>) -> Result<Self, PrecomputedError> {
        let PrecomputedParams { mesh, material, stored, progress, .. } = *params;
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

        let system = FreeSystem::new(&edges, &tensors, &conditions)?;
        let factor = system.factorize()?;
        let unknowns: Vec<[usize; 3]> = rows
            .iter()
            .map(|&n| [0, 1, 2].map(|a| system.row_of(n, a).expect("stored nodes are free")))
            .collect();

        let n_rows = rows.len();
        let bytes = Table::bytes(params.precision, n_rows, n_loadable);
        let mut table = Table::zeros(params.precision, n_rows, n_loadable)
            .ok_or(PrecomputedError::Memory { n_loadable, n_rows, bytes })?;

        let done = AtomicUsize::new(0);
        let tell = || {
            let finished = done.fetch_add(1, Ordering::Relaxed) + 1;
            if let Some(progress) = progress {
                progress(finished, n_loadable);
            }
        };
        match &mut table.numbers {
            Numbers::F64(numbers) => solve_unit_forces(&factor, &unknowns, numbers, |u| u, tell),
            Numbers::F32(numbers) => solve_unit_forces(&factor, &unknowns, numbers, |u| u as f32, tell),
        }
        let weight_response_s2 = weight_response(&system, &factor, params, &rows);
        let compliance = Compliance {
            material: *material,
            fixed_nodes,
            rows,
            n_loadable,
            mesh_hash: mesh_hash(mesh),
            table,
            weight_response_s2,
        };
        Ok(Self::new(compliance, mesh))
    }
}

/// Fills a table's numbers: unit forces along each axis on the loadable nodes, which are the first of the rows.
/// `unknowns` are those of each row, `tell` hears of every node that is done.
fn solve_unit_forces<T: Send>(
    factor: &Factorization,
    unknowns: &[[usize; 3]],
    numbers: &mut [T],
    narrow: impl Fn(f64) -> T + Sync,
    tell: impl Fn() + Sync,
) {
    let n_free = factor.n_rows();
    solve_columns_into(
        factor,
        3,
        numbers,
        Table::stride(unknowns.len()),
        |column, right| right[unknowns[column / 3][column % 3]] = 1.0,
        |_, solutions, target| {
            for (axis, solution) in solutions.chunks_exact(n_free).enumerate() {
                let of_row = unknowns.iter().map(|free| free.map(|i| solution[i]));
                write_column(target, axis, of_row, &narrow);
            }
            tell();
        },
    );
}

/// Displacements of `rows` for the body's weight under gravity of 1 m/s2 along each axis.
fn weight_response(
    system: &FreeSystem,
    factor: &Factorization,
    params: &PrecomputedParams<'_>,
    rows: &[NodeId],
) -> Vec<f64> {
    let n_free = system.n_free();
    let mut right = vec![0.0; 3 * n_free];
    let mut response = vec![0.0; Table::stride(rows.len())];
    let mut displacement = vec![DVec3::ZERO; params.mesh.positions_m.len()];
    for (axis, right) in right.chunks_exact_mut(n_free).enumerate() {
        let mut weight = vec![DVec3::ZERO; displacement.len()];
        add_gravity_forces(params.mesh, params.material, DVec3::AXES[axis], &mut weight);
        system.gather_into(&weight, right);
    }
    factor.solve_in_place(&mut right, 3, &mut factor.scratch(3));
    for (axis, solution) in right.chunks_exact(n_free).enumerate() {
        displacement.fill(DVec3::ZERO);
        system.add_scattered(solution, &mut displacement);
        let of_row = rows.iter().map(|node| displacement[node.index()].to_array());
        write_column(&mut response, axis, of_row, |u| u);
    }
    response
}
