//! Mending a mesh that cutting has spoilt.

mod moving;

pub use moving::{Freedom, MoveLimits, MoveRefusal, WatchedMove, freedom, rest_place_m, watched_move};
