//! Constraints by Lagrange multipliers (seed `001`, eq. 2): displacements u and multipliers l of
//!
//! ```text
//! | K   C^T |  | u |   | f  |
//! | C   0   |  | l | = | u* |
//! ```
//!
//! with K the stiffness, f the forces and C u = u* the constraints, one per row. The seed has rows of a single 1 (one
//! displacement component each); here a row is any sum, so that points inside a triangle can be held too. -l is the
//! force that the constraints exert along their rows, C^T (-l) on the nodes.
//!
//! [`solve_lagrange_densely`] solves this system directly, with the supports as rows of C: the reference, for bodies of a few
//! hundred nodes. [`solve_lagrange`] eliminates the supports, factors K once and solves the Schur complement C K^-1 C^T of
//! the constraints.

use super::{
    Factorization, FreeSystem, MeshEdges, SolveError, StaticProblem, StiffnessTensors, solve_columns_into,
    solve_dense_in_place,
};
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::NodeId;

/// A weighted sum of displacement components that has a given value.
#[derive(Clone, Debug, PartialEq)]
pub struct LinearConstraint {
    /// Node, axis (0, 1, 2) and weight of each term.
    pub terms: Vec<(NodeId, usize, f64)>,
    /// What they sum up to [m].
    pub value_m: f64,
}

impl LinearConstraint {
    /// One displacement component.
    pub fn component(node: NodeId, axis: usize, displacement_m: f64) -> Self {
        Self { terms: vec![(node, axis, 1.0)], value_m: displacement_m }
    }

    /// All three components of a node.
    pub fn node(node: NodeId, displacement_m: DVec3) -> [Self; 3] {
        [0, 1, 2].map(|axis| Self::component(node, axis, displacement_m[axis]))
    }

    fn of(&self, displacement_m: &[DVec3]) -> f64 {
        self.terms.iter().map(|&(node, axis, weight)| weight * displacement_m[node.index()][axis]).sum()
    }
}

/// Why a body with constraints has no solution.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum LagrangeError {
    /// The body without the constraints.
    #[error(transparent)]
    Solve(#[from] SolveError),
    /// Constraints that contradict or repeat one another or the supports.
    #[error(
        "constraint {constraint} (from 0) says nothing that the supports and the constraints before it have not said, \
         or contradicts them"
    )]
    Dependent {
        /// Which one.
        constraint: usize,
    },
    /// The whole system is singular: constraints that depend on one another, or a body that floats.
    #[error("the system of {n_rows} rows is singular: constraints depend on one another, or the body floats")]
    Singular {
        /// Displacement components and constraints.
        n_rows: usize,
    },
}

/// Equilibrium under constraints.
#[derive(Clone, Debug, PartialEq)]
pub struct LagrangeSolution {
    /// Displacement of each node [m].
    pub displacement_m: Vec<DVec3>,
    /// Multiplier of each constraint [N]: the opposite of the force that it exerts.
    pub multiplier_n: Vec<f64>,
}

/// A pivot below this share of the largest entry counts as zero.
const LEAST_PIVOT: f64 = 1e-13;

fn check_constraints(
    problem: &StaticProblem<'_>,
    constraints: &[LinearConstraint],
) -> Result<(), SolveError> {
    let n_nodes = problem.mesh.positions_m.len();
    assert_eq!(problem.nodal_force_n.len(), n_nodes, "one force a node");
    for constraint in constraints {
        for &(node, axis, weight) in &constraint.terms {
            assert!(axis < 3, "axes are 0, 1, 2");
            if node.index() >= n_nodes {
                return Err(SolveError::ConditionOutOfRange { node, n_nodes });
            }
            if !(weight.is_finite() && constraint.value_m.is_finite()) {
                return Err(SolveError::NonFiniteCondition { node });
            }
        }
    }
    match problem.nodal_force_n.iter().position(|f| !f.is_finite()) {
        Some(n) => Err(SolveError::NonFiniteCondition { node: NodeId::from_index(n) }),
        None => Ok(()),
    }
}

