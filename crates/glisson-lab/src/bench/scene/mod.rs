//! `glisson bench scene`: whole scenes on the synthetic patient's liver, as `glisson run` makes them. The benchmarks of
//! parts say what a part costs; these say whether what a hand does is in real time.

mod motions;

use super::timing::{quantile, thread_cpu_ns};
use super::{Answer, Machine, MachineBudget, Tell, Trial, TrialRequest};
use crate::bodies::liver;
use crate::scratch::ScratchFolder;
use crate::scripted::{LongestStep, open_with_longest_step};
use anyhow::{Context, bail, ensure};
use glisson::mesh::files::write_mesh;
use glisson::model::kind::ModelKind;
use glisson::model::{FollowedEdits, ModelMotion};
use glisson::scene::Scene;
use glisson::world::StepStage;
use glisson_runtime::Simulation;
use motions::{MOTIONS, Motion, Place};
use serde::Serialize;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

pub(super) const TRIAL: Trial = Trial {
    name: "scene",
    about: "whole scenes on a liver: rest, push, drag, cut, grasp with every model",
    measure: run,
};

/// Livers, in tetrahedra.
const USUAL_SIZES: [usize; 3] = [2_000, 6_300, 20_000];
/// A scene is broken off after so much processor time [s].
const USUAL_SECONDS: f64 = 60.0;

fn run(request: &TrialRequest, tell: Tell<'_>) -> anyhow::Result<Answer> {
    let request = SceneRequest {
        motion: request.motion.clone(),
        model: request.model.clone(),
        imposed: request.imposed,
        step_s: request.step_s,
        sizes: request.sizes.clone().unwrap_or(USUAL_SIZES.to_vec()),
        threads: request.threads,
        seconds: request.seconds.unwrap_or(USUAL_SECONDS),
    };
    let report = measure(&request, tell)?;
    Ok(Answer { json: serde_json::to_string_pretty(&report)?, text: report.to_table() })
}

/// A model with a law, and the time step with which its scenes run.
#[derive(Clone, Copy)]
struct Subject {
    kind: ModelKind,
    /// None: the model's own.
    law: Option<&'static str>,
    /// The longest step that is tried [s]; halved until the model takes it.
    step_s: f64,
}

/// A law that models of any law run with, beside their own.
const SECOND_LAW: &str = "stable_neo_hooke";

/// Every model of scenes but those that need measured curves.
fn subjects() -> Vec<Subject> {
    let mut subjects = Vec::new();
    for kind in ModelKind::ALL.into_iter().filter(|kind| !kind.row().follows_curves) {
        let row = kind.row();
        let step_s = if row.motion == ModelMotion::Implicit { 2e-3 } else { 1e-3 };
        let laws: &[Option<&str>] =
            if row.follows_any_law { &[row.laws.first().copied(), Some(SECOND_LAW)] } else { &[None] };
        subjects.extend(laws.iter().map(|&law| Subject { kind, law, step_s }));
    }
    subjects
}

/// What to measure.
#[derive(Clone, Debug)]
struct SceneRequest {
    /// One motion; all for none.
    motion: Option<String>,
    /// One model; all for none.
    model: Option<String>,
    /// Whether the hand imposes its motion (`touch = "imposed"`) instead of giving way.
    imposed: bool,
    /// The longest step that is tried [s]; the subject's own for none.
    step_s: Option<f64>,
    /// Wanted tetrahedra.
    sizes: Vec<usize>,
    /// Threads of the models that use several.
    threads: usize,
    /// A scene is broken off after so much processor time [s].
    seconds: f64,
}

/// Times of steps, in microseconds of processor time (of wall time with several threads).
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
struct StepMicroseconds {
    /// Median.
    p50: f64,
    /// 99 of 100 take no longer.
    p99: f64,
    /// The longest.
    max: f64,
}

