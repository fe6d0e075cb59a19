//! How tissue deforms.
//!
//! ```text
//! tetrahedra + material -> stiffness, forces (solve) -> model: a step takes loads and held nodes and gives displacements
//!                          TopologyChange -> model: the same without what was cut
//! ```
//!
//! The modules stand in data-flow order; a module uses only modules above it (`xtask/tests/layering.rs`).

pub mod workers;
pub mod material;
pub mod solve;
pub mod model;
