//! Many worlds at once.

use crate::arrays::{POSE_LENGTH, numbers_of, poses_of};
use crate::errors::{SimulationError, of_scene, of_simulation};
use crate::runner::{Runner, Saved};
use crate::scene::PyScene;
use glam::DVec3;
use glisson::tool::ToolInput;
use numpy::ndarray::{Array, Dimension, ShapeBuilder};
use numpy::{
    Element, IntoPyArray, PyArray, PyArray1, PyArray2, PyArray3, PyReadonlyArray2, PyReadonlyArrayDyn,
};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use std::sync::atomic::{AtomicUsize, Ordering};
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
            let Ok(_busy) = self.busy.try_lock() else {
                return Err(SimulationError::new_err("another thread is using these worlds"));
            };
            Ok(on_threads(self.n_threads.min(n), n, |i| act(i, &mut lock(&self.places[number(i)]))))
        })?;
        let of_world = |(i, result): (usize, anyhow::Result<T>)| {
            result.map_err(|error| of_simulation(&error.context(format!("world {}", number(i)))))
        };
        done.into_iter().enumerate().map(of_world).collect()
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

/// `act(0)` to `act(n - 1)`, each on one of `n_threads` threads, in their order.
fn on_threads<T: Send>(n_threads: usize, n: usize, act: impl Fn(usize) -> T + Sync) -> Vec<T> {
    if n_threads < 2 {
        return (0..n).map(act).collect();
    }
    let next = AtomicUsize::new(0);
    let take_turns = || {
        let mut done = Vec::new();
        loop {
            let i = next.fetch_add(1, Ordering::Relaxed);
            if i >= n {
                return done;
            }
            done.push((i, act(i)));
        }
    };
    let mut done: Vec<(usize, T)> = std::thread::scope(|scope| {
        // The calling thread works, too.
        let others: Vec<_> = (1..n_threads).map(|_| scope.spawn(take_turns)).collect();
        let mut done = take_turns();
        for other in others {
            done.extend(other.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)));
        }
        done
    });
    done.sort_by_key(|(i, _)| *i);
    done.into_iter().map(|(_, what)| what).collect()
}

/// An array of what each world has.
fn gathered<T: Element, D: Dimension>(
    py: Python<'_>,
    shape: impl ShapeBuilder<Dim = D>,
    values: Vec<T>,
) -> PyResult<Py<PyArray<T, D>>> {
    let array =
        Array::from_shape_vec(shape, values).map_err(|error| PyValueError::new_err(error.to_string()))?;
    Ok(array.into_pyarray(py).unbind())
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
        let opened: anyhow::Result<Vec<Place>> =
            py.detach(|| on_threads(n_threads.min(scenes.len()), scenes.len(), open)).into_iter().collect();
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
        let (mut values, mut n_points) = (Vec::new(), 0);
        for place in &self.places {
            let place = lock(place);
            n_points = place.tracked.len();
            let positions_m = place.runner.world().state().positions_m;
            values.extend(place.tracked.iter().flat_map(|node| positions_m[*node].to_array()));
        }
        gathered(py, (self.places.len(), n_points, 3), values)
    }

    /// Where the instruments are, (worlds, instruments, 9).
    #[getter]
    fn poses(&self, py: Python<'_>) -> PyResult<Py<PyArray3<f64>>> {
        let n_tools = self.n_tools;
        let poses = |place: &Place| {
            (0..n_tools)
                .flat_map(|tool| numbers_of(&place.runner.world().tool_pose(tool)))
                .collect::<Vec<_>>()
        };
        let values = self.places.iter().flat_map(|place| poses(&lock(place))).collect();
        gathered(py, (self.places.len(), n_tools, POSE_LENGTH), values)
    }

    /// Force of the tissue on each instrument [N], (worlds, instruments, 3).
    #[getter]
    fn forces_n(&self, py: Python<'_>) -> PyResult<Py<PyArray3<f64>>> {
        let n_tools = self.n_tools;
        let forces = |place: &Place| {
            let tools = &place.runner.world().report().tools[..n_tools];
            tools.iter().flat_map(|tool| tool.force_on_tool_n.to_array()).collect::<Vec<_>>()
        };
        let values = self.places.iter().flat_map(|place| forces(&lock(place))).collect();
        gathered(py, (self.places.len(), n_tools, 3), values)
    }

    /// Nodes that the jaws of each instrument hold, (worlds, instruments).
    #[getter]
    fn n_held(&self, py: Python<'_>) -> PyResult<Py<PyArray2<u32>>> {
        let n_tools = self.n_tools;
        let held = |place: &Place| {
            let tools = &place.runner.world().report().tools[..n_tools];
            tools.iter().map(|tool| tool.n_held_nodes).collect::<Vec<_>>()
        };
        let values = self.places.iter().flat_map(|place| held(&lock(place))).collect();
        gathered(py, (self.places.len(), n_tools), values)
    }

    /// Simulated time of each world [s], (worlds,).
    #[getter]
    fn times_s(&self, py: Python<'_>) -> PyResult<Py<PyArray1<f64>>> {
        let times_s: Vec<f64> = self.places.iter().map(|place| lock(place).runner.world().time_s()).collect();
        Ok(times_s.into_pyarray(py).unbind())
    }

    /// Volume of tissue taken out of each world so far [m3], (worlds,).
    #[getter]
    fn removed_volumes_m3(&self, py: Python<'_>) -> PyResult<Py<PyArray1<f64>>> {
        let removed = |place: &Mutex<Place>| lock(place).runner.world().removed_volume_m3();
        Ok(self.places.iter().map(removed).collect::<Vec<f64>>().into_pyarray(py).unbind())
    }

    /// Hash of everything that the next steps of each world depend on.
    fn hashes(&self, py: Python<'_>) -> PyResult<Vec<String>> {
        self.each(py, None, |_, place| Ok(place.runner.world().state_hash().to_string()))
    }

    fn __reduce__(&self) -> PyResult<()> {
        Err(PyTypeError::new_err("worlds cannot be pickled: pickle their scenes, and make them anew"))
    }

    fn __repr__(&self) -> String {
        format!("<glisson.Worlds, {} of them on {} threads>", self.places.len(), self.n_threads)
    }
}
