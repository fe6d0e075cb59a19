//! Tasks in small worlds: each goal is reached when it should be and not before, mistakes are counted, and what cannot be done is said.

use glisson::scene::{Scene, build_world};
use glisson::tool::ToolInput;
use glisson::training::moments::Fault;
use glisson::training::task::{Effects, MarkKind, Outcome, TaskError, TaskResult, TaskRun};
use glisson::workers::Sequential;
use glisson::world::World;
use std::path::Path;
use std::sync::Arc;

/// A block of liver, 100 x 100 x 40 mm, whose upper face is at y = 0.
fn block(model: &str, step: &str, tool: &str, task: &str) -> Scene {
    let text = format!(
        "glisson_scene = 1\n[simulation]\ntime_step = \"{step}\"\n[organ]\n\
         box = {{ min = [\"-5 cm\", \"0 cm\", \"-5 cm\"], max = [\"5 cm\", \"4 cm\", \"5 cm\"] }}\nedge = \"10 mm\"\n\
         tissue = \"liver\"\nmodel = \"{model}\"\ndamping = \"20 1/s\"\n\
         [[organ.fixed]]\nfurthest = {{ direction = [0, 1, 0], fraction = 0.2 }}\n\
         [tool]\nname = \"hand\"\nhome_tip = [0, \"-30 mm\", 0]\nhome_shaft = [0, -1, 0]\n{tool}\
         [task]\ntitle = \"T\"\n{task}"
    );
    Scene::parse(&text).unwrap_or_else(|error| panic!("{error}\n{text}"))
}

fn world_of(scene: &Scene) -> World {
    build_world(scene, Path::new(""), Arc::new(Sequential)).unwrap().0
}

fn begin(scene: &Scene, world: &World) -> Result<TaskRun, TaskError> {
    TaskRun::new(scene.task.as_ref().unwrap(), world)
}

/// Follows the scene's path for `time_s`; what happened, with the time at which each stage was done.
fn play(scene: &Scene, time_s: f64) -> (TaskRun, World) {
    let mut world = world_of(scene);
    let mut run = begin(scene, &world).unwrap();
    let step_s = scene.world.time_step_s;
    for step in 1..=(time_s / step_s).round() as u64 {
        world.step(&scene.input_at(step as f64 * step_s));
        world.cut_with_tools();
        run.after_step(&world);
    }
    (run, world)
}

fn result_of(scene: &Scene, time_s: f64) -> TaskResult {
    play(scene, time_s).0.record().result()
}

/// Stands for half a second, goes 3 mm into the block in one, stays for one, and goes away.
const PRESS: &str = "kind = \"probe\"\ntip_radius = \"5 mm\"\n\
    [[tool.path]]\ntime = \"0.5 s\"\ntip = [0, \"-30 mm\", 0]\n\
    [[tool.path]]\ntime = \"1.5 s\"\ntip = [0, \"-2 mm\", 0]\n\
    [[tool.path]]\ntime = \"2.5 s\"\ntip = [0, \"-2 mm\", 0]\n\
    [[tool.path]]\ntime = \"3 s\"\ntip = [0, \"-30 mm\", 0]\n";

