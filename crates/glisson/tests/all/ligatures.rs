//! A ligating loop around a stump, in whole worlds of scenes.

use glisson::math::{DVec3, tetrahedron_volume_m3};
use glisson::mesh::edit::MeshEdit;
use glisson::scene::{Scene, build_world};
use glisson::workers::Sequential;
use glisson::world::{StepInput, World};
use std::path::Path;
use std::sync::Arc;

/// A stump 12 mm thick and 54 mm high, held at its foot, with a vessel along it; a loop beside it.
fn scene(model: &str, step_ms: f64, more: &str) -> String {
    format!(
        "glisson_scene = 1\n[simulation]\ntime_step = \"{step_ms} ms\"\n[organ]\n\
         tube = {{ path = [[\"0 mm\", \"0 mm\", \"0 mm\"], [\"0 mm\", \"0 mm\", \"48 mm\"]], radii = [[\"6 mm\"], [\"6 mm\"]] }}\n\
         edge = \"4 mm\"\nyoung_modulus = \"5 kPa\"\npoisson_ratio = 0.45\ndensity = \"1060 kg/m3\"\nmodel = \"{model}\"\n\
         damping = \"20 1/s\"\n{more}\
         [[organ.fixed]]\nbox = {{ min = [\"-9 mm\", \"-9 mm\", \"-9 mm\"], max = [\"9 mm\", \"9 mm\", \"4 mm\"] }}\n\
         [[tool]]\nkind = \"loop\"\ntip_radius = \"2 mm\"\nloop_diameter = \"30 mm\"\n\
         home_tip = [\"0 mm\", \"-15 mm\", \"70 mm\"]\nhome_shaft = [0, -1, 0]\n"
    )
}

const NEO_HOOKE: &str = "law = \"stable_neo_hooke\"\n";

fn open(text: &str) -> World {
    build_world(&Scene::parse(text).unwrap(), Path::new(""), Arc::new(Sequential)).unwrap().0
}

fn ramp(time_s: f64, from_s: f64, to_s: f64) -> f64 {
    ((time_s - from_s) / (to_s - from_s)).clamp(0.0, 1.0)
}

/// Over the stump, drawn tight until 0.7 s, tied off at 0.8 s, and away from 0.9 s on.
fn input(world: &World, time_s: f64) -> StepInput {
    let mut input = StepInput::of(&[world.tools()[0].home]);
    let tool = &mut input.tools[0];
    tool.tip_in_world_m.z -= 0.04 * ramp(time_s, 0.0, 0.2);
    tool.jaw_opening = 1.0 - ramp(time_s, 0.2, 0.6);
    tool.tip_in_world_m.y += 6e-3 * ramp(time_s, 0.2, 0.5);
    tool.trigger = ramp(time_s, 0.8, 0.81) - ramp(time_s, 0.84, 0.85);
    tool.tip_in_world_m.y -= 0.05 * ramp(time_s, 0.9, 1.1);
    input
}

/// Steps until a time, as [`input`] says.
fn run(world: &mut World, until_s: f64) {
    let dt_s = world.spec().time_step_s;
    while (world.steps_made() as f64 + 0.5) * dt_s < until_s {
        let time_s = (world.steps_made() + 1) as f64 * dt_s;
        let asked = input(world, time_s);
        let report = world.step(&asked);
        assert_eq!(report.n_non_finite_nodes, 0, "{time_s} s");
        world.cut_with_tools();
    }
}

fn length_m(thread: &[DVec3]) -> f64 {
    thread.windows(2).map(|pair| pair[0].distance(pair[1])).sum()
}

fn fastest_m_per_s(world: &World) -> f64 {
    world.state().velocities_m_per_s.iter().map(|v| v.length()).fold(0.0, f64::max)
}

