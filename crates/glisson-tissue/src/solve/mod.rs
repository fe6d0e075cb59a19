//! Finite elements: shape gradients, stiffness on vertices and edges, boundary conditions, sparse
//! Cholesky, static solutions, and the files of a static case.
//!
//! A linear static solution uses [`MeshEdges`] and [`StiffnessTensors`] (K as 3x3 blocks on vertices and edges, the form
//! that the tensor-mass model keeps), [`BoundaryConditions`], [`FreeSystem`] (the free rows of K in a fixed sparse pattern
//! with a slot for every block), [`Factorization`] and [`solve_static`]. Further solvers: [`solve_lagrange`] with
//! constraints on any components; [`IncompleteCholesky`] as in the papers; [`ElasticBody`] and [`solve_nonlinear`] for any
//! law; [`SmoothedBody`] and [`solve_nonlinear_smoothed`] without locking. [`equilibrating_stress`] is the stress in a body
//! that was imaged under load.

mod p1;
mod tensors;
mod boundary;
mod ordering;
mod supernodal;
mod supernodal_factor;
mod system;
mod aggregates;
mod two_grid;
mod columns;
mod static_problem;
mod dense;
mod lagrange;
mod conjugate_gradient;
mod supports;
mod equilibrating_stress;
mod nonlinear;
mod near_incompressible;
mod smoothed;
pub mod case;
pub mod integrators;

pub use boundary::BoundaryConditions;
pub use columns::solve_columns_into;
pub use conjugate_gradient::{CgReport, CgScratch, IncompleteCholesky};
pub use dense::solve_dense_in_place;
pub use equilibrating_stress::{
    equilibrating_stress, is_stable_under, stress_forces_into, stress_under_loads,
};
pub use lagrange::{
    LagrangeError, LagrangeSolution, LinearConstraint, solve_lagrange, solve_lagrange_densely,
};
pub use near_incompressible::{
    NodeAveraging, assemble_node_averaged, node_pressures_pa, solve_static_node_averaged,
};
pub use nonlinear::{
    ElasticBody, NonlinearError, NonlinearProblem, NonlinearSettings, NonlinearSolution, StepFailure,
    TangentKind, solve_nonlinear,
};
pub(crate) use nonlinear::{contracted_columns, contracted_rows};
pub use p1::{LOCAL_EDGES, P1Gradients, TetStiffness};
pub use smoothed::{
    SmoothedBody, Smoothing, node_deformation_gradients, solve_nonlinear_smoothed, solve_static_smoothed,
};
pub use static_problem::{StaticProblem, StaticSolution, add_gravity_forces, solve_static};
pub use supernodal::FactorScratch;
pub use supports::{Attachment, FixedNode, RestStress, stress_tensor_pa};
pub(crate) use system::{FactorPattern, NextFactor, Supernode};
pub use system::{Factorization, FreeSystem};
pub use tensors::{MeshEdges, StiffnessTensors, boundary_nodes};
pub(crate) use two_grid::{Given, TwoGrid};

use glisson_mesh::mesh::{NodeId, TetId};

/// Why a mesh with its supports has no solution.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SolveError {
    /// No tetrahedron at all.
    #[error("the mesh has no tetrahedron")]
    EmptyMesh,
    /// A tetrahedron names a node that does not exist.
    #[error("tetrahedron {tet} names node {node}, but there are {n_nodes} nodes (numbered from 0)")]
    NodeOutOfRange {
        /// Which tetrahedron.
        tet: TetId,
        /// The node it names.
        node: NodeId,
        /// Number of nodes.
        n_nodes: usize,
    },
    /// A node's position is not a number.
    #[error("node {node} lies at ({x}, {y}, {z}) m, which is not finite", x = position_m[0], y = position_m[1], z = position_m[2])]
    NonFinitePosition {
        /// Which node.
        node: NodeId,
        /// Its position [m].
        position_m: [f64; 3],
    },
    /// A tetrahedron is flat or inverted.
    #[error(
        "tetrahedron {tet} has volume {volume_m3} m3; allowed: above {least_m3:e} m3 (1e-12 of its longest edge \
         cubed). Check the mesh with `glisson check`"
    )]
    Volume {
        /// Which tetrahedron.
        tet: TetId,
        /// Its signed volume [m3].
        volume_m3: f64,
        /// Least volume [m3].
        least_m3: f64,
    },
    /// Nodes that belong to no tetrahedron.
    #[error(
        "{count} nodes belong to no tetrahedron (first: {first:?}) and have no stiffness: remove them or fix them"
    )]
    LooseNodes {
        /// How many.
        count: usize,
        /// The first ten.
        first: Vec<u32>,
    },
    /// A boundary condition or force names a node that does not exist.
    #[error(
        "a boundary condition or force names node {node}, but there are {n_nodes} nodes (numbered from 0)"
    )]
    ConditionOutOfRange {
        /// The node it names.
        node: NodeId,
        /// Number of nodes.
        n_nodes: usize,
    },
    /// A prescribed displacement or a force is not finite.
    #[error("a displacement or force at node {node} is not finite")]
    NonFiniteCondition {
        /// Which node.
        node: NodeId,
    },
    /// A piece of the mesh can move without deforming.
    #[error(
        "the piece of {piece_nodes} nodes around node {node} floats: {rigid_modes} of its 6 rigid motions are free \
         ({named}). Fix at least three of its nodes that do not lie on a line"
    )]
    Floating {
        /// Number of nodes of the piece.
        piece_nodes: usize,
        /// Its first node.
        node: NodeId,
        /// Dimension of the free rigid motions.
        rigid_modes: usize,
        /// Directions that take part in a free motion.
        named: String,
    },
    /// The matrix is singular for another reason: a hinge.
    #[error(
        "the stiffness matrix is singular: pieces that hang together by a vertex or an edge only can turn without \
         deforming. Check the mesh with `glisson check`"
    )]
    Singular,
    /// The sparse factorization ran out of memory or index range.
    #[error("the sparse factorization of {n_rows} rows failed: {reason}")]
    Factorization {
        /// Size of the system.
        n_rows: usize,
        /// What the solver says.
        reason: String,
    },
}
