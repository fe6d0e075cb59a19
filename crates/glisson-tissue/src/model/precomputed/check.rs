//! Comparison of a compliance with direct solutions.

use super::{Precomputed, PrecomputedError};
use crate::solve::{BoundaryConditions, FreeSystem, MeshEdges, StiffnessTensors};
use glisson_mesh::math::{DMat3, DVec3};
use glisson_mesh::mesh::TetMesh;

/// How far a compliance is from direct solutions and from its own transpose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ComplianceCheck {
    /// Loadable nodes whose three columns were compared with direct solutions.
    pub n_compared: usize,
    /// Its largest entry [m/N].
    pub largest_m_per_n: f64,
    /// Largest difference from a direct solution, over the largest entry.
    pub difference: f64,
    /// Largest difference between T_lm and the transpose of T_ml, over the largest entry; all pairs of loadable nodes.
    pub asymmetry: f64,
}

/// Rounds of iterative refinement of a direct solution: the residual of the second is rounding.
const REFINEMENTS: usize = 2;

fn largest_of(tensor: DMat3) -> f64 {
    // A value that is not a number counts as the largest.
    tensor.to_cols_array().into_iter().fold(0.0, |most, x| if x.abs() <= most { most } else { x.abs() })
}

/// Compares the columns of about `n_compared` evenly spaced loadable nodes with direct solutions, iteratively refined,
/// and the whole compliance with its transpose.
///
/// # Errors
/// [`PrecomputedError::Solve`] when the mesh has no solution.
///
/// # Panics
/// When the mesh has another number of nodes than that of the model, or the model was cut. For a mesh of another shape
/// the differences are large.
pub fn check_compliance(
    model: &Precomputed,
    mesh: &TetMesh,
    n_compared: usize,
) -> Result<ComplianceCheck, PrecomputedError> {
    assert_eq!(mesh.positions_m.len(), model.rest_m.len(), "the mesh of the model");
    assert!(!model.is_cut(), "the compliance followed cuts");
    let edges = MeshEdges::of_mesh(mesh)?;
    let tensors = StiffnessTensors::assemble(mesh, &edges, model.material())?;
    let conditions = BoundaryConditions::fixed(model.fixed_nodes());
    conditions.check(mesh, &edges)?;
    let system = FreeSystem::new(&edges, &tensors, &conditions)?;
    let factor = system.factorize()?;

    let loadable = model.loadable_nodes();
    let table = &model.compliance.table;
    let (mut largest, mut asymmetry, mut difference) = (0.0_f64, 0.0_f64, 0.0_f64);
    for l in 0..loadable.len() {
        for m in 0..=l {
            let there = table.tensor(l, m);
            largest = largest.max(largest_of(there));
            asymmetry = asymmetry.max(largest_of(there - table.tensor(m, l).transpose()));
        }
    }

    let stride = loadable.len().div_ceil(n_compared.max(1)).max(1);
    let mut free = vec![0.0; system.n_free()];
    let mut residual_n = vec![DVec3::ZERO; mesh.positions_m.len()];
    let mut scratch = factor.scratch(1);
    let chosen = (0..loadable.len()).step_by(stride);
    let n_compared = chosen.len();
    for m in chosen {
        for axis in 0..3 {
            let mut displacement_m = vec![DVec3::ZERO; mesh.positions_m.len()];
            for _ in 0..=REFINEMENTS {
                tensors.force_into(&edges, &displacement_m, &mut residual_n);
                residual_n.iter_mut().for_each(|r| *r = -*r);
                residual_n[loadable[m].index()] += DVec3::AXES[axis];
                system.gather_into(&residual_n, &mut free);
                factor.solve_in_place(&mut free, 1, &mut scratch);
                system.add_scattered(&free, &mut displacement_m);
            }
            for (row, node) in model.stored_nodes().iter().enumerate() {
                let off = table.tensor(row, m).col(axis) - displacement_m[node.index()];
                let off = off.abs().max_element();
                difference = if off <= difference { difference } else { off };
            }
        }
    }
    let [difference, asymmetry] = [difference, asymmetry].map(|x| x / largest);
    Ok(ComplianceCheck { n_compared, largest_m_per_n: largest, difference, asymmetry })
}
