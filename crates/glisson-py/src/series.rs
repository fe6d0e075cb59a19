//! Moments of worlds for other programs.

use crate::errors::{SimulationError, of_simulation, try_lock};
use crate::world::PyWorld;
use glisson_view::recording::series::Series;
use pyo3::prelude::*;
use std::path::PathBuf;
use std::sync::Mutex;

/// Moments of a world as files that ParaView, PyVista and meshio read: a `.pvd` list, and in a folder beside it for each moment the
/// tetrahedra with displacement, velocity, strain and stress (`.vtu`), and the instruments with their forces (`.vtp`). Places are in mm.
///
/// Use it in a `with`, or close it: the list is written at the end.
#[pyclass(name = "Series", module = "glisson", frozen)]
pub(crate) struct PySeries {
    /// None when it was closed.
    series: Mutex<Option<Series>>,
}

impl PySeries {
    fn with<T>(&self, act: impl FnOnce(&mut Option<Series>) -> PyResult<T>) -> PyResult<T> {
        let mut series = try_lock(&self.series)
            .ok_or_else(|| SimulationError::new_err("another thread is writing to this series"))?;
        act(&mut series)
    }
}

#[pymethods]
impl PySeries {
    /// A list that ends in .pvd; the moments' files go to a folder beside it, where they overwrite others.
    #[new]
    fn new(path: PathBuf) -> PyResult<Self> {
        let series = Series::new(&path).map_err(|error| of_simulation(&error))?;
        Ok(Self { series: Mutex::new(Some(series)) })
    }

    /// Writes a world as it is now.
    fn add(&self, py: Python<'_>, world: &PyWorld) -> PyResult<()> {
        self.with(|series| {
            let series = series.as_mut().ok_or_else(|| SimulationError::new_err("this series was closed"))?;
            world.with(py, |runner| series.add(&runner.simulation))
        })
    }

    /// How many moments there are.
    fn __len__(&self) -> PyResult<usize> {
        self.with(|series| Ok(series.as_ref().map_or(0, Series::len)))
    }

    /// Writes the list. Closing twice does nothing.
    fn close(&self) -> PyResult<()> {
        self.with(|series| {
            // One whose list cannot be written stays open.
            series.as_ref().map_or(Ok(()), Series::finish).map_err(|error| of_simulation(&error))?;
            *series = None;
            Ok(())
        })
    }

    fn __enter__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    /// Closes it; what was written before an error is kept.
    #[pyo3(signature = (_kind, _error, _trace))]
    fn __exit__(
        &self,
        _kind: &Bound<'_, PyAny>,
        _error: &Bound<'_, PyAny>,
        _trace: &Bound<'_, PyAny>,
    ) -> PyResult<()> {
        self.close()
    }
}
