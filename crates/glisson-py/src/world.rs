//! One world.

use crate::arrays::{POSE_LENGTH, flat, from_json, gathered, numbers_of, picture_kind, poses_of, read_only};
use crate::errors::{SimulationError, guarded, of_scene, of_simulation, try_lock};
use crate::runner::{Runner, Saved, blood_lost_m3};
use crate::scene::PyScene;
use glisson::math::DVec3;
use glisson::mesh::TetId;
use glisson::record::inside::Field;
use glisson::record::snapshot::ContactPoints;
use numpy::{PyArray1, PyArray2, PyArray3, PyReadonlyArrayDyn};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

/// A world in time: an organ or several, instruments, perhaps a task.
///
/// Arrays are copies of what is now, and belong to you: they stay as they are when the world goes on.
#[pyclass(name = "World", module = "glisson", frozen)]
pub(crate) struct PyWorld {
    /// None when it was closed.
    runner: Mutex<Option<Runner>>,
    scene: Py<PyScene>,
}

/// A moment of a world, to come back to with `World.restore`.
#[pyclass(name = "Saved", module = "glisson", frozen)]
pub(crate) struct PySaved {
    /// A model may not be looked at from two threads.
    saved: Mutex<Saved>,
    /// Of the world that it is of.
    scene: Py<PyScene>,
}

impl PyWorld {
    /// How many instruments it has.
    pub(crate) fn n_tools(&self) -> usize {
        self.scene.get().n_tools()
    }

    /// Does something with the world, without the GIL.
    pub(crate) fn with<T: Send>(
        &self,
        py: Python<'_>,
        act: impl FnOnce(&mut Runner) -> anyhow::Result<T> + Send,
    ) -> PyResult<T> {
        py.detach(|| {
            let Some(mut runner) = try_lock(&self.runner) else {
                let words = "another thread is using this world: give each thread a world of its own, or use glisson.Worlds";
                return Err(SimulationError::new_err(words));
            };
            match runner.as_mut() {
                Some(runner) => guarded(|| act(runner)).map_err(|error| of_simulation(&error)),
                None => Err(SimulationError::new_err("this world was closed: make another one of its scene")),
            }
        })
    }

    /// Looks at the world.
    fn look<T: Send>(&self, py: Python<'_>, see: impl FnOnce(&Runner) -> T + Send) -> PyResult<T> {
        self.with(py, |runner| Ok(see(runner)))
    }

    fn at_nodes(&self, py: Python<'_>, field: Field) -> PyResult<Py<PyArray1<f64>>> {
        let values = self.with(py, |runner| {
            let inside = runner.inside();
            Ok(inside.interior.at_nodes(field, &inside.positions_m))
        })?;
        gathered(py, values.len(), values)
    }

    fn vectors(
        &self,
        py: Python<'_>,
        see: impl FnOnce(&Runner) -> Vec<f64> + Send,
        width: usize,
    ) -> PyResult<Py<PyArray2<f64>>> {
        let values = self.look(py, see)?;
        Ok(read_only(py, values, width)?.unbind())
    }

    fn json(&self, py: Python<'_>, text: Option<String>) -> PyResult<Py<PyAny>> {
        match text {
            Some(text) => from_json(py, &text),
            None => Ok(py.None()),
        }
    }
}

fn number_of_tool(tool: usize, runner: &Runner) -> anyhow::Result<()> {
    let n_tools = runner.world().tools().len();
    anyhow::ensure!(tool < n_tools, "there is no instrument {tool}: the scene has {n_tools}, counted from 0");
    Ok(())
}

#[pymethods]
impl PyWorld {
    /// A world at rest, its instruments at home. With `record` the session is written there; it is whole after `close`.
    /// `threads` are those of models that can use several: the bits do not depend on it.
    #[new]
    #[pyo3(signature = (scene, *, threads = 1, record = None))]
    fn new(py: Python<'_>, scene: Py<PyScene>, threads: usize, record: Option<PathBuf>) -> PyResult<Self> {
        if threads == 0 {
            return Err(PyValueError::new_err("threads is 0; give 1 or more"));
        }
        let to_open = scene.get().to_open(threads);
        let runner = py.detach(|| Runner::open(to_open, record.as_deref()));
        let runner = runner.map_err(|error| of_scene(&error))?;
        Ok(Self { runner: Mutex::new(Some(runner)), scene })
    }

    /// What the world was made from.
    #[getter]
    fn scene(&self, py: Python<'_>) -> Py<PyScene> {
        self.scene.clone_ref(py)
    }

