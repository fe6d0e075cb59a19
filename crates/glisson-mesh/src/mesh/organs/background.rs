//! The lattice over all organs: even, or refined where smaller cells are wanted.

use super::bisection::{Graded, graded};
use super::cell_size::CellSize;
use crate::math::DVec3;
use crate::mesh::stuffing::Lattice;

/// Nodes and tetrahedra whose corners are given regions.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Background {
    Even(Lattice),
    Graded(Box<Graded>, f64),
}

impl Background {
    /// `lattice`, which has the largest cells, refined to `size`; none where that would be too many tetrahedra.
    pub(super) fn new(lattice: Lattice, size: &CellSize<'_>) -> Option<Self> {
        if size.is_even() {
            return Some(Self::Even(lattice));
        }
        Some(Self::Graded(Box::new(graded(&lattice, size)?), lattice.cell_m))
    }

    pub(super) fn n_nodes(&self) -> usize {
        match self {
            Self::Even(lattice) => lattice.n_nodes(),
            Self::Graded(graded, _) => graded.positions_m.len(),
        }
    }

    /// Position of a node [m].
    pub(super) fn position_m(&self, node: usize) -> DVec3 {
        match self {
            Self::Even(lattice) => lattice.position_m(node),
            Self::Graded(graded, _) => graded.positions_m[node],
        }
    }

    /// Calls `visit` with the nodes of every tetrahedron.
    pub(super) fn for_each_tet(&self, mut visit: impl FnMut([usize; 4])) {
        match self {
            Self::Even(lattice) => lattice.for_each_tet(visit),
            Self::Graded(graded, _) => graded.tets.iter().for_each(|tet| visit(tet.map(|n| n as usize))),
        }
    }

    /// Whether a node is away from the border.
    pub(super) fn is_interior(&self, node: usize) -> bool {
        match self {
            Self::Even(lattice) => lattice.is_interior(node, 1),
            Self::Graded(graded, _) => graded.is_interior[node],
        }
    }

    /// Nodes that share an edge with each of some interior nodes.
    pub(super) fn neighbours_of(&self, nodes: &[usize]) -> Vec<Vec<usize>> {
        match self {
            Self::Even(lattice) => nodes.iter().map(|&node| lattice.neighbours(node).to_vec()).collect(),
            Self::Graded(graded, _) => graded.neighbours_of(nodes),
        }
    }

    /// Size of the cells around a node [m].
    pub(super) fn cell_at_m(&self, node: usize) -> f64 {
        match self {
            Self::Even(lattice) => lattice.cell_m,
            Self::Graded(graded, _) => graded.cell_m[node],
        }
    }

    /// Volume of a node over that of a node of the largest cells.
    pub(super) fn weight(&self, node: usize) -> f64 {
        match self {
            Self::Even(_) => 1.0,
            Self::Graded(graded, largest_m) => {
                graded.volume_m3[node] / (0.5 * largest_m * largest_m * largest_m)
            }
        }
    }
}
