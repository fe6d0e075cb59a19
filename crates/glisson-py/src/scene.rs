//! Scenes: what a world is made from.

use crate::errors::of_scene;
use anyhow::{Context, anyhow};
use glisson::scene::{Choice, Scene, choose};
use glisson_runtime::OpenScene;
use glisson_runtime::tasks::{TASKS, task_named};
use pyo3::prelude::*;
use std::path::PathBuf;

/// A scene: an organ or several, instruments, perhaps a task. See docs/scene.md.
#[pyclass(name = "Scene", module = "glisson", frozen)]
pub(crate) struct PyScene {
    text: String,
    folder: PathBuf,
    origin: String,
    scene: Scene,
}

impl PyScene {
    fn read(text: String, folder: PathBuf, origin: String) -> PyResult<Self> {
        let scene = Scene::parse(&text).map_err(|error| of_scene(&anyhow!("{origin}: {error}")))?;
        Ok(Self { text, folder, origin, scene })
    }

    /// For a world of its own.
    pub(crate) fn to_open(&self, n_threads: usize) -> OpenScene {
        let (scene, folder) = (self.scene.clone(), self.folder.clone());
        OpenScene { scene, folder, origin: self.origin.clone(), n_threads }
    }

    /// Whether worlds of both are the same.
    pub(crate) fn is_same_as(&self, other: &Self) -> bool {
        self.text == other.text && self.folder == other.folder
    }

    pub(crate) fn parsed(&self) -> &Scene {
        &self.scene
    }
}

#[pymethods]
impl PyScene {
    /// Reads a scene file. Files that it names are relative to its folder.
    #[staticmethod]
    fn load(path: PathBuf) -> PyResult<Self> {
        let text = std::fs::read_to_string(&path)
            .with_context(|| format!("{}: cannot read the scene", path.display()))
            .map_err(|error| of_scene(&error))?;
        let folder = path.parent().map_or_else(|| PathBuf::from("."), PathBuf::from);
        Self::read(text, folder, path.display().to_string())
    }

    /// Reads a scene's text. Files that it names are relative to `folder`.
    #[staticmethod]
    #[pyo3(signature = (text, folder = PathBuf::from(".")))]
    fn parse(text: String, folder: PathBuf) -> PyResult<Self> {
        Self::read(text, folder, "scene".to_owned())
    }

    /// A scene from JSON of the same keys and values as a scene file; `glisson.scene_from_dict` is made of it.
    #[staticmethod]
    #[pyo3(signature = (json, folder = PathBuf::from(".")))]
    fn _from_json(json: &str, folder: PathBuf) -> PyResult<Self> {
        let value: serde_json::Value =
            serde_json::from_str(json).context("scene").map_err(|error| of_scene(&error))?;
        let text = toml::to_string(&value)
            .context("scene: a dictionary that cannot be written as a scene file")
            .map_err(|error| of_scene(&error))?;
        Self::read(text, folder, "scene".to_owned())
    }

    /// A task that comes with the program, at a level and with a patient that it has.
    #[staticmethod]
    #[pyo3(signature = (name, level = None, patient = None))]
    fn task(name: &str, level: Option<String>, patient: Option<u32>) -> PyResult<Self> {
        let text = task_named(name).with_context(|| {
            let names: Vec<&str> = TASKS.iter().map(|(name, _)| *name).collect();
            let suggestion = glisson::text::did_you_mean(name, &names);
            format!("there is no task \"{name}\"; there are: {}{suggestion}", names.join(", "))
        });
        let text = text.map_err(|error| of_scene(&error))?;
        let chosen = choose(text, &Choice { patient, level });
        let text = chosen.map_err(|error| of_scene(&anyhow!("task {name}: {error}")))?;
        Self::read(text, PathBuf::from("."), format!("task {name}"))
    }

    /// The scene file's text.
    #[getter]
    fn text(&self) -> &str {
        &self.text
    }

    /// Folder that its files are relative to.
    #[getter]
    fn folder(&self) -> PathBuf {
        self.folder.clone()
    }

    /// What the scene is called.
    #[getter]
    fn name(&self) -> &str {
        &self.scene.world.name
    }

    /// Time of a step [s].
    #[getter]
    fn time_step_s(&self) -> f64 {
        self.scene.world.time_step_s
    }

    /// Names of its instruments, in their order.
    #[getter]
    fn tool_names(&self) -> Vec<String> {
        self.scene.world.tools.iter().map(|tool| tool.name.clone()).collect()
    }

    fn __repr__(&self) -> String {
        let tools = self.tool_names().join(", ");
        format!("<glisson.Scene \"{}\", instruments: {tools}>", self.scene.world.name)
    }

    fn __reduce__(slf: &Bound<'_, Self>) -> PyResult<(Py<PyAny>, (String, PathBuf))> {
        let parse = slf.get_type().getattr("parse")?.unbind();
        let scene = slf.get();
        Ok((parse, (scene.text.clone(), scene.folder.clone())))
    }
}

/// Names of the tasks that come with the program.
#[pyfunction]
pub(crate) fn task_names() -> Vec<&'static str> {
    TASKS.iter().map(|(name, _)| *name).collect()
}
