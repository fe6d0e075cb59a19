//! Training: what a session is measured by.
//!
//! ```text
//! world after each step -> trace (100 samples a second) -> gestures, metrics, moments
//! ```
//!
//! Nothing here changes a world, and all of it follows from the steps alone: a replay gives the same numbers.

pub mod trace;
pub mod motion;
pub mod smoothness;
pub mod gestures;
pub mod moments;
pub mod metrics;
