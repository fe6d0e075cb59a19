//! Hybrids from scene files: zones of every law, the organ's law for what is cut, a world that steps.

use glisson::math::DVec3;
use glisson::mesh::box_mesh::box_of_five;
use glisson::mesh::edit::MeshEdit;
use glisson::mesh::zones::Zones;
use glisson::mesh::{TetId, TetMesh};
use glisson::model::hybrid::condensed::{CondensedHybrid, CondensedParams, StoredNodes, Updated, ZoneLaw};
use glisson::model::kind::ModelKind;
use glisson::model::{Constraints, DeformableModel, DynamicBody, ImposedDisplacement};
use glisson::scene::{OrganBody, Scene, build_model, build_world};
use glisson::tool::ToolInput;
use glisson::workers::Sequential;
use glisson::world::{StepInput, World};
use std::path::Path;
use std::sync::Arc;

const SIZE_M: DVec3 = DVec3::new(0.10, 0.04, 0.03);

fn bar() -> TetMesh {
    box_of_five([10, 4, 3], SIZE_M)
}

/// A scene whose organ has a zone of `model` beyond x = 60 mm.
fn scene(model: &str, law: &str) -> String {
    format!(
        "glisson_scene = 1\n[simulation]\ntime_step = \"0.2 ms\"\n[organ]\nmesh = \"bar.tet\"\nyoung_modulus = \"5 kPa\"\n\
         poisson_ratio = 0.45\ndensity = \"1000 kg/m3\"\nmodel = \"hybrid\"\ndamping = \"30 1/s\"\n{law}\n\
         [[organ.fixed]]\nbox = {{ min = [\"-1 mm\", \"-1 mm\", \"-1 mm\"], max = [\"1 mm\", \"41 mm\", \"31 mm\"] }}\n\
         [[organ.zone]]\nbox = {{ min = [\"59 mm\", \"-1 mm\", \"-1 mm\"], max = [\"101 mm\", \"41 mm\", \"31 mm\"] }}\n\
         model = \"{model}\"\n\
         [tool]\ntip_radius = \"5 mm\"\nhome_tip = [\"90 mm\", \"20 mm\", \"50 mm\"]\nhome_shaft = [0, 0, 1]\n"
    )
}

fn open(text: &str, folder: &Path) -> (World, OrganBody) {
    let mesh = bar();
    let node = |p: &DVec3| format!("{:.9} {:.9} {:.9}\n", 1e3 * p.x, 1e3 * p.y, 1e3 * p.z);
    let tet = |t: &[glisson::mesh::NodeId; 4]| t.map(|n| n.0.to_string()).join(" ") + "\n";
    let head = format!("{} {}\n", mesh.positions_m.len(), mesh.tetrahedra.len());
    let nodes: String = mesh.positions_m.iter().map(node).collect();
    let tets: String = mesh.tetrahedra.iter().map(tet).collect();
    std::fs::write(folder.join("bar.tet"), head + &nodes + &tets).unwrap();
    let (world, bodies) = build_world(&Scene::parse(text).unwrap(), folder, Arc::new(Sequential)).unwrap();
    (world, bodies.joint)
}

/// Pushes the tool down into the zone by `depth_m` and back, and answers the deepest place of the tissue's top.
fn push(world: &mut World, depth_m: f64) -> f64 {
    let (mut lowest_m, rest) = (f64::INFINITY, bar());
    for step in 0..400 {
        let down_m = (0.018 + depth_m) * (step as f64 / 200.0).min(1.0);
        let tip_in_world_m = DVec3::new(0.09, 0.02, 0.05 - down_m);
        let tool = ToolInput::at(tip_in_world_m, DVec3::Z);
        let report = world.step(&StepInput::of(&[tool]));
        assert_eq!((report.n_non_finite_nodes, report.model.n_quarantined_tets), (0, 0), "step {step}");
        let tops = world
            .state()
            .positions_m
            .iter()
            .zip(&rest.positions_m)
            .filter(|(_, r)| r.z > 0.029 && r.x > 0.07);
        lowest_m = tops.map(|(p, _)| p.z).fold(lowest_m, f64::min);
    }
    lowest_m
}

