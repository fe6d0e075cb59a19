//! The scene of a new patient's organ.

use anyhow::{Context, ensure};
use glisson::files::write_atomically;
use glisson::material::tissues::Tissue;
use glisson::math::{Aabb, DVec3};
use glisson::mesh::files::{FieldPlace, FieldValues, LABEL_FIELD, VtuField, write_vtu_with};
use serde::Deserialize;
use serde_json::Value;
use std::io::Write;
use std::path::{Path, PathBuf};

use super::tetrahedra::Body;

/// A model that the page offers, with what its scene says about it.
#[derive(Clone, Copy, Debug)]
pub(super) struct ModelOffer {
    /// Its name, as scenes write it.
    pub(super) name: &'static str,
    /// What it is for.
    pub(super) about: &'static str,
    time_step: &'static str,
    law: Option<&'static str>,
    /// Whether a body may be of several tissues.
    has_parts: bool,
}

/// The models, the first one taken if nothing is said.
pub(super) const MODELS: [ModelOffer; 2] = [
    ModelOffer {
        name: "implicit",
        about: "any motion of a hand, large deformations",
        time_step: "10 ms",
        law: Some("stable_neo_hooke"),
        has_parts: true,
    },
    ModelOffer {
        name: "precomputed",
        about: "small deformations, the fastest: computed at the start",
        time_step: "1 ms",
        law: None,
        has_parts: false,
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
/// The mesh of an organ that is alone, beside its scene.
pub(super) const MESH_NAME: &str = "organ.vtu";
/// With a number, those of several bodies.
const MESH_PREFIX: &str = "organ-";
/// The scene that the page writes.
pub const SCENE_NAME: &str = "scene.toml";
/// Share of the nodes that is held: a choice, that of the demo.
const HELD_FRACTION: f64 = 0.1;
/// Radius of the probe's tip, and how far in front of the organ it waits [m]: choices.
const TIP_RADIUS_M: f64 = 6e-3;
const STAND_OFF_M: f64 = 40e-3;

/// What the page says about the scene; what it leaves out is the first of its list.
#[derive(Clone, Debug, Default, Deserialize, PartialEq, Eq)]
#[serde(default, deny_unknown_fields)]
pub struct SceneChoice {
    /// A row of the table of tissues for each organ, in the order of the organs; liver for those that are left out.
    pub tissues: Vec<String>,
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

/// All that the text of a body in a scene is made from.
struct BodyText<'a> {
    body: &'a Body,
    mesh_name: String,
    /// Of all organs.
    names: &'a [String],
    tissues: &'a [&'static str],
    model: &'a ModelOffer,
    held: &'a Held,
}

impl SceneChoice {
    /// Writes the scene of `bodies`, whose labels have these names, with its meshes into `folder`.
    ///
    /// # Errors
    /// An unknown tissue, model or place; tissues that the model cannot part; a file that cannot be written.
    pub(super) fn write(&self, names: &[String], bodies: &[Body], folder: &Path) -> anyhow::Result<PathBuf> {
        let model = chosen(&MODELS, self.model.as_deref(), |model| model.name)?;
        let held = chosen(&HELD, self.held.as_deref(), |held| held.name)?;
        let tissues = (0..names.len())
            .map(|organ| Tissue::by_name(self.tissues.get(organ).map_or("liver", String::as_str)))
            .map(|tissue| tissue.map(|tissue| tissue.name))
            .collect::<Result<Vec<_>, _>>()?;
        let mut text = String::from(
            "# Written by `glisson patient`. Every quantity names its unit; positions are in the patient frame (LPS).\n\
             glisson_scene = 1\nname = \"A patient's organs\"\n\n",
        );
        text += &format!("[simulation]\ntime_step = \"{}\"\n", model.time_step);
        remove_meshes(folder)?;
        let mut body_names: Vec<String> = Vec::new();
        for (number, body) in (1..).zip(bodies) {
            let mesh_name =
                if bodies.len() == 1 { MESH_NAME.into() } else { format!("{MESH_PREFIX}{number}.vtu") };
            let body = BodyText { body, mesh_name, names, tissues: &tissues, model, held };
            // An organ in several pieces is several bodies.
            let name = body.name();
            let n_before = body_names.iter().filter(|known| **known == name).count();
            let own_name = if n_before > 0 { format!("{name}, part {}", n_before + 1) } else { name.clone() };
            body_names.push(name);
            text += &body.text((bodies.len() > 1).then_some(&own_name))?;
            let label_of: Vec<i32> = body.body.label_of.iter().map(|&label| i32::from(label)).collect();
            let values = FieldValues::Integers(&label_of);
            let field = VtuField { name: LABEL_FIELD, place: FieldPlace::Tets, values };
            write_vtu_with(&folder.join(&body.mesh_name), &body.body.mesh, &[field])?;
        }
        text += &tool_text(bodies)?;
        let path = folder.join(SCENE_NAME);
        write_atomically(&path, |file| file.write_all(text.as_bytes()))
            .with_context(|| path.display().to_string())?;
        Ok(path)
    }
}

/// Files of meshes in a folder that the page writes, as it names them.
pub fn meshes_in(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let is_mesh = |name: &str| {
        let number = name.strip_prefix(MESH_PREFIX).and_then(|rest| rest.strip_suffix(".vtu"));
        name == MESH_NAME || number.is_some_and(|number| number.parse::<u32>().is_ok())
    };
    entries
        .filter(|entry| entry.file_name().to_str().is_some_and(is_mesh))
        .map(|entry| entry.path())
        .collect()
}

/// Removes what a start before wrote: of it there may have been more bodies.
fn remove_meshes(folder: &Path) -> anyhow::Result<()> {
    for path in meshes_in(folder) {
        std::fs::remove_file(&path).with_context(|| path.display().to_string())?;
    }
    Ok(())
}

/// As TOML writes it: its strings with escapes are those of JSON.
fn quoted(text: &str) -> String {
    Value::from(text).to_string()
}

impl BodyText<'_> {
    fn name_of(&self, label: u16) -> &str {
        &self.names[usize::from(label) - 1]
    }

    fn tissue_of(&self, label: u16) -> &'static str {
        self.tissues[usize::from(label) - 1]
    }

    /// The names of its organs.
    fn name(&self) -> String {
        let names: Vec<&str> = self.body.labels.iter().map(|&label| self.name_of(label)).collect();
        names.join(" with ")
    }

    /// The body's tables; with its name where it is one of several. Its largest organ gives the tissue, other ones are parts of it where
    /// theirs differs.
    fn text(&self, own_name: Option<&str>) -> anyhow::Result<String> {
        let labels = &self.body.labels;
        let largest = *labels.first().context("a body without an organ")?;
        let tissue = self.tissue_of(largest);
        let parts: Vec<u16> = labels.iter().copied().filter(|&l| self.tissue_of(l) != tissue).collect();
        ensure!(
            parts.is_empty() || self.model.has_parts,
            "{} of {} in one body with {} of {tissue}: the model {} has one tissue a body; take `implicit`, or one tissue",
            self.name_of(parts[0]),
            self.tissue_of(parts[0]),
            self.name_of(largest),
            self.model.name
        );
        let ModelOffer { name, law, .. } = self.model;
        let mut text = String::from(if own_name.is_some() { "\n[[organ]]\n" } else { "\n[organ]\n" });
        if let Some(name) = own_name {
            text += &format!("name = {}\n", quoted(name));
        }
        text += &format!("mesh = \"{}\"\ntissue = \"{tissue}\"\nmodel = \"{name}\"\n", self.mesh_name);
        text += &law.map_or_else(String::new, |law| format!("law = \"{law}\"\n"));
        text += "damping = \"20 1/s\"\n";
        for label in parts {
            let (name, tissue) = (self.name_of(label), self.tissue_of(label));
            text += &format!("\n[[organ.part]] # {name}\nlabel = {label}\ntissue = \"{tissue}\"\n");
        }
        let Held { name, direction } = self.held;
        text += &format!(
            "\n# Held {name}.\n[[organ.fixed]]\nfurthest = {{ direction = {direction:?}, fraction = {HELD_FRACTION} }}\n"
        );
        Ok(text)
    }
}

