//! What leaves the world: snapshots for viewers and reports, sessions for replay, and the state's hash (`model::StateHash`) for both.

pub mod inside;
pub mod parameter;
pub mod note;
pub mod session;
pub mod snapshot;
