//! The program itself.

use crate::errors::{guarded, of_simulation};
use pyo3::prelude::*;
use std::ffi::OsString;
use std::path::PathBuf;

fn run(py: Python<'_>, arguments: Vec<PathBuf>) -> PyResult<u8> {
    let words = arguments.into_iter().map(PathBuf::into_os_string);
    let words = std::iter::once(OsString::from("glisson")).chain(words);
    py.detach(|| guarded(|| Ok(glisson_cli::run_program(words)))).map_err(|error| of_simulation(&error))
}

/// Runs the program `glisson` with these words, as `glisson mesh liver.nrrd` has them: `run_program(["mesh", "liver.nrrd"])`.
///
/// It tells on the standard streams what comes of it, and answers the exit code: 0 done, 1 the work failed, 2 the words are wrong, 3 the
/// simulation broke by a fault of the program. Verbs that run until Ctrl + C (`serve`, `start`) belong into a process of their own.
#[pyfunction]
pub(crate) fn run_program(py: Python<'_>, arguments: Vec<PathBuf>) -> PyResult<u8> {
    run(py, arguments)
}

/// The same in a process that is nothing else: it ends where nobody reads what is told.
#[pyfunction]
pub(crate) fn _run_main(py: Python<'_>, arguments: Vec<PathBuf>) -> PyResult<u8> {
    glisson_cli::leave_closed_pipes_quietly();
    run(py, arguments)
}
