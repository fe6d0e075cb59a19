//! Threads through tissue, in whole worlds of scenes.

use glisson::math::DVec3;
use glisson::mesh::TetMesh;
use glisson::mesh::box_mesh::cells_of_five;
use glisson::mesh::edit::MeshEdit;
use glisson::mesh::files::write_mesh;
use glisson::scene::{Scene, build_world};
use glisson::workers::Sequential;
use glisson::world::{StepInput, World};
use std::sync::Arc;

/// A block of 60 x 40 x 20 mm with a groove of 4 mm across its middle, down to 8 mm above its bottom.
fn grooved_block() -> TetMesh {
    cells_of_five([15, 10, 5], 4e-3, |[i, _, k]| !(i == 7 && k >= 2))
}

/// A plate of 40 x 40 x 8 mm.
fn plate() -> TetMesh {
    cells_of_five([10, 10, 2], 4e-3, |_| true)
}

fn tool(kind: &str, tip_mm: [f64; 3], jaw: u32) -> String {
    let [x, y, z] = tip_mm;
    format!(
        "[[tool]]\nkind = \"{kind}\"\ntip_radius = \"1.5 mm\"\nclosing_force = \"8 N\"\nfriction = 0.6\n\
         home_tip = [\"{x} mm\", \"{y} mm\", \"{z} mm\"]\nhome_shaft = [0, 0, 1]\nhome_jaw = {jaw}\n"
    )
}

fn organ(model: &str, step_ms: f64, fixed: &str) -> String {
    format!(
        "glisson_scene = 1\n[simulation]\ntime_step = \"{step_ms} ms\"\n[organ]\nmesh = \"body.vtu\"\nyoung_modulus = \"5 kPa\"\n\
         poisson_ratio = 0.45\ndensity = \"1060 kg/m3\"\nmodel = \"{model}\"\ndamping = \"20 1/s\"\n\
         [[organ.fixed]]\nbox = {fixed}\n"
    )
}

/// A thread through both sides of the groove, whose ends two graspers hold.
fn stitch(model: &str, step_ms: f64, more_tools: &str) -> String {
    let bottom = "{ min = [\"-1 mm\", \"-1 mm\", \"-1 mm\"], max = [\"61 mm\", \"41 mm\", \"0.1 mm\"] }";
    let corners = [[46, 40], [40, 22], [38, 14], [22, 14], [20, 22], [14, 40]];
    let point = |[x, z]: [i32; 2]| format!("[\"{x} mm\", \"20 mm\", \"{z} mm\"]");
    format!(
        "{}[[suture]]\nsize = \"3-0\"\npath = [{}]\n{}{}{more_tools}",
        organ(model, step_ms, bottom),
        corners.map(point).join(", "),
        tool("grasper", [46.0, 20.0, 40.0], 0),
        tool("grasper", [14.0, 20.0, 40.0], 0)
    )
}

fn open(text: &str, mesh: &TetMesh) -> World {
    let folder = tempfile::tempdir().unwrap();
    write_mesh(&folder.path().join("body.vtu"), mesh).unwrap();
    build_world(&Scene::parse(text).unwrap(), folder.path(), Arc::new(Sequential)).unwrap().0
}

/// All tools at home, the first two up by so much.
fn pulled(world: &World, up_m: f64) -> StepInput {
    let homes: Vec<_> = world.tools().iter().map(|tool| tool.home).collect();
    let mut input = StepInput::of(&homes);
    input.tools[..2].iter_mut().for_each(|tool| tool.tip_in_world_m.z += up_m);
    input
}

/// How wide the groove is at its top, in the middle [m].
fn groove_m(world: &World) -> f64 {
    let rest_m = &world.organ().mesh().positions_m;
    let at = |x_m: f64| {
        let away_m = |i: &usize| rest_m[*i].distance(DVec3::new(x_m, 0.02, 0.02));
        (0..rest_m.len()).min_by(|a, b| away_m(a).total_cmp(&away_m(b))).unwrap()
    };
    let positions_m = world.state().positions_m;
    positions_m[at(0.032)].x - positions_m[at(0.028)].x
}

