//! The tasks that come with the program: their demonstrations pass in real time, a careless player is worse by every metric that says
//! so, and what goes wrong on purpose is found, and nothing else.

use super::{Experiment, Outcome};
use crate::bench::thread_cpu_ns;
use anyhow::{Context, ensure};
use glisson::math::{DVec3, SeededRandom};
use glisson::scene::{Choice, PathPoint, Scene, choose, tool_on_path};
use glisson::tool::{Tool, ToolInput};
use glisson::training::metrics::Better;
use glisson::training::moments::{Fault, Moment};
use glisson::training::task::{TaskResult, TaskRun};
use glisson::training::trace::Trace;
use glisson_runtime::script::PathScript;
use glisson_runtime::tasks::{TASKS, task_named};
use glisson_runtime::workers::side_by_side;
use glisson_runtime::{OpenScene, Simulation};
use std::path::PathBuf;

const OWN: &str = "requirement: tasks and their assessment";
/// How far a careless hand is off half-way between two points of the demonstration [m], and how long it thinks there, and at the end of the way [s].
const DETOUR_M: f64 = 0.015;
const THINKS_S: f64 = 0.3;
/// Ways along the axis are the same when they differ by less than this share.
const SAME_DEPTH: f64 = 1e-6;
/// Metrics of a hand that a wandering one is worse by.
const OF_MOTION: [&str; 8] = [
    "path_length",
    "depth_path",
    "angular_path",
    "movements",
    "economy",
    "smoothness_sparc",
    "smoothness_ldlj",
    "idle_time",
];

/// A played task.
struct Played {
    result: TaskResult,
    trace: Trace,
    real_time_factor: f64,
}

fn scene_of(task: &str) -> anyhow::Result<Scene> {
    let text = task_named(task).with_context(|| format!("there is no task {task}"))?;
    Ok(Scene::parse(text)?)
}

/// Follows the paths of a scene to their end.
fn play(scene: Scene) -> anyhow::Result<Played> {
    let script = PathScript::new(scene.clone()).context("the scene has paths")?;
    let (time_step_s, origin) = (scene.world.time_step_s, scene.world.name.clone());
    let source = OpenScene { scene, folder: PathBuf::from("."), origin, n_threads: 1 };
    let mut simulation = Simulation::open(source, None)?;
    simulation.follow_script(Box::new(script));
    let (begun_ns, mut steps) = (thread_cpu_ns(), 0_u32);
    let is_over = |simulation: &Simulation| simulation.task().is_some_and(|task| task.outcome().is_some());
    while !simulation.script_is_over() && !is_over(&simulation) {
        let input = simulation.scripted_input().context("the script goes on")?;
        simulation.advance(&input)?;
        steps += 1;
    }
    let busy_s = 1e-9 * (thread_cpu_ns() - begun_ns) as f64;
    let record = simulation.task().map(TaskRun::record).context("a task")?;
    let (result, trace) = (record.result(), record.trace().clone());
    Ok(Played { result, trace, real_time_factor: f64::from(steps) * time_step_s / busy_s })
}

/// What a part of the group comes to.
type Part = anyhow::Result<Vec<Experiment>>;

pub(super) fn experiments() -> anyhow::Result<Outcome> {
    let mut parts: Vec<Box<dyn Fn() -> Part + Send + Sync>> = Vec::new();
    for (name, _) in TASKS {
        parts.push(Box::new(|| of_task(name)));
    }
    for (name, text) in TASKS {
        for choice in choices(text)? {
            parts.push(Box::new(move || Ok(vec![of_variant(name, text, &choice)?])));
        }
    }
    for injected in &INJECTED {
        parts.push(Box::new(|| of_injected(injected)));
    }
    // Each part on one thread, whose processor time is its own.
    let n_cores = std::thread::available_parallelism().map_or(1, usize::from);
    let found = side_by_side(n_cores, parts.len(), |i| parts[i]());
    let found: Vec<Vec<Experiment>> = found.into_iter().collect::<anyhow::Result<_>>()?;
    Ok(found.concat().into())
}

