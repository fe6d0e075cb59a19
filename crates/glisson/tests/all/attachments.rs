//! Attachments between bodies that instruments part and pulls tear.

use glisson::math::DVec3;
use glisson::scene::{Scene, build_world};
use glisson::tool::ToolInput;
use glisson::training::task::TaskRun;
use glisson::workers::Sequential;
use glisson::world::{StepInput, World};
use std::path::Path;
use std::sync::Arc;

/// A cube of 40 mm and 64 g hangs half a millimetre under a slab, by an attachment of 200 N/m.
fn hanging(attachment: &str, tool: &str) -> World {
    let scene = Scene::parse(&scene_text(attachment, tool, "")).unwrap();
    build_world(&scene, Path::new("."), Arc::new(Sequential)).unwrap().0
}

fn scene_text(attachment: &str, tool: &str, more: &str) -> String {
    format!(
        "glisson_scene = 1\n[simulation]\ntime_step = \"2 ms\"\ngravity = [0, 0, \"-9.81 m/s2\"]\n\
         [[organ]]\nname = \"cube\"\nbox = {{ min = [\"-20 mm\", \"-20 mm\", \"-60.5 mm\"], max = [\"20 mm\", \"20 mm\", \"-20.5 mm\"] }}\n\
         edge = \"10 mm\"\nyoung_modulus = \"100 kPa\"\npoisson_ratio = 0.3\ndensity = \"1000 kg/m3\"\nmodel = \"implicit\"\n\
         damping = \"20 1/s\"\nimaged_under_gravity = false\n\
         [[rigid]]\nname = \"slab\"\nslab = {{ point = [0, 0, 0], normal = [0, 0, 1], size = \"200 mm\", thickness = \"20 mm\" }}\n\
         [[attachment]]\nbody = \"cube\"\nto = \"slab\"\nreach = \"1 mm\"\nstiffness = \"200 N/m\"\ndamping = \"50 ms\"\n{attachment}\n\
         [tool]\nname = \"tool\"\ntip_radius = \"1 mm\"\nhome_tip = [\"-100 mm\", 0, \"-20 mm\"]\n{tool}\n{more}"
    )
}

const SCALPEL: &str = "kind = \"scalpel\"\nblade_length = \"60 mm\"\nhome_shaft = [0, 1, 0]\n";
const HOOK: &str = "kind = \"hook\"\nshaft_radius = \"1 mm\"\ncut_force = \"1 N\"\ncut_time = \"1 s\"\nhome_shaft = [0, 1, 0]\n";

fn steps(world: &mut World, n: usize, tip_m: impl Fn(f64) -> DVec3, trigger: f64) -> usize {
    let home = world.tools()[0].home;
    let mut n_parted = 0;
    for step in 1..=n {
        let input = ToolInput { tip_in_world_m: tip_m(step as f64 / n as f64), trigger, ..home };
        world.step(&StepInput::of(&[input]));
        n_parted += world.cut_with_tools().n_parted;
    }
    n_parted
}

/// From beside the cube through the gap above it, to the middle or out on the other side.
fn through_the_gap(to_x_m: f64) -> impl Fn(f64) -> DVec3 {
    move |share| DVec3::new(-0.03 + share * (to_x_m + 0.03), -0.03, -0.0204)
}

fn away(_: f64) -> DVec3 {
    DVec3::new(-0.1, 0.0, -0.02)
}

fn lowest_m(world: &World) -> f64 {
    world.state().positions_m.iter().map(|at| at.z).fold(f64::INFINITY, f64::min)
}

#[test]
fn an_edge_parts_what_it_goes_through_and_what_was_parted_stays_so() {
    for kind in ["glue", "membrane"] {
        let mut world = hanging(&format!("kind = \"{kind}\"\ncut = true"), SCALPEL);
        assert_eq!(world.n_strands_between([0, 1]), [25, 25], "{kind}");
        assert_eq!(world.n_strands_between([1, 0]), [25, 25]);
        let parted = steps(&mut world, 100, through_the_gap(0.004), 1.0);
        // Of five rows of five strands three, and the cube hangs by the others.
        assert_eq!((parted, world.n_strands_between([0, 1])[0]), (15, 10), "{kind}");
        assert_eq!(world.snapshot().strands_m.len(), 10);
        steps(&mut world, 200, away, 0.0);
        assert!(lowest_m(&world) > -0.1, "{kind}: {}", lowest_m(&world));
        let saved = world.save();
        let hash = world.state_hash();
        assert_eq!(steps(&mut world, 100, through_the_gap(0.03), 1.0), 10);
        steps(&mut world, 100, away, 0.0);
        assert!(lowest_m(&world) < -0.1, "{kind} has fallen: {}", lowest_m(&world));
        world.reset();
        assert_eq!(world.n_strands_between([0, 1])[0], 0, "as cuts, it stays parted");
        world.restore(&saved);
        assert_eq!((world.n_strands_between([0, 1])[0], world.state_hash()), (10, hash));
    }
}

