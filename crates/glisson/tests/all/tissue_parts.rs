//! Organs with parts of other tissue: they deform as the static solution with each tetrahedron's own stiffness says, also after
//! edits, and what cannot have parts is refused.

use std::path::Path;
use std::sync::Arc;

use crate::edit_faults::list_file;
use glisson::material::LinearElastic;
use glisson::math::DVec3;
use glisson::mesh::box_mesh::box_of_five;
use glisson::mesh::edit::{EdgeSplit, MeshEdit};
use glisson::mesh::files::{FieldPlace, FieldValues, LABEL_FIELD, VtuField, write_vtu_with};
use glisson::mesh::{EdgeId, NodeId, TetId, TetMesh};
use glisson::scene::{Scene, build_world, joint_mesh_hash, mesh_hash};
use glisson::solve::{
    BoundaryConditions, FreeSystem, MeshEdges, StiffnessTensors, TetStiffness, add_gravity_forces,
};
use glisson::workers::Sequential;
use glisson::world::{StepInput, World};

/// The bar: width and height [m].
const SIZE_M: DVec3 = DVec3::new(0.02, 0.02, 0.04);
/// Above this height it is of the other tissue [m].
const BORDER_M: f64 = 0.02;
const GRAVITY_M_PER_S2: DVec3 = DVec3::new(0.0, 0.0, -0.1);

fn bar() -> TetMesh {
    box_of_five([2, 2, 4], SIZE_M)
}

fn is_stiff(mesh: &TetMesh, tet: TetId) -> bool {
    mesh.corners_m(tet).iter().sum::<DVec3>().z > 4.0 * BORDER_M
}

fn tets_of(mesh: &TetMesh) -> impl Iterator<Item = TetId> {
    (0..mesh.tetrahedra.len()).map(TetId::from_index)
}

fn write_bar(folder: &Path, mesh: &TetMesh) {
    let labels: Vec<i32> = tets_of(mesh).map(|tet| if is_stiff(mesh, tet) { 7 } else { 3 }).collect();
    let field =
        VtuField { name: LABEL_FIELD, place: FieldPlace::Tets, values: FieldValues::Integers(&labels) };
    write_vtu_with(&folder.join("bar.vtu"), mesh, &[field]).unwrap();
}

const PART: &str = "[[organ.part]]\nlabel = 7\nyoung_modulus = \"20 kPa\"\npoisson_ratio = 0.2\n";

fn scene_text(model: &str, step: &str, law: &str, parts: &str) -> String {
    format!(
        "glisson_scene = 1\n[simulation]\ntime_step = \"{step}\"\ngravity = [0, 0, \"-0.1 m/s2\"]\n\
         [organ]\nmesh = \"bar.vtu\"\nyoung_modulus = \"4 kPa\"\npoisson_ratio = 0.3\ndensity = \"1000 kg/m3\"\n\
         model = \"{model}\"\nlaw = {law}\ndamping = \"60 1/s\"\nimaged_under_gravity = false\n\
         [[organ.fixed]]\nbox = {{ min = [\"-1 m\", \"-1 m\", \"-1 mm\"], max = [\"1 m\", \"1 m\", \"0.1 mm\"] }}\n{parts}\
         [tool]\ntip_radius = \"5 mm\"\nhome_tip = [0, 0, \"200 mm\"]\nhome_shaft = [0, 0, 1]\n"
    )
}

fn open(folder: &Path, text: &str) -> World {
    build_world(&Scene::parse(text).unwrap(), folder, Arc::new(Sequential)).unwrap().0
}

fn settle(world: &mut World) {
    let input = StepInput::of(&[world.tools()[0].home]);
    for _ in 0..(1.0 / world.spec().time_step_s).round() as usize {
        world.step(&input);
    }
}

