//! What can be wrong with a simplex mesh or with what it is made from.

use crate::math::DVec3;
use crate::surface::error::{Place, SurfaceError};

/// Why there is no simplex mesh, or why it is not valid.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SimplexError {
    /// The triangle mesh or the mask it starts from is unfit.
    #[error(transparent)]
    Surface(#[from] SurfaceError),
    /// A vertex of the triangle mesh that no triangle uses: it would be a cell without vertices.
    #[error("vertex {vertex} at {place} belongs to no triangle; remove it")]
    UnusedVertex {
        /// Which vertex, from 0.
        vertex: usize,
        /// Where it is.
        place: Place,
    },
    /// Two vertices of which only one names the other as its neighbour.
    #[error(
        "vertex {vertex} names {neighbour} as its neighbour {side}, which does not name it across the same two cells"
    )]
    NotMutual {
        /// Which vertex, from 0.
        vertex: usize,
        /// Which of its three neighbours.
        side: usize,
        /// The neighbour.
        neighbour: u32,
    },
    /// A contour that does not close after as many steps as its cell has vertices.
    #[error("the contour of cell {cell} has {found} vertices, but {expected} vertices name the cell")]
    BrokenContour {
        /// Which cell, from 0.
        cell: usize,
        /// Vertices on the way round.
        found: usize,
        /// Vertices that name the cell.
        expected: usize,
    },
    /// A cell of fewer than three vertices.
    #[error("cell {cell} has {found} vertices; at least 3 are needed")]
    SmallCell {
        /// Which cell, from 0.
        cell: usize,
        /// Its number of vertices.
        found: usize,
    },
    /// Two cells that meet along more than one edge: the dual would have a double edge.
    #[error("cells {cells:?} meet along {found} edges; at most one is allowed")]
    DoubleBorder {
        /// The two cells, ascending.
        cells: [u32; 2],
        /// Their common edges.
        found: usize,
    },
    /// A coordinate that is not a finite number.
    #[error("vertex {vertex} has the position {found_m:?} m; coordinates must be finite")]
    NotFinite {
        /// Which vertex, from 0.
        vertex: usize,
        /// Its position [m].
        found_m: DVec3,
    },
    /// A parameter out of its range.
    #[error("{name} is {found}; allowed: {allowed}")]
    Parameter {
        /// Which one.
        name: &'static str,
        /// Its value.
        found: f64,
        /// What is allowed.
        allowed: &'static str,
    },
    /// The caller asked to stop.
    #[error("the fit was stopped during {stage}")]
    Stopped {
        /// What was being done.
        stage: &'static str,
    },
}
