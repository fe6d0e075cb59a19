//! A scene, or a session, as a page that has the simulation in itself.

use crate::commands::output::{check_extension, make_folder_of};
use crate::commands::replay::Source;
use crate::text_file::write_text;
use anyhow::{Context, ensure};
use glisson::record::session::Session;
use glisson::scene::Scene;
use glisson_runtime::OpenScene;
use glisson_runtime::replay::check_version;
use glisson_runtime::tasks::{TASKS, task_named};
use glisson_view::local_page::{check_built, local_page_with};
use std::path::{Component, Path, PathBuf};

/// What the scene's file is called in the page.
const SCENE: &str = "scene.toml";
/// What a session's is called.
const SESSION: &str = "session.jsonl";
/// The folder of its files there.
const FOLDER: &str = "scene";

/// The scene that is asked for, if it is one and no session: that of a task, or a file.
pub(super) fn scene_of(source: &Source) -> anyhow::Result<Option<Scene>> {
    let named = source.session();
    if named.extension().is_some_and(|ending| ending == "toml") {
        return OpenScene::read(named).map(|source| Some(source.scene));
    }
    if named.extension().is_some() || named.is_file() {
        return Ok(None);
    }
    let name = named.to_string_lossy();
    let text = task_named(&name).with_context(|| {
        let names: Vec<&str> = TASKS.iter().map(|(name, _)| *name).collect();
        format!("no file or task \"{name}\"; tasks: {}", names.join(", "))
    })?;
    Ok(Some(Scene::parse(text)?))
}

pub(super) fn export(source: &Source, scene: &Scene, html: &Path) -> anyhow::Result<()> {
    check_extension(html, &["html", "htm"])?;
    check_built()?;
    let files = FilesInPage::of(scene, source.folder(), SCENE, scene.text.clone().into_bytes())?;
    let page = files.page()?;
    make_folder_of(html)?;
    write_text(html, &page)?;
    println!("scene            {}", scene.world.name);
    println!("files            {} beside the scene, {:.2} MB", files.all.len() - 1, mb(files.n_bytes()));
    println!("size             {:.2} MB", mb(page.len()));
    println!("written          {}; a browser opens it, without a server or a network", html.display());
    Ok(())
}

/// The page that simulates on from any step of a session, for the page that plays it.
pub(super) fn simulator_of(source: &Source, session: &Session) -> anyhow::Result<String> {
    check_built()?;
    check_version(session)?;
    let scene = Scene::parse_recorded(&session.header)?;
    let path = source.session();
    let text = std::fs::read(path).with_context(|| format!("{}: cannot read", path.display()))?;
    FilesInPage::of(&scene, source.folder(), SESSION, text)?.page()
}

/// Files by their names in a page; it begins with the first.
struct FilesInPage {
    all: Vec<(String, Vec<u8>)>,
}

impl FilesInPage {
    /// A first file, and those that a scene names beside it.
    fn of(scene: &Scene, folder: &Path, name: &str, bytes: Vec<u8>) -> anyhow::Result<Self> {
        let inner = inner_folder(scene);
        let mut all = vec![(format!("{inner}/{name}"), bytes)];
        for file in scene.files() {
            let path = folder.join(&file);
            let bytes = std::fs::read(&path).with_context(|| format!("{}: cannot read", path.display()))?;
            let name = name_within(&inner, &file);
            let is_taken = all.iter().any(|(other, there)| *other == name && *there != bytes);
            ensure!(
                !is_taken,
                "{}: another file of the scene has the same place, {name}, in the page",
                path.display()
            );
            all.push((name, bytes));
        }
        Ok(Self { all })
    }

    fn n_bytes(&self) -> usize {
        self.all.iter().map(|(_, bytes)| bytes.len()).sum()
    }

    fn page(&self) -> anyhow::Result<String> {
        local_page_with(&self.all[0].0, &self.all)
    }
}

fn mb(bytes: usize) -> f64 {
    bytes as f64 / 1e6
}

/// A folder so deep that no file of the scene lies above the page's first one.
fn inner_folder(scene: &Scene) -> String {
    let n_up = |file: PathBuf| file.components().filter(|part| *part == Component::ParentDir).count();
    let deepest = scene.files().into_iter().map(n_up).max().unwrap_or(0);
    FOLDER.to_owned() + &"/inner".repeat(deepest)
}

/// Where a file that a scene in `folder` names lies in the page.
fn name_within(folder: &str, file: &Path) -> String {
    let mut parts: Vec<String> =
        if file.is_absolute() { Vec::new() } else { folder.split('/').map(str::to_owned).collect() };
    for part in file.components() {
        match part {
            Component::ParentDir => drop(parts.pop()),
            Component::Normal(name) => parts.push(name.to_string_lossy().into_owned()),
            Component::CurDir | Component::RootDir | Component::Prefix(_) => {}
        }
    }
    parts.join("/")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_above_the_scene_lie_within_the_page() {
        let name = |file: &str| name_within("scene/inner", Path::new(file));
        assert_eq!(name("liver.vtu"), "scene/inner/liver.vtu");
        assert_eq!(name("./meshes/../liver.vtu"), "scene/inner/liver.vtu");
        assert_eq!(name("../liver.vtu"), "scene/liver.vtu");
        assert_eq!(name("/data/liver.vtu"), "data/liver.vtu");
    }
}