#[test]
fn the_clock_starts_with_the_first_motion_and_a_goal_has_to_hold() {
    let scene = block(
        "precomputed",
        "5 ms",
        PRESS,
        "[[task.stage]]\ntitle = \"touch\"\nhold = \"0.5 s\"\ntouch = { near = [0, 0, 0], within = \"8 mm\" }\n\
         [[task.stage]]\ntitle = \"back\"\nhint = \"up\"\nhint_after = \"1 s\"\nreach = { point = [0, \"-30 mm\", 0], within = \"2 mm\" }\n",
    );
    let (run, _) = play(&scene, 3.0);
    let status = run.status();
    // The path begins at 0.5 s; a millimetre later the clock starts.
    let began_s = status.began_s.unwrap();
    assert!((0.5..0.56).contains(&began_s), "{began_s}");
    assert_eq!((status.outcome, status.n_done, status.mark.clone()), (Some(Outcome::Done), 2, None));
    let result = run.record().result();
    assert!(result.is_passed);
    let took_s = status.ended_s.unwrap() - began_s;
    assert!((took_s - result.metric("time", None).unwrap()).abs() < 1e-9);
    let [touch, back] = &result.stages[..] else { panic!("{:?}", result.stages) };
    // The tip, of radius 5 mm, is at the surface after 25 of 28 mm, at 1.39 s; half a second later it was held long enough.
    let touched_s = 0.5 + 25.0 / 28.0 + 0.5 - began_s;
    assert!((touch.ended_s - touched_s).abs() < 0.06, "{} {touched_s}", touch.ended_s);
    assert!(back.ended_s > touch.ended_s && (back.began_s - touch.ended_s).abs() < 1e-12);

    let (halfway, _) = play(&scene, 1.0);
    let status = halfway.status();
    assert_eq!((status.n_done, status.stage.as_str(), status.hint), (0, "touch", None));
    assert_eq!(status.mark.map(|mark| mark.kind), Some(MarkKind::Place));
    let (never, _) = play(&scene, 0.4);
    assert_eq!((never.status().began_s, never.record().result().stages.len()), (None, 0));
}

#[test]
fn a_task_ends_with_its_time_and_what_comes_later_does_not_count() {
    let task = "time_limit = \"0.6 s\"\n[[task.stage]]\ntitle = \"touch\"\ntouch = {}\n";
    let scene = block("precomputed", "5 ms", PRESS, task);
    let result = result_of(&scene, 3.0);
    assert_eq!((result.outcome, result.is_passed, result.stages.len()), (Some(Outcome::TimeOver), false, 0));
    assert!((result.metric("time", None).unwrap() - 0.6).abs() < 1e-9);
    assert_eq!(result.metric("peak_force", Some("hand")), Some(0.0));
}

#[test]
fn a_mark_beside_the_place_is_a_mistake_each_time_and_the_gate_counts_them() {
    let tool = "kind = \"probe\"\ntip_radius = \"5 mm\"\n\
        [[tool.path]]\ntime = \"0.2 s\"\ntip = [0, \"-20 mm\", 0]\ntrigger = 1\n\
        [[tool.path]]\ntime = \"0.4 s\"\ntip = [0, \"-20 mm\", 0]\ntrigger = 0\n\
        [[tool.path]]\ntime = \"1 s\"\ntip = [0, \"-3 mm\", 0]\n\
        [[tool.path]]\ntime = \"1.2 s\"\ntip = [0, \"-3 mm\", 0]\ntrigger = 1\n\
        [[tool.path]]\ntime = \"1.6 s\"\ntip = [0, \"-3 mm\", 0]\n\
        [[tool.path]]\ntime = \"1.7 s\"\ntip = [0, \"-3 mm\", 0]\ntrigger = 0\n\
        [[tool.path]]\ntime = \"2.2 s\"\ntip = [\"30 mm\", \"-12 mm\", 0]\n\
        [[tool.path]]\ntime = \"2.6 s\"\ntip = [\"30 mm\", \"-3 mm\", 0]\n\
        [[tool.path]]\ntime = \"2.8 s\"\ntip = [\"30 mm\", \"-3 mm\", 0]\ntrigger = 1\n";
    let stage = "[[task.stage]]\ntitle = \"mark\"\nmark = { near = [\"30 mm\", 0, 0], within = \"8 mm\" }\n";
    let scene = block("precomputed", "5 ms", tool, &format!("[task.gate]\nmistakes = 1\n{stage}"));
    let result = result_of(&scene, 3.0);
    assert_eq!((result.outcome, result.metric("mistakes", None)), (Some(Outcome::Done), Some(2.0)));
    let mistakes: Vec<&str> = result.moments.iter().map(|moment| moment.detail.as_str()).collect();
    assert!(result.moments.iter().all(|moment| moment.fault == Fault::Mistake), "{mistakes:?}");
    assert_eq!(mistakes[0], "mark: marked without touching the tissue");
    assert!(
        mistakes[1].starts_with("mark: marked 3") && mistakes[1].ends_with("mm from the place"),
        "{mistakes:?}"
    );
    assert!(!result.is_passed && !result.gate[0].is_kept && result.gate[0].found == 2.0);
    let patient = block("precomputed", "5 ms", tool, &format!("[task.gate]\nmistakes = 2\n{stage}"));
    assert!(result_of(&patient, 3.0).is_passed);
}

