//! Set-up: the basis, the coefficients, and the rest of the linear compliance.

use rayon::prelude::*;

use super::basis::HeldBody;
use super::cubic::ReducedForces;
use super::{Constants, NONE, Reduced, ReducedError, ReducedParams};
use crate::model::precomputed::StoredNodes;
use crate::solve::{
    BoundaryConditions, FreeSystem, MeshEdges, P1Gradients, SolveError, StiffnessTensors, add_gravity_forces,
    boundary_nodes,
};
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::{NodeId, TetId};

/// Loaded nodes in one block: 48 right-hand sides. The partition does not depend on the number of threads, so neither
/// do the bits.
const NODES_IN_BLOCK: usize = 16;

impl Reduced {
    /// Computes the model. Runs on the threads of the rayon pool it is called in; the bits do not depend on their
    /// number.
    ///
    /// # Errors
    /// [`ReducedError::Solve`] for a mesh or support without solution, [`ReducedError::NothingLoadable`],
    /// [`ReducedError::Sizes`], [`ReducedError::Memory`].
    pub fn build(params: &ReducedParams<'_>) -> Result<Self, ReducedError> {
        let ReducedParams { mesh, material, fixed, n_modes, n_reduced, loads, stored } = *params;
        let edges = MeshEdges::of_mesh(mesh)?;
        let tensors = StiffnessTensors::assemble(mesh, &edges, material)?;
        let mut conditions = BoundaryConditions::new();
        for node in fixed {
            (0..3).filter(|&a| node.axes[a]).for_each(|a| conditions.impose(node.node, a, 0.0));
        }
        conditions.check(mesh, &edges)?;
        let system = FreeSystem::new(&edges, &tensors, &conditions)?;
        let n_free = system.n_free();
        let sizes_fit = n_modes >= 1 && n_modes <= n_reduced && n_reduced <= Self::MAX_REDUCED.min(n_free);
        if !sizes_fit || loads.iter().any(|l| l.len() != mesh.positions_m.len()) {
            return Err(ReducedError::Sizes { n_modes, n_reduced, n_free });
        }
        let gradients: Result<Vec<P1Gradients>, SolveError> =
            (0..mesh.tetrahedra.len()).map(|t| P1Gradients::of_tet(mesh, TetId::from_index(t))).collect();
        let mut mass_kg = vec![0.0; mesh.positions_m.len()];
        for (t, nodes) in mesh.tetrahedra.iter().enumerate() {
            let corner_kg = material.density_kg_per_m3() * mesh.tet_volume_m3(TetId::from_index(t)) / 4.0;
            nodes.iter().for_each(|n| mass_kg[n.index()] += corner_kg);
        }
        let factor = system.factorize()?;
        let body =
            HeldBody { mesh, material, edges, tensors, gradients: gradients?, system, factor, mass_kg };

        let basis = body.basis(n_modes, loads, n_reduced);
        let modes: Vec<Vec<DVec3>> = basis.vectors.chunks_exact(n_free).map(|v| body.of_nodes(v)).collect();
        let forces = ReducedForces::project(&body, &modes, basis.squared_frequency_per_s2);
        let constants = Constants::new(&body, &modes, forces, stored)?;
        Ok(Self::new(constants))
    }
}

impl Constants {
    fn new(
        body: &HeldBody<'_>,
        modes: &[Vec<DVec3>],
        forces: ReducedForces,
        stored: StoredNodes,
    ) -> Result<Self, ReducedError> {
        let mesh = body.mesh;
        let n_nodes = mesh.positions_m.len();
        let (rows, n_loadable) = rows_of(body, stored)?;
        let mut row_of = vec![NONE; n_nodes];
        rows.iter().enumerate().for_each(|(row, node)| row_of[node.index()] = row as u32);

        let flat = |mode: &Vec<DVec3>| mode.iter().flat_map(|u| u.to_array()).collect::<Vec<f64>>();
        let mode_m: Vec<f64> = modes.iter().flat_map(flat).collect();
        let remainder_m_per_n =
            remainder(body, &mode_m, &forces.squared_frequency_per_s2, &rows[..n_loadable], &rows)?;
        let mut weight_n = [const { Vec::new() }; 3];
        for (axis, weight_n) in weight_n.iter_mut().enumerate() {
            weight_n.resize(n_nodes, DVec3::ZERO);
            add_gravity_forces(mesh, body.material, DVec3::AXES[axis], weight_n);
        }
        let project = |force: &Vec<DVec3>| -> Vec<f64> {
            let along = |mode: &Vec<DVec3>| mode.iter().zip(force).map(|(u, f)| u.dot(*f)).sum();
            modes.iter().map(along).collect()
        };
        let reduced_weight = [0, 1, 2].map(|axis| project(&weight_n[axis]));
        let weight_remainder = [0, 1, 2].map(|axis| {
            let mut answer = body.of_nodes(&body.answer_to(&weight_n[axis]));
            for ((mode, w), squared) in
                modes.iter().zip(&reduced_weight[axis]).zip(&forces.squared_frequency_per_s2)
            {
                answer.iter_mut().zip(mode).for_each(|(a, u)| *a -= *u * (w / squared));
            }
            by_axis(&rows, &answer)
        });
        Ok(Self {
            rest_m: mesh.positions_m.clone(),
            mass_kg: body.mass_kg.clone(),
            rows,
            row_of,
            n_loadable,
            mode_m,
            forces,
            remainder_m_per_n,
            reduced_weight,
            weight_remainder,
        })
    }
}

