//! Exchange of tetrahedra for others whose descent is known.

use super::{CavityNode, NewNode};
use crate::mesh::TetId;

/// Tetrahedra that make room for others in the same place. Unlike in a retetrahedralisation the parents are
/// given, triangles of the surface may be divided, and triangles within may open (their nodes come twice).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Replacement {
    /// The tetrahedra that make room; live, each once.
    pub tets: Vec<TetId>,
    /// Nodes that come in.
    pub new_nodes: Vec<NewNode>,
    /// The tetrahedra that take the place.
    pub new_tets: Vec<NewTet>,
}

/// A tetrahedron that comes in.
#[derive(Clone, Debug, PartialEq)]
pub struct NewTet {
    /// Its corners; the volume at rest is positive.
    pub corners: [CavityNode; 4],
    /// Tetrahedra of [`Replacement::tets`] in whose place it is, with their shares of its volume (sum 1).
    pub parents: Vec<(TetId, f64)>,
}