/// Draws a blade of 15 mm along x through the block's upper face, 10 mm deep, at z = 0.
const CUT: &str = "kind = \"scalpel\"\ntip_radius = \"1 mm\"\nshaft_radius = \"1 mm\"\nblade_length = \"20 mm\"\n\
    [[tool.path]]\ntime = \"0.2 s\"\ntip = [\"-58 mm\", \"-20 mm\", 0]\n\
    [[tool.path]]\ntime = \"0.4 s\"\ntip = [\"-58 mm\", \"10 mm\", 0]\ntrigger = 1\n\
    [[tool.path]]\ntime = \"1.2 s\"\ntip = [\"10 mm\", \"10 mm\", 0]\n\
    [[tool.path]]\ntime = \"1.4 s\"\ntip = [\"10 mm\", \"-20 mm\", 0]\ntrigger = 0\n";

#[test]
fn a_cut_counts_along_its_line_and_not_along_one_beside() {
    let stage = |z: &str, to: &str, within: &str| {
        format!(
            "[[task.stage]]\ntitle = \"cut\"\ncut = {{ from = [\"-40 mm\", 0, \"{z}\"], to = [\"{to}\", 0, \"{z}\"], within = \"{within}\" }}\n"
        )
    };
    let of = |stage: String| {
        let result = result_of(&block("implicit", "5 ms", CUT, &stage), 1.6);
        (result.outcome, result.metric("cut_share", None).unwrap(), result.metric("cut_error_greatest", None))
    };
    let (outcome, share, error_m) = of(stage("0 mm", "0 mm", "2 mm"));
    assert_eq!((outcome, share > 0.9), (Some(Outcome::Done), true));
    assert!(error_m.unwrap() < 1e-3, "{error_m:?}");
    // Half of a line twice as long.
    let (outcome, share, _) = of(stage("0 mm", "40 mm", "2 mm"));
    assert!(outcome.is_none() && (0.55..0.7).contains(&share), "{share}");
    // 3 mm beside: no share, and an error that is known.
    let (outcome, share, error_m) = of(stage("3 mm", "0 mm", "2 mm"));
    assert_eq!((outcome, share), (None, 0.0));
    assert!((error_m.unwrap() - 3e-3).abs() < 1e-3, "{error_m:?}");
    // 30 mm beside is another cut: of this line nothing is cut, and what is not cut has no error.
    assert_eq!(of(stage("30 mm", "0 mm", "2 mm")), (None, 0.0, None));
}

#[test]
fn places_and_lines_follow_cuts_and_their_undoing() {
    let stage = "[[task.stage]]\ntitle = \"cut\"\ncut = { from = [\"-40 mm\", 0, 0], to = [\"40 mm\", 0, 0], within = \"2 mm\" }\n\
        [[task.stage]]\ntitle = \"there\"\ntouch = { near = [\"-20 mm\", \"1 mm\", \"0.1 mm\"], within = \"3 mm\" }\n";
    let scene = block("implicit", "5 ms", CUT, stage);
    let (mut run, mut world) = play(&scene, 1.6);
    let share = |run: &TaskRun| run.record().result().metric("cut_share", None).unwrap();
    let before = share(&run);
    assert!(before > 0.5);
    let mut n_undone = 0;
    while world.undo_edit() {
        n_undone += 1;
        for step in 0..4 {
            world.step(&scene.input_at(1.6 + 5e-3 * f64::from(step)));
            run.after_step(&world);
        }
    }
    assert!(n_undone > 0 && run.outcome().is_none(), "{n_undone} {:?}", run.outcome());
    assert!(share(&run) < before, "{n_undone} edits undone: {}", share(&run));
    // Another try begins with what is there: nothing lost, nothing cut.
    world.reset();
    let anew = run.anew(&world).unwrap().record().result();
    assert_eq!((anew.metric("cut_area", None), anew.metric("cut_share", None)), (Some(0.0), Some(0.0)));
}