/// The stored nodes that move, loadable ones first, and the number of loadable ones.
fn rows_of(body: &HeldBody<'_>, stored: StoredNodes) -> Result<(Vec<NodeId>, usize), ReducedError> {
    let surface = boundary_nodes(body.mesh);
    let n_free_axes = |n: NodeId| (0..3).filter(|&a| body.system.row_of(n, a).is_some()).count();
    let mut rows: Vec<NodeId> = surface.iter().copied().filter(|&n| n_free_axes(n) == 3).collect();
    let n_loadable = rows.len();
    if n_loadable == 0 {
        return Err(ReducedError::NothingLoadable { n_surface: surface.len() });
    }
    let others = (0..body.mesh.positions_m.len()).map(NodeId::from_index).filter(|&n| {
        let is_surface = surface.binary_search(&n).is_ok();
        // Nodes that slide on a support move too, but cannot be loaded.
        n_free_axes(n) > 0
            && !(is_surface && n_free_axes(n) == 3)
            && (is_surface || stored == StoredNodes::All)
    });
    rows.extend(others);
    Ok((rows, n_loadable))
}

/// Displacements of the rows: all x, all y, all z.
fn by_axis(rows: &[NodeId], of_node: &[DVec3]) -> Vec<f64> {
    (0..3).flat_map(|axis| rows.iter().map(move |n| of_node[n.index()][axis])).collect()
}

/// The columns of K^-1 - V diag(1/omega^2) V^T for unit forces on the loadable nodes: node, force axis, displacement
/// axis, row.
fn remainder(
    body: &HeldBody<'_>,
    mode_m: &[f64],
    squared: &[f64],
    loadable: &[NodeId],
    rows: &[NodeId],
) -> Result<Vec<f64>, ReducedError> {
    let (s, n_free, n_nodes) = (rows.len(), body.system.n_free(), body.mesh.positions_m.len());
    let bytes = 72 * loadable.len() as u128 * s as u128;
    let mut columns = Vec::new();
    usize::try_from(bytes)
        .ok()
        .filter(|b| columns.try_reserve_exact(b / 8).is_ok())
        .ok_or(ReducedError::Memory { n_loadable: loadable.len(), n_rows: s, bytes })?;
    columns.resize(9 * loadable.len() * s, 0.0);
    columns.par_chunks_mut(9 * NODES_IN_BLOCK * s).enumerate().for_each_init(
        || (body.factor.scratch(3 * NODES_IN_BLOCK), vec![0.0; n_free * 3 * NODES_IN_BLOCK]),
        |(scratch, right), (block, target)| {
            let n_columns = target.len() / (3 * s);
            let right = &mut right[..n_free * n_columns];
            right.fill(0.0);
            let node_of = |column: usize| loadable[block * NODES_IN_BLOCK + column / 3];
            for column in 0..n_columns {
                let row = body.system.row_of(node_of(column), column % 3).expect("loadable nodes are free");
                right[column * n_free + row] = 1.0;
            }
            body.factor.solve_in_place(right, n_columns, scratch);
            for (column, target) in target.chunks_exact_mut(3 * s).enumerate() {
                let solution = &right[column * n_free..(column + 1) * n_free];
                for (row, node) in rows.iter().enumerate() {
                    for axis in 0..3 {
                        let free = body.system.row_of(*node, axis);
                        target[axis * s + row] = free.map_or(0.0, |f| solution[f]);
                    }
                }
                for (mode, squared) in mode_m.chunks_exact(3 * n_nodes).zip(squared) {
                    let factor = mode[3 * node_of(column).index() + column % 3] / squared;
                    for (row, node) in rows.iter().enumerate() {
                        for axis in 0..3 {
                            target[axis * s + row] -= factor * mode[3 * node.index() + axis];
                        }
                    }
                }
            }
        },
    );
    Ok(columns)
}
