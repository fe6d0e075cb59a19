//! Computing the compliance: sparse Cholesky, then unit forces in blocks of right-hand sides.

use std::sync::atomic::{AtomicUsize, Ordering};

use rayon::prelude::*;

use super::{Compliance, Precomputed, PrecomputedError, PrecomputedParams, StoredNodes, mesh_hash};
use crate::math::DVec3;
use crate::mesh::NodeId;
use crate::solve::{
    BoundaryConditions, Factorization, FreeSystem, MeshEdges, StiffnessTensors, add_gravity_forces,
    boundary_nodes,
};

/// Loaded nodes in one block: 48 right-hand sides, a multiple of the dense kernels' widths. The partition
/// into blocks does not depend on the number of threads, so neither do the bits.
const NODES_IN_BLOCK: usize = 16;

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
        let n_free = system.n_free();
        let row_of: Vec<[usize; 3]> = rows
            .iter()
            .map(|&n| [0, 1, 2].map(|a| system.row_of(n, a).expect("stored nodes are free")))
            .collect();

        let s = rows.len();
        let bytes = 72 * n_loadable as u128 * s as u128;
        let mut column_m_per_n = Vec::new();
        usize::try_from(bytes)
            .ok()
            .filter(|b| column_m_per_n.try_reserve_exact(b / 8).is_ok())
            .ok_or(PrecomputedError::Memory { n_loadable, n_rows: s, bytes })?;
        column_m_per_n.resize(9 * n_loadable * s, 0.0);

        let done = AtomicUsize::new(0);
        let columns_in_block = 3 * NODES_IN_BLOCK;
        column_m_per_n.par_chunks_mut(9 * NODES_IN_BLOCK * s).enumerate().for_each_init(
            || (factor.scratch(columns_in_block), vec![0.0; n_free * columns_in_block]),
            |(scratch, right), (block, target)| {
                let first = block * NODES_IN_BLOCK;
                let n_nodes = target.len() / (9 * s);
                let n_columns = 3 * n_nodes;
                let right = &mut right[..n_free * n_columns];
                right.fill(0.0);
                for column in 0..n_columns {
                    right[column * n_free + row_of[first + column / 3][column % 3]] = 1.0;
                }
                factor.solve_in_place(right, n_columns, scratch);
                for (column, target) in target.chunks_exact_mut(3 * s).enumerate() {
                    let solution = &right[column * n_free..(column + 1) * n_free];
                    for (row, free) in row_of.iter().enumerate() {
                        for axis in 0..3 {
                            target[axis * s + row] = solution[free[axis]];
                        }
                    }
                }
                let finished = done.fetch_add(n_nodes, Ordering::Relaxed) + n_nodes;
                if let Some(progress) = progress {
                    progress(finished, n_loadable);
                }
            },
        );
        let weight_response_s2 = weight_response(&system, &factor, params, &rows);
        let compliance = Compliance {
            material: *material,
            fixed_nodes,
            rows,
            n_loadable,
            mesh_hash: mesh_hash(mesh),
            column_m_per_n,
            weight_response_s2,
        };
        Ok(Self::new(compliance, mesh))
    }
}

/// Displacements of `rows` for the body's weight under gravity of 1 m/s2 along each axis.
fn weight_response(
    system: &FreeSystem,
    factor: &Factorization,
    params: &PrecomputedParams<'_>,
    rows: &[NodeId],
) -> Vec<f64> {
    let (n_free, s) = (system.n_free(), rows.len());
    let mut right = vec![0.0; 3 * n_free];
    let mut response = vec![0.0; 9 * s];
    let mut displacement = vec![DVec3::ZERO; params.mesh.positions_m.len()];
    for (axis, right) in right.chunks_exact_mut(n_free).enumerate() {
        let mut weight = vec![DVec3::ZERO; displacement.len()];
        add_gravity_forces(params.mesh, params.material, DVec3::AXES[axis], &mut weight);
        system.gather_into(&weight, right);
    }
    factor.solve_in_place(&mut right, 3, &mut factor.scratch(3));
    for (solution, target) in right.chunks_exact(n_free).zip(response.chunks_exact_mut(3 * s)) {
        displacement.fill(DVec3::ZERO);
        system.add_scattered(solution, &mut displacement);
        for (row, node) in rows.iter().enumerate() {
            for (axis, u) in displacement[node.index()].to_array().into_iter().enumerate() {
                target[axis * s + row] = u;
            }
        }
    }
    response
}
