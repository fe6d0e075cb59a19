//! Mending a mesh that cutting has spoilt: watched moves, collapse of short edges, local remeshing.

mod cavity;
mod collapse;
mod mending;
mod moving;
mod remesh;
mod sliding;

pub use collapse::{CollapseParams, CollapseRefusal, collapse, short_surface_edges};
pub use mending::{MendParams, Mending, mending};
pub use moving::{Freedom, MoveLimits, MoveRefusal, WatchedMove, freedom, rest_place_m, watched_move};
pub use remesh::{RemeshParams, Repair, remesh, remesh_around, tets_below};
pub use sliding::slide;
