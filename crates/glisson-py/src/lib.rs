//! Glisson for Python.
//!
//! ```text
//! Scene (a file, a text, a task) -> World (one) or Worlds (many, on threads): steps without the GIL
//!                                -> arrays: copies that belong to Python, read-only
//! Image -> Labels -> Surface -> Mesh -> Solution (images.rs, meshes.rs, statics.rs)
//! ```
//!
//! What Python code needs beyond that is Python itself (`python/glisson`): environments for learning, the viewer.

#![expect(clippy::needless_pass_by_value, reason = "what Python gives is taken by value")]

mod errors;
mod runner;
mod arrays;
mod work;
mod images;
mod meshes;
mod statics;
mod validation;
mod program;
mod scene;
mod sessions;
mod world;
mod worlds;
mod series;
mod viewer;

use pyo3::prelude::*;

/// The native part of the package `glisson`.
#[pymodule]
fn _glisson(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add("MAX_TOOLS", glisson::tool::MAX_TOOLS)?;
    module.add("POSE_LENGTH", arrays::POSE_LENGTH)?;
    module.add("SceneError", module.py().get_type::<errors::SceneError>())?;
    module.add("SimulationError", module.py().get_type::<errors::SimulationError>())?;
    module.add("MeshError", module.py().get_type::<errors::MeshError>())?;
    module.add_class::<images::PyImage>()?;
    module.add_class::<images::PyLabels>()?;
    module.add_class::<meshes::PySurface>()?;
    module.add_class::<meshes::PyMesh>()?;
    module.add_class::<statics::PySolution>()?;
    module.add_class::<scene::PyScene>()?;
    module.add_class::<world::PyWorld>()?;
    module.add_class::<world::PySaved>()?;
    module.add_class::<worlds::PyWorlds>()?;
    module.add_class::<series::PySeries>()?;
    module.add_class::<viewer::PyViewer>()?;
    module.add_function(wrap_pyfunction!(images::segment, module)?)?;
    module.add_function(wrap_pyfunction!(meshes::surface_of, module)?)?;
    module.add_function(wrap_pyfunction!(meshes::mesh, module)?)?;
    module.add_function(wrap_pyfunction!(meshes::check, module)?)?;
    module.add_function(wrap_pyfunction!(statics::solve, module)?)?;
    module.add_function(wrap_pyfunction!(validation::validate, module)?)?;
    module.add_function(wrap_pyfunction!(validation::validation_groups, module)?)?;
    module.add_function(wrap_pyfunction!(scene::task_names, module)?)?;
    module.add_function(wrap_pyfunction!(program::run_program, module)?)?;
    module.add_function(wrap_pyfunction!(program::_run_main, module)?)?;
    module.add_function(wrap_pyfunction!(sessions::replay_session, module)?)?;
    module.add_function(wrap_pyfunction!(sessions::_replay_page, module)?)?;
    Ok(())
}