#[test]
fn a_hot_tip_parts_strands_along_its_way_alone_and_nothing_is_parted_unless_the_scene_says_so() {
    let mut world = hanging("kind = \"glue\"\ncut = true", HOOK);
    assert_eq!(steps(&mut world, 50, through_the_gap(0.03), 0.0), 0, "it is off");
    // Along one of the cube's edges, which gives way to it: strands of that row alone.
    let along = |share: f64| DVec3::new(-0.03 + 0.06 * share, -0.02, -0.0204);
    let n_parted = steps(&mut world, 100, along, 1.0);
    let n_inner = world.strands_m().filter(|(_, [end_m, _])| end_m.y > -0.015).count();
    assert!((4..=5).contains(&n_parted) && n_inner == 20, "{n_parted} {n_inner}");
    for tool in [SCALPEL, HOOK] {
        let mut world = hanging("kind = \"glue\"", tool);
        assert_eq!(steps(&mut world, 50, through_the_gap(0.03), 1.0), 0);
        assert_eq!(world.n_strands_between([0, 1]), [25, 25]);
    }
}

#[test]
fn strands_tear_by_their_strength() {
    // The cube weighs 0.63 N.
    for (strength, is_torn) in [("0.3 N", true), ("1.5 N", false)] {
        let mut world = hanging(&format!("kind = \"glue\"\nstrength = \"{strength}\""), SCALPEL);
        steps(&mut world, 300, away, 0.0);
        let n_strands = world.n_strands_between([0, 1])[0];
        assert_eq!((n_strands, lowest_m(&world) < -0.1), if is_torn { (0, true) } else { (25, false) });
    }
}

#[test]
fn what_was_parted_between_two_cuts_comes_back_with_the_later_one() {
    let mut world = hanging("kind = \"glue\"\ncut = true", SCALPEL);
    steps(&mut world, 60, through_the_gap(-0.016), 1.0);
    let n_left = world.n_strands_between([0, 1])[0];
    assert_eq!(n_left, 20);
    // Into the cube itself, from below.
    steps(&mut world, 60, |share| DVec3::new(0.0, -0.03, -0.08 + 0.03 * share), 1.0);
    assert!(world.organ().topology_version() > 0, "it was cut");
    steps(&mut world, 60, through_the_gap(0.004), 1.0);
    assert!(world.n_strands_between([0, 1])[0] < n_left);
    while world.undo_edit() {}
    assert_eq!(world.n_strands_between([0, 1])[0], n_left);
}

/// A ligament that is hardly longer than what its node moves in a step turns as it is pulled: it must not swing to and fro.
#[test]
fn short_ligaments_come_to_rest() {
    let text = "glisson_scene = 1\n[simulation]\ntime_step = \"8 ms\"\ngravity = [\"6 m/s2\", 0, \"-7 m/s2\"]\n\
         [[organ]]\nname = \"cube\"\nbox = { min = [\"-20 mm\", \"-20 mm\", \"-60.1 mm\"], max = [\"20 mm\", \"20 mm\", \"-20.1 mm\"] }\n\
         edge = \"10 mm\"\nyoung_modulus = \"10 kPa\"\npoisson_ratio = 0.3\ndensity = \"1000 kg/m3\"\nmodel = \"implicit\"\n\
         damping = \"20 1/s\"\nimaged_under_gravity = false\n\
         [[rigid]]\nname = \"slab\"\nslab = { point = [0, 0, 0], normal = [0, 0, 1], size = \"200 mm\", thickness = \"20 mm\" }\n\
         [[attachment]]\nbody = \"cube\"\nto = \"slab\"\nkind = \"membrane\"\nreach = \"1 mm\"\nstiffness = \"600 N/m\"\ndamping = \"20 ms\"\n\
         [tool]\ntip_radius = \"5 mm\"\nhome_tip = [0, 0, \"200 mm\"]\nhome_shaft = [0, 0, 1]\n";
    let mut world =
        build_world(&Scene::parse(text).unwrap(), Path::new("."), Arc::new(Sequential)).unwrap().0;
    let home = StepInput::of(&[world.tools()[0].home]);
    for _ in 0..400 {
        world.step(&home);
    }
    let fastest_m_per_s =
        world.state().velocities_m_per_s.iter().fold(0.0_f64, |fastest, v| fastest.max(v.length()));
    assert!(fastest_m_per_s < 1e-3, "{fastest_m_per_s}");
}

