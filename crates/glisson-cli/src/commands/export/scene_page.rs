//! A scene as a page that has its simulation in itself.

use crate::commands::output::{check_extension, make_folder_of};
use crate::commands::replay::Source;
use crate::text_file::write_text;
use anyhow::{Context, ensure};
use glisson::scene::Scene;
use glisson_runtime::OpenScene;
use glisson_runtime::tasks::{TASKS, task_named};
use glisson_view::local_page::{has_local_page, local_page_with};
use std::path::{Component, Path, PathBuf};

/// What the scene's file is called in the page.
const SCENE: &str = "scene.toml";
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
    ensure!(
        has_local_page(),
        "this program was built without the simulator for browsers; `cargo xtask web` builds it, then `cargo xtask demo` the program"
    );
    let folder = inner_folder(scene);
    let scene_name = format!("{folder}/{SCENE}");
    let mut files = vec![(scene_name.clone(), scene.text.clone().into_bytes())];
    for file in scene.files() {
        let path = source.folder().join(&file);
        let bytes = std::fs::read(&path).with_context(|| format!("{}: cannot read", path.display()))?;
        let name = name_within(&folder, &file);
        let is_taken = files.iter().any(|(other, there)| *other == name && *there != bytes);
        ensure!(
            !is_taken,
            "{}: another file of the scene has the same place, {name}, in the page",
            path.display()
        );
        files.push((name, bytes));
    }
    let page = local_page_with(&scene_name, &files).context("the program's page is gone")?;
    make_folder_of(html)?;
    write_text(html, &page)?;
    println!("scene            {}", scene.world.name);
    println!(
        "files            {} beside the scene, {:.2} MB",
        files.len() - 1,
        mb(files.iter().map(|(_, bytes)| bytes.len()).sum())
    );
    println!("size             {:.2} MB", mb(page.len()));
    println!("written          {}; a browser opens it, without a server or a network", html.display());
    Ok(())
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