/// One scene.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct SceneOutcome {
    /// The motion's name.
    case: &'static str,
    /// Whether the hand imposed its motion.
    imposed: bool,
    /// Tetrahedra at the start.
    size: usize,
    /// Threads of the model.
    threads: usize,
    /// The model's scene name.
    model: &'static str,
    /// The law that it followed.
    law: &'static str,
    /// Simulated time over time taken.
    real_time_factor: f64,
    /// A step with its contacts and cuts.
    step_us: StepMicroseconds,
    /// Of them, what finding and solving the instruments' contacts takes, in steps that have some.
    touch_us: StepMicroseconds,
    /// Most contact points of a step.
    most_points: u32,
    /// The time step: what a step may take in real time.
    budget_us: f64,
    /// The greatest force on an instrument [N].
    greatest_force_n: Option<f64>,
    /// The most tetrahedra that were inverted, or without finite numbers, in one step.
    inverted: u32,
    /// Edits of the mesh.
    edits: usize,
    /// How thoroughly steps were computed at the end.
    effort: &'static str,
    /// Simulated time [s].
    simulated_s: f64,
    /// Why it ended before the motion's end, if it did.
    #[serde(skip_serializing_if = "Option::is_none")]
    broken_off: Option<String>,
}

/// The answer to a request.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct SceneReport {
    /// `scene`.
    bench: &'static str,
    /// The machine's peaks.
    machine: Machine,
    /// One for each motion, size and model.
    results: Vec<SceneOutcome>,
}

/// Runs what `request` asks for; `tell` hears before each scene what comes (name, number done, number in all).
///
/// # Errors
/// For an unknown motion or model and a bad setting, or when a scene cannot be set up.
fn measure(request: &SceneRequest, tell: Tell<'_>) -> anyhow::Result<SceneReport> {
    ensure!(request.seconds > 0.0 && request.seconds.is_finite(), "--seconds must be above 0");
    ensure!((1..=64).contains(&request.threads), "--threads {}: must be 1 to 64", request.threads);
    let motions = chosen(request.motion.as_deref(), MOTIONS, "motion", |motion| motion.name)?;
    let subjects = chosen(request.model.as_deref(), &subjects(), "model", |subject| subject.kind.name())?;
    let mut jobs = Vec::new();
    for &size in &request.sizes {
        ensure!(size > 0, "--sizes: a size must be above 0");
        for motion in &motions {
            let follow = |subject: &&Subject| !motion.cuts || subject.kind.row().edits != FollowedEdits::None;
            jobs.extend(subjects.iter().filter(follow).map(|subject| (size, *motion, *subject)));
        }
    }
    tell("machine", 0, jobs.len());
    let machine = Machine::measure(MachineBudget::default())?;
    let mut results = Vec::new();
    for (done, (size, motion, subject)) in jobs.iter().enumerate() {
        let name = format!("{}, {} at {size}", motion.name, subject.kind);
        tell(&name, done, jobs.len());
        results.push(run_scene(motion, *size, subject, request).with_context(|| name)?);
    }
    Ok(SceneReport { bench: "scene", machine, results })
}

fn chosen<T: Copy>(
    name: Option<&str>,
    all: &[T],
    what: &str,
    name_of: impl Fn(&T) -> &'static str,
) -> anyhow::Result<Vec<T>> {
    let Some(name) = name else { return Ok(all.to_vec()) };
    let found: Vec<T> = all.iter().filter(|one| name_of(one) == name).copied().collect();
    if found.is_empty() {
        let mut names: Vec<&str> = all.iter().map(name_of).collect();
        names.dedup();
        let hint = glisson::text::did_you_mean(name, &names);
        bail!("bench scene has no {what} {name:?}{hint}\nknown: {}", names.join(", "));
    }
    Ok(found)
}

/// A scene that is set up.
struct Opened {
    simulation: Simulation,
    scene: Scene,
    step_s: f64,
    end_s: f64,
    size: usize,
}

/// Sets a scene up, with the longest time step that the model takes.
fn open(motion: &Motion, size: usize, subject: &Subject, request: &SceneRequest) -> anyhow::Result<Opened> {
    let mesh = liver(size)?;
    let folder = ScratchFolder::new()?;
    write_mesh(&folder.path().join("liver.vtu"), &mesh)?;
    let (mut tool, end_s) = (motion.write)(&Place::of(&mesh));
    if request.imposed {
        tool.insert_str(0, "[hand]\ntouch = \"imposed\"\n");
    }
    let step_s = request.step_s.unwrap_or(subject.step_s);
    let text = |step_s: f64| scene_text(subject, step_s, &tool);
    let opened = open_with_longest_step(folder.path(), request.threads, step_s, &text)?;
    let LongestStep { simulation, scene, step_s } = opened;
    Ok(Opened { simulation, scene, step_s, end_s, size: mesh.tetrahedra.len() })
}