/// Solves the whole system by Gaussian elimination, the supports as further rows. The body may be held by the
/// constraints alone. Cost: the cube of the number of components.
///
/// # Errors
/// [`LagrangeError`]; [`LagrangeError::Singular`] for whatever has no single solution.
///
/// # Panics
/// When there is not one force per node, or an axis is not 0, 1 or 2.
pub fn solve_lagrange_densely(
    problem: &StaticProblem<'_>,
    constraints: &[LinearConstraint],
) -> Result<LagrangeSolution, LagrangeError> {
    check_constraints(problem, constraints)?;
    let mesh = problem.mesh;
    let edges = MeshEdges::of_mesh(mesh)?;
    let tensors = StiffnessTensors::assemble(mesh, &edges, problem.material)?;
    let n_nodes = mesh.positions_m.len();
    let supports =
        problem.conditions.iter().map(|(node, axis, u_m)| LinearConstraint::component(node, axis, u_m));
    let all: Vec<LinearConstraint> = constraints.iter().cloned().chain(supports).collect();
    if let Some((node, ..)) = problem.conditions.iter().find(|(node, ..)| node.index() >= n_nodes) {
        return Err(SolveError::ConditionOutOfRange { node, n_nodes }.into());
    }

    let n = 3 * n_nodes + all.len();
    let mut matrix = vec![0.0; n * n];
    let mut add = |i: usize, j: usize, value: f64| matrix[n * j + i] += value;
    for a in 0..3 {
        for b in 0..3 {
            for (p, tensor) in tensors.vertex.iter().enumerate() {
                add(3 * p + a, 3 * p + b, tensor.col(b)[a]);
            }
            for ([p, j], tensor) in edges.nodes.iter().zip(&tensors.edge) {
                add(3 * p.index() + a, 3 * j.index() + b, tensor.col(b)[a]);
                add(3 * j.index() + b, 3 * p.index() + a, tensor.col(b)[a]);
            }
        }
    }
    // Constraints as large as the stiffness, for the pivots: l is then in this unit.
    let unit_n_per_m = tensors.vertex.iter().map(|b| b.x_axis.x).fold(0.0, f64::max);
    let mut right: Vec<f64> = problem.nodal_force_n.iter().flat_map(|f| f.to_array()).collect();
    for (row, constraint) in all.iter().enumerate() {
        for &(node, axis, weight) in &constraint.terms {
            let component = 3 * node.index() + axis;
            add(3 * n_nodes + row, component, weight * unit_n_per_m);
            add(component, 3 * n_nodes + row, weight * unit_n_per_m);
        }
        right.push(constraint.value_m * unit_n_per_m);
    }
    solve_dense_in_place(n, &mut matrix, &mut right, LEAST_PIVOT)
        .map_err(|_| LagrangeError::Singular { n_rows: n })?;
    let (components, multipliers) = right.split_at(3 * n_nodes);
    Ok(LagrangeSolution {
        displacement_m: components.chunks_exact(3).map(DVec3::from_slice).collect(),
        multiplier_n: multipliers[..constraints.len()].iter().map(|l| l * unit_n_per_m).collect(),
    })
}

