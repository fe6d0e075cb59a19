//! Training: what a session is measured by, and tasks.
//!
//! ```text
//! world after each step -> trace (100 samples a second) -> gestures, metrics, moments
//!                       -> goals of a task, stage by stage -> result
//! ```
//!
//! Nothing here changes a world, and all of it follows from the steps alone: a replay gives the same numbers.

pub mod surface_strain;
pub mod trace;
pub mod motion;
pub mod smoothness;
pub mod gestures;
pub mod moments;
pub mod metrics;
pub mod task;