/// The demonstration of a task, twice, and a hand that wanders on its way.
fn of_task(name: &str) -> Part {
    let demonstration = play(scene_of(name)?)?;
    let again = play(scene_of(name)?)?;
    let mut experiments = of_demonstration(name, &demonstration, &again);
    let (mut careful, mut careless) = (scene_of(name)?, scene_of(name)?);
    wander(&mut careless, &demonstration.trace);
    for scene in [&mut careful, &mut careless] {
        move_like_a_hand(scene);
    }
    experiments.push(of_wandering(name, &play(careful)?.result, &play(careless)?.result, &scene_of(name)?)?);
    Ok(experiments)
}

/// The patients and levels of a task that may be chosen, but that of the demonstration itself.
fn choices(text: &str) -> anyhow::Result<Vec<Choice>> {
    let Some(task) = Scene::parse(text)?.task else { return Ok(Vec::new()) };
    let patients = task.patients.iter().map(|patient| Choice { patient: Some(*patient), level: None });
    let others = task.levels.iter().filter(|level| task.level.as_ref() != Some(level));
    let levels = others.map(|level| Choice { patient: None, level: Some(level.clone()) });
    Ok(patients.chain(levels).collect())
}

/// The demonstration with another patient, or at another level.
fn of_variant(name: &str, text: &str, choice: &Choice) -> anyhow::Result<Experiment> {
    let played = play(Scene::parse(&choose(text, choice)?)?)?;
    let of = match choice {
        Choice { patient: Some(patient), .. } => format!("of patient {patient}"),
        Choice { level, .. } => format!("at the level {}", level.as_deref().unwrap_or_default()),
    };
    let not_passed = f64::from(u8::from(!played.result.is_passed));
    let what = format!("{name} {of}: its demonstration does not pass");
    Ok(Experiment::at_most(&what, OWN, not_passed, 0.0))
}

/// What is cut there holds vessels: that they bleed then is no fault of the demonstration, and the gate limits the blood.
const BLEEDS: &str = "metastasectomy";

fn of_demonstration(name: &str, played: &Played, again: &Played) -> Vec<Experiment> {
    let result = &played.result;
    let not_passed = f64::from(u8::from(!result.is_passed));
    let differs = f64::from(u8::from(again.result != *result));
    let named = |what: &str| format!("{name}: {what}");
    let is_fault = |moment: &&Moment| !(name.starts_with(BLEEDS) && moment.fault == Fault::Bleeding);
    let n_faults = result.moments.iter().filter(is_fault).count();
    vec![
        Experiment::at_most(&named("its demonstration does not pass"), OWN, not_passed, 0.0),
        Experiment::at_most(&named("moments that went wrong in it"), OWN, n_faults as f64, 0.0),
        Experiment::at_most(&named("another run has another result"), OWN, differs, 0.0),
        Experiment::within(
            &named("real-time factor, one core"),
            OWN,
            played.real_time_factor,
            [1.0, f64::INFINITY],
        )
        .of_times(),
    ]
}

