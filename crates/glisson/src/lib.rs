//! The simulator: instruments touch, grasp, cut and tear an organ; forces come back.
//!
//! ```text
//! tool motion -> contact -> imposed displacements -> model's step -> reaction force -> haptics, report
//!             -> cut -> mesh edit -> TopologyChange -> model, surface
//! world -> record (snapshots, sessions, hash);  scene file -> world;  world -> training (metrics of a session)
//! ```
//!
//! The modules stand in data-flow order; a module uses only modules above it (`xtask/tests/layering.rs`).
//! What lies below is in two crates of their own, shown here under the same names: `glisson_mesh` (from an image to
//! tetrahedra and their edits) and `glisson_tissue` (how tissue deforms). One who simulates needs this crate alone.

pub use glisson_mesh::{base64, files, image, math, mesh, progress, surface, text, units};
pub use glisson_tissue::{material, model, solve, workers};

pub mod contact;
pub mod tool;
pub mod haptics;
pub mod suture;
pub mod record;
pub mod world;
pub mod scene;
pub mod training;
