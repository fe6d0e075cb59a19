//! Many worlds at once.

use crate::arrays::{POSE_LENGTH, gathered, numbers_of, picture_kind, poses_of};
use crate::errors::{SimulationError, guarded, of_scene, of_simulation, try_lock};
use crate::runner::{Runner, Saved};
use crate::scene::PyScene;
use glisson::math::DVec3;
use glisson::tool::ToolInput;
use glisson_runtime::workers::side_by_side;
use numpy::{PyArray1, PyArray2, PyArray3, PyArray4, PyReadonlyArray2, PyReadonlyArrayDyn};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// A world of many.
struct Place {
    runner: Runner,
    /// At rest, as it was made.
    start: Saved,
    /// Surface nodes whose places are asked for.
    tracked: Vec<usize>,
}

/// Many worlds of one scene or several with as many instruments, stepped on threads: `threads` of them, or one for each core.
///
/// What happens in a world depends neither on the others nor on the number of threads.
#[pyclass(name = "Worlds", module = "glisson", frozen)]
pub(crate) struct PyWorlds {
    places: Vec<Mutex<Place>>,
    n_tools: usize,
    n_threads: usize,
    /// Held while they step.
    busy: Mutex<()>,
}

fn lock(place: &Mutex<Place>) -> MutexGuard<'_, Place> {
    // A step that breaks leaves a world that says so at its next one.
    place.lock().unwrap_or_else(PoisonError::into_inner)
}

impl PyWorlds {
    /// Does something with each world that is `asked` for, on threads, by its place among them; the error of the first, if there are some.
    fn each<T: Send>(
        &self,
        py: Python<'_>,
        asked: Option<&[usize]>,
        act: impl Fn(usize, &mut Place) -> anyhow::Result<T> + Sync,
    ) -> PyResult<Vec<T>> {
        let n = asked.map_or(self.places.len(), <[usize]>::len);
        let number = |i: usize| asked.map_or(i, |asked| asked[i]);
        let done: Vec<anyhow::Result<T>> = py.detach(|| {
            let Some(_busy) = try_lock(&self.busy) else {
                return Err(SimulationError::new_err("another thread is using these worlds"));
            };
            Ok(side_by_side(self.n_threads, n, |i| guarded(|| act(i, &mut lock(&self.places[number(i)])))))
        })?;
        let of_world = |(i, result): (usize, anyhow::Result<T>)| {
            result.map_err(|error| of_simulation(&error.context(format!("world {}", number(i)))))
        };
        done.into_iter().enumerate().map(of_world).collect()
    }

    /// Something of each instrument of each world.
    fn of_tools<T: Send>(
        &self,
        py: Python<'_>,
        see: impl Fn(&glisson::world::World, usize) -> T + Sync,
    ) -> PyResult<Vec<T>> {
        let n_tools = self.n_tools;
        let of_each = self.each(py, None, |_, place| {
            Ok((0..n_tools).map(|tool| see(place.runner.world(), tool)).collect::<Vec<T>>())
        })?;
        Ok(of_each.into_iter().flatten().collect())
    }

    fn numbers_asked(&self, worlds: Option<Vec<usize>>) -> PyResult<Option<Vec<usize>>> {
        let n = self.places.len();
        if let Some(none) = worlds.iter().flatten().find(|world| **world >= n) {
            return Err(PyValueError::new_err(format!(
                "there is no world {none}: there are {n}, counted from 0"
            )));
        }
        let mut sorted = worlds.clone().unwrap_or_default();
        sorted.sort_unstable();
        sorted.dedup();
        if worlds.as_ref().is_some_and(|worlds| worlds.len() != sorted.len()) {
            return Err(PyValueError::new_err("a world is named twice"));
        }
        Ok(worlds)
    }

    fn poses_for(
        &self,
        poses: &PyReadonlyArrayDyn<'_, f64>,
        worlds: Option<&[usize]>,
    ) -> PyResult<Vec<Vec<ToolInput>>> {
        let n = worlds.map_or(self.places.len(), <[usize]>::len);
        poses_of(poses, (Some(n), self.n_tools))
    }
}