    /// Makes `n` steps, in which the hands go straight from where they are to `poses`, an array of shape (instruments, 9) in m and rad:
    /// tip (3), shaft from the tip towards the handle (3), roll, jaws (0 closed to 1 open), trigger (0 to 1). Without `poses` they stay.
    #[pyo3(signature = (n = 1, poses = None))]
    fn step(&self, py: Python<'_>, n: u32, poses: Option<PyReadonlyArrayDyn<'_, f64>>) -> PyResult<()> {
        let n_tools = self.n_tools();
        let wanted = poses.map(|poses| poses_of(&poses, (None, n_tools))).transpose()?;
        self.with(py, |runner| runner.step(n, wanted.as_ref().map(|poses| &poses[0][..])))
    }

    /// Leads the hands along the `[[tool.path]]` of the scene from where time is until `until_s`, to their end without it, and sets the clips
    /// on the way, as `glisson task run --headless` does. It ends before where they end, or the scene's task; whether there is more.
    #[pyo3(signature = (until_s = f64::INFINITY))]
    fn demonstrate(&self, py: Python<'_>, until_s: f64) -> PyResult<bool> {
        if until_s.is_nan() {
            return Err(PyValueError::new_err("until_s is not a number; give a time in s"));
        }
        let scene = self.scene.get().parsed();
        self.with(py, |runner| runner.demonstrate(scene, until_s))
    }

    /// Makes a step with the hands put to `poses`, without touching anything on the way.
    fn place(&self, py: Python<'_>, poses: PyReadonlyArrayDyn<'_, f64>) -> PyResult<()> {
        let poses = poses_of(&poses, (None, self.n_tools()))?;
        self.with(py, |runner| runner.place(&poses[0]))
    }

    /// Everything goes back to rest, and the task begins anew. What was cut stays cut: `restore` brings that back.
    fn reset(&self, py: Python<'_>) -> PyResult<()> {
        self.with(py, Runner::reset)
    }

    /// This moment, to come back to. Edits before it cannot be undone after coming back.
    fn save(&self, py: Python<'_>) -> PyResult<PySaved> {
        Ok(PySaved {
            saved: Mutex::new(self.with(py, |runner| runner.save())?),
            scene: self.scene.clone_ref(py),
        })
    }

    /// Comes back to a saved moment of a world of the same scene, to the bit.
    fn restore(&self, py: Python<'_>, saved: &Bound<'_, PySaved>) -> PyResult<()> {
        let PySaved { saved, scene } = saved.get();
        if !scene.get().is_same_as(self.scene.get()) {
            return Err(SimulationError::new_err(
                "that moment is of a world of another scene: it cannot come back in this one",
            ));
        }
        self.with(py, |runner| runner.restore(&saved.lock().unwrap_or_else(PoisonError::into_inner)))
    }

    /// Hash of everything that the next steps depend on, 64 hexadecimal digits.
    fn hash(&self, py: Python<'_>) -> PyResult<String> {
        self.look(py, |runner| runner.world().state_hash().to_string())
    }

    /// Ends it, and its session if one is recorded; answers the hash of the end.
    fn close(&self, py: Python<'_>) -> PyResult<Option<String>> {
        py.detach(|| {
            let Some(mut held) = try_lock(&self.runner) else {
                return Err(SimulationError::new_err(
                    "another thread is using this world: it cannot be closed",
                ));
            };
            let taken = held.take();
            let Some(runner) = taken else { return Ok(None) };
            let hash = runner.simulation.finish().map_err(|error| of_simulation(&error))?;
            Ok(Some(hash.to_string()))
        })
    }

    /// Takes tetrahedra out, by their numbers.
    fn remove(&self, py: Python<'_>, tetrahedra: Vec<u32>) -> PyResult<()> {
        self.with(py, |runner| {
            let n = runner.world().organ().live_tetrahedra().len();
            if let Some(none) = tetrahedra.iter().find(|number| **number as usize >= n) {
                anyhow::bail!("there is no tetrahedron {none}: the mesh has {n}, counted from 0");
            }
            runner.simulation.remove_tetrahedra(tetrahedra.into_iter().map(TetId).collect())
        })
    }

    /// Takes the last cut back, if there is one that can be.
    fn undo(&self, py: Python<'_>) -> PyResult<()> {
        self.with(py, |runner| runner.simulation.undo_edit())
    }

    /// Takes out what an instrument's tip touches; where it touches nothing `notices` tells so.
    fn cut(&self, py: Python<'_>, tool: usize) -> PyResult<()> {
        self.with(py, |runner| {
            number_of_tool(tool, runner)?;
            runner.simulation.cut_at_tip(tool)
        })
    }

