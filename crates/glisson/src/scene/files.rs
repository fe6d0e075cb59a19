//! Files that a scene names.

use super::bodies::BodySource;
use super::organ::OrganSource;
use super::shape::{BodyShape, ShapeSource};
use super::spec::Scene;
use crate::mesh::files::files_of_mesh;
use std::path::PathBuf;

impl Scene {
    /// Files that building it reads, as it names them (relative to its folder, or absolute), each once.
    pub fn files(&self) -> Vec<PathBuf> {
        let of_bodies = self.bodies.iter().flat_map(|body| match &body.source {
            BodySource::Organ(organ, _) => of_organ(organ),
            BodySource::Rigid(rigid) => of_shape(&rigid.source),
        });
        let of_tools = self.tool_shapes.iter().flatten().cloned();
        let mut files: Vec<PathBuf> =
            of_organ(&self.organ).into_iter().chain(of_bodies).chain(of_tools).collect();
        files.sort_unstable();
        files.dedup();
        files
    }
}

fn of_shape(source: &ShapeSource) -> Vec<PathBuf> {
    match &source.shape {
        BodyShape::File { file, .. } => files_of_mesh(file),
        _ => Vec::new(),
    }
}

fn of_organ(organ: &OrganSource) -> Vec<PathBuf> {
    let curve = organ.measured.as_ref().map(|measured| &measured.curve);
    let named = [organ.vessels.as_ref(), organ.precomputed.as_ref(), curve];
    of_shape(&organ.shape).into_iter().chain(named.into_iter().flatten().cloned()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_files_of_a_scene_are_named_once() {
        let scene = Scene::parse(
            "glisson_scene = 1\n[[organ]]\nname = \"a\"\nmodel = \"precomputed\"\nmesh = \"one.node\"\nvessels = \"v.json\"\nyoung_modulus = \"5 kPa\"\n\
             poisson_ratio = 0.45\ndensity = \"1000 kg/m3\"\n[[organ.fixed]]\nfurthest = { direction = [0, 0, -1], fraction = 0.6 }\n\
             [[rigid]]\nname = \"b\"\nmesh = \"../table.stl\"\n[[rigid]]\nname = \"c\"\nball = { center = [\"0 mm\", \"0 mm\", \"0 mm\"], radius = \"5 mm\" }\n\
             [tool]\ntip_radius = \"5 mm\"\nhome_tip = [\"40 mm\", \"40 mm\", \"90 mm\"]\nhome_shaft = [0, 0, 1]\n",
        )
        .unwrap();
        assert_eq!(scene.files(), ["../table.stl", "one.ele", "one.node", "v.json"].map(PathBuf::from));
    }
}