fn scene_text(subject: &Subject, step_s: f64, tool: &str) -> String {
    let law = subject.law.map_or(String::new(), |law| format!("law = \"{law}\"\n"));
    format!(
        "glisson_scene = 1\n[simulation]\ntime_step = \"{} us\"\n\
         [organ]\nmesh = \"liver.vtu\"\ntissue = \"liver\"\nmodel = \"{}\"\n{law}damping = \"20 1/s\"\n\
         [[organ.fixed]]\nfurthest = {{ direction = [0, 1, 0.4], fraction = 0.1 }}\n{tool}",
        step_s * 1e6,
        subject.kind
    )
}

/// What came of the steps of a scene.
#[derive(Default)]
struct Course {
    /// Of each step.
    step_us: Vec<f64>,
    /// Of each step that had contacts.
    touch_us: Vec<f64>,
    most_points: u32,
    taken_s: f64,
    greatest_force_n: f64,
    inverted: u32,
    broken_off: Option<String>,
}

/// Steps through a scene, to its end or until it is broken off.
fn run_through(opened: &mut Opened, request: &SceneRequest) -> Course {
    let Opened { simulation, scene, step_s, end_s, .. } = opened;
    let n_steps = (*end_s / *step_s).ceil() as u64;
    let mut course = Course { step_us: Vec::with_capacity(n_steps as usize), ..Course::default() };
    let touch_ns = watch_touch(simulation);
    for step in 1..=n_steps {
        let input = scene.input_at(step as f64 * *step_s);
        let (wall, cpu_ns) = (Instant::now(), thread_cpu_ns());
        let made = simulation.advance(&input);
        let step_taken_s = if request.threads == 1 {
            (thread_cpu_ns() - cpu_ns) as f64 * 1e-9
        } else {
            wall.elapsed().as_secs_f64()
        };
        course.taken_s += step_taken_s;
        course.step_us.push(step_taken_s * 1e6);
        let report = match made {
            Ok(report) => report,
            Err(error) => {
                course.broken_off = Some(format!("{error:#}"));
                break;
            }
        };
        if report.n_contact_points > 0 {
            course.touch_us.push(touch_ns.load(Ordering::Relaxed) as f64 * 1e-3);
            course.most_points = course.most_points.max(report.n_contact_points);
        }
        let felt = report.tools.iter().map(|tool| tool.force_on_tool_n.length());
        // NaN is the greatest of all.
        course.greatest_force_n =
            felt.fold(course.greatest_force_n, |most, n| if n > most || n.is_nan() { n } else { most });
        course.inverted = course.inverted.max(report.model.n_quarantined_tets);
        if course.taken_s > request.seconds {
            course.broken_off = Some(format!("it took longer than {} s", request.seconds));
            break;
        }
    }
    course
}

/// Times the contacts of instruments in each step: processor time of the last step's [ns].
fn watch_touch(simulation: &mut Simulation) -> Arc<AtomicU64> {
    let taken_ns = Arc::new(AtomicU64::new(0));
    let (told_ns, mut begun_ns) = (Arc::clone(&taken_ns), 0);
    simulation.watch_stages(Some(Box::new(move |stage| match stage {
        StepStage::Hands => begun_ns = thread_cpu_ns(),
        StepStage::Touch => told_ns.store(thread_cpu_ns() - begun_ns, Ordering::Relaxed),
        StepStage::Organ | StepStage::Forces => {}
    })));
    taken_ns
}

impl StepMicroseconds {
    fn of(mut step_us: Vec<f64>) -> Self {
        if step_us.is_empty() {
            return Self { p50: 0.0, p99: 0.0, max: 0.0 };
        }
        step_us.sort_unstable_by(f64::total_cmp);
        Self { p50: quantile(&step_us, 0.5), p99: quantile(&step_us, 0.99), max: step_us[step_us.len() - 1] }
    }
}

