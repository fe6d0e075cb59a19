//! Cutting: pure functions from a blade's motion to mesh edits.

pub mod subdivision;
