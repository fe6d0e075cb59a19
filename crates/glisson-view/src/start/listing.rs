//! What can be started: the tasks of the program, and the scene files in some folders.

use anyhow::Context;
use glisson::scene::{Scene, TaskSource};
use glisson_runtime::cut_off::CutOff;
use glisson_runtime::tasks::TASKS;
use serde::Serialize;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Folders below a listed one are looked into down to so many levels. A choice.
const DEEPEST: usize = 3;
/// Scenes that are listed. A choice: a page of more is no help.
const MOST_SCENES: usize = 200;
/// Files and folders that are looked at: a listed folder may be somebody's home. A choice.
const MOST_ENTRIES: usize = 20_000;
/// A longer file is no scene: those with every option have some kilobytes.
const LONGEST_SCENE_BYTES: u64 = 1 << 20;
/// What every scene file says of itself.
const MARK: &str = "glisson_scene";
/// Folders of other programs' files, which are many.
const PASSED_OVER: [&str; 2] = ["target", "node_modules"];

/// A task of the program.
#[derive(Clone, Debug, Serialize)]
pub(super) struct TaskLine {
    pub(super) name: &'static str,
    title: String,
    about: String,
    stages: Vec<String>,
    time_limit_s: f64,
    levels: Vec<String>,
    level: Option<String>,
    patients: Vec<u32>,
    /// Its instruments have paths that do it.
    pub(super) has_demonstration: bool,
}

impl TaskLine {
    pub(super) fn title(&self) -> &str {
        &self.title
    }
}

/// A scene file.
#[derive(Clone, Debug, Serialize)]
pub(super) struct SceneLine {
    /// What the page calls the file, and what it asks for.
    pub(super) file: String,
    name: Option<String>,
    /// Title of its task.
    task: Option<String>,
    /// Why it cannot be read.
    error: Option<String>,
    #[serde(skip)]
    pub(super) path: PathBuf,
}

/// The scene files in folders.
#[derive(Clone, Debug, Default, Serialize)]
pub(super) struct SceneList {
    pub(super) scenes: Vec<SceneLine>,
    /// There may be more than were looked for.
    pub(super) is_cut: bool,
}

/// A session that was cut off.
#[derive(Clone, Debug, Serialize)]
pub(super) struct SessionLine {
    /// What the page asks for.
    pub(super) session: String,
    /// Of its task or scene.
    pub(super) title: String,
    /// Simulated time up to its last moment [s].
    time_s: f64,
    #[serde(skip)]
    pub(super) path: PathBuf,
}

/// The sessions of a folder that were cut off.
pub(super) fn cut_off(folder: Option<&Path>) -> Vec<SessionLine> {
    let line = |CutOff { session, title, time_s }: CutOff| {
        let name = session.file_name().unwrap_or_default().to_string_lossy().into_owned();
        SessionLine { session: name, title, time_s, path: session }
    };
    folder.map(CutOff::all_in).unwrap_or_default().into_iter().map(line).collect()
}

/// The tasks that come with the program.
///
/// # Errors
/// A task that cannot be read: a fault of the program.
pub(super) fn tasks() -> anyhow::Result<Vec<TaskLine>> {
    let line = |&(name, text): &(&'static str, &str)| {
        let scene = Scene::parse(text).with_context(|| format!("the task {name}"))?;
        let has_demonstration = scene.paths.iter().any(|path| !path.is_empty());
        let task = scene.task.with_context(|| format!("the scene {name} has no task"))?;
        let TaskSource { title, about, stages, time_limit_s, levels, level, patients, .. } = task;
        let stages = stages.into_iter().map(|stage| stage.title).collect();
        Ok(TaskLine { name, title, about, stages, time_limit_s, levels, level, patients, has_demonstration })
    };
    TASKS.iter().map(line).collect()
}

/// The scene files in `folders` and not far below them, in the order of their names. Links are not followed, and what cannot be
/// read is passed over.
pub(super) fn scenes(folders: &[PathBuf]) -> SceneList {
    let mut list = SceneList::default();
    let mut n_entries = 0;
    // A folder may be listed and be in a listed one.
    let mut seen = BTreeSet::new();
    let mut open: Vec<(PathBuf, usize)> = folders.iter().rev().map(|folder| (folder.clone(), 0)).collect();
    while let Some((folder, level)) = open.pop() {
        let Ok(entries) = std::fs::read_dir(&folder) else { continue };
        let mut entries: Vec<_> = entries.flatten().take(MOST_ENTRIES - n_entries + 1).collect();
        entries.sort_by_key(std::fs::DirEntry::file_name);
        let mut inner = Vec::new();
        for entry in entries {
            n_entries += 1;
            if n_entries > MOST_ENTRIES || list.scenes.len() == MOST_SCENES {
                list.is_cut = true;
                return list;
            }
            let (Ok(kind), path) = (entry.file_type(), entry.path()) else { continue };
            if kind.is_dir() && level < DEEPEST && is_looked_into(&path) {
                inner.push((path, level + 1));
            } else if kind.is_file()
                && let Some(text) = scene_text(&path)
                && std::fs::canonicalize(&path).is_ok_and(|whole| seen.insert(whole))
            {
                list.scenes.extend(scene_line(path, &text));
            }
        }
        open.extend(inner.into_iter().rev());
    }
    list
}

fn is_looked_into(folder: &Path) -> bool {
    let name = folder.file_name().and_then(|name| name.to_str());
    name.is_some_and(|name| !name.starts_with('.') && !PASSED_OVER.contains(&name))
}

