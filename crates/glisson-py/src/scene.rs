//! Scenes: what a world is made from.

use crate::arrays::{POSE_LENGTH, numbers_of, read_only};
use crate::errors::of_scene;
use anyhow::{Context, anyhow};
use glisson::scene::{Choice, Scene, choose, with_patient};
use glisson_runtime::OpenScene;
use glisson_runtime::tasks::{TASKS, task_named};
use numpy::PyArray2;
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

    /// How many instruments it has.
    pub(crate) fn n_tools(&self) -> usize {
        self.scene.world.tools.len()
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

    /// This scene with other values, JSON of paths to values; `glisson.vary` is made of it.
    #[pyo3(signature = (json, patient = None))]
    fn _varied(&self, json: &str, patient: Option<u32>) -> PyResult<Self> {
        let varied = || -> anyhow::Result<String> {
            let mut text = self.text.clone();
            if let Some(patient) = patient {
                text = with_patient(&text, patient)?;
            }
            let values: Vec<(String, toml::Value)> = serde_json::from_str(json)?;
            if values.is_empty() {
                return Ok(text);
            }
            let mut document = toml::Value::Table(text.parse()?);
            for (path, value) in values {
                *value_at(&mut document, &path)? = value;
            }
            Ok(toml::to_string(&document)?)
        };
        let text = varied().map_err(|error| of_scene(&error.context(self.origin.clone())))?;
        Self::read(text, self.folder.clone(), self.origin.clone())
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

    /// Whether it says what is to be done.
    #[getter]
    fn has_task(&self) -> bool {
        self.scene.task.is_some()
    }

    /// Kinds of its instruments as its file names them, in their order.
    #[getter]
    fn tool_kinds(&self) -> Vec<&'static str> {
        self.scene.world.tools.iter().map(|tool| tool.kind.name()).collect()
    }

    /// When the paths of its instruments end that its file has, a demonstration [s]; None without paths.
    #[getter]
    fn demonstration_ends_s(&self) -> Option<f64> {
        self.scene.end_of_paths_s()
    }

    /// Where the demonstration has the instruments at a time, (instruments, 9).
    fn demonstration(&self, py: Python<'_>, time_s: f64) -> PyResult<Py<PyArray2<f64>>> {
        let tools = self.scene.input_at(time_s).tools;
        let numbers: Vec<f64> = tools[..self.scene.world.tools.len()].iter().flat_map(numbers_of).collect();
        Ok(read_only(py, numbers, POSE_LENGTH)?.unbind())
    }

    /// Numbers of the instruments that set a clip in the demonstration after a time and not after another [s].
    fn demonstrated_clips(&self, from_s: f64, to_s: f64) -> Vec<usize> {
        self.scene.clips_between(from_s, to_s).collect()
    }

    fn __repr__(&self) -> String {
        let tools = self.tool_names().join(", ");
        format!("<glisson.Scene \"{}\", instruments: {tools}>", self.scene.world.name)
    }

    /// A scene that was pickled, or is looked at from another folder.
    #[staticmethod]
    fn _again(text: String, folder: PathBuf, origin: String) -> PyResult<Self> {
        Self::read(text, folder, origin)
    }

    /// The same scene whose files are found from another folder.
    fn _in_folder(&self, folder: PathBuf) -> PyResult<Self> {
        Self::read(self.text.clone(), folder, self.origin.clone())
    }

    fn __reduce__(slf: &Bound<'_, Self>) -> PyResult<(Py<PyAny>, (String, PathBuf, String))> {
        let again = slf.get_type().getattr("_again")?.unbind();
        let scene = slf.get();
        Ok((again, (scene.text.clone(), scene.folder.clone(), scene.origin.clone())))
    }
}

/// What is at a path of a scene file: names of tables and keys, numbers of what is in a list, with dots between. The last key may be new.
fn value_at<'a>(document: &'a mut toml::Value, path: &str) -> anyhow::Result<&'a mut toml::Value> {
    let mut at = document;
    let mut keys = path.split('.').peekable();
    while let Some(key) = keys.next() {
        at = match at {
            toml::Value::Table(table) => {
                if keys.peek().is_none() {
                    return Ok(table.entry(key).or_insert(toml::Value::Boolean(false)));
                }
                let known: Vec<String> = table.keys().cloned().collect();
                let known: Vec<&str> = known.iter().map(String::as_str).collect();
                let suggestion = glisson::text::did_you_mean(key, &known);
                let there = known.join(", ");
                table.get_mut(key).with_context(|| {
                    format!("\"{path}\" leads to nothing: there is no {key}{suggestion}; there are: {there}")
                })?
            }
            toml::Value::Array(list) => {
                let n = list.len();
                let number = key.parse::<usize>().ok().and_then(|number| list.get_mut(number));
                number.with_context(|| {
                    format!("\"{path}\" leads to nothing: {key} is in a list of {n}, counted from 0")
                })?
            }
            _ => anyhow::bail!(
                "\"{path}\" leads to nothing: what is before {key} is neither a table nor a list"
            ),
        };
    }
    Ok(at)
}

/// Names of the tasks that come with the program.
#[pyfunction]
pub(crate) fn task_names() -> Vec<&'static str> {
    TASKS.iter().map(|(name, _)| *name).collect()
}
