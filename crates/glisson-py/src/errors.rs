//! What goes wrong, as Python's exceptions with the program's own words.

use pyo3::PyErr;
use pyo3::create_exception;
use pyo3::exceptions::{PyRuntimeError, PyValueError};

create_exception!(
    glisson,
    SceneError,
    PyValueError,
    "A scene that cannot be read or built; the message says where and what to do."
);
create_exception!(
    glisson,
    SimulationError,
    PyRuntimeError,
    "Something that a world cannot do now, or a world that cannot go on."
);

/// A scene that cannot be read or built.
pub(crate) fn of_scene(error: &anyhow::Error) -> PyErr {
    SceneError::new_err(format!("{error:#}"))
}

/// Something that a world cannot do.
pub(crate) fn of_simulation(error: &anyhow::Error) -> PyErr {
    SimulationError::new_err(format!("{error:#}"))
}
