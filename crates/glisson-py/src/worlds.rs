//! Many worlds at once.

use crate::arrays::{POSE_LENGTH, flat, gathered, numbers_of, picture_kind, poses_of};
use crate::errors::{SimulationError, guarded, of_scene, of_simulation, try_lock};
use crate::runner::{Runner, Saved, blood_lost_m3};
use crate::scene::PyScene;
use glisson::math::DVec3;
use glisson::record::inside::Field;
use glisson::tool::ToolInput;
use glisson_runtime::workers::side_by_side;
use numpy::{PyArray1, PyArray2, PyArray3, PyArray4, PyReadonlyArray2, PyReadonlyArrayDyn};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// A world of many.
struct Place {
    runner: Runner,
    /// At rest, as it was made; shared with other worlds of its scene. A model may not be looked at from two threads.
    start: Arc<Mutex<Saved>>,
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

fn lock<T>(place: &Mutex<T>) -> MutexGuard<'_, T> {
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
        self.each_on(py, self.n_threads, asked, act)
    }

    /// Reads something of each world: on this thread, which takes less than to start others.
    fn read<T: Send>(&self, py: Python<'_>, see: impl Fn(&Place) -> T + Sync) -> PyResult<Vec<T>> {
        self.each_on(py, 1, None, |_, place| Ok(see(place)))
    }

    fn each_on<T: Send>(
        &self,
        py: Python<'_>,
        n_threads: usize,
        asked: Option<&[usize]>,
        act: impl Fn(usize, &mut Place) -> anyhow::Result<T> + Sync,
    ) -> PyResult<Vec<T>> {
        let n = asked.map_or(self.places.len(), <[usize]>::len);
        let number = |i: usize| asked.map_or(i, |asked| asked[i]);
        let done: Vec<anyhow::Result<T>> = py.detach(|| {
            let Some(_busy) = try_lock(&self.busy) else {
                return Err(SimulationError::new_err("another thread is using these worlds"));
            };
            Ok(side_by_side(n_threads, n, |i| guarded(|| act(i, &mut lock(&self.places[number(i)])))))
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
        let of_each = self
            .read(py, |place| (0..n_tools).map(|tool| see(place.runner.world(), tool)).collect::<Vec<T>>())?;
        Ok(of_each.into_iter().flatten().collect())
    }

    /// A field at the tracked points, (worlds, points).
    fn at_tracked(
        &self,
        py: Python<'_>,
        field: Field,
        worlds: Option<Vec<usize>>,
    ) -> PyResult<Py<PyArray2<f64>>> {
        let worlds = self.numbers_asked(worlds)?;
        let of_each = self.each(py, worlds.as_deref(), |_, place| {
            let inside = place.runner.inside();
            let values = inside.interior.at_nodes(field, &inside.positions_m);
            Ok(place.tracked.iter().map(|node| values[*node]).collect::<Vec<f64>>())
        })?;
        let n_points = of_each.first().map_or(0, Vec::len);
        gathered(py, (of_each.len(), n_points), of_each.concat())
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
        let n_tools_of = |scene: &Py<PyScene>| scene.get().n_tools();
        let n_tools = n_tools_of(&scenes[0]);
        if let Some(other) = scenes.iter().position(|scene| n_tools_of(scene) != n_tools) {
            return Err(PyValueError::new_err(format!(
                "scene {other} has {} instruments, and scene 0 has {n_tools}: worlds of one batch have as many",
                n_tools_of(&scenes[other])
            )));
        }
        let cores = || std::thread::available_parallelism().map_or(1, usize::from);
        let n_threads = threads.unwrap_or_else(cores);
        // Organs are meshed once for each scene, and its other worlds begin where the first one does.
        let mut of_scenes: Vec<Vec<usize>> = Vec::new();
        for (i, scene) in scenes.iter().enumerate() {
            let same = |those: &&mut Vec<usize>| scenes[those[0]].get().is_same_as(scene.get());
            match of_scenes.iter_mut().find(same) {
                Some(those) => those.push(i),
                None => of_scenes.push(vec![i]),
            }
        }
        let open = |those: &Vec<usize>| -> anyhow::Result<Vec<(usize, Place)>> {
            let first = Runner::open(scenes[those[0]].get().to_open(1), None)?;
            // As many beginnings as are looked at at once.
            let n_starts = n_threads.min(those.len());
            let starts = (0..n_starts).map(|_| Ok(Arc::new(Mutex::new(first.save()?))));
            let starts = starts.collect::<anyhow::Result<Vec<_>>>()?;
            let mut runners: Vec<Runner> =
                those[1..].iter().map(|_| first.another_at(&lock(&starts[0]))).collect();
            runners.insert(0, first);
            let place =
                |(k, runner)| Place { runner, start: Arc::clone(&starts[k % n_starts]), tracked: Vec::new() };
            Ok(those.iter().copied().zip(runners.into_iter().enumerate().map(place)).collect())
        };
        let all = py.detach(|| -> anyhow::Result<Vec<Mutex<Place>>> {
            let opened = side_by_side(n_threads, of_scenes.len(), |i| guarded(|| open(&of_scenes[i])));
            let opened = opened.into_iter().collect::<anyhow::Result<Vec<_>>>()?;
            let mut places: Vec<(usize, Place)> = opened.into_iter().flatten().collect();
            places.sort_by_key(|(i, _)| *i);
            Ok(places.into_iter().map(|(_, place)| Mutex::new(place)).collect())
        });
        let places = all.map_err(|error| of_scene(&error))?;
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
        self.each(py, worlds.as_deref(), |_, place| place.runner.restore(&lock(&place.start)))?;
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
        let of_each = self.read(py, |place| {
            let positions_m = place.runner.world().state().positions_m;
            place.tracked.iter().flat_map(|node| positions_m[*node].to_array()).collect::<Vec<_>>()
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

    /// Its torque about each tip [N m], (worlds, instruments, 3).
    #[getter]
    fn torques_n_m(&self, py: Python<'_>) -> PyResult<Py<PyArray3<f64>>> {
        let of_each =
            self.of_tools(py, |world, tool| world.report().tools[tool].torque_on_tool_n_m.to_array())?;
        gathered(py, (self.places.len(), self.n_tools, 3), of_each.into_flattened())
    }

    /// Nodes that the jaws of each instrument hold, (worlds, instruments).
    #[getter]
    fn n_held(&self, py: Python<'_>) -> PyResult<Py<PyArray2<u32>>> {
        let of_each = self.of_tools(py, |world, tool| world.report().tools[tool].n_held_nodes)?;
        gathered(py, (self.places.len(), self.n_tools), of_each)
    }

    /// Tension of the loop of each instrument [N], (worlds, instruments); zero where it has none.
    #[getter]
    fn loop_tensions_n(&self, py: Python<'_>) -> PyResult<Py<PyArray2<f64>>> {
        let of_each = self.of_tools(py, glisson::world::World::loop_tension_n)?;
        gathered(py, (self.places.len(), self.n_tools), of_each)
    }

    /// Loops that are tied off in each world, (worlds,).
    #[getter]
    fn n_tied_loops(&self, py: Python<'_>) -> PyResult<Py<PyArray1<u32>>> {
        let tied = self.read(py, |place| place.runner.world().n_tied_loops() as u32)?;
        gathered(py, tied.len(), tied)
    }

    /// How far the task of each world is, (worlds, 4): stages done, stages in all, share of the stage that is done, mistakes; zeros where a
    /// scene has no task.
    #[getter]
    fn task_progress(&self, py: Python<'_>) -> PyResult<Py<PyArray2<f64>>> {
        let of_each = self.read(py, |place| {
            let progress = place.runner.progress();
            [progress.n_done as f64, progress.n_stages as f64, progress.share, progress.n_mistakes as f64]
        })?;
        gathered(py, (of_each.len(), 4), of_each.into_flattened())
    }

    /// The first, the middle and the last point of what each task marks now [m], (worlds, 3, 3), of the tissue at rest; zeros where
    /// nothing is marked.
    #[getter]
    fn task_marks_m(&self, py: Python<'_>) -> PyResult<Py<PyArray3<f64>>> {
        let of_each = self.read(py, |place| place.runner.marks_m().unwrap_or_default())?;
        gathered(py, (of_each.len(), 3, 3), flat(of_each.into_flattened()))
    }

    /// Middle of the strand between bodies that is nearest to the tip of each instrument [m], (worlds, instruments, 3); the tip itself
    /// where none is left.
    #[getter]
    fn nearest_strands_m(&self, py: Python<'_>) -> PyResult<Py<PyArray3<f64>>> {
        let n_tools = self.n_tools;
        let of_each = self.read(py, |place| {
            let nearest = |tool| {
                let tip_m = || place.runner.world().tool_pose(tool).tip_in_world_m;
                place.runner.nearest_strand_m(tool).unwrap_or_else(tip_m)
            };
            flat((0..n_tools).map(nearest))
        })?;
        gathered(py, (of_each.len(), n_tools, 3), of_each.concat())
    }

    /// Equivalent strain at the tracked points of `worlds` (all, if not given), (worlds, points).
    #[pyo3(signature = (worlds = None))]
    fn tracked_strain(&self, py: Python<'_>, worlds: Option<Vec<usize>>) -> PyResult<Py<PyArray2<f64>>> {
        self.at_tracked(py, Field::Strain, worlds)
    }

    /// Von Mises stress there [Pa], (worlds, points).
    #[pyo3(signature = (worlds = None))]
    fn tracked_stress_pa(&self, py: Python<'_>, worlds: Option<Vec<usize>>) -> PyResult<Py<PyArray2<f64>>> {
        self.at_tracked(py, Field::Stress, worlds)
    }

    /// Damage of `worlds` (all, if not given) as `World.damage` tells it, (worlds, 4).
    #[pyo3(signature = (worlds = None))]
    fn damages(&self, py: Python<'_>, worlds: Option<Vec<usize>>) -> PyResult<Py<PyArray2<f64>>> {
        let worlds = self.numbers_asked(worlds)?;
        let of_each = self.each(py, worlds.as_deref(), |_, place| Ok(place.runner.damage()))?;
        gathered(py, (of_each.len(), 4), of_each.into_flattened())
    }

    /// Points of the surface of `worlds` (all, if not given) as `World.cloud` gives them [m], (worlds, points, 3).
    #[pyo3(signature = (points, worlds = None))]
    fn clouds(
        &self,
        py: Python<'_>,
        points: usize,
        worlds: Option<Vec<usize>>,
    ) -> PyResult<Py<PyArray3<f64>>> {
        let worlds = self.numbers_asked(worlds)?;
        let of_each = self.each(py, worlds.as_deref(), |_, place| Ok(flat(place.runner.cloud_m(points))))?;
        gathered(py, (of_each.len(), points, 3), of_each.concat())
    }

    /// Blood lost in each world so far [m3], (worlds,).
    #[getter]
    fn blood_lost_m3(&self, py: Python<'_>) -> PyResult<Py<PyArray1<f64>>> {
        let lost_m3 = self.read(py, |place| blood_lost_m3(place.runner.world()))?;
        gathered(py, lost_m3.len(), lost_m3)
    }

    /// Simulated time of each world [s], (worlds,).
    #[getter]
    fn times_s(&self, py: Python<'_>) -> PyResult<Py<PyArray1<f64>>> {
        let times_s = self.read(py, |place| place.runner.world().time_s())?;
        gathered(py, times_s.len(), times_s)
    }

    /// Volume of tissue taken out of each world so far [m3], (worlds,).
    #[getter]
    fn removed_volumes_m3(&self, py: Python<'_>) -> PyResult<Py<PyArray1<f64>>> {
        let volumes_m3 = self.read(py, |place| place.runner.world().removed_volume_m3())?;
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

    /// What pictures of `worlds` show at each pixel as `World.layers` tells it: depths [m] and kinds, each (worlds, height, width).
    #[pyo3(signature = (width = 128, height = 128, view = "outside", worlds = None))]
    #[expect(clippy::type_complexity, reason = "two arrays")]
    fn layers(
        &self,
        py: Python<'_>,
        width: usize,
        height: usize,
        view: &str,
        worlds: Option<Vec<usize>>,
    ) -> PyResult<(Py<PyArray3<f32>>, Py<PyArray3<u8>>)> {
        let (worlds, kind) = (self.numbers_asked(worlds)?, picture_kind(view, width, height)?);
        let layers = self.each(py, worlds.as_deref(), |_, place| place.runner.layers(kind))?;
        let shape = (layers.len(), height, width);
        let (depths_m, kinds): (Vec<_>, Vec<_>) =
            layers.into_iter().map(|layer| (layer.depths_m, layer.kinds)).unzip();
        Ok((gathered(py, shape, depths_m.concat())?, gathered(py, shape, kinds.concat())?))
    }

    /// An instrument of each of `worlds` (all, if not given) sets a clip on the vessel nearest to its tip.
    #[pyo3(signature = (tool, worlds = None))]
    fn clip(&self, py: Python<'_>, tool: usize, worlds: Option<Vec<usize>>) -> PyResult<()> {
        let worlds = self.numbers_asked(worlds)?;
        if tool >= self.n_tools {
            return Err(PyValueError::new_err(format!(
                "there is no instrument {tool}: there are {}, counted from 0",
                self.n_tools
            )));
        }
        self.each(py, worlds.as_deref(), |_, place| place.runner.simulation.clip_vessel(tool))?;
        Ok(())
    }

    fn __reduce__(&self) -> PyResult<()> {
        Err(PyTypeError::new_err("worlds cannot be pickled: pickle their scenes, and make them anew"))
    }

    fn __repr__(&self) -> String {
        format!("<glisson.Worlds, {} of them on {} threads>", self.places.len(), self.n_threads)
    }
}
