//! Computing the compliance: sparse Cholesky, then unit forces in blocks of right-hand sides.

use std::sync::atomic::{AtomicUsize, Ordering};

use rayon::prelude::*;

use super::{Compliance, Precomputed, PrecomputedError, PrecomputedParams, StoredNodes, mesh_hash};
use crate::mesh::NodeId;
use crate::solve::{BoundaryConditions, FreeSystem, MeshEdges, StiffnessTensors, boundary_nodes};

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
        let compliance = Compliance {
            material: *material,
            fixed_nodes,
            rows,
            n_loadable,
            mesh_hash: mesh_hash(mesh),
            column_m_per_n,
        };
        Ok(Self::new(compliance, mesh))
    }
}