#[test]
fn a_place_in_a_tetrahedron_that_was_cut_goes_on_in_what_became_of_it() {
    // The blade goes 10 mm deep past the first place; both hang together all the same, also when cuts are undone.
    let stage = "[[task.stage]]\ntitle = \"part\"\npart = { from = [\"-20 mm\", \"5 mm\", \"0.1 mm\"], to = [\"-20 mm\", \"35 mm\", 0] }\n";
    let scene = block("implicit", "5 ms", CUT, stage);
    let (mut run, mut world) = play(&scene, 1.6);
    assert!(run.record().result().metric("cut_area", None).unwrap() > 1e-4);
    assert_eq!(run.status().n_done, 0);
    while world.undo_edit() {
        for step in 0..4 {
            world.step(&scene.input_at(1.6 + 5e-3 * f64::from(step)));
            run.after_step(&world);
        }
    }
    assert_eq!(run.status().n_done, 0);
}

/// A bar from x = -30 to 30 mm, held at its left end, and a scalpel that cuts it through at x = `at_mm`.
fn bar_cut_through(at_mm: f64, gate: &str) -> TaskResult {
    let text = format!(
        "glisson_scene = 1\n[simulation]\ntime_step = \"2 ms\"\n[organ]\n\
         box = {{ min = [\"-30 mm\", \"-5 mm\", \"-5 mm\"], max = [\"30 mm\", \"5 mm\", \"5 mm\"] }}\nedge = \"5 mm\"\n\
         tissue = \"liver\"\nmodel = \"implicit\"\nlaw = \"stable_neo_hooke\"\ndamping = \"40 1/s\"\n\
         [[organ.fixed]]\nbox = {{ min = [\"-31 mm\", \"-6 mm\", \"-6 mm\"], max = [\"-24 mm\", \"6 mm\", \"6 mm\"] }}\n\
         [tool]\nname = \"scalpel\"\nkind = \"scalpel\"\ntip_radius = \"0.5 mm\"\nblade_length = \"30 mm\"\nhome_shaft = [0, -1, 0]\n\
         home_tip = [\"{at_mm} mm\", \"10 mm\", \"-20 mm\"]\n\
         [[tool.path]]\ntime = \"0.2 s\"\ntip = [\"{at_mm} mm\", \"10 mm\", \"-19 mm\"]\ntrigger = 1\n\
         [[tool.path]]\ntime = \"1.2 s\"\ntip = [\"{at_mm} mm\", \"10 mm\", \"20 mm\"]\ntrigger = 1\n\
         [[tool.path]]\ntime = \"1.4 s\"\ntip = [\"{at_mm} mm\", \"10 mm\", \"22 mm\"]\ntrigger = 0\n\
         [task]\ntitle = \"T\"\n{gate}[[task.stage]]\ntitle = \"out\"\n\
         excise = {{ center = [\"18 mm\", 0, 0], radius = \"4 mm\" }}\n"
    );
    result_of(&Scene::parse(&text).unwrap_or_else(|error| panic!("{error}\n{text}")), 1.4)
}

