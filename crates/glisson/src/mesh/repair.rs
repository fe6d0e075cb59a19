//! Mending a mesh that cutting has spoilt: watched moves, collapse of short edges, local remeshing.

mod cavity;
mod collapse;
mod moving;
mod remesh;

pub use collapse::{CollapseParams, CollapseRefusal, collapse, short_surface_edges};
pub use moving::{Freedom, MoveLimits, MoveRefusal, WatchedMove, freedom, rest_place_m, watched_move};
pub use remesh::{RemeshParams, Repair, remesh, tets_below};
