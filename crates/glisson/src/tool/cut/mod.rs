//! Cutting: pure functions from a body, its present positions and a blade to edits of the mesh.

pub mod scalpel;
pub mod subdivision;
