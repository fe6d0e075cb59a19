//! A new patient and the one page before it: the steps of `glisson_patient`, in the page's own memory.

use anyhow::Context;
use glisson_patient::{Opened, Patient, SceneChoice, Step, image_among};
use serde::Deserialize;
use std::path::PathBuf;

/// Where the scene and its meshes are written.
const SCENES: &str = "/patient";

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct OpenChoice {
    /// Where its files are.
    folder: PathBuf,
    /// From 1.
    series: Option<usize>,
}

/// What is to be done next.
enum Next {
    Open(OpenChoice),
    Step(Step),
    Scene(SceneChoice),
}

/// A new patient.
#[derive(Default)]
pub struct NewPatient {
    patient: Patient,
    next: Option<Next>,
}

impl NewPatient {
    /// What the page shows, in JSON.
    pub fn state(&self) -> String {
        self.patient.state().to_string()
    }

    /// Has a step ready for [`NewPatient::run`]: "open" (an image), "start" (writes the scene), or one of [`Patient::step`]. Answers what
    /// the page says meanwhile.
    ///
    /// # Errors
    /// A name that is no step, a choice that cannot be read.
    pub fn prepare(&mut self, name: &str, choice: &str) -> anyhow::Result<&'static str> {
        let (what, next) = match name {
            "open" => ("reading the image", Next::Open(serde_json::from_str(choice)?)),
            "start" => ("writing the scene", Next::Scene(serde_json::from_str(choice)?)),
            _ => {
                let step =
                    self.patient.step(name, choice).with_context(|| format!("\"{name}\" is no step"))??;
                (step.what, Next::Step(step))
            }
        };
        self.next = Some(next);
        Ok(what)
    }

    /// Does what is ready.
    ///
    /// # Errors
    /// Those of the step.
    pub fn run(&mut self) -> anyhow::Result<()> {
        let change = match self.next.take().context("no step was asked for")? {
            Next::Step(step) => step.run()?,
            Next::Scene(choice) => {
                return self.patient.scene(choice, SCENES.into())().map(drop);
            }
            Next::Open(OpenChoice { folder, series }) => {
                let path = image_among(&folder)?;
                Opened::read(&path, series).without_names(&path).change()?
            }
        };
        self.patient.take(change);
        Ok(())
    }

    /// A picture of [`Patient::picture`], as PNG.
    ///
    /// # Errors
    /// A name that is no picture, or nothing to be drawn yet.
    pub fn picture(&self, name: &str) -> anyhow::Result<Vec<u8>> {
        self.patient.picture(name)?()
    }

    /// The outlines that an organ was made from, in JSON.
    ///
    /// # Errors
    /// No such organ.
    pub fn outlines(&self, organ: &str) -> anyhow::Result<String> {
        let outlines =
            self.patient.outlines(organ).with_context(|| format!("there is no organ \"{organ}\""))?;
        Ok(serde_json::to_string(outlines)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glisson::image::files::write_label_map;
    use glisson::image::{LabelMap, VoxelGrid};
    use glisson::math::{DMat3, DVec3};
    use serde_json::{Value, json};

    /// A block of label 3.
    fn block() -> LabelMap {
        let grid = VoxelGrid {
            dims: [16; 3],
            spacing_m: DVec3::splat(4e-3),
            origin_m: DVec3::ZERO,
            axes: DMat3::IDENTITY,
        };
        let is_inside = |index: usize| grid.voxel(index).iter().all(|i| (4..12).contains(i));
        let labels = (0..grid.n_voxels()).map(|index| if is_inside(index) { 3 } else { 0 }).collect();
        LabelMap { grid, labels, names: vec![(3, "liver".into())], colours: Vec::new() }
    }

    fn done(patient: &mut NewPatient, name: &str, choice: &Value) -> anyhow::Result<Value> {
        patient.prepare(name, &choice.to_string())?;
        patient.run()?;
        Ok(serde_json::from_str(&patient.state())?)
    }

    #[test]
    fn an_image_becomes_tetrahedra_and_what_is_wrong_is_said() {
        let folder = tempfile::tempdir().unwrap();
        let mut patient = NewPatient::default();
        let open = json!({"folder": folder.path()});
        let words = |outcome: anyhow::Result<Value>| format!("{:#}", outcome.unwrap_err());
        assert!(words(done(&mut patient, "open", &open)).contains("no file came"));
        std::fs::write(folder.path().join("name.nii"), "no image").unwrap();
        let refused = words(done(&mut patient, "open", &open));
        assert!(refused.contains("the image") && !refused.contains("name"), "{refused}");
        std::fs::remove_file(folder.path().join("name.nii")).unwrap();
        assert!(words(done(&mut patient, "magic", &json!({}))).contains("magic"));
        assert!(patient.run().is_err(), "nothing is ready");

        write_label_map(&folder.path().join("block.nii.gz"), &block()).unwrap();
        let opened = done(&mut patient, "open", &open).unwrap();
        assert_eq!(opened["image"]["labels"], json!([{"label": 3, "name": "liver"}]));
        assert!(patient.picture("slice/axial/30/30/30/1/3").unwrap().starts_with(b"\x89PNG"));
        assert!(patient.picture("mesh/20/16/none/0/organ").is_err());
        done(&mut patient, "organ", &json!({"name": "liver", "label": "3"})).unwrap();
        assert_eq!(patient.outlines("liver").unwrap(), "[]");
        assert!(patient.outlines("spleen").is_err());
        let filled = done(&mut patient, "mesh", &json!({"tetrahedra": 600})).unwrap();
        assert!(filled["mesh"]["tetrahedra"].as_u64().unwrap() > 300, "{filled}");
        assert!(patient.picture("mesh/20/16/none/0/organ").unwrap().starts_with(b"\x89PNG"));
    }
}