#[test]
fn what_is_cut_out_has_its_margin_and_its_volume() {
    let gate = "[task.gate]\nmargin = \"3 mm\"\n";
    let free = bar_cut_through(7.0, gate);
    assert_eq!((free.outcome, free.is_passed), (Some(Outcome::Done), true), "{:?}", free.gate);
    // The face at x = 7 mm is 11 mm from the ball's middle; the piece is 23 mm of 10 mm x 10 mm.
    let metric = |result: &TaskResult, name: &str| result.metric(name, None).unwrap();
    assert!((metric(&free, "margin_least") - 7e-3).abs() < 2e-4, "{}", metric(&free, "margin_least"));
    assert!(metric(&free, "margin_mean") > 7e-3 && metric(&free, "margin_mean") < 9e-3);
    assert!((metric(&free, "specimen_volume") - 2.3e-6).abs() < 2e-8);
    let close = bar_cut_through(12.0, gate);
    assert_eq!((close.outcome, close.is_passed), (Some(Outcome::Done), false), "a margin of 2 mm");
    assert!((metric(&close, "margin_least") - 2e-3).abs() < 2e-4);
    let through = bar_cut_through(16.0, "");
    assert_eq!(through.outcome, None, "the rest of it is still on the bar");
    assert_eq!(through.metric("margin_least", None), None);
}

#[test]
fn events_come_with_time_and_stage_last_as_long_as_they_say_and_come_once() {
    let task = "[[task.stage]]\ntitle = \"touch\"\ntouch = {}\n[[task.stage]]\ntitle = \"wait\"\nhold = \"9 s\"\ntouch = {}\n\
        [[task.event]]\ntitle = \"dark\"\nat = \"0.2 s\"\nlight_out = { for = \"0.3 s\" }\n\
        [[task.event]]\ntitle = \"stuck\"\nstage = 2\nafter = \"0.2 s\"\nfail = { for = \"0.4 s\" }\n\
        [[task.event]]\ntitle = \"cough\"\njerk = { acceleration = [0, 0, \"4 m/s2\"], for = \"0.2 s\" }\n";
    let scene = block("precomputed", "5 ms", PRESS, task);
    let mut world = world_of(&scene);
    let mut run = begin(&scene, &world).unwrap();
    assert!(!run.let_come(2, &world), "nothing comes before the task has begun");
    let (mut dark_s, mut stuck_s, mut greatest) = (0.0, 0.0, 0.0_f64);
    let mut came_by_hand = None;
    for step in 1..=500_u32 {
        world.step(&scene.input_at(f64::from(step) * 5e-3));
        run.after_step(&world);
        let effects = run.effects(&world);
        dark_s += if run.status().is_dark { 5e-3 } else { 0.0 };
        stuck_s += if effects.fails[0] { 5e-3 } else { 0.0 };
        greatest = greatest.max(effects.acceleration_m_per_s2.z);
        if step == 400 {
            assert!(run.let_come(2, &world) && !run.let_come(2, &world) && !run.let_come(7, &world));
            came_by_hand = Some(2.0 - run.status().began_s.unwrap());
        }
    }
    assert!((dark_s - 0.3_f64).abs() < 0.011 && (stuck_s - 0.4_f64).abs() < 0.011, "{dark_s} {stuck_s}");
    assert!((greatest - 4.0).abs() < 0.02, "the middle of half a sine: {greatest}");
    let result = run.record().result();
    let came_s: Vec<f64> = result.events.iter().map(|event| event.came_s.unwrap()).collect();
    assert!((came_s[0] - 0.2).abs() < 0.011, "{came_s:?}");
    let touched_s = result.stages[0].ended_s;
    assert!((came_s[1] - touched_s - 0.2).abs() < 0.011, "{came_s:?} {touched_s}");
    assert!((came_s[2] - came_by_hand.unwrap()).abs() < 1e-9, "{came_s:?}");
}

#[test]
fn an_instrument_that_fails_does_not_close_nor_work() {
    let hand = ToolInput {
        jaw_opening: 0.2,
        trigger: 1.0,
        ..block("precomputed", "5 ms", PRESS, "[[task.stage]]\ntitle = \"t\"\ntouch = {}\n").world.tools[0]
            .home
    };
    let mut effects = Effects::default();
    assert_eq!(effects.on(0, hand), hand);
    effects.fails[0] = true;
    assert_eq!(effects.on(0, hand), ToolInput { jaw_opening: 1.0, trigger: 0.0, ..hand });
    assert_eq!(effects.on(1, hand), hand);
}