    /// Makes the mesh finer around an instrument's tip, within two of the edges there, until they are half as long; where that cannot be
    /// `notices` tells why.
    fn refine(&self, py: Python<'_>, tool: usize) -> PyResult<()> {
        self.with(py, |runner| {
            number_of_tool(tool, runner)?;
            runner.simulation.refine_around(tool)
        })
    }

    /// The table is tilted: gravity from now on [m/s2], patient frame.
    fn set_gravity(&self, py: Python<'_>, gravity_m_per_s2: [f64; 3]) -> PyResult<()> {
        let gravity = DVec3::from_array(gravity_m_per_s2);
        if !gravity.is_finite() {
            return Err(PyValueError::new_err(format!("gravity is {gravity_m_per_s2:?}: it is not finite")));
        }
        self.with(py, |runner| runner.simulation.set_gravity(gravity))
    }

    /// An instrument sets a clip on the vessel nearest to its tip.
    fn clip(&self, py: Python<'_>, tool: usize) -> PyResult<()> {
        self.with(py, |runner| {
            number_of_tool(tool, runner)?;
            runner.simulation.clip_vessel(tool)
        })
    }

    /// Simulated time [s].
    #[getter]
    fn time_s(&self, py: Python<'_>) -> PyResult<f64> {
        self.look(py, |runner| runner.world().time_s())
    }

    /// Steps made so far.
    #[getter]
    fn steps(&self, py: Python<'_>) -> PyResult<u64> {
        self.look(py, |runner| runner.world().steps_made())
    }

    /// Counts up with every cut; arrays of nodes and triangles of before have other lengths then.
    #[getter]
    fn topology_version(&self, py: Python<'_>) -> PyResult<u32> {
        self.look(py, |runner| runner.world().organ().topology_version())
    }

    /// Where all nodes are [m], (nodes, 3).
    #[getter]
    fn positions_m(&self, py: Python<'_>) -> PyResult<Py<PyArray2<f64>>> {
        self.vectors(py, |runner| flat(runner.world().state().positions_m.iter().copied()), 3)
    }

    /// How fast all nodes move [m/s], (nodes, 3).
    #[getter]
    fn velocities_m_per_s(&self, py: Python<'_>) -> PyResult<Py<PyArray2<f64>>> {
        self.vectors(py, |runner| flat(runner.world().state().velocities_m_per_s.iter().copied()), 3)
    }

    /// Where all nodes are at rest [m], (nodes, 3).
    #[getter]
    fn rest_positions_m(&self, py: Python<'_>) -> PyResult<Py<PyArray2<f64>>> {
        self.vectors(py, |runner| flat(runner.world().organ().mesh().positions_m.iter().copied()), 3)
    }

    /// Nodes of all tetrahedra that are not taken out, (tetrahedra, 4).
    #[getter]
    fn tetrahedra(&self, py: Python<'_>) -> PyResult<Py<PyArray2<u32>>> {
        let nodes = self.look(py, |runner| {
            let organ = runner.world().organ();
            let all = organ.mesh().tetrahedra.iter().zip(organ.live_tetrahedra());
            let live = all.filter(|(_, live)| **live).map(|(nodes, _)| nodes);
            live.flat_map(|nodes| nodes.map(|node| node.0)).collect::<Vec<u32>>()
        })?;
        Ok(read_only(py, nodes, 4)?.unbind())
    }

    /// Nodes of the surface's triangles, counter-clockwise from outside, (triangles, 3).
    #[getter]
    fn surface(&self, py: Python<'_>) -> PyResult<Py<PyArray2<u32>>> {
        let nodes = self.look(py, |runner| {
            let shown = runner.world().display_topology();
            let node_of = |vertex: u32| shown.nodes[vertex as usize].0;
            shown.triangles.iter().flat_map(|triangle| triangle.map(node_of)).collect::<Vec<u32>>()
        })?;
        Ok(read_only(py, nodes, 3)?.unbind())
    }

    /// Where the instruments are, (instruments, 9), as in `step`. A hand gives way: that is not where it was led.
    #[getter]
    fn poses(&self, py: Python<'_>) -> PyResult<Py<PyArray2<f64>>> {
        let poses = |runner: &Runner| {
            let world = runner.world();
            (0..world.tools().len()).flat_map(|tool| numbers_of(&world.tool_pose(tool))).collect()
        };
        self.vectors(py, poses, POSE_LENGTH)
    }

