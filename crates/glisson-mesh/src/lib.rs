//! From an image to tetrahedra and their edits.
//!
//! ```text
//! CT volume -> label map (image) -> closed surface (surface) -> tetrahedra (mesh) -> edits -> TopologyChange
//! ```
//!
//! The modules stand in data-flow order; a module uses only modules above it (`xtask/tests/layering.rs`).
//! Everything inside is SI and `f64`; positions are in the patient frame (LPS: +x left, +y posterior,
//! +z superior).

pub mod math;
pub mod fault;
pub mod progress;
pub mod text;
pub mod units;
pub mod files;
mod scan;
mod binary;
pub mod base64;
mod vtk_xml;
mod disjoint_sets;
pub mod image;
pub mod surface;
pub mod mesh;
