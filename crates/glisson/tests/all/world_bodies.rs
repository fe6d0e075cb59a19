//! Worlds of several bodies: they carry each other, step alike at any number of threads, are cut one by one and come back.

use std::path::Path;
use std::sync::Arc;

use crate::bodies::Backwards;
use crate::edit_faults::list_file;
use glisson::math::DVec3;
use glisson::mesh::box_mesh::box_of_five;
use glisson::mesh::edit::MeshEdit;
use glisson::mesh::{TetId, TetMesh};
use glisson::model::LevelOfDetail;
use glisson::record::snapshot::{ContactKind, ContactPoint, ContactPoints};
use glisson::scene::{BodySet, Scene, build_world};
use glisson::tool::ToolInput;
use glisson::workers::{Sequential, SharedWorkers};
use glisson::world::{StepInput, World};

/// Edge of the cubes [m].
const SIDE_M: f64 = 0.04;
const DENSITY_KG_PER_M3: f64 = 1000.0;
/// Weight of a cube [N].
const WEIGHT_N: f64 = DENSITY_KG_PER_M3 * SIDE_M * SIDE_M * SIDE_M * 9.81;

/// A cube with its lower corner there.
fn cube(cells: usize, corner_m: DVec3) -> TetMesh {
    let mut mesh = box_of_five([cells; 3], DVec3::splat(SIDE_M));
    mesh.positions_m.iter_mut().for_each(|p| *p += corner_m);
    mesh
}

/// Two cubes, a little apart, one above the other over a slab.
fn write_meshes(folder: &Path) {
    let lower = cube(3, DVec3::new(-0.02, -0.02, 0.0005));
    let upper = cube(2, DVec3::new(-0.017, -0.023, 0.0415));
    std::fs::write(folder.join("lower.tet"), list_file(&lower)).unwrap();
    std::fs::write(folder.join("upper.tet"), list_file(&upper)).unwrap();
}