/// Least volume of a tetrahedron over that at rest.
fn least_volume(world: &World) -> f64 {
    let (topology, rest_m) = (world.organ().body().topology(), &world.organ().mesh().positions_m);
    let share = |tet| {
        let nodes = topology.tet_nodes(tet);
        let of = |positions_m: &[DVec3]| tetrahedron_volume_m3(nodes.map(|n| positions_m[n.index()]));
        of(world.state().positions_m) / of(rest_m)
    };
    topology.live_tets().map(share).fold(f64::INFINITY, f64::min)
}

#[test]
fn a_loop_closes_a_stump_and_stays_on_it() {
    let models = [
        ("implicit", 5.0, NEO_HOOKE),
        ("explicit", 0.08, NEO_HOOKE),
        ("tensor_mass", 0.1, ""),
        ("precomputed", 1.0, ""),
    ];
    let mut tensions_n = Vec::new();
    for (model, step_ms, law) in models {
        let mut world = open(&scene(model, step_ms, law));
        run(&mut world, 0.2);
        let open_m = length_m(&world.snapshot().threads[0].nodes_m);
        assert!((open_m / (std::f64::consts::PI * 0.03) - 1.0).abs() < 0.01, "{model}: {open_m}");
        assert_eq!(world.loop_tension_n(0), 0.0);
        let mut tension_n = 0.0;
        for n in 0..20 {
            run(&mut world, 0.75 + 2e-3 * f64::from(n));
            tension_n += world.loop_tension_n(0) / 20.0;
        }
        let felt_n = world.report().tools[0].force_on_tool_n.length();
        assert!((0.005..0.5).contains(&tension_n), "{model}: {tension_n} N");
        assert!(felt_n <= 3.0 * tension_n && world.report().tools[0].in_contact, "{model}: {felt_n} N");
        run(&mut world, 0.9);
        assert_eq!((world.n_tied_loops(), world.loop_tension_n(0)), (1, 0.0), "{model}");
        assert!(world.snapshot().threads[0].nodes_m.is_empty());
        let tied_m = world.tied_girths_m().next().unwrap()[0];
        let rest_m = world.tied_girths_m().next().unwrap()[1];
        assert!((0.033..0.038).contains(&rest_m), "{model}: {rest_m} m");
        assert!((0.6..0.87).contains(&(tied_m / rest_m)), "{model}: {tied_m} m of {rest_m} m");
        run(&mut world, 1.8);
        let after_m = world.tied_girths_m().next().unwrap()[0];
        assert!((after_m / tied_m - 1.0).abs() < 0.03, "{model}: {after_m} m of {tied_m} m");
        assert_eq!(world.report().tools[0].force_on_tool_n, DVec3::ZERO);
        assert!(fastest_m_per_s(&world) < 0.01, "{model}: {}", fastest_m_per_s(&world));
        if model != "precomputed" {
            assert!(least_volume(&world) > 0.3, "{model}: {}", least_volume(&world));
            tensions_n.push(tension_n);
        }
    }
    let (least_n, most_n) = (tensions_n[0].min(tensions_n[1]), tensions_n[0].max(tensions_n[1]));
    assert!(most_n < 1.25 * least_n, "{tensions_n:?}");
}

/// St Venant and Kirchhoff's law bears little in compression, nor do springs: there a loop is drawn as far as volumes allow.
#[test]
fn no_model_breaks_under_a_loop() {
    for (model, step_ms) in
        [("nonlinear_tensor_mass", 0.1), ("mass_spring", 0.1), ("extended_mass_spring", 0.1)]
    {
        let mut world = open(&scene(model, step_ms, ""));
        run(&mut world, 1.15);
        assert_eq!(world.n_tied_loops(), 1, "{model}");
        let rest_m = &world.organ().mesh().positions_m;
        let moved_m = world.state().positions_m.iter().zip(rest_m).map(|(now, rest)| now.distance(*rest));
        assert!(moved_m.fold(0.0, f64::max) < 0.02, "{model}");
    }
}