/// A probe in front of what of the organs is foremost near their middle line from head to feet.
fn tool_text(bodies: &[Body]) -> anyhow::Result<String> {
    let positions_m: Vec<DVec3> =
        bodies.iter().flat_map(|body| body.mesh.positions_m.iter().copied()).collect();
    ensure!(!positions_m.is_empty(), "the mesh has no node");
    let middle = Aabb::of_points(&positions_m).center_m();
    let near = positions_m.iter().filter(|p| (p.x - middle.x).hypot(p.z - middle.z) < 2.0 * STAND_OFF_M);
    let front = near.map(|p| p.y).fold(middle.y, f64::min);
    let home_mm = 1e3 * DVec3::new(middle.x, front - TIP_RADIUS_M - STAND_OFF_M, middle.z);
    Ok(format!(
        "\n[tool]\nname = \"palpation probe\"\ntip_radius = \"{} mm\"\n\
         home_tip = [\"{:.3} mm\", \"{:.3} mm\", \"{:.3} mm\"]\nhome_shaft = [-0.2, -1, 0.5]\n",
        1e3 * TIP_RADIUS_M,
        home_mm.x,
        home_mm.y,
        home_mm.z,
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glisson::mesh::TetMesh;
    use glisson::mesh::box_mesh::box_of_five;
    use glisson::scene::{Scene, build_world};
    use glisson::workers::Sequential;
    use std::sync::Arc;

    /// A box, its upper half of another organ.
    fn body(labels: [u16; 2], at_m: DVec3) -> Body {
        let mut mesh: TetMesh = box_of_five([3; 3], DVec3::splat(0.06));
        let middle = |t: &[glisson::mesh::NodeId; 4]| {
            t.iter().map(|n| mesh.positions_m[n.index()].z).sum::<f64>() / 4.0
        };
        let label_of: Vec<u16> =
            mesh.tetrahedra.iter().map(|t| labels[usize::from(middle(t) > 0.04)]).collect();
        mesh.positions_m.iter_mut().for_each(|p| *p += at_m);
        let labels = if labels[0] == labels[1] { vec![labels[0]] } else { labels.to_vec() };
        Body { mesh, label_of, labels }
    }

    fn names(n: usize) -> Vec<String> {
        ["liver \"of two\"", "tumour", "kidney # 1"].map(String::from)[..n].to_vec()
    }

    fn built(choice: &SceneChoice, names: &[String], bodies: &[Body]) -> anyhow::Result<String> {
        let folder = tempfile::tempdir()?;
        let text = std::fs::read_to_string(choice.write(names, bodies, folder.path())?)?;
        build_world(&Scene::parse(&text)?, folder.path(), Arc::new(Sequential))?;
        Ok(text)
    }

    #[test]
    fn every_choice_makes_a_world() {
        for model in MODELS {
            for held in HELD {
                let choice = SceneChoice {
                    model: Some(model.name.into()),
                    held: Some(held.name.into()),
                    tissues: Vec::new(),
                };
                built(&choice, &names(1), &[body([1, 1], DVec3::ZERO)]).unwrap();
            }
        }
        for wrong in [
            SceneChoice { model: Some("magic".into()), ..SceneChoice::default() },
            SceneChoice { held: Some("nowhere".into()), ..SceneChoice::default() },
            SceneChoice { tissues: vec!["lever".into()], ..SceneChoice::default() },
        ] {
            let error = built(&wrong, &names(1), &[body([1, 1], DVec3::ZERO)]).unwrap_err().to_string();
            assert!(error.contains("liver") || error.contains("allowed"), "{error}");
        }
    }

    #[test]
    fn organs_become_parts_where_they_hang_together_and_bodies_where_not() {
        let aside_m = DVec3::new(0.1, 0.0, 0.0);
        // The third organ is in two pieces.
        let bodies = [body([1, 2], DVec3::ZERO), body([3, 3], aside_m), body([3, 3], 2.0 * aside_m)];
        let tissues: Vec<String> = ["liver", "gall_bladder", "liver"].map(String::from).to_vec();
        let choice = SceneChoice { tissues: tissues.clone(), ..SceneChoice::default() };
        let text = built(&choice, &names(3), &bodies).unwrap();
        assert_eq!(text.matches("[[organ]]").count(), 3);
        assert_eq!(text.matches("[[organ.part]]").count(), 1);
        assert!(text.contains("label = 2\ntissue = \"gall_bladder\""), "{text}");
        let choice = SceneChoice { tissues, model: Some("precomputed".into()), ..SceneChoice::default() };
        let error = built(&choice, &names(3), &bodies).unwrap_err().to_string();
        assert!(error.contains("tumour") && error.contains("implicit"), "{error}");
        let choice = SceneChoice { model: Some("precomputed".into()), ..SceneChoice::default() };
        assert!(!built(&choice, &names(3), &bodies).unwrap().contains("[[organ.part]]"));
    }
}