/// No step of a thread that slides makes tissue or thread jump.
fn fastest_m_per_s(world: &World) -> f64 {
    let thread = &world.sutures()[0].rod().velocities_m_per_s;
    thread.iter().chain(world.state().velocities_m_per_s).map(|v| v.length()).fold(0.0, f64::max)
}

#[test]
fn a_stitch_draws_the_sides_of_a_groove_together() {
    let mut world = open(&stitch("implicit", 5.0, ""), &grooved_block());
    let suture = &world.sutures()[0];
    assert_eq!(suture.holes_m().count(), 4);
    assert!(suture.is_held_by(0) && suture.is_held_by(1));
    assert!((groove_m(&world) - 4e-3).abs() < 1e-9);
    let (mut fastest, mut widest_m) = (0.0_f64, 0.0);
    for step in 1..=200 {
        let up_m = 5e-3 * (f64::from(step) / 160.0).min(1.0);
        let report = world.step(&pulled(&world, up_m));
        assert_eq!(report.n_non_finite_nodes, 0);
        if step > 20 {
            fastest = fastest.max(fastest_m_per_s(&world));
        }
        if step == 40 {
            widest_m = groove_m(&world);
        }
    }
    let (suture, report) = (&world.sutures()[0], world.report());
    assert!(widest_m > 2.5e-3 && groove_m(&world) < 1e-3, "{widest_m} {}", groove_m(&world));
    assert!(fastest < 0.2, "{fastest} m/s");
    // Both ends are pulled alike, and what pulls them is the thread.
    for tool in 0..2 {
        let felt_n = report.tools[tool].force_on_tool_n.length();
        assert!((0.1..0.4).contains(&felt_n), "{felt_n} N");
        assert!((felt_n / suture.force_on_tool_n(tool).length() - 1.0).abs() < 1e-9);
    }
    // What pulls the hands pulls the tissue.
    let on_tissue_n: DVec3 = suture.forces().iter().map(|force| force.force_n).sum();
    let on_tools_n = suture.force_on_tool_n(0) + suture.force_on_tool_n(1);
    let off_n = (on_tissue_n + on_tools_n).length();
    assert!(off_n < 0.02 * on_tools_n.length(), "{on_tissue_n} {on_tools_n}");
    // Thread has come out of both sides.
    let holes_m: Vec<f64> = suture.holes_m().collect();
    assert!(holes_m[0] > 23e-3 && holes_m[3] < 48e-3 && holes_m.is_sorted(), "{holes_m:?}");
}

#[test]
fn a_restored_world_sews_on_to_the_bit_and_no_step_allocates() {
    let mut world = open(&stitch("implicit", 5.0, ""), &grooved_block());
    let sew = |world: &mut World, steps: std::ops::RangeInclusive<i32>| {
        for n in steps {
            let input = pulled(world, 5e-3 * f64::from(n) / 160.0);
            world.step(&input);
        }
    };
    sew(&mut world, 1..=30);
    let saved = world.save();
    sew(&mut world, 31..=60);
    let hash = world.state_hash();
    for come_back in [World::restore, World::go_back] {
        come_back(&mut world, &saved);
        assert_ne!(world.state_hash(), hash);
        sew(&mut world, 31..=60);
        assert_eq!(world.state_hash(), hash);
    }
    let inputs: Vec<StepInput> = (61..=70).map(|n| pulled(&world, 5e-3 * f64::from(n) / 160.0)).collect();
    let count = allocation_counter::measure(|| {
        for input in &inputs {
            world.step(input);
        }
    });
    assert_eq!(count.count_total, 0);
    world.reset();
    assert_eq!(world.sutures()[0].holes_m().count(), 4);
    assert!(world.sutures()[0].rod().positions_m[0].distance(DVec3::new(0.046, 0.02, 0.04)) < 1e-12);
}