#[test]
fn a_restored_world_draws_on_to_the_bit_and_no_step_allocates() {
    let mut world = open(&scene("implicit", 5.0, NEO_HOOKE));
    run(&mut world, 0.62);
    assert!(world.loop_tension_n(0) > 0.0);
    let saved = world.save();
    run(&mut world, 0.7);
    let hash = world.state_hash();
    world.restore(&saved);
    assert_ne!(world.state_hash(), hash);
    run(&mut world, 0.7);
    assert_eq!(world.state_hash(), hash);
    let inputs: Vec<StepInput> = (0..10).map(|n| input(&world, 0.7 + 5e-3 * f64::from(n))).collect();
    let count = allocation_counter::measure(|| {
        for input in &inputs {
            world.step(input);
        }
    });
    assert_eq!(count.count_total, 0);
    run(&mut world, 0.9);
    let (tied, hash) = (world.save(), world.state_hash());
    world.reset();
    assert_eq!((world.n_tied_loops(), world.snapshot().threads.len()), (0, 1));
    world.restore(&tied);
    assert_eq!((world.n_tied_loops(), world.snapshot().threads.len()), (1, 2));
    assert_eq!(world.state_hash(), hash);
}

#[test]
fn a_loop_does_not_get_around_a_stump_from_the_side() {
    let mut world = open(&scene("implicit", 5.0, NEO_HOOKE));
    for n in 0..160 {
        let time_s = 5e-3 * f64::from(n);
        let mut input = StepInput::of(&[world.tools()[0].home]);
        let tool = &mut input.tools[0];
        // Beside it, down, and then over it.
        tool.tip_in_world_m +=
            DVec3::new(0.04 * (1.0 - ramp(time_s, 0.3, 0.5)), 0.0, -0.04 * ramp(time_s, 0.0, 0.2));
        tool.jaw_opening = 1.0 - ramp(time_s, 0.5, 0.75);
        world.step(&input);
    }
    assert_eq!(world.loop_tension_n(0), 0.0);
    let moved_m = world.state().positions_m.iter().zip(&world.organ().mesh().positions_m);
    assert!(moved_m.map(|(now, rest)| now.distance(*rest)).fold(0.0, f64::max) < 1e-3);
    // Nor when it is opened in the tissue, its tip pushed into the side with the lever closed.
    let mut world = open(&scene("implicit", 5.0, NEO_HOOKE));
    for n in 0..200 {
        let time_s = 5e-3 * f64::from(n);
        let mut input = StepInput::of(&[world.tools()[0].home]);
        let tool = &mut input.tools[0];
        tool.tip_in_world_m = DVec3::new(0.0, -0.02 + 0.013 * ramp(time_s, 0.1, 0.3), 0.03);
        tool.jaw_opening = ramp(time_s, 0.3, 0.6) - ramp(time_s, 0.7, 0.9);
        world.step(&input);
    }
    assert_eq!(world.loop_tension_n(0), 0.0);
    // Put over its end it is.
    let mut world = open(&scene("implicit", 5.0, NEO_HOOKE));
    run(&mut world, 0.7);
    assert!(world.loop_tension_n(0) > 0.0);
}

