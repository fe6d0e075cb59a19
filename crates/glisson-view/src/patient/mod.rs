//! The page for a new patient: from an image to a simulation, step by step in the browser. The steps are `glisson_patient`'s.
//!
//! ```text
//! files -> upload -> Patient (image, organs, tetrahedra) -> scene file -> Simulation
//! ```
//!
//! Each step is also a command: `glisson import`, `segment`, `mesh`, `mesh-organs`, `serve`. What the patient is called is neither shown nor
//! written: the files that were dropped are deleted once they are read.

mod upload;
mod steps;
mod api;

pub use api::serve;
pub use steps::{OpenSimulation, PatientPage};

#[cfg(test)]
mod tests;