#[test]
fn clips_at_its_ends_keep_a_stitch_drawn_together() {
    let clippers = tool("clipper", [46.0, 20.0, 90.0], 1) + &tool("clipper", [14.0, 20.0, 90.0], 1);
    let mut world = open(&stitch("implicit", 5.0, &clippers), &grooved_block());
    for step in 1..=500 {
        let time_s = 5e-3 * f64::from(step);
        let mut input = pulled(&world, 7e-3 * (time_s / 1.0).min(1.0));
        // Clips go on both strands, a little beyond where they come out.
        let suture = &world.sutures()[0];
        let holes_m: Vec<f64> = suture.holes_m().collect();
        if (1.1..1.4).contains(&time_s) && holes_m.len() == 4 {
            for (tool, along_m) in [(2, holes_m[0] - 1.2e-3), (3, holes_m[3] + 1.2e-3)] {
                let at_m = suture.rod().place_at(along_m).point_m(&suture.rod().positions_m);
                input.tools[tool].tip_in_world_m = at_m;
            }
        }
        let closing = (1.0 - (time_s - 1.2) / 0.1).clamp(0.0, 1.0);
        input.tools[2..].iter_mut().for_each(|tool| tool.jaw_opening = closing);
        let opening = ((time_s - 1.6) / 0.1).clamp(0.0, 1.0);
        input.tools[..2].iter_mut().for_each(|tool| tool.jaw_opening = opening);
        world.step(&input);
    }
    let suture = &world.sutures()[0];
    assert_eq!(suture.clips_m().count(), 2);
    assert!(!suture.is_held_by(0) && !suture.is_held_by(1));
    assert!(suture.rod().tension_n(suture.rod().n_nodes() / 2) > 0.02);
    assert!(groove_m(&world) < 2.5e-3 && fastest_m_per_s(&world) < 5e-3, "{}", groove_m(&world));
}

#[test]
fn a_needle_goes_through_a_plate_and_draws_its_thread_after_it() {
    let side = "{ min = [\"-1 mm\", \"-1 mm\", \"-1 mm\"], max = [\"41 mm\", \"8.1 mm\", \"9 mm\"] }";
    let text = format!(
        "{}[[organ.fixed]]\nbox = {{ min = [\"-1 mm\", \"31.9 mm\", \"-1 mm\"], max = [\"41 mm\", \"41 mm\", \"9 mm\"] }}\n\
         [[suture]]\nsize = \"3-0\"\nneedle = \"30 mm\"\npath = [[\"19 mm\", \"21 mm\", \"10 mm\"], [\"19 mm\", \"21 mm\", \"100 mm\"]]\n{}",
        organ("implicit", 5.0, side),
        tool("grasper", [19.0, 21.0, 32.5], 0)
    );
    let mut world = open(&text, &plate());
    assert!(world.sutures()[0].is_held_by(0));
    let mut n_holes = Vec::new();
    let mut most_n: f64 = 0.0;
    for step in 1..=240 {
        let mut input = pulled(&world, -25e-3 * (f64::from(step) / 200.0).min(1.0));
        input.tools[1] = input.tools[0];
        let report = world.step(&input);
        assert_eq!(report.n_non_finite_nodes, 0);
        most_n = most_n.max(report.tools[0].force_on_tool_n.length());
        let n = world.sutures()[0].holes_m().count();
        if n_holes.last() != Some(&n) {
            n_holes.push(n);
        }
    }
    // In at the top, out at the bottom.
    assert_eq!(n_holes, [0, 1, 2], "{most_n} N");
    let suture = &world.sutures()[0];
    let holes_m: Vec<f64> = suture.holes_m().collect();
    assert!(!suture.is_in_tissue(0.0) && suture.is_in_tissue(0.5 * (holes_m[0] + holes_m[1])), "{holes_m:?}");
    assert!((0.05..2.0).contains(&most_n), "{most_n} N");
    assert!(suture.rod().positions_m[0].z < -5e-3, "{}", suture.rod().positions_m[0]);
}