#[test]
fn a_trigger_that_stays_pressed_marks_once() {
    let tool = "kind = \"probe\"\ntip_radius = \"5 mm\"\n\
        [[tool.path]]\ntime = \"0.5 s\"\ntip = [0, \"-3 mm\", 0]\n\
        [[tool.path]]\ntime = \"0.8 s\"\ntip = [0, \"-3 mm\", 0]\ntrigger = 1\n\
        [[tool.path]]\ntime = \"1.5 s\"\ntip = [0, \"-3 mm\", 0]\n";
    let stages = "[[task.stage]]\ntitle = \"a\"\nmark = { near = [0, 0, 0], within = \"8 mm\" }\n\
        [[task.stage]]\ntitle = \"b\"\nmark = { near = [\"30 mm\", 0, 0], within = \"8 mm\" }\n";
    let result = result_of(&block("precomputed", "5 ms", tool, stages), 1.5);
    assert_eq!((result.stages.len(), result.metric("mistakes", None)), (1, Some(0.0)));
}

#[test]
fn what_cannot_be_done_is_said_before_it_begins() {
    let scene = block(
        "precomputed",
        "5 ms",
        PRESS,
        "[[task.stage]]\ntitle = \"there\"\ntouch = {}\n[[task.stage]]\ntitle = \"nowhere\"\ntouch = { near = [0, \"-2 cm\", 0], within = \"1 mm\" }\n",
    );
    let error = begin(&scene, &world_of(&scene)).unwrap_err().to_string();
    assert_eq!(
        error,
        "stage 2 of the task, \"nowhere\": there is no tissue at (0.0, -20.0, 0.0) mm; give a place at rest within 5 mm of it"
    );
    let scene = block("precomputed", "5 ms", PRESS, "[[task.stage]]\ntitle = \"clips\"\nclip = {}\n");
    let error = begin(&scene, &world_of(&scene)).unwrap_err().to_string();
    assert!(error.contains("is about vessels, and the organ has none"), "{error}");
}

#[test]
fn a_place_whose_tissue_is_gone_is_in_what_is_left_and_nothing_breaks() {
    let stage = "[[task.stage]]\ntitle = \"part\"\npart = { from = [\"25 mm\", \"5 mm\", 0], to = [\"30 mm\", \"5 mm\", 0] }\n\
        [[task.stage]]\ntitle = \"there\"\ntouch = { near = [\"-30 mm\", 0, 0], within = \"3 mm\" }\n";
    let scene = block("implicit", "5 ms", CUT, stage);
    let mut world = world_of(&scene);
    let mut run = begin(&scene, &world).unwrap();
    let mut looks = Vec::new();
    for step in 1..=300 {
        world.step(&scene.input_at(f64::from(step) * 5e-3));
        // Every 50 steps a slab of the block goes, from the left to the right.
        if step % 50 == 0 {
            let edge_m = -0.05 + 0.01 * f64::from(step / 50);
            let mesh = world.organ().mesh();
            let live = world.organ().body().topology().live_tets();
            let gone = live.filter(|tet| mesh.corners_m(*tet).iter().all(|p| p.x < edge_m + 1e-9)).collect();
            looks.push(world.remove_and_part(gone).is_ok());
        }
        run.after_step(&world);
    }
    assert_eq!(looks, [true; 6]);
    assert!(run.record().result().metric("volume_removed", None).unwrap() > 1e-4);
    // Both places of the first stage are in one piece still; that of the second is gone.
    assert_eq!(run.status().n_done, 0);
    world.reset();
    assert!(matches!(run.anew(&world), Err(TaskError::NoTissue { stage: 2, .. })));
}
