//! The scene of a new patient's organ.

use anyhow::{Context, ensure};
use glisson::files::write_atomically;
use glisson::material::tissues::Tissue;
use glisson::math::{Aabb, DVec3};
use glisson::mesh::TetMesh;
use serde::Deserialize;
use std::io::Write;
use std::path::{Path, PathBuf};

/// A model that the page offers, with what its scene says about it.
#[derive(Clone, Copy, Debug)]
pub(super) struct ModelOffer {
    /// Its name, as scenes write it.
    pub(super) name: &'static str,
    /// What it is for.
    pub(super) about: &'static str,
    time_step: &'static str,
    law: Option<&'static str>,
}

/// The models, the first one taken if nothing is said.
pub(super) const MODELS: [ModelOffer; 2] = [
    ModelOffer {
        name: "implicit",
        about: "any motion of a hand, large deformations",
        time_step: "10 ms",
        law: Some("stable_neo_hooke"),
    },
    ModelOffer {
        name: "precomputed",
        about: "small deformations, the fastest: computed at the start",
        time_step: "1 ms",
        law: None,
    },
];

/// Where an organ may be held.
#[derive(Clone, Copy, Debug)]
pub(super) struct Held {
    /// Its name in choices.
    pub(super) name: &'static str,
    /// What is held: the part that lies furthest this way, LPS.
    pub(super) direction: [f64; 3],
}

/// The places, the first one taken if nothing is said: a liver's at the diaphragm and the great vessels.
pub(super) const HELD: [Held; 7] = [
    Held { name: "behind and above", direction: [0.0, 1.0, 0.4] },
    Held { name: "behind", direction: [0.0, 1.0, 0.0] },
    Held { name: "in front", direction: [0.0, -1.0, 0.0] },
    Held { name: "above", direction: [0.0, 0.0, 1.0] },
    Held { name: "below", direction: [0.0, 0.0, -1.0] },
    Held { name: "on the patient's left", direction: [1.0, 0.0, 0.0] },
    Held { name: "on the patient's right", direction: [-1.0, 0.0, 0.0] },
];
/// The scene that the page writes.
pub(super) const SCENE_NAME: &str = "scene.toml";
/// Share of the nodes that is held: a choice, that of the demo.
const HELD_FRACTION: f64 = 0.1;
/// Radius of the probe's tip, and how far in front of the organ it waits [m]: choices.
const TIP_RADIUS_M: f64 = 6e-3;
const STAND_OFF_M: f64 = 40e-3;

/// What the page says about the scene; what it leaves out is the first of its list.
#[derive(Clone, Debug, Default, Deserialize, PartialEq, Eq)]
#[serde(default, deny_unknown_fields)]
pub struct SceneChoice {
    /// A row of the table of tissues.
    pub tissue: Option<String>,
    /// One of [`MODELS`].
    pub model: Option<String>,
    /// One of [`HELD`].
    pub held: Option<String>,
}

/// The entry with this name, or the first.
fn chosen<'a, T>(list: &'a [T], name: Option<&str>, name_of: impl Fn(&T) -> &str) -> anyhow::Result<&'a T> {
    let Some(name) = name else { return list.first().context("nothing to choose from") };
    let names = || list.iter().map(&name_of).collect::<Vec<_>>().join(", ");
    list.iter()
        .find(|entry| name_of(entry) == name)
        .with_context(|| format!("found \"{name}\", allowed: {}", names()))
}

impl SceneChoice {
    /// Writes the scene of `mesh`, which is in `mesh_name` beside it, into `folder`.
    ///
    /// # Errors
    /// An unknown tissue, model or place; a file that cannot be written.
    pub fn write(&self, mesh: &TetMesh, mesh_name: &str, folder: &Path) -> anyhow::Result<PathBuf> {
        let model = chosen(&MODELS, self.model.as_deref(), |model| model.name)?;
        let held = chosen(&HELD, self.held.as_deref(), |held| held.name)?;
        let tissue = Tissue::by_name(self.tissue.as_deref().unwrap_or("liver"))?;
        ensure!(!mesh.positions_m.is_empty(), "the mesh has no node");
        let text = scene_text(mesh, mesh_name, (model, held, tissue.name));
        let path = folder.join(SCENE_NAME);
        write_atomically(&path, |file| file.write_all(text.as_bytes()))
            .with_context(|| path.display().to_string())?;
        Ok(path)
    }
}

fn scene_text(mesh: &TetMesh, mesh_name: &str, (model, held, tissue): (&ModelOffer, &Held, &str)) -> String {
    let bounds = Aabb::of_points(&mesh.positions_m);
    let middle = bounds.center_m();
    // In front of what of the organ is foremost near its middle line from head to feet.
    let near = mesh.positions_m.iter().filter(|p| (p.x - middle.x).hypot(p.z - middle.z) < 2.0 * STAND_OFF_M);
    let front = near.map(|p| p.y).fold(middle.y, f64::min);
    let home_mm = 1e3 * DVec3::new(middle.x, front - TIP_RADIUS_M - STAND_OFF_M, middle.z);
    let law = model.law.map_or_else(String::new, |law| format!("law = \"{law}\"\n"));
    let ModelOffer { name, time_step, .. } = model;
    format!(
        "# Written by `glisson patient`. Every quantity names its unit; positions are in the patient frame (LPS).\n\
         glisson_scene = 1\nname = \"A patient's organ\"\n\n[simulation]\ntime_step = \"{time_step}\"\n\n\
         [organ]\nmesh = \"{mesh_name}\"\ntissue = \"{tissue}\"\nmodel = \"{name}\"\n{law}damping = \"20 1/s\"\n\n\
         # Held {}.\n[[organ.fixed]]\nfurthest = {{ direction = {:?}, fraction = {HELD_FRACTION} }}\n\n\
         [tool]\nname = \"palpation probe\"\ntip_radius = \"{} mm\"\n\
         home_tip = [\"{:.3} mm\", \"{:.3} mm\", \"{:.3} mm\"]\nhome_shaft = [-0.2, -1, 0.5]\n",
        held.name,
        held.direction,
        1e3 * TIP_RADIUS_M,
        home_mm.x,
        home_mm.y,
        home_mm.z,
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use glisson::mesh::box_mesh::box_of_five;
    use glisson::mesh::files::write_mesh;
    use glisson::scene::{Scene, build_world};
    use glisson::workers::Sequential;
    use std::sync::Arc;

    #[test]
    fn every_choice_makes_a_world() {
        let folder = tempfile::tempdir().unwrap();
        let mesh = box_of_five([3; 3], DVec3::splat(0.06));
        write_mesh(&folder.path().join("organ.vtu"), &mesh).unwrap();
        for model in MODELS {
            for held in HELD {
                let choice = SceneChoice {
                    model: Some(model.name.into()),
                    held: Some(held.name.into()),
                    tissue: None,
                };
                let path = choice.write(&mesh, "organ.vtu", folder.path()).unwrap();
                let scene = Scene::parse(&std::fs::read_to_string(path).unwrap()).unwrap();
                build_world(&scene, folder.path(), Arc::new(Sequential)).unwrap();
            }
        }
        for wrong in [
            SceneChoice { model: Some("magic".into()), ..SceneChoice::default() },
            SceneChoice { held: Some("nowhere".into()), ..SceneChoice::default() },
            SceneChoice { tissue: Some("lever".into()), ..SceneChoice::default() },
        ] {
            let error = wrong.write(&mesh, "organ.vtu", folder.path()).unwrap_err().to_string();
            assert!(error.contains("liver") || error.contains("allowed"), "{error}");
        }
    }
}
