//! Positions in few bytes: whole numbers of a step, and these in as few bytes as they need. On the wire and in recordings.

pub mod numbers;
pub mod places;