#[pymethods]
impl PyWorlds {
    /// A world for each scene, at rest.
    #[new]
    #[pyo3(signature = (scenes, *, threads = None))]
    fn new(py: Python<'_>, scenes: Vec<Py<PyScene>>, threads: Option<usize>) -> PyResult<Self> {
        if threads == Some(0) || scenes.is_empty() {
            return Err(PyValueError::new_err("give one scene or more, and 1 thread or more"));
        }
        let n_tools_of = |scene: &Py<PyScene>| scene.get().parsed().world.tools.len();
        let n_tools = n_tools_of(&scenes[0]);
        if let Some(other) = scenes.iter().position(|scene| n_tools_of(scene) != n_tools) {
            return Err(PyValueError::new_err(format!(
                "scene {other} has {} instruments, and scene 0 has {n_tools}: worlds of one batch have as many",
                n_tools_of(&scenes[other])
            )));
        }
        let cores = || std::thread::available_parallelism().map_or(1, usize::from);
        let n_threads = threads.unwrap_or_else(cores);
        let open = |i: usize| {
            let runner = Runner::open(scenes[i].get().to_open(1), None)?;
            let start = runner.save()?;
            Ok(Place { runner, start, tracked: Vec::new() })
        };
        let opened: anyhow::Result<Vec<Place>> = py
            .detach(|| side_by_side(n_threads, scenes.len(), |i| guarded(|| open(i))))
            .into_iter()
            .collect();
        let places = opened.map_err(|error| of_scene(&error))?.into_iter().map(Mutex::new).collect();
        Ok(Self { places, n_tools, n_threads, busy: Mutex::new(()) })
    }

    fn __len__(&self) -> usize {
        self.places.len()
    }

    /// Instruments of each world.
    #[getter]
    fn n_tools(&self) -> usize {
        self.n_tools
    }

    /// Threads that step them.
    #[getter]
    fn threads(&self) -> usize {
        self.n_threads
    }

    /// Makes `n` steps in each of `worlds` (all, if not given), in which the hands go straight to `poses`, (worlds, instruments, 9).
    #[pyo3(signature = (poses, n = 1, worlds = None))]
    fn step(
        &self,
        py: Python<'_>,
        poses: PyReadonlyArrayDyn<'_, f64>,
        n: u32,
        worlds: Option<Vec<usize>>,
    ) -> PyResult<()> {
        let worlds = self.numbers_asked(worlds)?;
        let wanted = self.poses_for(&poses, worlds.as_deref())?;
        self.each(py, worlds.as_deref(), |i, place| place.runner.step(n, Some(&wanted[i])))?;
        Ok(())
    }

    /// Brings `worlds` (all, if not given) back to how they were made, to the bit.
    #[pyo3(signature = (worlds = None))]
    fn restart(&self, py: Python<'_>, worlds: Option<Vec<usize>>) -> PyResult<()> {
        let worlds = self.numbers_asked(worlds)?;
        self.each(py, worlds.as_deref(), |_, place| place.runner.restore(&place.start))?;
        Ok(())
    }

    /// Makes a step with the hands of `worlds` put to `poses`, (worlds, instruments, 9), without touching anything on the way.
    #[pyo3(signature = (poses, worlds = None))]
    fn place(
        &self,
        py: Python<'_>,
        poses: PyReadonlyArrayDyn<'_, f64>,
        worlds: Option<Vec<usize>>,
    ) -> PyResult<()> {
        let worlds = self.numbers_asked(worlds)?;
        let wanted = self.poses_for(&poses, worlds.as_deref())?;
        self.each(py, worlds.as_deref(), |i, place| place.runner.place(&wanted[i]))?;
        Ok(())
    }

    /// From now on `tracked_m` tells where the surface nodes are that are nearest to these points of the tissue at rest [m], (points, 3).
    fn track(&self, py: Python<'_>, points_m: PyReadonlyArray2<'_, f64>) -> PyResult<()> {
        let points_m = points_m.as_array();
        if points_m.ncols() != 3 || points_m.iter().any(|x| !x.is_finite()) {
            return Err(PyValueError::new_err("points are finite numbers of shape (points, 3)"));
        }
        let points_m: Vec<DVec3> =
            points_m.rows().into_iter().map(|p| DVec3::new(p[0], p[1], p[2])).collect();
        self.each(py, None, |_, place| {
            let nodes = points_m.iter().map(|point_m| place.runner.surface_node_near(*point_m));
            place.tracked = nodes.collect::<Option<_>>().unwrap_or_default();
            Ok(())
        })?;
        Ok(())
    }

