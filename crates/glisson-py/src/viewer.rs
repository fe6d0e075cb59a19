//! The page before a world that Python steps.

use crate::arrays::{POSE_LENGTH, numbers_of, poses_of, read_only};
use crate::errors::SimulationError;
use crate::world::PyWorld;
use anyhow::Context;
use glisson_view::server::passive::PassiveServer;
use numpy::{PyArray2, PyReadonlyArrayDyn};
use pyo3::prelude::*;
use std::sync::{Mutex, PoisonError};

const CLOSED: &str = "this viewer was closed: launch another one";

/// Pages that show a world while Python steps it; `glisson.viewer.launch_passive` makes it.
#[pyclass(name = "Viewer", module = "glisson", frozen)]
pub(crate) struct PyViewer {
    /// None when it was closed.
    server: Mutex<Option<Shown>>,
    world: Py<PyWorld>,
    address: String,
}

/// What serves the pages, and how often the world had gone back when it was shown last.
struct Shown {
    server: PassiveServer,
    n_returns: u64,
}

impl PyViewer {
    fn with<T: Send>(
        &self,
        py: Python<'_>,
        act: impl FnOnce(&mut PassiveServer) -> PyResult<T> + Send,
    ) -> PyResult<T> {
        py.detach(|| {
            let mut server = self.server.lock().unwrap_or_else(PoisonError::into_inner);
            let shown = server.as_mut().ok_or_else(|| SimulationError::new_err(CLOSED))?;
            act(&mut shown.server)
        })
    }
}

#[pymethods]
impl PyViewer {
    #[new]
    #[pyo3(signature = (world, host = "127.0.0.1", port = 0, token = None))]
    fn new(
        py: Python<'_>,
        world: Py<PyWorld>,
        host: &str,
        port: u16,
        token: Option<String>,
    ) -> PyResult<Self> {
        let shown = world.get().with(py, |runner| {
            let server = PassiveServer::start(&runner.simulation, host, port, token)?;
            Ok(Shown { server, n_returns: runner.n_returns() })
        })?;
        Ok(Self { address: shown.server.address().to_owned(), server: Mutex::new(Some(shown)), world })
    }

    /// Where the page is.
    #[getter]
    fn address(&self) -> &str {
        &self.address
    }

    /// Where the page is for who teaches: draws on the tissue, takes control, stops time.
    #[getter]
    fn teacher_address(&self, py: Python<'_>) -> PyResult<String> {
        self.with(py, |server| Ok(server.teacher_address().to_owned()))
    }

    /// Takes what pages asked, and shows the world as it is now; more often than a display it shows nothing new. Call it after each step.
    fn sync(&self, py: Python<'_>) -> PyResult<()> {
        self.world.get().with(py, |runner| {
            let mut server = self.server.lock().unwrap_or_else(PoisonError::into_inner);
            let shown = server.as_mut().context(CLOSED)?;
            if shown.n_returns != runner.n_returns() {
                shown.n_returns = runner.n_returns();
                shown.server.went_back();
            }
            shown.server.sync(&mut runner.simulation);
            Ok(())
        })
    }

    /// Whether somebody looks, or nobody has yet: false after `close`, and 10 s after the last page has gone.
    fn is_running(&self, py: Python<'_>) -> PyResult<bool> {
        py.detach(|| {
            let server = self.server.lock().unwrap_or_else(PoisonError::into_inner);
            Ok(server.as_ref().is_some_and(|shown| shown.server.is_running()))
        })
    }

    /// How many pages look.
    #[getter]
    fn watchers(&self, py: Python<'_>) -> PyResult<usize> {
        self.with(py, |server| Ok(server.n_watchers()))
    }

    /// Whether a page asked time to stand still.
    #[getter]
    fn is_paused(&self, py: Python<'_>) -> PyResult<bool> {
        self.with(py, |server| Ok(server.asked().is_paused))
    }

    /// How many single steps pages asked for.
    #[getter]
    fn n_steps(&self, py: Python<'_>) -> PyResult<u64> {
        self.with(py, |server| Ok(server.asked().n_steps))
    }

    /// How often pages asked everything to go back to rest.
    #[getter]
    fn n_resets(&self, py: Python<'_>) -> PyResult<u64> {
        self.with(py, |server| Ok(server.asked().n_resets))
    }

    /// Numbers of the instruments that a page has moved.
    #[getter]
    fn in_hand(&self, py: Python<'_>) -> PyResult<Vec<usize>> {
        let poses = self.with(py, |server| Ok(server.asked().poses))?;
        Ok((0..poses.len()).filter(|&tool| poses[tool].is_some()).collect())
    }

    /// Poses (instruments, 9) for `World.step`: `poses`, but for those instruments that a page has moved, which are where it has them.
    fn poses(&self, py: Python<'_>, poses: PyReadonlyArrayDyn<'_, f64>) -> PyResult<Py<PyArray2<f64>>> {
        let n_tools = self.world.get().n_tools();
        let wanted = poses_of(&poses, (None, n_tools))?;
        let asked = self.with(py, |server| Ok(server.asked().poses))?;
        let chosen = wanted[0].iter().zip(&asked).map(|(wanted, asked)| asked.as_ref().unwrap_or(wanted));
        Ok(read_only(py, chosen.flat_map(numbers_of).collect(), POSE_LENGTH)?.unbind())
    }

    /// Lets go of an instrument that a page had moved.
    fn let_go(&self, py: Python<'_>, tool: usize) -> PyResult<()> {
        self.with(py, |server| {
            server.let_go(tool);
            Ok(())
        })
    }

    /// Ends the pages; closing twice does nothing.
    fn close(&self, py: Python<'_>) -> PyResult<()> {
        py.detach(|| {
            // Taken first: whoever waits for it need not wait for the pages' end.
            let shown = self.server.lock().unwrap_or_else(PoisonError::into_inner).take();
            drop(shown);
        });
        Ok(())
    }

    fn __enter__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    #[pyo3(signature = (_kind, _error, _trace))]
    fn __exit__(
        &self,
        py: Python<'_>,
        _kind: &Bound<'_, PyAny>,
        _error: &Bound<'_, PyAny>,
        _trace: &Bound<'_, PyAny>,
    ) -> PyResult<()> {
        self.close(py)
    }

    /// The page in a notebook, as high as a picture.
    fn _repr_html_(&self) -> String {
        format!(
            "<iframe src=\"{}\" width=\"100%\" height=\"600\" style=\"border: 0\"></iframe>",
            self.address
        )
    }

    fn __repr__(&self) -> String {
        format!("<glisson.Viewer at {}>", self.address)
    }
}