struct Setting {
    models: [&'static str; 2],
    time_step: &'static str,
    extra: &'static str,
}

fn scene_text(setting: &Setting) -> String {
    let organ = |name: &str, model: &str| {
        format!(
            "[[organ]]\nname = \"{name}\"\nmesh = \"{name}.tet\"\nyoung_modulus = \"10 kPa\"\npoisson_ratio = 0.3\n\
             density = \"1000 kg/m3\"\nmodel = \"{model}\"\ndamping = \"10 1/s\"\nimaged_under_gravity = false\n"
        )
    };
    let [lower, upper] = setting.models;
    format!(
        "glisson_scene = 1\n[simulation]\ntime_step = \"{}\"\ngravity = [0, 0, \"-9.81 m/s2\"]\n{}{}\
         [[rigid]]\nname = \"slab\"\nslab = {{ point = [0, 0, 0], normal = [0, 0, 1], size = \"200 mm\", thickness = \"20 mm\" }}\n{}\
         [tool]\ntip_radius = \"5 mm\"\nhome_tip = [0, 0, \"200 mm\"]\nhome_shaft = [0, 0, 1]\n",
        setting.time_step,
        organ("lower", lower),
        organ("upper", upper),
        setting.extra,
    )
}

fn open(setting: &Setting, workers: SharedWorkers) -> (World, BodySet) {
    let folder = tempfile::tempdir().unwrap();
    write_meshes(folder.path());
    let scene = Scene::parse(&scene_text(setting)).unwrap();
    build_world(&scene, folder.path(), workers).unwrap()
}

fn idle(world: &World) -> StepInput {
    StepInput::of(&[world.tools()[0].home])
}

fn run(world: &mut World, seconds: f64) -> f64 {
    let input = idle(world);
    let mut deepest_m = 0.0_f64;
    for _ in 0..(seconds / world.spec().time_step_s).round() as usize {
        deepest_m = deepest_m.max(world.step(&input).self_contact.penetration_m);
    }
    deepest_m
}

/// Sum of the forces between bodies on a body [N].
fn force_on_body_n(world: &World, body: usize) -> DVec3 {
    let nodes = world.spec().bodies[body].nodes.clone();
    let forces = world.body_contact().unwrap().forces().iter();
    forces.filter(|force| nodes.contains(&force.node.0)).map(|force| force.force_n).sum()
}

const SETTINGS: [Setting; 3] = [
    Setting { models: ["implicit", "implicit"], time_step: "5 ms", extra: "" },
    Setting { models: ["explicit", "explicit"], time_step: "0.5 ms", extra: "" },
    Setting { models: ["implicit", "explicit"], time_step: "0.5 ms", extra: "" },
];

#[test]
fn bodies_fall_on_a_slab_and_rest_on_each_other() {
    for setting in &SETTINGS {
        let name = format!("{:?}", setting.models);
        let (mut world, _) = open(setting, Arc::new(Sequential));
        let deepest_m = run(&mut world, 1.5);
        // Found before the response: the way of a step at the blow.
        assert!(deepest_m < 1e-3, "{name}: {deepest_m}");
        let before_m = world.state().positions_m.to_vec();
        let deepest_m = run(&mut world, 0.5);
        assert!(deepest_m < 1e-4, "{name}: {deepest_m}");
        let moved_m = before_m.iter().zip(world.state().positions_m).map(|(a, b)| a.distance(*b));
        let moved_m = moved_m.fold(0.0, f64::max);
        assert!(moved_m < 1e-4, "{name}: still moves, {moved_m}");
        let on_slab_n = force_on_body_n(&world, 2);
        assert!((on_slab_n.z + 2.0 * WEIGHT_N).abs() < 0.02 * WEIGHT_N, "{name}: {on_slab_n} {WEIGHT_N}");
        let on_upper_n = force_on_body_n(&world, 1);
        assert!((on_upper_n.z - WEIGHT_N).abs() < 0.02 * WEIGHT_N, "{name}: {on_upper_n} {WEIGHT_N}");
        // Those who look on see the same forces, place by place.
        let mut found = ContactPoints::default();
        world.contact_points_into(&mut found);
        assert_eq!(found.n_left_out(), 0, "{name}");
        for body in 0..3 {
            let on_it_n = |point: &ContactPoint| {
                let is = |number: u8| f64::from(u8::from(usize::from(number) == body));
                point.force_n * (is(point.by) - is(point.touched))
            };
            let seen_n: DVec3 = found.points.iter().map(on_it_n).sum();
            assert!(seen_n.distance(force_on_body_n(&world, body)) < 1e-9, "{name}: body {body} {seen_n}");
        }
        let is_right = |p: &ContactPoint| {
            p.kind == ContactKind::Bodies && p.by < p.touched && p.force_n.dot(p.normal) > 0.0
        };
        assert!(found.points.iter().all(is_right), "{name}: {found:?}");
    }
}

#[test]
fn threads_and_restores_in_mid_contact_change_no_bit() {
    for setting in &SETTINGS {
        let (mut world, _) = open(setting, Arc::new(Sequential));
        let (mut other, _) = open(setting, Arc::new(Backwards));
        run(&mut world, 0.1);
        run(&mut other, 0.1);
        assert!(world.report().self_contact.n_contacts > 0);
        assert_eq!(world.state_hash(), other.state_hash());
        let saved = other.save();
        run(&mut world, 0.05);
        run(&mut other, 0.03);
        other.restore(&saved);
        run(&mut other, 0.05);
        assert_eq!(world.state_hash(), other.state_hash());
    }
}

#[test]
fn a_body_is_cut_while_it_carries_another_and_undo_brings_every_bit_back() {
    for setting in &SETTINGS {
        let (mut world, _) = open(setting, Arc::new(Sequential));
        run(&mut world, 0.2);
        let before = world.state_hash();
        let forces = world.body_contact().unwrap().memory();
        // Of the upper cube: its numbers stand after those of the lower one.
        let first = world.spec().bodies[1].tetrahedra.start;
        world.edit(&MeshEdit::Remove { tets: vec![TetId(first), TetId(first + 7)] }).unwrap();
        assert_ne!(world.state_hash(), before);
        run(&mut world, 0.02);
        assert!(world.undo_edit());
        assert_eq!(world.state_hash(), before, "{:?}", setting.models);
        assert_eq!(world.body_contact().unwrap().memory(), forces);
        // The slab is rigid: the whole edit is refused, and changes nothing.
        let slab = world.spec().bodies[2].tetrahedra.start;
        let tets = vec![TetId(first), TetId(slab)];
        let refusal = world.edit(&MeshEdit::Remove { tets }).unwrap_err().to_string();
        assert!(refusal.contains("rigid body cannot be cut"), "{refusal}");
        assert_eq!(world.state_hash(), before);
    }
}

#[test]
fn attachments_carry_a_body_by_their_stiffness() {
    let folder = tempfile::tempdir().unwrap();
    // Half a millimetre under the slab.
    std::fs::write(folder.path().join("cube.tet"), list_file(&cube(2, DVec3::new(-0.02, -0.02, -0.0605))))
        .unwrap();
    for (kind, model, step) in [("glue", "implicit", "5 ms"), ("ligament", "explicit", "0.5 ms")] {
        let text = format!(
            "glisson_scene = 1\n[simulation]\ntime_step = \"{step}\"\ngravity = [0, 0, \"-9.81 m/s2\"]\n\
             [[organ]]\nname = \"cube\"\nmesh = \"cube.tet\"\nyoung_modulus = \"100 kPa\"\npoisson_ratio = 0.3\n\
             density = \"1000 kg/m3\"\nmodel = \"{model}\"\ndamping = \"20 1/s\"\nimaged_under_gravity = false\n\
             [[rigid]]\nname = \"slab\"\nslab = {{ point = [0, 0, 0], normal = [0, 0, 1], size = \"200 mm\", thickness = \"20 mm\" }}\n\
             [[attachment]]\nbody = \"cube\"\nto = \"slab\"\nkind = \"{kind}\"\nreach = \"1 mm\"\nstiffness = \"400 N/m\"\ndamping = \"50 ms\"\n\
             [tool]\ntip_radius = \"5 mm\"\nhome_tip = [0, 0, \"200 mm\"]\nhome_shaft = [0, 0, 1]\n"
        );
        let scene = Scene::parse(&text).unwrap();
        let (mut world, _) = build_world(&scene, folder.path(), Arc::new(Sequential)).unwrap();
        run(&mut world, 2.0);
        let (rest_m, now_m) = (&world.organ().mesh().positions_m, world.state().positions_m);
        let top: Vec<usize> = (0..27).filter(|&n| rest_m[n].z > -0.021).collect();
        let down_m = top.iter().map(|&n| rest_m[n].z - now_m[n].z).sum::<f64>() / top.len() as f64;
        let expected_m = WEIGHT_N / 400.0;
        assert!((down_m / expected_m - 1.0).abs() < 0.05, "{kind}: {down_m} {expected_m}");
        let pull_n = force_on_body_n(&world, 0);
        assert!((pull_n.z / WEIGHT_N - 1.0).abs() < 0.02, "{kind}: {pull_n}");
    }
}

/// A simulation that is late computes less, and divides its steps otherwise: bodies stay on each other all the same.
#[test]
fn bodies_rest_at_any_level_of_detail_and_in_parts_of_steps() {
    let setting = Setting { models: ["implicit", "implicit"], time_step: "5 ms", extra: "" };
    for (effort, n_parts) in [
        (LevelOfDetail::Full, 1),
        (LevelOfDetail::Full, 2),
        (LevelOfDetail::Least, 1),
        (LevelOfDetail::Least, 2),
    ] {
        let (mut world, _) = open(&setting, Arc::new(Sequential));
        let input = idle(&world);
        for step in 0..400 {
            if step == 100 {
                world.set_level_of_detail(effort);
            }
            let n = if step > 100 && step % 3 == 0 { n_parts } else { 1 };
            world.step(&input.divided(n));
        }
        let rest_m = &world.organ().mesh().positions_m;
        let ways_m =
            world.state().positions_m.iter().zip(rest_m).map(|(now_m, rest_m)| now_m.distance(*rest_m));
        let furthest_m = ways_m.fold(0.0, f64::max);
        // They fall by 1.5 mm, and their weight presses them by some millimetres.
        assert!(furthest_m < 8e-3, "{effort:?} {n_parts}: {furthest_m}");
    }
}

/// What was imaged under gravity lies still from the first step: on a slope, on each other, apart or in each other by what the
/// image leaves open.
#[test]
fn bodies_imaged_on_each_other_are_at_rest_from_the_first_step() {
    // By 8 degrees; the gaps between them are those of meshes from an image.
    let slope = 8.0_f64.to_radians();
    let gravity = DVec3::new(libm::sin(slope), 0.0, -libm::cos(slope)) * 9.81;
    let mut lower = cube(4, DVec3::new(-0.02, -0.02, 0.0));
    let mut upper = cube(3, DVec3::new(-0.017, -0.023, SIDE_M));
    for (n, p) in lower.positions_m.iter_mut().chain(&mut upper.positions_m).enumerate() {
        p.z += 4e-4 * libm::sin(n as f64);
    }
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("lower.tet"), list_file(&lower)).unwrap();
    std::fs::write(folder.path().join("upper.tet"), list_file(&upper)).unwrap();
    // In steps of explicit models the answers do not suffice to find the forces exactly: bodies settle.
    for (model, step, law, most_m) in [
        ("implicit", "5 ms", "law = \"stable_neo_hooke\"\n", 1e-6),
        ("explicit", "0.25 ms", "law = \"stable_neo_hooke\"\n", 1e-4),
        ("tensor_mass", "0.25 ms", "", 1e-4),
    ] {
        let organ = |name: &str| {
            format!(
                "[[organ]]\nname = \"{name}\"\nmesh = \"{name}.tet\"\nyoung_modulus = \"10 kPa\"\npoisson_ratio = 0.3\n\
                 density = \"1000 kg/m3\"\nmodel = \"{model}\"\n{law}damping = \"10 1/s\"\n"
            )
        };
        let text = format!(
            "glisson_scene = 1\n[simulation]\ntime_step = \"{step}\"\ngravity = [\"{} m/s2\", 0, \"{} m/s2\"]\n{}{}\
             [[rigid]]\nname = \"slab\"\nslab = {{ point = [0, 0, 0], normal = [0, 0, 1], size = \"200 mm\", thickness = \"20 mm\" }}\n\
             [tool]\ntip_radius = \"5 mm\"\nhome_tip = [0, 0, \"200 mm\"]\nhome_shaft = [0, 0, 1]\n",
            gravity.x,
            gravity.z,
            organ("lower"),
            organ("upper"),
        );
        let (mut world, _) =
            build_world(&Scene::parse(&text).unwrap(), folder.path(), Arc::new(Sequential)).unwrap();
        let rest_m = world.state().positions_m.to_vec();
        let furthest_m = |world: &World| {
            let ways_m = world.state().positions_m.iter().zip(&rest_m).map(|(a, b)| a.distance(*b));
            ways_m.fold(0.0, f64::max)
        };
        let input = idle(&world);
        world.step(&input);
        let first_m = furthest_m(&world);
        assert!(first_m < 1e-9, "{model}: {first_m} m in the first step");
        run(&mut world, 1.0);
        let later_m = furthest_m(&world);
        assert!(later_m < most_m, "{model}: {later_m} m in a second");
        // Each carries the weight of what is above it, against the slope too.
        let weight_n = gravity * (DENSITY_KG_PER_M3 * SIDE_M * SIDE_M * SIDE_M);
        let on_upper_n = force_on_body_n(&world, 1);
        assert!((on_upper_n + weight_n).length() < 0.02 * WEIGHT_N, "{model}: {on_upper_n} {weight_n}");
        let on_slab_n = force_on_body_n(&world, 2);
        assert!((on_slab_n - weight_n * 2.0).length() < 0.02 * WEIGHT_N, "{model}: {on_slab_n}");
    }
}

