//! The page for a new patient: from an image to a simulation, step by step in the browser.
//!
//! ```text
//! files -> upload -> Image -> organs (by points, contours or labels) -> tetrahedra -> scene file -> Simulation
//! ```
//!
//! Each step is also a command: `glisson import`, `segment`, `mesh`, `mesh-organs`, `serve`. What the patient is called is neither shown nor
//! written: the files that were dropped are deleted once they are read.

mod image;
mod organ;
mod tetrahedra;
mod mesh_picture;
mod scene;
mod upload;
mod steps;
mod api;

pub use api::serve;
pub use scene::SceneChoice;
pub use steps::{OpenSimulation, PatientPage};

#[cfg(test)]
mod tests;