    /// Force of the tissue on each instrument [N], (instruments, 3).
    #[getter]
    fn forces_n(&self, py: Python<'_>) -> PyResult<Py<PyArray2<f64>>> {
        let of = |runner: &Runner| flat(reports(runner).iter().map(|tool| tool.force_on_tool_n));
        self.vectors(py, of, 3)
    }

    /// Its torque about each tip [N m], (instruments, 3).
    #[getter]
    fn torques_n_m(&self, py: Python<'_>) -> PyResult<Py<PyArray2<f64>>> {
        let of = |runner: &Runner| flat(reports(runner).iter().map(|tool| tool.torque_on_tool_n_m));
        self.vectors(py, of, 3)
    }

    /// Nodes that the jaws of each instrument hold, (instruments,).
    #[getter]
    fn n_held(&self, py: Python<'_>) -> PyResult<Py<PyArray1<u32>>> {
        let held = self
            .look(py, |runner| reports(runner).iter().map(|tool| tool.n_held_nodes).collect::<Vec<u32>>())?;
        gathered(py, held.len(), held)
    }

    /// Tension of the loop of each instrument [N], (instruments,); zero where it has none.
    #[getter]
    fn loop_tensions_n(&self, py: Python<'_>) -> PyResult<Py<PyArray1<f64>>> {
        let of_each = |runner: &Runner| {
            let world = runner.world();
            (0..world.tools().len()).map(|tool| world.loop_tension_n(tool)).collect::<Vec<f64>>()
        };
        let tensions_n = self.look(py, of_each)?;
        gathered(py, tensions_n.len(), tensions_n)
    }

    /// Length of the thread of each loop that is tied off, around what it is around now and around the same at rest [m], (loops, 2).
    #[getter]
    fn tied_girths_m(&self, py: Python<'_>) -> PyResult<Py<PyArray2<f64>>> {
        let girths_m = self.look(py, |runner| runner.world().tied_girths_m().collect::<Vec<_>>())?;
        gathered(py, (girths_m.len(), 2), girths_m.into_flattened())
    }

    /// Where surfaces bear forces, the greatest first: places [m], normals, forces on what touches [N], each (contacts, 3), and the
    /// number of the instrument or body that touches, (contacts,).
    #[expect(clippy::type_complexity, reason = "four arrays")]
    fn contacts(
        &self,
        py: Python<'_>,
    ) -> PyResult<(Py<PyArray2<f64>>, Py<PyArray2<f64>>, Py<PyArray2<f64>>, Py<PyArray1<u8>>)> {
        let points = self.look(py, |runner| {
            let mut contacts = ContactPoints::default();
            runner.world().contact_points_into(&mut contacts);
            contacts.points
        })?;
        let array = |values: Vec<f64>| read_only(py, values, 3).map(Bound::unbind);
        Ok((
            array(flat(points.iter().map(|point| point.place_m)))?,
            array(flat(points.iter().map(|point| point.normal)))?,
            array(flat(points.iter().map(|point| point.force_n)))?,
            gathered(py, points.len(), points.iter().map(|point| point.by).collect())?,
        ))
    }

    /// A picture of the world now, drawn by the processor, (height, width, 3), 8-bit sRGB: from "outside", where the whole organ at the
    /// time of the first picture is in it, or through the scene's first "endoscope".
    #[pyo3(signature = (width = 640, height = 480, view = "outside"))]
    fn picture(&self, py: Python<'_>, width: usize, height: usize, view: &str) -> PyResult<Py<PyArray3<u8>>> {
        let kind = picture_kind(view, width, height)?;
        let rgb = self.with(py, |runner| runner.picture(kind))?;
        gathered(py, (height, width, 3), rgb)
    }