/// A ball that is small beside the mesh is borne by what the mesh does not show, which is each body's own tissue; a rigid body has
/// nothing that yields. Of every model beside a soft quasi-static one, whatever the first body is.
#[test]
fn an_instrument_feels_each_bodys_own_tissue() {
    let folder = tempfile::tempdir().unwrap();
    for (name, x_m) in [("soft", 0.0), ("stiff", 0.1)] {
        let cube = cube(3, DVec3::new(x_m, 0.0, 0.0));
        std::fs::write(folder.path().join(format!("{name}.tet")), list_file(&cube)).unwrap();
    }
    for model in ["precomputed", "implicit"] {
        let organ = |name: &str, kpa: f64, model: &str| {
            format!(
                "[[organ]]\nname = \"{name}\"\nmesh = \"{name}.tet\"\nyoung_modulus = \"{kpa} kPa\"\npoisson_ratio = 0.3\n\
                 density = \"1000 kg/m3\"\nmodel = \"{model}\"\ndamping = \"50 1/s\"\n\
                 [[organ.fixed]]\nfurthest = {{ direction = [0, 0, -1], fraction = 0.1 }}\n"
            )
        };
        let text = format!(
            "glisson_scene = 1\n[simulation]\ntime_step = \"2 ms\"\n{}{}\
             [[rigid]]\nname = \"bone\"\nedge = \"10 mm\"\nbox = {{ min = [\"200 mm\", 0, 0], max = [\"240 mm\", \"40 mm\", \"40 mm\"] }}\n\
             [tool]\ntip_radius = \"3 mm\"\nfriction = 0\nhome_tip = [0, 0, \"200 mm\"]\nhome_shaft = [0, 0, 1]\n",
            organ("soft", 5.0, "precomputed"),
            organ("stiff", 20.0, model),
        );
        let scene = Scene::parse(&text).unwrap();
        let (mut world, _) = build_world(&scene, folder.path(), Arc::new(Sequential)).unwrap();
        let mut press = |x_m: f64| {
            let at = |depth_m: f64| ToolInput::at(DVec3::new(x_m, 0.0213, 0.043 - depth_m), DVec3::Z);
            world.step(&StepInput::of(&[at(-5e-3)]).placed());
            for i in 0..1000 {
                world.step(&StepInput::of(&[at((f64::from(i) * 1e-5 - 5e-3).min(2e-3))]));
            }
            world.report().tools[0].force_on_tool_n.z
        };
        let [soft_n, stiff_n, bone_n] = [0.0213, 0.1213, 0.2213].map(&mut press);
        // 2 mm deep, less what the hand's spring gives way.
        assert!((stiff_n / soft_n / 4.0 - 1.0).abs() < 0.05, "{model}: {soft_n} {stiff_n}");
        assert!((bone_n / 20.0 - 1.0).abs() < 0.02, "{model}: {bone_n}");
    }
}