#[test]
fn a_goal_asks_for_an_attachment_that_can_be_parted() {
    let task = |attachment: &str| {
        let world = hanging(attachment, SCALPEL);
        let text = "[task]\ntitle = \"T\"\n[[task.stage]]\ntitle = \"S\"\ndetach = { body = \"cube\", from = \"slab\" }\n";
        let scene = Scene::parse(&scene_text(attachment, SCALPEL, text)).unwrap();
        TaskRun::new(scene.task.as_ref().unwrap(), &world).map(|run| (run, world))
    };
    let error = task("kind = \"glue\"").err().unwrap().to_string();
    assert!(error.contains("nothing attaches cube to slab, or nothing parts what does"), "{error}");
    assert!(task("kind = \"glue\"\nstrength = \"9 N\"").is_ok());
    let Ok((mut run, mut world)) = task("kind = \"glue\"\ncut = true") else { panic!("it can be done") };
    // It begins with the first motion.
    steps(&mut world, 1, away, 0.0);
    run.after_step(&world);
    steps(&mut world, 100, through_the_gap(0.004), 1.0);
    run.after_step(&world);
    run.after_step(&world);
    assert!((run.status().share - 0.6).abs() < 1e-9 && run.status().n_done == 0, "{:?}", run.status());
    steps(&mut world, 100, through_the_gap(0.03), 1.0);
    run.after_step(&world);
    assert_eq!(run.status().n_done, 1);
    // All is at rest again, also what is drawn of it, and nothing holds any more.
    world.reset();
    assert!(world.snapshot().strands_m.is_empty());
}

/// With tearing an edge that is on parts strands, too, before it has broken into tissue.
#[test]
fn strands_cost_an_edge_nothing_where_tissue_tears() {
    let scene = scene_text("kind = \"glue\"\ncut = true", SCALPEL, "")
        .replace("model = ", "tearing = true\nmodel = ");
    let scene = Scene::parse(&scene).unwrap();
    let mut world = build_world(&scene, Path::new("."), Arc::new(Sequential)).unwrap().0;
    assert_eq!(steps(&mut world, 100, through_the_gap(0.03), 1.0), 25);
}

/// After a reset strands are where the bodies are, before any further step.
#[test]
fn strands_are_at_rest_after_a_reset() {
    let mut world = hanging("kind = \"glue\"", SCALPEL);
    let rest = world.snapshot().strands_m;
    steps(&mut world, 50, away, 0.0);
    assert_ne!(world.snapshot().strands_m, rest);
    world.reset();
    assert_eq!(world.snapshot().strands_m, rest);
}

#[test]
fn tables_of_attachments_are_checked() {
    let refuse = |attachment: &str| {
        let text = format!(
            "glisson_scene = 1\n[[organ]]\nname = \"a\"\nbox = {{ min = [0, 0, 0], max = [\"1 cm\", \"1 cm\", \"1 cm\"] }}\n\
             tissue = \"liver\"\nmodel = \"implicit\"\n[[rigid]]\nname = \"b\"\nbox = {{ min = [0, 0, \"1 cm\"], max = [\"1 cm\", \"1 cm\", \"2 cm\"] }}\n\
             [[attachment]]\nbody = \"a\"\nto = \"b\"\nkind = \"glue\"\nreach = \"1 mm\"\nstiffness = \"9 N/m\"\n{attachment}\n\
             [tool]\ntip_radius = \"1 mm\"\nhome_tip = [0, 0, \"-5 cm\"]\nhome_shaft = [0, 0, -1]\n"
        );
        Scene::parse(&text).unwrap_err().to_string()
    };
    assert!(refuse("strength = \"0 N\"").contains("strength"));
    assert!(refuse("cut = 1").contains("true or false"));
}
