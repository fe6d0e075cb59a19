//! The page for a new patient: from an image to a simulation, step by step in the browser.
//!
//! ```text
//! files -> upload -> Image -> organ (points in the image, or a label) -> tetrahedra -> scene file -> Simulation
//! ```
//!
//! Each step is also a command: `glisson import`, `segment`, `mesh`, `serve`. What the patient is called is neither shown nor
//! written: the files that were dropped are deleted once they are read.

mod api;
mod image;
mod scene;
mod upload;

pub use api::{OpenSimulation, PatientPage, serve};
pub use scene::SceneChoice;

#[cfg(test)]
mod tests;