    /// Where the tracked points are [m], (worlds, points, 3).
    #[getter]
    fn tracked_m(&self, py: Python<'_>) -> PyResult<Py<PyArray3<f64>>> {
        let of_each = self.each(py, None, |_, place| {
            let positions_m = place.runner.world().state().positions_m;
            Ok(place.tracked.iter().flat_map(|node| positions_m[*node].to_array()).collect::<Vec<_>>())
        })?;
        let n_points = of_each[0].len() / 3;
        gathered(py, (of_each.len(), n_points, 3), of_each.concat())
    }

    /// Where the instruments are, (worlds, instruments, 9).
    #[getter]
    fn poses(&self, py: Python<'_>) -> PyResult<Py<PyArray3<f64>>> {
        let of_each = self.of_tools(py, |world, tool| numbers_of(&world.tool_pose(tool)))?;
        gathered(py, (self.places.len(), self.n_tools, POSE_LENGTH), of_each.into_flattened())
    }

    /// Force of the tissue on each instrument [N], (worlds, instruments, 3).
    #[getter]
    fn forces_n(&self, py: Python<'_>) -> PyResult<Py<PyArray3<f64>>> {
        let of_each =
            self.of_tools(py, |world, tool| world.report().tools[tool].force_on_tool_n.to_array())?;
        gathered(py, (self.places.len(), self.n_tools, 3), of_each.into_flattened())
    }

    /// Nodes that the jaws of each instrument hold, (worlds, instruments).
    #[getter]
    fn n_held(&self, py: Python<'_>) -> PyResult<Py<PyArray2<u32>>> {
        let of_each = self.of_tools(py, |world, tool| world.report().tools[tool].n_held_nodes)?;
        gathered(py, (self.places.len(), self.n_tools), of_each)
    }

    /// Simulated time of each world [s], (worlds,).
    #[getter]
    fn times_s(&self, py: Python<'_>) -> PyResult<Py<PyArray1<f64>>> {
        let times_s = self.each(py, None, |_, place| Ok(place.runner.world().time_s()))?;
        gathered(py, times_s.len(), times_s)
    }

    /// Volume of tissue taken out of each world so far [m3], (worlds,).
    #[getter]
    fn removed_volumes_m3(&self, py: Python<'_>) -> PyResult<Py<PyArray1<f64>>> {
        let volumes_m3 = self.each(py, None, |_, place| Ok(place.runner.world().removed_volume_m3()))?;
        gathered(py, volumes_m3.len(), volumes_m3)
    }

    /// Hash of everything that the next steps of each world depend on.
    fn hashes(&self, py: Python<'_>) -> PyResult<Vec<String>> {
        self.each(py, None, |_, place| Ok(place.runner.world().state_hash().to_string()))
    }

    /// Pictures of `worlds` (all, if not given) as `World.picture` makes them, (worlds, height, width, 3).
    #[pyo3(signature = (width = 128, height = 128, view = "outside", worlds = None))]
    fn pictures(
        &self,
        py: Python<'_>,
        width: usize,
        height: usize,
        view: &str,
        worlds: Option<Vec<usize>>,
    ) -> PyResult<Py<PyArray4<u8>>> {
        let (worlds, kind) = (self.numbers_asked(worlds)?, picture_kind(view, width, height)?);
        let rgb = self.each(py, worlds.as_deref(), |_, place| place.runner.picture(kind))?;
        gathered(py, (rgb.len(), height, width, 3), rgb.concat())
    }

    fn __reduce__(&self) -> PyResult<()> {
        Err(PyTypeError::new_err("worlds cannot be pickled: pickle their scenes, and make them anew"))
    }

    fn __repr__(&self) -> String {
        format!("<glisson.Worlds, {} of them on {} threads>", self.places.len(), self.n_threads)
    }
}