/// Where the nodes are under gravity with each tetrahedron's own stiffness, by the linear static solution.
fn displacements_m(mesh: &TetMesh, live: impl Fn(TetId) -> bool, has_parts: bool) -> Vec<DVec3> {
    let soft = LinearElastic::from_young_poisson(4e3, 0.3, 1000.0).unwrap();
    let stiff = LinearElastic::from_young_poisson(20e3, 0.2, 1000.0).unwrap();
    let mut live_mesh = mesh.clone();
    live_mesh.tetrahedra =
        tets_of(mesh).filter(|tet| live(*tet)).map(|t| mesh.tetrahedra[t.index()]).collect();
    let mesh = &live_mesh;
    let edges = MeshEdges::of_mesh(mesh).unwrap();
    let tensors = StiffnessTensors::assemble_with(mesh, &edges, |tet, gradients| -> TetStiffness {
        let tissue = if has_parts && is_stiff(mesh, tet) { &stiff } else { &soft };
        gradients.stiffness(tissue.lambda_pa(), tissue.mu_pa())
    })
    .unwrap();
    let mut conditions = BoundaryConditions::new();
    for (n, _) in mesh.positions_m.iter().enumerate().filter(|(_, p)| p.z < 1e-4) {
        (0..3).for_each(|axis| conditions.impose(NodeId::from_index(n), axis, 0.0));
    }
    let mut load_n = vec![DVec3::ZERO; mesh.positions_m.len()];
    add_gravity_forces(mesh, &soft, GRAVITY_M_PER_S2, &mut load_n);
    let system = FreeSystem::new(&edges, &tensors, &conditions).unwrap();
    let factor = system.factorize().unwrap();
    let mut free = vec![0.0; system.n_free()];
    system.gather_into(&load_n, &mut free);
    factor.solve_in_place(&mut free, 1, &mut factor.scratch(1));
    let mut displacement_m = vec![DVec3::ZERO; mesh.positions_m.len()];
    system.add_scattered(&free, &mut displacement_m);
    displacement_m
}

fn largest_m(of: &[DVec3]) -> f64 {
    of.iter().map(|u| u.length()).fold(0.0, f64::max)
}

/// How far the world is from the static solution, as a share of that one's largest displacement.
fn error(world: &World, has_parts: bool) -> f64 {
    let (mesh, topology) = (world.organ().mesh(), world.organ().body().topology());
    let exact_m = displacements_m(mesh, |tet| topology.is_live_tet(tet), has_parts);
    let found_m = world.state().positions_m.iter().zip(&mesh.positions_m).map(|(now, rest)| *now - *rest);
    let off_m: Vec<DVec3> = found_m.zip(&exact_m).map(|(found, exact)| found - *exact).collect();
    largest_m(&off_m) / largest_m(&exact_m)
}

/// A removal of one tetrahedron of each tissue that leaves no node alone, and splits of an edge of each and of one on the border.
fn edits(world: &World) -> [MeshEdit; 2] {
    let (mesh, topology) = (world.organ().mesh(), world.organ().body().topology());
    let is_inner =
        |tet: &TetId| topology.tet_nodes(*tet).iter().all(|node| topology.node_tets(*node).len() > 1);
    let removed = |stiff| tets_of(mesh).find(|tet| is_stiff(mesh, *tet) == stiff && is_inner(tet)).unwrap();
    let tets = vec![removed(false), removed(true)];
    let middle_m = |edge: EdgeId| {
        let [a, b] = topology.edge_nodes(edge);
        0.5 * (mesh.positions_m[a.index()] + mesh.positions_m[b.index()]).z
    };
    let split = |height_m: f64| {
        let mut edges = (0..topology.n_edges()).map(EdgeId::from_index).rev();
        let edge = edges.find(|edge| (middle_m(*edge) - height_m).abs() < 1e-6).unwrap();
        EdgeSplit { edge, fraction: 0.5 }
    };
    let edges = [0.5 * BORDER_M, BORDER_M, 1.5 * BORDER_M].map(split).to_vec();
    [MeshEdit::Remove { tets }, MeshEdit::Split { edges }]
}

#[test]
fn each_part_has_its_own_stiffness_also_after_edits() {
    let folder = tempfile::tempdir().unwrap();
    write_bar(folder.path(), &bar());
    let cases = [
        ("implicit", "10 ms", "\"neo_hooke_log\""),
        ("implicit", "10 ms", "\"stable_neo_hooke\""),
        ("implicit", "10 ms", "{ name = \"ogden\", exponent = -4.7 }"),
        ("explicit", "0.2 ms", "\"st_venant_kirchhoff\""),
        ("explicit", "0.2 ms", "\"stable_neo_hooke\""),
        ("explicit", "0.2 ms", "{ name = \"ogden\", exponent = -4.7 }"),
    ];
    for (model, step, law) in cases {
        let name = format!("{model}, {law}");
        let mut world = open(folder.path(), &scene_text(model, step, law, PART));
        settle(&mut world);
        let off = error(&world, true);
        assert!(off < 0.01, "{name}: {off}");
        assert!(error(&world, false) > 0.1, "{name}: the parts tell");
        for edit in edits(&world) {
            world.edit(&edit).unwrap();
        }
        settle(&mut world);
        let off = error(&world, true);
        assert!(off < 0.01, "{name}, edited: {off}");
        // Down to nothing.
        let topology = world.organ().body().topology();
        let tets = tets_of(world.organ().mesh()).filter(|tet| topology.is_live_tet(*tet)).collect();
        if world.edit(&MeshEdit::Remove { tets }).is_ok() {
            world.step(&StepInput::of(&[world.tools()[0].home]));
        }
    }
}

