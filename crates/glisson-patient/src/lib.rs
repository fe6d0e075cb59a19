//! A new patient, step by step: from an image to the scene of a simulation, as the page asks for it, of a server or of its own Worker.
//!
//! ```text
//! files -> Image -> organs (by points, contours or labels) -> tetrahedra -> scene file
//! ```
//!
//! Each step is also a command: `glisson import`, `segment`, `mesh`, `mesh-organs`. What the patient is called is neither shown nor
//! written.

mod files;
mod image;
mod organ;
mod tetrahedra;
mod mesh_picture;
mod scene;
mod steps;

pub use files::image_among;
pub use organ::Outline;
pub use scene::{SCENE_NAME, SceneChoice, meshes_in};
pub use steps::{Change, Drawing, Opened, Patient, Step};