#[test]
fn a_hand_that_tears_at_a_drawn_loop_breaks_nothing() {
    for (model, step_ms) in [("implicit", 5.0), ("explicit", 0.08)] {
        let mut world = open(&scene(model, step_ms, NEO_HOOKE));
        run(&mut world, 0.7);
        let dt_s = world.spec().time_step_s;
        let pull_n = world.tools()[0].kind.ligating_loop().unwrap().greatest_pull_n;
        let hand_n = world.spec().hand.unwrap().greatest_force_n;
        let mut input = input(&world, 0.7);
        let start_m = input.tools[0].tip_in_world_m;
        // 5 m/s to all sides and back, the lever to and fro.
        for step in 0..(0.6 / dt_s) as usize {
            let time_s = step as f64 * dt_s;
            let to =
                [DVec3::NEG_Y, DVec3::X, DVec3::Z, DVec3::new(0.6, 0.8, 0.0)][(time_s / 0.15) as usize % 4];
            let way = ramp(time_s % 0.15, 0.0, 0.03) - ramp(time_s % 0.15, 0.06, 0.09);
            input.tools[0].tip_in_world_m = start_m + to * (0.15 * way);
            input.tools[0].jaw_opening = if time_s % 0.1 < 0.05 { 0.0 } else { 0.3 };
            let report = world.step(&input);
            assert_eq!(report.n_non_finite_nodes, 0);
            // Of both strands, and of tissue that the shaft meets.
            let felt_n = report.tools[0].force_on_tool_n.length();
            assert!(
                world.loop_tension_n(0) <= pull_n && felt_n <= hand_n,
                "{model}: {felt_n} N at {time_s} s"
            );
        }
        // Let go, all comes back.
        input.tools[0].tip_in_world_m = world.tools()[0].home.tip_in_world_m;
        input.tools[0].jaw_opening = 1.0;
        for _ in 0..(2.0 / dt_s) as usize {
            world.step(&input);
        }
        let moved_m = world.state().positions_m.iter().zip(&world.organ().mesh().positions_m);
        let furthest_m = moved_m.map(|(now, rest)| now.distance(*rest)).fold(0.0, f64::max);
        assert!(furthest_m < 1e-3 && least_volume(&world) > 0.5, "{model}: {furthest_m} m");
    }
}

#[test]
fn what_is_tied_off_does_not_bleed_and_edits_leave_the_thread_on_what_is_left() {
    let vessel = "[[organ.vessel]]\npath = [[\"0 mm\", \"0 mm\", \"0 mm\"], [\"0 mm\", \"0 mm\", \"48 mm\"]]\nradius = \"1.5 mm\"\n";
    let text =
        scene("implicit", 5.0, NEO_HOOKE).replace("[[organ.fixed]]", &format!("{vessel}[[organ.fixed]]"));
    let above = |world: &World, from_m: f64| {
        let mesh = world.organ().mesh();
        let is_above = |tet: &glisson::mesh::TetId| {
            let nodes = world.organ().body().topology().tet_nodes(*tet);
            nodes.iter().map(|n| mesh.positions_m[n.index()].z).sum::<f64>() / 4.0 > from_m
        };
        MeshEdit::Remove { tets: world.organ().body().topology().live_tets().filter(is_above).collect() }
    };
    let mut world = open(&text);
    run(&mut world, 0.05);
    world.edit(&above(&world, 0.038)).unwrap();
    assert!(world.vessels().unwrap().bleeding_m3_per_s() > 0.0);
    let mut world = open(&text);
    run(&mut world, 1.2);
    let before = world.state_hash();
    world.edit(&above(&world, 0.038)).unwrap();
    assert_eq!(world.vessels().unwrap().bleeding_m3_per_s(), 0.0);
    assert_eq!((world.vessels().unwrap().n_clips(), world.n_tied_loops()), (0, 1));
    assert!(world.undo_edit());
    assert_eq!(world.state_hash(), before);
    // Taken back after steps, too.
    world.edit(&above(&world, 0.02)).unwrap();
    assert!(world.n_tied_loops() == 0 && world.vessels().unwrap().bleeding_m3_per_s() > 0.0);
    run(&mut world, 1.25);
    assert!(world.undo_edit());
    assert_eq!((world.n_tied_loops(), world.vessels().unwrap().bleeding_m3_per_s()), (1, 0.0));
    run(&mut world, 1.4);
    let [now_m, rest_m] = world.tied_girths_m().next().unwrap();
    assert!(now_m < 0.87 * rest_m, "{now_m} m of {rest_m} m");
    // Below the thread it bleeds, and the thread went with what was tied.
    world.edit(&above(&world, 0.02)).unwrap();
    assert!(world.vessels().unwrap().bleeding_m3_per_s() > 0.0);
    assert_eq!(world.n_tied_loops(), 0);
    run(&mut world, 1.5);
}