    /// A notebook shows a world as a picture from outside.
    fn _repr_png_<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        let kind = picture_kind("outside", 640, 480)?;
        let png = self.with(py, |runner| runner.png(kind))?;
        Ok(PyBytes::new(py, &png))
    }

    /// What a picture shows at the middle of each pixel: how deep along the view [m], 0 where there is nothing, (height, width); and what
    /// it is, (height, width): 0 nothing, 1 an instrument, 2 a thread, clip, strand or drop of blood, 3 a face of a cut, 4 and more the
    /// skin of the first body and of the next ones.
    #[pyo3(signature = (width = 640, height = 480, view = "outside"))]
    #[expect(clippy::type_complexity, reason = "two arrays")]
    fn layers(
        &self,
        py: Python<'_>,
        width: usize,
        height: usize,
        view: &str,
    ) -> PyResult<(Py<PyArray2<f32>>, Py<PyArray2<u8>>)> {
        let kind = picture_kind(view, width, height)?;
        let layers = self.with(py, |runner| runner.layers(kind))?;
        Ok((gathered(py, (height, width), layers.depths_m)?, gathered(py, (height, width), layers.kinds)?))
    }

    /// Greatest strain of the surface, its area at rest that is strained beyond what tears the capsule of livers (0.47) [m2], tissue taken
    /// out [m3], blood lost [m3], (4,); the first two are those of now.
    #[getter]
    fn damage(&self, py: Python<'_>) -> PyResult<Py<PyArray1<f64>>> {
        let damage = self.with(py, |runner| Ok(runner.damage()))?;
        gathered(py, 4, damage.to_vec())
    }

    /// So many points of the surface as it is drawn [m], (points, 3): vertices, spread evenly over their numbers.
    fn cloud(&self, py: Python<'_>, points: usize) -> PyResult<Py<PyArray2<f64>>> {
        self.vectors(py, |runner| flat(runner.cloud_m(points)), 3)
    }

    /// Equivalent strain at each node, (nodes,): the mean of the tetrahedra around it by their volumes at rest.
    #[getter]
    fn strain(&self, py: Python<'_>) -> PyResult<Py<PyArray1<f64>>> {
        self.at_nodes(py, Field::Strain)
    }

    /// Von Mises stress at each node [Pa], (nodes,): the mean of the tetrahedra around it by their volumes at rest.
    #[getter]
    fn stress_pa(&self, py: Python<'_>) -> PyResult<Py<PyArray1<f64>>> {
        self.at_nodes(py, Field::Stress)
    }

    /// Elastic energy of all that deforms, and kinetic energy [J].
    #[getter]
    fn energies_j(&self, py: Python<'_>) -> PyResult<(f64, f64)> {
        self.with(py, |runner| {
            let inside = runner.inside();
            Ok((inside.interior.elastic_energy_j(&inside.positions_m), inside.kinetic_energy_j))
        })
    }

    /// Blood lost so far [m3].
    #[getter]
    fn blood_lost_m3(&self, py: Python<'_>) -> PyResult<f64> {
        self.look(py, |runner| blood_lost_m3(runner.world()))
    }

    /// Volume of tissue taken out so far [m3].
    #[getter]
    fn removed_volume_m3(&self, py: Python<'_>) -> PyResult<f64> {
        self.look(py, |runner| runner.world().removed_volume_m3())
    }

    /// How far the scene's task is, a dictionary (docs/protocol.md, `task`); None without one.
    #[getter]
    fn task(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        let text = self.with(py, |runner| {
            let status = runner.simulation.task().map(|task| serde_json::to_string(&task.status()));
            Ok(status.transpose()?)
        })?;
        self.json(py, text)
    }

    /// The task's result so far, with its metrics (docs/tasks.md); None without a task.
    #[getter]
    fn result(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        let text = self.with(py, |runner| {
            let task = runner.simulation.task();
            Ok(task.map(|task| serde_json::to_string(&task.record().result())).transpose()?)
        })?;
        self.json(py, text)
    }

    /// What the simulation told its user, in order: what was refused, what tore.
    #[getter]
    fn notices(&self, py: Python<'_>) -> PyResult<Vec<String>> {
        self.look(py, |runner| runner.simulation.notices().iter().map(|notice| notice.text.clone()).collect())
    }

    fn __enter__(slf: Bound<'_, Self>) -> Bound<'_, Self> {
        slf
    }

    #[pyo3(signature = (*_exception))]
    fn __exit__(&self, py: Python<'_>, _exception: &Bound<'_, pyo3::types::PyTuple>) -> PyResult<()> {
        self.close(py).map(|_| ())
    }

    fn __reduce__(&self) -> PyResult<()> {
        Err(PyTypeError::new_err(
            "a world cannot be pickled: pickle its scene (World.scene) and the poses, which lead to the same bits",
        ))
    }

    fn __repr__(&self, py: Python<'_>) -> String {
        let scene = &self.scene.get().parsed().world.name;
        match self.look(py, |runner| (runner.world().steps_made(), runner.world().time_s())) {
            Ok((steps, time_s)) => format!("<glisson.World \"{scene}\", step {steps}, {time_s:.3} s>"),
            Err(_) => format!("<glisson.World \"{scene}\", closed or in use>"),
        }
    }
}

fn reports(runner: &Runner) -> &[glisson::world::ToolReport] {
    &runner.world().report().tools[..runner.world().tools().len()]
}
