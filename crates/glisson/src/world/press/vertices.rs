//! The numbers of the vertices in the system of contacts: the touched nodes, then those by which instruments move, then those by
//! which they turn.

use super::{SIDES, VERTICES};
use crate::model::LocalModel;
use crate::tool::MAX_TOOLS;
use crate::world::parts::ToolPart;

pub(super) const MOST_NODES: usize = LocalModel::MOST_NODES;
const FIRST_TURN: usize = MOST_NODES + VERTICES * MAX_TOOLS;
pub(super) const N_VERTICES: usize = FIRST_TURN + MAX_TOOLS;

/// The vertex of a side of a tool's part, or of its jaws, in the system.
pub(super) fn vertex_of(place: usize, side: usize) -> u32 {
    (MOST_NODES + VERTICES * place + side) as u32
}

/// The vertex by which a tool turns about its tip.
pub(super) fn turn_vertex_of(place: usize) -> u32 {
    (FIRST_TURN + place) as u32
}

/// Place of a side of a part among a tool's vertices.
pub(super) fn side_of(part: ToolPart, side: usize) -> usize {
    SIDES * part.index() + side
}