fn run_scene(
    motion: &Motion,
    size: usize,
    subject: &Subject,
    request: &SceneRequest,
) -> anyhow::Result<SceneOutcome> {
    let mut opened = open(motion, size, subject, request)?;
    let Course { step_us, touch_us, most_points, taken_s, greatest_force_n, inverted, broken_off } =
        run_through(&mut opened, request);
    let Opened { simulation, step_s, size, .. } = opened;
    let simulated_s = step_us.len() as f64 * step_s;
    Ok(SceneOutcome {
        case: motion.name,
        imposed: request.imposed,
        size,
        threads: request.threads,
        model: subject.kind.name(),
        law: subject.law.or(subject.kind.row().laws.first().copied()).unwrap_or("springs"),
        real_time_factor: simulated_s / taken_s.max(1e-12),
        step_us: StepMicroseconds::of(step_us),
        touch_us: StepMicroseconds::of(touch_us),
        most_points,
        budget_us: step_s * 1e6,
        greatest_force_n: greatest_force_n.is_finite().then_some(greatest_force_n),
        inverted,
        edits: simulation.world().organ().topology_version() as usize - 1,
        effort: simulation.world().effort().name(),
        simulated_s,
        broken_off,
    })
}

impl SceneReport {
    /// A table for people.
    fn to_table(&self) -> String {
        let mut text = format!(
            "machine: {}, one core: FMA {:.1} GFLOP/s f64\n{:<6} {:>6} {:<22} {:<20} {:>9} {:>9} {:>9} {:>9} {:>9} {:>9} {:>6} {:>10} {:>8} {:>6}\n",
            self.machine.cpu,
            self.machine.fma_gflops_f64,
            "case",
            "size",
            "model",
            "law",
            "real time",
            "p50 us",
            "p99 us",
            "max us",
            "budget us",
            "touch p99",
            "points",
            "force N",
            "inverted",
            "edits"
        );
        for r in &self.results {
            let force = r
                .greatest_force_n
                .map_or("none".to_owned(), |n| if n < 1e4 { format!("{n:.3}") } else { format!("{n:.1e}") });
            text += &format!(
                "{:<6} {:>6} {:<22} {:<20} {:>9.2} {:>9.0} {:>9.0} {:>9.0} {:>9.0} {:>9.0} {:>6} {force:>10} {:>8} {:>6}{}\n",
                r.case,
                r.size,
                r.model,
                r.law,
                r.real_time_factor,
                r.step_us.p50,
                r.step_us.p99,
                r.step_us.max,
                r.budget_us,
                r.touch_us.p99,
                r.most_points,
                r.inverted,
                r.edits,
                r.broken_off.as_ref().map_or(String::new(), |why| format!("  broken off: {why}")),
            );
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_motion_runs_with_a_model_and_what_it_meets_is_told() {
        let request = SceneRequest {
            motion: None,
            model: Some("tensor_mass".into()),
            imposed: false,
            step_s: None,
            sizes: vec![500],
            threads: 1,
            seconds: 60.0,
        };
        let subject = Subject { kind: ModelKind::TensorMass, law: None, step_s: 1e-3 };
        for motion in MOTIONS {
            let outcome = run_scene(motion, 500, &subject, &request).unwrap();
            assert_eq!(outcome.broken_off, None, "{}", motion.name);
            let force_n = outcome.greatest_force_n.unwrap();
            assert_eq!(force_n > 0.0, !matches!(motion.name, "rest"), "{}: {force_n} N", motion.name);
            assert!(outcome.step_us.p50 <= outcome.step_us.p99 && outcome.step_us.p99 <= outcome.step_us.max);
            assert_eq!(outcome.edits > 0, motion.cuts, "{}", motion.name);
            assert!(outcome.budget_us <= 1e3 && outcome.real_time_factor > 0.0);
        }
        let wrong = SceneRequest { motion: Some("pusch".into()), ..request };
        let error = measure(&wrong, &|_, _, _| {}).unwrap_err().to_string();
        assert!(error.contains("did you mean \"push\""), "{error}");
    }
}
