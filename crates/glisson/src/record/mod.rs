//! What leaves the world: snapshots for viewers and reports, sessions for replay, hashes for both.

pub mod hash;
pub mod session;
pub mod snapshot;