#[test]
fn a_stitch_follows_edits_of_its_tissue_and_their_undo() {
    let mut world = open(&stitch("implicit", 5.0, ""), &grooved_block());
    for n in 1..=20 {
        world.step(&pulled(&world, 1e-4 * f64::from(n)));
    }
    let before = world.state_hash();
    // Of the side at x > 32 mm the corner goes by which the thread comes in.
    let near = |p: DVec3| p.distance(DVec3::new(0.0396, 0.02, 0.02)) < 5e-3;
    let middle_m = |t: &[glisson::mesh::NodeId; 4]| -> DVec3 {
        t.iter().map(|n| world.organ().mesh().positions_m[n.index()]).sum::<DVec3>() / 4.0
    };
    let tets = &world.organ().mesh().tetrahedra;
    let gone = (0..tets.len()).filter(|&i| near(middle_m(&tets[i]))).map(glisson::mesh::TetId::from_index);
    let edit = MeshEdit::Remove { tets: gone.collect() };
    world.edit(&edit).unwrap();
    let holes_m: Vec<f64> = world.sutures()[0].holes_m().collect();
    assert!(holes_m.len() == 4 && holes_m[0] > 21e-3, "{holes_m:?}");
    assert!(world.undo_edit());
    assert_eq!(world.state_hash(), before);
    world.edit(&edit).unwrap();
    (21..=60)
        .for_each(|n| assert_eq!(world.step(&pulled(&world, 1e-4 * f64::from(n))).n_non_finite_nodes, 0));
    assert!(groove_m(&world) < 4.2e-3, "{}", groove_m(&world));
}

/// Two bites into a plate; the tissue of the second one goes.
#[test]
fn a_bite_that_is_cut_out_leaves_the_other_one() {
    let side = "{ min = [\"-1 mm\", \"-1 mm\", \"-1 mm\"], max = [\"41 mm\", \"4.1 mm\", \"9 mm\"] }";
    let corners = [[2, 20], [8, 4], [12, 4], [20, 14], [28, 4], [32, 4], [38, 20]];
    let point = |[x, z]: [i32; 2]| format!("[\"{x} mm\", \"21 mm\", \"{z} mm\"]");
    let text = format!(
        "{}[[suture]]\nsize = \"3-0\"\npath = [{}]\n{}",
        organ("implicit", 5.0, side),
        corners.map(point).join(", "),
        tool("grasper", [2.0, 21.0, 60.0], 1)
    );
    let mut world = open(&text, &plate());
    let holes_m: Vec<f64> = world.sutures()[0].holes_m().collect();
    assert_eq!(holes_m.len(), 4);
    let rest_m = world.organ().mesh().positions_m.clone();
    let middle_m = |t: &[glisson::mesh::NodeId; 4]| -> DVec3 {
        t.iter().map(|n| rest_m[n.index()]).sum::<DVec3>() / 4.0
    };
    let tets = &world.organ().mesh().tetrahedra;
    let gone = (0..tets.len()).filter(|&i| {
        let p = middle_m(&tets[i]);
        (22e-3..38e-3).contains(&p.x) && (14e-3..28e-3).contains(&p.y)
    });
    let edit = MeshEdit::Remove { tets: gone.map(glisson::mesh::TetId::from_index).collect() };
    world.edit(&edit).unwrap();
    let suture = &world.sutures()[0];
    assert_eq!(suture.holes_m().collect::<Vec<_>>(), holes_m[..2]);
    assert!(suture.is_in_tissue(0.5 * (holes_m[0] + holes_m[1])));
    assert!(
        !suture.is_in_tissue(0.5 * (holes_m[2] + holes_m[3]))
            && !suture.is_in_tissue(suture.rod().length_m())
    );
    assert!(world.undo_edit());
    assert_eq!(world.sutures()[0].holes_m().collect::<Vec<_>>(), holes_m);
}

#[test]
fn a_thread_that_lies_in_itself_is_refused() {
    let text = stitch("implicit", 5.0, "")
        .replace("[\"46 mm\", \"20 mm\", \"40 mm\"]", "[\"14 mm\", \"20 mm\", \"40 mm\"]");
    let folder = tempfile::tempdir().unwrap();
    write_mesh(&folder.path().join("body.vtu"), &grooved_block()).unwrap();
    let refused = build_world(&Scene::parse(&text).unwrap(), folder.path(), Arc::new(Sequential));
    let message = format!("{:?}", refused.err().map(|error| error.to_string()));
    assert!(message.contains("of itself"), "{message}");
}
