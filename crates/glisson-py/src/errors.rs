//! What goes wrong, as Python's exceptions with the program's own words.

use glisson_runtime::simulation::panic_text;
use pyo3::PyErr;
use pyo3::create_exception;
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Mutex, MutexGuard, TryLockError};

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

create_exception!(
    glisson,
    MeshError,
    PyValueError,
    "An image, a surface or a mesh that cannot be read, made or solved; the message says where and what to do."
);

/// A scene that cannot be read or built.
pub(crate) fn of_scene(error: &anyhow::Error) -> PyErr {
    SceneError::new_err(format!("{error:#}"))
}

/// An image, a surface or a mesh that is not what is needed.
pub(crate) fn of_shape(error: &anyhow::Error) -> PyErr {
    MeshError::new_err(format!("{error:#}"))
}

/// Something that a world cannot do.
pub(crate) fn of_simulation(error: &anyhow::Error) -> PyErr {
    SimulationError::new_err(format!("{error:#}"))
}

/// Does something that may break: a panic is told as an error, and does not end the interpreter's thread.
pub(crate) fn guarded<T>(act: impl FnOnce() -> anyhow::Result<T>) -> anyhow::Result<T> {
    catch_unwind(AssertUnwindSafe(act)).unwrap_or_else(|panic| {
        let words = panic_text(panic.as_ref());
        Err(anyhow::anyhow!("the program broke: {words}. Please report this with the scene"))
    })
}

/// Takes a lock that nobody has; what broke while it was held does not matter any more. `None`: somebody has it.
pub(crate) fn try_lock<T>(mutex: &Mutex<T>) -> Option<MutexGuard<'_, T>> {
    match mutex.try_lock() {
        Ok(guard) => Some(guard),
        Err(TryLockError::Poisoned(poisoned)) => Some(poisoned.into_inner()),
        Err(TryLockError::WouldBlock) => None,
    }
}
