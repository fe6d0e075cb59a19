//! Work that takes a while: without Python's lock, told how far it is, ended by Ctrl + C.

use crate::errors::{guarded, of_shape};
use glisson::progress::watched;
use pyo3::PyErr;
use pyo3::prelude::*;
use std::ops::ControlFlow;
use std::sync::{Arc, Mutex, PoisonError};

/// [`done_or`] for images, surfaces and meshes.
pub(crate) fn done<T: Send>(
    py: Python<'_>,
    progress: Option<Py<PyAny>>,
    work: impl FnOnce() -> anyhow::Result<T> + Send,
) -> PyResult<T> {
    done_or(py, of_shape, progress, work)
}

/// Does `work`, whose errors are told by `error_of`; `progress` is called with the share of it that is done, 0 to 1. What it raises ends the work, and so does Ctrl + C.
pub(crate) fn done_or<T: Send>(
    py: Python<'_>,
    error_of: fn(&anyhow::Error) -> PyErr,
    progress: Option<Py<PyAny>>,
    work: impl FnOnce() -> anyhow::Result<T> + Send,
) -> PyResult<T> {
    let raised = Arc::new(Mutex::new(None));
    let heard = Arc::clone(&raised);
    let listener = move |share: f64| {
        let told = Python::attach(|py| {
            py.check_signals()?;
            if let Some(progress) = &progress {
                progress.call1(py, (share,))?;
            }
            Ok(())
        });
        match told {
            Ok(()) => ControlFlow::Continue(()),
            Err(error) => {
                *heard.lock().unwrap_or_else(PoisonError::into_inner) = Some(error);
                ControlFlow::Break(())
            }
        }
    };
    let done = py.detach(|| guarded(|| Ok(watched(listener, work)?)));
    let raised = raised.lock().unwrap_or_else(PoisonError::into_inner).take();
    match (raised, done) {
        (Some(error), _) => Err(error),
        (None, Ok(Ok(done))) => Ok(done),
        (None, Ok(Err(error)) | Err(error)) => Err(error_of(&error)),
    }
}