/// Somebody who does not know the way: a hand goes beside the straight line half-way between two points, and all hands stand
/// while one thinks there and at the end of the way. Only where it is free on the trace of who knows it: a detour in tissue would be another
/// operation.
fn wander(scene: &mut Scene, knows: &Trace) {
    let mut random = SeededRandom::new(7);
    let mut detours: Vec<Vec<PathPoint>> = Vec::new();
    let mut pauses_s = Vec::new();
    for ((path, tool), trace) in scene.paths.iter().zip(&scene.world.tools).zip(&knows.tools) {
        let mut before = PathPoint { time_s: 0.0, tool: tool.home, sets_clip: false };
        let mut detours_of_tool = Vec::new();
        for point in path {
            let way_m = before.tool.tip_in_world_m.distance(point.tool.tip_in_world_m);
            let [from, to] = [before.time_s, point.time_s].map(|time_s| (time_s / knows.period_s) as usize);
            let is_free =
                trace.touches.iter().take(to + 2).skip(from.saturating_sub(1)).all(|touches| !touches);
            if way_m > DETOUR_M && is_free {
                let half = 0.5 * (before.tool.tip_in_world_m + point.tool.tip_in_world_m);
                let beside = DVec3::new(random.normal(), 0.0, random.normal()).normalize_or(DVec3::X);
                // Away from the organ, whose front is towards -y.
                let at_m = half + (beside - DVec3::Y).normalize() * DETOUR_M;
                let at = moved_to(before.tool, at_m).through(tool.trocar_m);
                let time_s = 0.5 * (before.time_s + point.time_s);
                detours_of_tool.push(PathPoint { time_s, tool: at, sets_clip: false });
                pauses_s.extend([time_s, point.time_s]);
            }
            before = *point;
        }
        detours.push(detours_of_tool);
    }
    pauses_s.sort_by(f64::total_cmp);
    let later_s = |n_pauses: usize| n_pauses as f64 * THINKS_S;
    for ((path, tool), detours) in scene.paths.iter_mut().zip(&scene.world.tools).zip(detours) {
        let mut wandering: Vec<PathPoint> = path.iter().copied().chain(detours).collect();
        wandering.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
        // Who is under way when another thinks stands there, too.
        let last_s = wandering.last().map_or(0.0, |point| point.time_s);
        let is_between =
            |time_s: f64| time_s < last_s && wandering.iter().all(|point| point.time_s != time_s);
        let stand = |time_s: f64| PathPoint {
            time_s,
            tool: tool_on_path(tool.home, &wandering, time_s),
            sets_clip: false,
        };
        let mut between_s: Vec<f64> = pauses_s.iter().copied().filter(|time_s| is_between(*time_s)).collect();
        between_s.dedup();
        let stands: Vec<PathPoint> = between_s.into_iter().map(stand).collect();
        wandering.extend(stands);
        wandering.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
        path.clear();
        for point in wandering {
            let so_far = pauses_s.partition_point(|time_s| *time_s < point.time_s);
            let with_it = pauses_s.partition_point(|time_s| *time_s <= point.time_s);
            let at = |n_pauses: usize| PathPoint { time_s: point.time_s + later_s(n_pauses), ..point };
            path.push(at(so_far));
            if with_it > so_far {
                path.push(PathPoint { sets_clip: false, ..at(with_it) });
            }
        }
    }
}

/// A hand's way is made of pieces of this time [s]: that of a sample, so that there is no jerk between them to be seen.
const PIECE_S: f64 = 0.01;

/// From point to point as hands go: by the polynomial of least jerk (Flash and Hogan 1985, doi 10.1523/JNEUROSCI.05-07-01688.1985).
fn move_like_a_hand(scene: &mut Scene) {
    for (path, tool) in scene.paths.iter_mut().zip(&scene.world.tools) {
        let (straight, mut from_s) = (path.clone(), 0.0);
        let mut smooth = Vec::new();
        for point in &straight {
            let n_parts = ((point.time_s - from_s) / PIECE_S).ceil().max(1.0) as u32;
            for part in 1..n_parts {
                let t = f64::from(part) / f64::from(n_parts);
                let done = t * t * t * (10.0 + t * (6.0 * t - 15.0));
                let at = tool_on_path(tool.home, &straight, from_s + done * (point.time_s - from_s));
                // What is switched stays until the end.
                let at = ToolInput { trigger: tool_on_path(tool.home, &straight, from_s).trigger, ..at };
                let time_s = from_s + t * (point.time_s - from_s);
                smooth.push(PathPoint { time_s, tool: at, sets_clip: false });
            }
            smooth.push(*point);
            from_s = point.time_s;
        }
        *path = smooth;
    }
}

/// Metrics of motion by which the wandering hand is not worse, though they say that it should be.
fn of_wandering(
    name: &str,
    careful: &TaskResult,
    careless: &TaskResult,
    scene: &Scene,
) -> anyhow::Result<Experiment> {
    let mut not_worse = 0;
    for good in &careful.metrics {
        let named = |tool: &Tool| Some(&tool.name) == good.tool.as_ref();
        let place = scene.world.tools.iter().position(named);
        // A shaft that nothing leads to a trocar need not turn on a detour, and who is not led does not wander.
        let may_stay = place.is_some_and(|place| {
            let is_free = scene.world.tools[place].trocar_m.is_none();
            scene.paths[place].is_empty() || (good.name == "angular_path" && is_free)
        });
        if may_stay || !(OF_MOTION.contains(&good.name) || good.name == "time") {
            continue;
        }
        let bad = careless.metric(good.name, good.tool.as_deref());
        let bad = bad.with_context(|| format!("{name}: {} has no value", good.name))?;
        // A detour at right angles to the shaft leaves the way along it as it is.
        if good.name == "depth_path" && (bad / good.value - 1.0).abs() < SAME_DEPTH {
            continue;
        }
        let is_worse = if good.better == Better::Less { bad > good.value } else { bad < good.value };
        if !is_worse {
            eprintln!("{name}: {} {:?} is not worse: {bad} after {}", good.name, good.tool, good.value);
            not_worse += 1;
        }
    }
    let what = format!("{name}: metrics of motion by which a hand that wanders is not worse");
    Ok(Experiment::at_most(&what, OWN, f64::from(not_worse), 0.0))
}