/// The same tetrahedra, by a region in place of their label: those with their middle in it.
#[test]
fn a_part_may_be_a_region() {
    let folder = tempfile::tempdir().unwrap();
    write_bar(folder.path(), &bar());
    let of_tet = |parts: &str| {
        let text = scene_text("implicit", "10 ms", "\"stable_neo_hooke\"", parts);
        let scene = Scene::parse(&text).unwrap();
        let (_, bodies) = build_world(&scene, folder.path(), Arc::new(Sequential)).unwrap();
        bodies.joint.tissue_parts.unwrap().of_tet
    };
    let by_box = "box = { min = [0, 0, \"20 mm\"], max = [\"20 mm\", \"20 mm\", \"40 mm\"] }";
    let by_box = PART.replace("label = 7", by_box);
    // From 29 mm on.
    let by_ball = PART.replace("label = 7", "ball = { center = [0, 0, \"10029 mm\"], radius = \"10 m\" }");
    assert_eq!(of_tet(&by_box), of_tet(PART));
    let upper = of_tet(&by_ball).into_iter().flatten().count();
    assert!(upper > 0 && 2 * upper == of_tet(PART).into_iter().flatten().count());
    // What two parts have is of the first.
    assert_eq!(of_tet(&format!("{by_box}{by_ball}")), of_tet(PART));
}

#[test]
fn sessions_name_a_mesh_with_its_parts() {
    let folder = tempfile::tempdir().unwrap();
    write_bar(folder.path(), &bar());
    let hash = |parts: &str| {
        let text = scene_text("implicit", "10 ms", "\"stable_neo_hooke\"", parts);
        let scene = Scene::parse(&text).unwrap();
        let (_, bodies) = build_world(&scene, folder.path(), Arc::new(Sequential)).unwrap();
        assert_eq!(joint_mesh_hash(&bodies), mesh_hash(&bodies.joint));
        joint_mesh_hash(&bodies)
    };
    let plain = hash("");
    assert_ne!(hash(PART), plain);
    assert_ne!(hash(&PART.replace('7', "3")), hash(PART));
    // The labels of a mesh that no part names do not count.
    assert_eq!(hash(""), plain);
}

#[test]
fn what_has_no_parts_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    write_bar(folder.path(), &bar());
    let of = |model: &str, parts: &str| {
        let text = scene_text(model, "1 ms", "", parts).replace("law = \n", "");
        let scene = Scene::parse(&text).map_err(|error| error.to_string())?;
        build_world(&scene, folder.path(), Arc::new(Sequential))
            .map(|_| ())
            .map_err(|error| error.to_string())
    };
    let refused = |model: &str, parts: &str, words: &[&str]| {
        let message = of(model, parts).expect_err(parts);
        assert!(words.iter().all(|word| message.contains(word)), "{message}");
    };
    assert_eq!(of("implicit", PART), Ok(()));
    refused("precomputed", PART, &["precomputed", "\"explicit\"", "\"implicit\""]);
    refused("implicit", &PART.replace('7', "8"), &["label 8", "3, 7"]);
    refused("implicit", &PART.replace('7', "7.5"), &["label", "7.5"]);
    refused("implicit", &format!("{PART}{PART}"), &["label", "once"]);
    refused("implicit", &format!("{PART}density = \"1100 kg/m3\"\n"), &["density"]);
    refused("implicit", "[[organ.part]]\nlabel = 7\ntissue = \"lever\"\n", &["lever", "liver"]);
    refused("implicit", "[[organ.part]]\nlabel = 7\n", &["young_modulus"]);
    refused("implicit", &PART.replace("label = 7\n", ""), &["label", "box"]);
    let ball = "ball = { center = [0, 0, 0], radius = \"1 mm\" }";
    refused("implicit", &PART.replace("label = 7", ball), &["[[organ.part]] number 1"]);
    refused("implicit", &PART.replace("label = 7", &format!("label = 7\n{ball}")), &["ball", "label"]);
    let tears = scene_text("implicit", "1 ms", "\"stable_neo_hooke\"\ntearing = true", PART);
    let message = Scene::parse(&tears).unwrap_err().to_string();
    assert!(message.contains("part") && message.contains("tears"), "{message}");
    std::fs::write(folder.path().join("bar.tet"), list_file(&bar())).unwrap();
    let text = scene_text("implicit", "1 ms", "\"stable_neo_hooke\"", PART).replace("bar.vtu", "bar.tet");
    let message =
        build_world(&Scene::parse(&text).unwrap(), folder.path(), Arc::new(Sequential)).err().unwrap();
    assert!(message.to_string().contains("mesh-organs"), "{message}");
}