#[test]
fn zones_of_a_scene_have_the_law_that_it_names_and_the_world_steps() {
    let folder = tempfile::tempdir().unwrap();
    for (name, law) in [
        ("precomputed", ZoneLaw::Precomputed),
        ("tensor_mass", ZoneLaw::TensorMass),
        ("nonlinear_tensor_mass", ZoneLaw::NonlinearTensorMass),
    ] {
        let (mut world, body) = open(&scene(name, ""), folder.path());
        assert_eq!((world.model_kind(), body.zones[0].law), (ModelKind::Hybrid, law));
        let lowest_m = push(&mut world, 0.008);
        assert!(lowest_m < 0.028, "{name}: {lowest_m}");

        // The model by hand, with the rest in four zones across its length as the manual says.
        let mesh = &body.mesh;
        let of_tet = |t: usize| {
            let corners_m = mesh.corners_m(TetId::from_index(t));
            let centre_m = corners_m.iter().sum::<DVec3>() / 4.0;
            let is_in = corners_m.iter().all(|p| p.x > 0.059);
            if is_in { 0 } else { 1 + (centre_m.x / SIZE_M.x * 4.0) as u32 }
        };
        let mut zones: Vec<u32> = (0..mesh.tetrahedra.len()).map(of_tet).collect();
        let mut used = zones.clone();
        used.sort_unstable();
        used.dedup();
        zones.iter_mut().for_each(|z| *z = used.binary_search(z).unwrap() as u32);
        let zones = Zones::new(mesh, zones).unwrap();
        let mut laws = vec![ZoneLaw::Precomputed; used.len()];
        laws[0] = law;
        let dynamics = DynamicBody {
            fixed: &body.fixed,
            damping: body.damping,
            gravity_m_per_s2: body.gravity_m_per_s2,
            rest_stress_pa: &body.rest_stress_pa,
            time_step_s: 2e-4,
            most_parts: body.most_parts,
            ..DynamicBody::new(mesh, body.material.density_kg_per_m3())
        };
        let params = CondensedParams::new(dynamics, &body.material, &zones, &laws);
        let mut by_hand =
            CondensedHybrid::build(&CondensedParams { stored: StoredNodes::Surface, ..params }).unwrap();
        by_hand.set_updated(Updated::SurfaceFirst);
        let mut from_scene = build_model(&body, ModelKind::Hybrid).unwrap();
        let node = (0..mesh.positions_m.len())
            .max_by(|&a, &b| mesh.positions_m[a].element_sum().total_cmp(&mesh.positions_m[b].element_sum()))
            .map(glisson::mesh::NodeId::from_index)
            .unwrap();
        let displacement_m = DVec3::new(0.0, 0.002, -0.003);
        let held = vec![ImposedDisplacement { node, displacement_m }];
        for model in [&mut by_hand as &mut dyn DeformableModel, &mut *from_scene] {
            model.apply(&Constraints { displacements: held.clone(), forces: vec![] });
            (0..50).for_each(|_| model.step(2e-4));
        }
        assert_eq!(by_hand.state().positions_m, from_scene.state().positions_m, "{name}");
    }
}

#[test]
fn places_inside_may_lag_where_nothing_tears() {
    let folder = tempfile::tempdir().unwrap();
    for (tearing, may_lag) in [("", true), ("tearing = true", false)] {
        let (_, body) = open(&scene("precomputed", tearing), folder.path());
        assert_eq!(body.inside_may_lag, may_lag, "{tearing}");
    }
}

#[test]
fn what_is_cut_becomes_what_the_organs_law_says() {
    let folder = tempfile::tempdir().unwrap();
    let turned = ["", "law = \"st_venant_kirchhoff\""].map(|law| {
        let (mut world, _) = open(&scene("precomputed", law), folder.path());
        let mesh = bar();
        let beyond = |t: &TetId| mesh.corners_m(*t).iter().all(|p| p.x > 0.075);
        let tets = (0..mesh.tetrahedra.len()).map(TetId::from_index).filter(beyond).take(2).collect();
        world.edit(&MeshEdit::Remove { tets }).unwrap();
        push(&mut world, 0.008);
        assert!(world.report().model.kinetic_energy_j > 0.0, "nothing is dynamic");
        world.state().positions_m.to_vec()
    });
    let between_m = turned[0].iter().zip(&turned[1]).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max);
    assert!((1e-5..0.01).contains(&between_m), "{between_m}");
}

#[test]
fn bad_zones_are_named() {
    let error = Scene::parse(&scene("implicit", "")).unwrap_err().to_string();
    assert!(error.contains("nonlinear_tensor_mass") && error.contains("implicit"), "{error}");
    let error = Scene::parse(&scene("tensor_mass", "law = \"ogden\"")).map(|_| ()).unwrap_err().to_string();
    assert!(error.contains("ogden"), "{error}");
}