/// A fault that is made on purpose in a task's demonstration.
struct Injected {
    task: &'static str,
    what: &'static str,
    expected: Fault,
    /// What stands in the scene, and what in its place.
    written: Option<[&'static str; 2]>,
    inject: fn(&mut Scene),
    /// Whether the task's gate does not let it pass.
    breaks_gate: bool,
}

const INJECTED: [Injected; 4] = [
    Injected {
        task: "palpation",
        what: "a wrong place is marked first",
        expected: Fault::Mistake,
        written: None,
        inject: mark_too_soon,
        breaks_gate: false,
    },
    Injected {
        task: "palpation",
        what: "the probe is pressed 30 mm too deep",
        expected: Fault::ForceAboveThreshold,
        written: None,
        inject: press_too_deep,
        breaks_gate: false,
    },
    Injected {
        task: "grasp_and_lift",
        what: "the jaws hardly close, and pull",
        expected: Fault::Slip,
        written: Some(["closing_force = \"8 N\"", "closing_force = \"0.1 N\""]),
        inject: |_| (),
        breaks_gate: true,
    },
    Injected {
        task: "clip_and_cut",
        what: "the clips are set after the cut",
        expected: Fault::Bleeding,
        written: None,
        inject: clip_too_late,
        breaks_gate: false,
    },
];

fn of_injected(injected: &Injected) -> Part {
    let Injected { task, what, expected, written, inject, breaks_gate } = injected;
    let mut scene = scene_of(task)?;
    if let Some([before, after]) = written {
        ensure!(scene.text.contains(before), "{task}: its scene has no {before}");
        scene = Scene::parse(&scene.text.replace(before, after))?;
    }
    inject(&mut scene);
    let played = play(scene)?;
    let result = &played.result;
    let (found, others): (Vec<_>, Vec<_>) = result.moments.iter().partition(|m| m.fault == *expected);
    let named = |claim: &str| format!("{task}, {what}: {claim}");
    let passes = f64::from(u8::from(result.gate.iter().all(|line| line.is_kept) == *breaks_gate));
    Ok(vec![
        Experiment::within(&named("found"), OWN, found.len() as f64, [1.0, 1.0]),
        Experiment::at_most(&named("others found"), OWN, others.len() as f64, 0.0),
        Experiment::at_most(&named("the gate says something else"), OWN, passes, 0.0),
    ])
}

fn moved_to(tool: ToolInput, tip_in_world_m: DVec3) -> ToolInput {
    ToolInput { tip_in_world_m, ..tool }
}

/// The trigger at the first place that the probe presses.
fn mark_too_soon(scene: &mut Scene) {
    let at = scene.paths[0][1];
    let pressed = |trigger: f64, later_s: f64| PathPoint {
        time_s: at.time_s + later_s,
        tool: ToolInput { trigger, ..at.tool },
        ..at
    };
    for (nth, point) in [pressed(1.0, 0.2), pressed(0.0, 0.4)].into_iter().enumerate() {
        scene.paths[0].insert(2 + nth, point);
    }
}

/// The first press goes in along y.
fn press_too_deep(scene: &mut Scene) {
    let trocar_m = scene.world.tools[0].trocar_m;
    let point = &mut scene.paths[0][1];
    let tip_m = point.tool.tip_in_world_m + DVec3::Y * 0.03;
    point.tool = moved_to(point.tool, tip_m).through(trocar_m);
}

/// Clips wait until the scissors have closed.
fn clip_too_late(scene: &mut Scene) {
    let after_s = scene.paths[1].iter().map(|point| point.time_s).fold(0.0, f64::max);
    for point in &mut scene.paths[0] {
        point.time_s += after_s;
    }
}