/// The text of a scene file; none of any other.
fn scene_text(path: &Path) -> Option<String> {
    let is_named = path.extension().is_some_and(|ending| ending == "toml");
    if !is_named || std::fs::metadata(path).ok()?.len() > LONGEST_SCENE_BYTES {
        return None;
    }
    let text = std::fs::read_to_string(path).ok()?;
    let marks = |line: &str| {
        line.trim_start().strip_prefix(MARK).is_some_and(|rest| rest.trim_start().starts_with('='))
    };
    text.lines().any(marks).then_some(text)
}

/// None of a file whose name is no text, by which the page could ask for it.
fn scene_line(path: PathBuf, text: &str) -> Option<SceneLine> {
    let file = path.strip_prefix(".").unwrap_or(&path).to_str()?.to_owned();
    Some(match Scene::parse(text) {
        Ok(scene) => {
            let task = scene.task.map(|task| task.title);
            SceneLine { file, name: Some(scene.world.name), task, error: None, path }
        }
        Err(error) => SceneLine { file, name: None, task: None, error: Some(error.to_string()), path },
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const SCENE: &str = "glisson_scene = 1\nname = \"a block\"\n[organ]\nbox = { min = [0, 0, 0], max = [\"1 cm\", \"1 cm\", \"1 cm\"] }\n\
        edge = \"5 mm\"\ntissue = \"liver\"\nmodel = \"precomputed\"\n[[organ.fixed]]\nfurthest = { direction = [0, 1, 0], fraction = 0.2 }\n\
        [tool]\ntip_radius = \"5 mm\"\nhome_tip = [0, 0, \"9 cm\"]\nhome_shaft = [0, 0, 1]\n";

    fn write(folder: &Path, file: &str, text: &str) {
        let path = folder.join(file);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, text).unwrap();
    }

    fn names(list: &SceneList, folder: &Path) -> Vec<String> {
        let inside = |line: &SceneLine| line.path.strip_prefix(folder).unwrap().to_str().unwrap().to_owned();
        list.scenes.iter().map(inside).collect()
    }

    #[test]
    fn the_tasks_of_the_program_are_listed_in_their_order() {
        let tasks = tasks().unwrap();
        let names: Vec<_> = tasks.iter().map(|task| task.name).collect();
        assert_eq!(names, TASKS.iter().map(|(name, _)| *name).collect::<Vec<_>>());
        for TaskLine { name, title, about, stages, time_limit_s, has_demonstration, .. } in tasks {
            assert!(!title.is_empty() && !about.is_empty() && !stages.is_empty(), "{name}");
            assert!(time_limit_s > 0.0 && has_demonstration, "{name}");
        }
    }

    #[test]
    fn scenes_are_found_not_too_deep_and_what_is_none_is_passed_over() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        for file in ["b.toml", "a/scene.toml", "a/b/c/deep.toml", "a/b/c/d/too_deep.toml", ".hidden/x.toml"] {
            write(folder, file, SCENE);
        }
        for file in ["target/x.toml", "web/node_modules/x.toml", "scene.txt"] {
            write(folder, file, SCENE);
        }
        write(folder, "Cargo.toml", "[package]\nname = \"glisson_scene\"\n");
        write(folder, "note.toml", "# glisson_scene = 1\n");
        write(folder, "long.toml", &format!("{SCENE}#{}", "x".repeat(LONGEST_SCENE_BYTES as usize)));
        std::fs::write(folder.join("bytes.toml"), b"glisson_scene = 1\n\xff").unwrap();
        let list = scenes(&[folder.to_path_buf()]);
        assert_eq!(names(&list, folder), ["b.toml", "a/scene.toml", "a/b/c/deep.toml"]);
        assert!(!list.is_cut);
        assert_eq!(list.scenes[0].name.as_deref(), Some("a block"));
        // Once, although both folders have it.
        let both = scenes(&[folder.to_path_buf(), folder.join("a")]);
        assert_eq!(names(&both, folder).len(), 4);
        assert!(scenes(&[folder.join("gone")]).scenes.is_empty());
    }

    #[test]
    fn a_scene_with_a_mistake_is_listed_with_it() {
        let folder = tempfile::tempdir().unwrap();
        write(folder.path(), "bad.toml", &SCENE.replace("tissue", "tisue"));
        let list = scenes(&[folder.path().to_path_buf()]);
        let error = list.scenes[0].error.as_deref().unwrap();
        assert!(error.contains("line 3: [organ] lacks"), "{error}");
    }

    #[cfg(unix)]
    #[test]
    fn links_are_not_followed() {
        let [folder, elsewhere] = [(); 2].map(|()| tempfile::tempdir().unwrap());
        write(elsewhere.path(), "scene.toml", SCENE);
        std::os::unix::fs::symlink(elsewhere.path(), folder.path().join("folder")).unwrap();
        std::os::unix::fs::symlink(elsewhere.path().join("scene.toml"), folder.path().join("x.toml"))
            .unwrap();
        assert!(scenes(&[folder.path().to_path_buf()]).scenes.is_empty());
    }

    #[test]
    fn there_are_not_more_than_a_page_can_show() {
        let folder = tempfile::tempdir().unwrap();
        for number in 0..MOST_SCENES + 5 {
            write(folder.path(), &format!("{number:04}.toml"), "glisson_scene = 1\n");
        }
        let list = scenes(&[folder.path().to_path_buf()]);
        assert!(list.is_cut);
        assert_eq!(list.scenes.len(), MOST_SCENES);
    }
}
