//! A haptics machine without a device: the scene's own paths move the instruments at 1 kHz, and the force that a device
//! would have got is computed. For trials of a link, and its tests.

use glisson::haptics::{ForceEstimate, Handover, HapticModel, LawSettings};
use glisson::math::{DMat3, DVec3};
use glisson::scene::Scene;
use glisson_runtime::exchange::exchange;
use glisson_runtime::exchange::{Latest, Publisher};
use glisson_runtime::haptic_loop::{DeviceStatus, Motion, PublishedModel, ToolLink};
use glisson_runtime::realtime::now_ns;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

const PERIOD: Duration = Duration::from_millis(1);
/// How long a model must have been stale until what is left of a force counts [ns]: the law lets go over some time.
const LETTING_GO_NS: u64 = 500_000_000;

/// A model older than this [ns] pulls no more: as in the law of the devices.
fn stale_ns() -> u64 {
    (LawSettings::default().stale_after_s * 1e9) as u64
}

/// What was played.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub(crate) struct Played {
    /// Ticks of a millisecond.
    pub(crate) n_ticks: u64,
    /// Ticks in which a model was there, and in how many of them it was too old.
    pub(crate) n_with_model: u64,
    pub(crate) n_stale: u64,
    /// Largest force on an instrument [N], and what was left of it while the models were stale for half a second.
    pub(crate) greatest_force_n: f64,
    pub(crate) greatest_stale_force_n: f64,
    /// Largest step of a force between two ticks [N], and what of such a step the tip's own motion against the stiffness of
    /// the tissue does not explain.
    pub(crate) greatest_jump_n: f64,
    pub(crate) greatest_unexplained_jump_n: f64,
}

struct Tool {
    models: Latest<PublishedModel>,
    motions: Publisher<Motion>,
    handover: Handover,
    last_force_n: DVec3,
    last_tip_m: DVec3,
    last_stiffness_n_per_m: f64,
}

/// Running.
pub(crate) struct Player {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<Played>>,
}

impl Player {
    /// Plays the paths of `scene` again and again; answers the simulation's ends of all its instruments.
    ///
    /// # Errors
    /// When the system gives no thread.
    pub(crate) fn start(scene: &Scene) -> std::io::Result<(Self, Vec<ToolLink>)> {
        let (mut tools, mut links) = (Vec::new(), Vec::new());
        for (number, tool) in scene.world.tools.iter().enumerate() {
            let (models_in, models) = exchange(PublishedModel::default());
            let (motions, motions_out) = exchange(Motion::of(tool.home, false));
            let (_, statuses) = exchange(DeviceStatus::Waiting);
            let handover = Handover::new(ForceEstimate::LocalModel);
            tools.push(Tool {
                models,
                motions,
                handover,
                last_force_n: DVec3::ZERO,
                last_tip_m: tool.home.tip_in_world_m,
                last_stiffness_n_per_m: 0.0,
            });
            links.push(ToolLink {
                tool: number,
                device_name: "the scene's path".into(),
                models: models_in,
                motions: motions_out,
                statuses,
                nearby: None,
            });
        }
        let stop = Arc::new(AtomicBool::new(false));
        let (scene, stops) = (scene.clone(), Arc::clone(&stop));
        let run = move || play(&scene, tools, &stops);
        let thread = std::thread::Builder::new().name("path-player".into()).spawn(run)?;
        Ok((Self { stop, thread: Some(thread) }, links))
    }

    /// Stops, and says how it went.
    pub(crate) fn finish(mut self) -> Played {
        self.stop.store(true, Ordering::Relaxed);
        // A panic was printed when it happened.
        self.thread.take().and_then(|thread| thread.join().ok()).unwrap_or_default()
    }
}

impl Drop for Player {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
    }
}

/// Of the whole contact and of its parts: no direction is stiffer than the root of the sum of squares.
fn greatest_stiffness_n_per_m(model: &HapticModel) -> f64 {
    let size = |m: &DMat3| m.to_cols_array().iter().map(|x| x * x).sum::<f64>().sqrt();
    let parts = model.parts.iter().take(model.n_parts as usize).map(|part| size(&part.stiffness_n_per_m));
    size(&model.stiffness_n_per_m).max(parts.sum())
}

fn play(scene: &Scene, mut tools: Vec<Tool>, stop: &AtomicBool) -> Played {
    let (start, end_s) = (Instant::now(), scene.end_of_paths_s().unwrap_or(1.0).max(0.1));
    let mut played = Played::default();
    let (mut deadline, stale_ns) = (start, stale_ns());
    while !stop.load(Ordering::Relaxed) {
        deadline += PERIOD;
        std::thread::sleep(deadline.saturating_duration_since(Instant::now()));
        let now = now_ns();
        // There and back, so that nothing jumps.
        let phase = (start.elapsed().as_secs_f64() / end_s) % 2.0;
        let input = scene.input_at(end_s * if phase > 1.0 { 2.0 - phase } else { phase });
        played.n_ticks += 1;
        for (tool, pose) in tools.iter_mut().zip(input.tools) {
            tool.motions.publish(Motion::of(pose, true));
            let PublishedModel { model, made_ns } = tool.models.get();
            if made_ns == 0 {
                continue;
            }
            let age_ns = now.saturating_sub(made_ns);
            let model = if age_ns > stale_ns { HapticModel::default() } else { model };
            let (tip_m, dt_s) = (pose.tip_in_world_m, PERIOD.as_secs_f64());
            let force_n = tool.handover.force(&model, tip_m, age_ns as f64 * 1e-9, dt_s);
            played.n_with_model += 1;
            played.n_stale += u64::from(age_ns > stale_ns);
            played.greatest_force_n = played.greatest_force_n.max(force_n.length());
            let jump_n = force_n.distance(tool.last_force_n);
            played.greatest_jump_n = played.greatest_jump_n.max(jump_n);
            // By the larger of the two models' stiffness: the tip may have entered or left the tissue in between.
            let stiffness_n_per_m = greatest_stiffness_n_per_m(&model);
            let most_n_per_m = stiffness_n_per_m.max(tool.last_stiffness_n_per_m);
            let unexplained_n = jump_n - most_n_per_m * tip_m.distance(tool.last_tip_m);
            played.greatest_unexplained_jump_n = played.greatest_unexplained_jump_n.max(unexplained_n);
            (tool.last_tip_m, tool.last_stiffness_n_per_m) = (tip_m, stiffness_n_per_m);
            if age_ns > stale_ns + LETTING_GO_NS {
                played.greatest_stale_force_n = played.greatest_stale_force_n.max(force_n.length());
            }
            tool.last_force_n = force_n;
        }
    }
    played
}