/// Solves with the sparse factor of K, held by its supports, and the Schur complement of the constraints; one step of
/// iterative refinement.
///
/// # Errors
/// [`LagrangeError`] naming the fault: an unusable mesh, a piece that floats without the constraints, a dependent
/// constraint.
///
/// # Panics
/// When there is not one force per node, or an axis is not 0, 1 or 2.
pub fn solve_lagrange(
    problem: &StaticProblem<'_>,
    constraints: &[LinearConstraint],
) -> Result<LagrangeSolution, LagrangeError> {
    check_constraints(problem, constraints)?;
    let StaticProblem { mesh, conditions, nodal_force_n, .. } = *problem;
    let edges = MeshEdges::of_mesh(mesh)?;
    let tensors = StiffnessTensors::assemble(mesh, &edges, problem.material)?;
    conditions.check(mesh, &edges)?;
    let system = FreeSystem::new(&edges, &tensors, conditions)?;
    let factor = system.factorize()?;
    let m = constraints.len();
    let complement = Complement::of(&system, &factor, constraints)?;

    let mut displacement_m = vec![DVec3::ZERO; mesh.positions_m.len()];
    for (node, axis, value_m) in conditions.iter() {
        displacement_m[node.index()][axis] = value_m;
    }
    let mut multiplier_n = vec![0.0; m];
    let mut balance_n = vec![DVec3::ZERO; mesh.positions_m.len()];
    let mut free = vec![0.0; system.n_free()];
    let mut scratch = factor.scratch(1);
    // The first round solves, the second refines.
    for _ in 0..2 {
        tensors.force_into(&edges, &displacement_m, &mut balance_n);
        for (b, f) in balance_n.iter_mut().zip(nodal_force_n) {
            *b = *f - *b;
        }
        system.gather_into(&balance_n, &mut free);
        for (row, l) in complement.rows.iter().zip(&multiplier_n) {
            row.iter().for_each(|&(i, w)| free[i] -= w * l);
        }
        factor.solve_in_place(&mut free, 1, &mut scratch);
        let mut change: Vec<f64> = complement
            .rows
            .iter()
            .zip(constraints)
            .map(|(row, c)| times_row(row, &free) - (c.value_m - c.of(&displacement_m)))
            .collect();
        solve_dense_in_place(m, &mut complement.schur.clone(), &mut change, 0.0)
            .map_err(|constraint| LagrangeError::Dependent { constraint })?;
        for ((l, dl), x) in multiplier_n.iter_mut().zip(&change).zip(complement.columns()) {
            *l += dl;
            free.iter_mut().zip(x).for_each(|(u, x)| *u -= dl * x);
        }
        system.add_scattered(&free, &mut displacement_m);
    }
    Ok(LagrangeSolution { displacement_m, multiplier_n })
}

/// The constraints on the free components.
struct Complement {
    n_free: usize,
    /// C: free component and weight of each term.
    rows: Vec<Vec<(usize, f64)>>,
    /// K^-1 C^T, column after column.
    influence: Vec<f64>,
    /// C K^-1 C^T.
    schur: Vec<f64>,
}

impl Complement {
    /// # Errors
    /// [`LagrangeError::Dependent`].
    fn of(
        system: &FreeSystem,
        factor: &Factorization,
        constraints: &[LinearConstraint],
    ) -> Result<Self, LagrangeError> {
        let (n_free, m) = (system.n_free(), constraints.len());
        let rows: Vec<Vec<(usize, f64)>> = constraints
            .iter()
            .map(|c| c.terms.iter().filter_map(|&(n, a, w)| Some((system.row_of(n, a)?, w))).collect())
            .collect();
        if n_free == 0 && m > 0 {
            return Err(LagrangeError::Dependent { constraint: 0 });
        }
        let mut influence = vec![0.0; n_free * m];
        solve_columns_into(
            factor,
            1,
            &mut influence,
            n_free.max(1),
            |column, right| rows[column].iter().for_each(|&(i, w)| right[i] += w),
            |_, solution, out| out.copy_from_slice(solution),
        );
        let mut complement = Self { n_free, rows, influence, schur: Vec::new() };
        let rows = &complement.rows;
        let schur: Vec<f64> =
            complement.columns().flat_map(|x| rows.iter().map(move |row| times_row(row, x))).collect();
        if let Some(constraint) = first_dependent(m, &schur) {
            return Err(LagrangeError::Dependent { constraint });
        }
        complement.schur = schur;
        Ok(complement)
    }

    fn columns(&self) -> impl Iterator<Item = &[f64]> {
        self.influence.chunks_exact(self.n_free.max(1))
    }
}

fn times_row(row: &[(usize, f64)], x: &[f64]) -> f64 {
    row.iter().map(|&(i, w)| w * x[i]).sum()
}

/// The first constraint whose pivot in the Cholesky factor of the complement is rounding.
fn first_dependent(m: usize, schur: &[f64]) -> Option<usize> {
    let mut a = schur.to_vec();
    for k in 0..m {
        let pivot = a[m * k + k];
        if pivot.is_nan() || pivot <= LEAST_PIVOT * schur[m * k + k] {
            return Some(k);
        }
        for j in k + 1..m {
            let factor = a[m * j + k] / a[m * k + k];
            for i in k + 1..m {
                a[m * j + i] -= factor * a[m * k + i];
            }
        }
    }
    None
}
