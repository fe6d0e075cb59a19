//! Real-time soft-tissue simulation: from a patient's image to an organ that one can push, grasp and cut.
//!
//! The modules stand in data-flow order; a module uses only modules above it
//! (`tests/all/layering.rs` reads this list and fails otherwise).
//! Everything inside is SI and `f64`; positions are in the patient frame (LPS: +x left, +y posterior,
//! +z superior).

pub mod math;
pub mod text;
pub mod units;
pub mod files;
pub mod image;
pub mod surface;
pub mod mesh;
pub mod material;
pub mod solve;
pub mod model;
pub mod contact;
pub mod tool;
pub mod haptics;
pub mod record;
pub mod world;
pub mod scene;
