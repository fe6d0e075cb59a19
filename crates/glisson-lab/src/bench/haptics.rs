//! The haptic loop beside a simulation of a liver that is pushed, and a viewer in a process of its own; and the same while the
//! simulation stands still now and then. `docs/bench.md` says how to read the result.

use super::core_use::{CoreUse, Moment};
use super::{Answer, Tell, Trial, TrialRequest, empty_loop};
use crate::bodies::liver;
use crate::scratch::ScratchFolder;
use anyhow::{Context, bail, ensure};
use glisson::haptics::{DeviceFault, DeviceLimits, DeviceState, ForceCommand, HapticDevice};
use glisson::math::DVec3;
use glisson::mesh::files::write_mesh;
use glisson_runtime::devices;
use glisson_runtime::haptic_loop::{HapticReport, HapticSettings, Meters, WARM_UP_S, check_rate, join};
use glisson_runtime::histogram::{GreatestValue, Histogram};
use glisson_runtime::live::Stalls;
use glisson_runtime::pace::StepTimes;
use glisson_runtime::realtime::{CoreKept, OwnCore};
use glisson_runtime::{OpenScene, Simulation};
use glisson_view::server::access::Access;
use glisson_view::server::{self, Served, Service};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc;
use std::time::Duration;

/// A stall as the issue of a hold-up in practice: a pre-computation on the same cores, a page fault storm ...
const STALL: Duration = Duration::from_millis(30);
/// ... once a second.
const STALL_EVERY: Duration = Duration::from_secs(1);
/// Both runs are divided into blocks of about this length in turn, so that what else the machine does falls on both [s].
const BLOCK_S: f64 = 10.0;
/// Before each block an empty loop shows what the machine lets a loop be at best, for this share of its time.
const EMPTY_SHARE: f64 = 0.2;
/// A machine on which 99.9 of 100 ticks of an empty loop are nearer to their moment than this is punctual [us].
const GREATEST_JITTER_US: f64 = 100.0;
/// Missed deadlines may rise by so many percentage points.
const GREATEST_RISE_PERCENT: f64 = 0.1;
/// During the stalls the loop ticks at this share of its rate at least, a choice: the host of a virtual machine may take a part
/// of their short time. A loop that waited for the simulation would tick once or twice in each.
const LEAST_RATE_SHARE: f64 = 0.8;
/// Name of the loop's thread.
const HAPTIC_THREAD: &str = "haptics";

pub(super) const TRIAL: Trial = Trial {
    name: "haptics",
    about: "the haptic loop beside a simulation and a viewer, with stalls and without",
    measure: run,
};

/// The liver of the demo.
const USUAL_TETS: usize = 6_300;
/// Time of each of the two runs [s].
const USUAL_SECONDS: f64 = 10.0;

fn run(request: &TrialRequest, tell: Tell<'_>) -> anyhow::Result<Answer> {
    let n_tets = match request.sizes.as_deref() {
        None => USUAL_TETS,
        Some(&[n_tets]) if n_tets > 0 => n_tets,
        Some(sizes) => bail!("--sizes {sizes:?}: the benchmark haptics takes one size above 0"),
    };
    let program =
        std::env::current_exe().context("finding this program, whose verb `watch` is the viewer")?;
    // As `glisson serve` does, before any thread is started; the viewer's process keeps away, too.
    let kept = CoreKept::keep(None);
    let seconds = request.seconds.unwrap_or(USUAL_SECONDS);
    let request = HapticsRequest { seconds, rate_hz: request.rate_hz, n_tets, core: kept.core(), program };
    let answer = measure(&request, tell)?;
    Ok(Answer { json: format!("{answer:#}"), text: to_text(&answer) })
}

/// What to measure.
struct HapticsRequest {
    /// Time of each of the two runs [s].
    seconds: f64,
    /// Ticks a second.
    rate_hz: f64,
    /// Size of the body.
    n_tets: usize,
    /// Where the loop stays.
    core: OwnCore,
    /// The program whose verb `watch` is the viewer.
    program: PathBuf,
}

/// One of the two runs.
#[derive(Default)]
struct Run {
    meters: Arc<Meters>,
    n_stalls: u64,
    stalled_s: f64,
    /// Whether the simulation stands still just now.
    is_stalled: Arc<AtomicBool>,
    steps: u64,
    /// Of the last block.
    times: StepTimes,
    seconds: f64,
    n_given_up: u64,
    n_frames: u64,
    n_bytes: u64,
    forces: Arc<Forces>,
    core_use: CoreUse,
}

/// What a device was told; one thread counts.
#[derive(Debug, Default)]
struct Forces {
    n_ticks: AtomicU64,
    n_in_contact: AtomicU64,
    n_in_stalls: AtomicU64,
    greatest_n: GreatestValue,
}

/// A device whose forces are counted on their way.
struct Counting {
    device: Box<dyn HapticDevice>,
    forces: Arc<Forces>,
    is_stalled: Arc<AtomicBool>,
}

impl HapticDevice for Counting {
    fn limits(&self) -> DeviceLimits {
        self.device.limits()
    }

    fn read(&mut self) -> Result<DeviceState, DeviceFault> {
        self.device.read()
    }

    fn write(&mut self, command: &ForceCommand) -> Result<(), DeviceFault> {
        let force_n = command.force_n.length();
        self.forces.n_ticks.fetch_add(1, Ordering::Relaxed);
        // Free, the law commands nothing at all.
        self.forces.n_in_contact.fetch_add(u64::from(force_n > 0.0), Ordering::Relaxed);
        self.forces
            .n_in_stalls
            .fetch_add(u64::from(self.is_stalled.load(Ordering::Relaxed)), Ordering::Relaxed);
        self.forces.greatest_n.raise_to(force_n);
        self.device.write(command)
    }
}

/// Measures both runs; `tell` hears what comes.
///
/// # Errors
/// For a bad setting, and when something cannot be set up.
fn measure(request: &HapticsRequest, tell: Tell<'_>) -> anyhow::Result<Value> {
    ensure!(
        request.seconds >= 1.0 && request.seconds <= 3_600.0,
        "--seconds {}: must be 1 to 3600 for the benchmark haptics",
        request.seconds
    );
    check_rate(request.rate_hz)?;
    let mesh = liver(request.n_tets)?;
    let front = mesh.positions_m.iter().copied().min_by(|a, b| a.y.total_cmp(&b.y));
    let front_m = front.context("a liver without nodes")?;
    let folder = ScratchFolder::new()?;
    write_mesh(&folder.path().join("liver.vtu"), &mesh)?;
    let scene = folder.path().join("scene.toml");
    let mut runs = Runs::default();
    let time_step_s = write_scene(&scene, front_m)?;
    runs.measure(request, &scene, tell)?;
    let mut answer = runs.plain.to_json(&runs.plain.meters.report());
    let about_all = json!({
        "bench": "haptics",
        "seconds": request.seconds,
        "body": "liver of the synthetic patient",
        "tetrahedra": mesh.tetrahedra.len(),
        "model": "explicit, st_venant_kirchhoff",
        "time_step_s": time_step_s,
    });
    for facts in [about_all, runs.compared()] {
        if let (Value::Object(answer), Value::Object(facts)) = (&mut answer, facts) {
            answer.extend(facts);
        }
    }
    Ok(answer)
}

/// The two runs, without stalls and with them, and an empty loop beside both.
#[derive(Default)]
struct Runs {
    plain: Run,
    stalled: Run,
    empty_jitter: Histogram,
}

impl Runs {
    /// Measures the blocks of both in turn.
    fn measure(
        &mut self,
        request: &HapticsRequest,
        scene: &Path,
        tell: &dyn Fn(&str, usize, usize),
    ) -> anyhow::Result<()> {
        let n_blocks = (request.seconds / BLOCK_S).ceil() as usize;
        let block_s = request.seconds / n_blocks as f64;
        let stalls =
            Stalls { every: STALL_EVERY, length: STALL, is_on: Arc::clone(&self.stalled.is_stalled) };
        for block in 0..n_blocks {
            // Now one first, now the other.
            let mut order = [(&mut self.plain, None), (&mut self.stalled, Some(&stalls))];
            if block % 2 == 1 {
                order.reverse();
            }
            for (number, (run, stalls)) in order.into_iter().enumerate() {
                let text = if stalls.is_some() { "with stalls" } else { "without stalls" };
                tell(text, 2 * block + number, 2 * n_blocks);
                empty_loop::measure(request.rate_hz, request.core, EMPTY_SHARE * block_s, &self.empty_jitter);
                let block = Block { scene, seconds: block_s, stalls, core: request.core };
                measure_block(request, &block, run)?;
            }
        }
        Ok(())
    }

    /// The run with stalls, and what they do.
    fn compared(&self) -> Value {
        let stalled = &self.stalled;
        let (plain_report, stalled_report) = (self.plain.meters.report(), stalled.meters.report());
        let rise = stalled_report.missed_percent() - plain_report.missed_percent();
        let n_in_stalls = stalled.forces.n_in_stalls.load(Ordering::Relaxed) as f64;
        let rate_in_stalls_hz = (stalled.n_stalls > 0).then(|| n_in_stalls / stalled.stalled_s);
        let is_felt = |hz: f64| hz < LEAST_RATE_SHARE * stalled_report.rate_hz;
        let empty = self.empty_jitter.percentiles();
        json!({
            "with_stalls": stalled.to_json(&stalled_report),
            "stall_ms": STALL.as_millis() as u64,
            "empty_loop_jitter_us": empty.to_json(1e3),
            "machine_is_punctual": (empty.p999_ns as f64) < 1e3 * GREATEST_JITTER_US,
            "missed_percent_rise": rise,
            "greatest_rise_percent": GREATEST_RISE_PERCENT,
            "rise_is_small": rise <= GREATEST_RISE_PERCENT,
            "rate_in_stalls_hz": rate_in_stalls_hz,
            "stalls_are_not_felt": rate_in_stalls_hz.map(|hz| !is_felt(hz)),
        })
    }
}

impl Run {
    fn to_json(&self, report: &HapticReport) -> Value {
        let mut answer = report.to_json();
        let dt = self.seconds.max(1e-9);
        let of = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        answer["contact"] = json!({
            "ticks": of(&self.forces.n_ticks),
            "ticks_in_contact": of(&self.forces.n_in_contact),
            "greatest_force_n": self.forces.greatest_n.get(),
        });
        // Null where nothing was counted.
        answer["core"] = json!({
            "others_percent": 100.0 * self.core_use.others_share(),
            "stolen_percent": 100.0 * self.core_use.stolen_share(),
        });
        answer["core_was_free"] = json!(self.core_use.was_free());
        answer["simulation"] = json!({
            "steps_per_s": self.steps as f64 / dt, "stalls": self.n_stalls, "times_given_up": self.n_given_up,
            "last_block": self.times.to_json(),
        });
        answer["viewer"] = json!({
            "frames_per_s": self.n_frames as f64 / dt, "megabytes_per_s": self.n_bytes as f64 * 1e-6 / dt,
        });
        answer
    }
}

/// As text: the figures that matter.
fn to_text(answer: &Value) -> String {
    let mut text = format!(
        "haptic loop beside {} tetrahedra ({}) and a viewer, {} s each; {}\n",
        answer["tetrahedra"], answer["model"], answer["seconds"], answer["scheduling"]
    );
    for (name, run) in [("without stalls", answer), ("with stalls", &answer["with_stalls"])] {
        let of = |field: &str, which: &str| run[field][which].as_f64().unwrap_or(f64::NAN);
        text += &format!(
            "{name:14}  {:.1} Hz; missed {} of {} ({:.4} %); jitter p50 {:.1}, p99 {:.1}, p99.9 {:.1} us; motion to \
             force p50 {:.1}, p99.9 {:.1} us; age of the model p50 {:.2}, max {:.1} ms; {:.0} steps/s, {} stalls; \
             viewer {:.0} frames/s\n                in contact in {} of {} ticks, up to {:.2} N; of the loop's core others had {:.1} %, the \
             host {:.2} %: {}\n",
            run["rate_hz"].as_f64().unwrap_or(f64::NAN),
            run["missed_deadlines"],
            run["deadlines"],
            run["missed_percent"].as_f64().unwrap_or(f64::NAN),
            of("jitter_us", "p50"),
            of("jitter_us", "p99"),
            of("jitter_us", "p999"),
            of("motion_to_force_us", "p50"),
            of("motion_to_force_us", "p999"),
            of("local_model_age_ms", "p50"),
            of("local_model_age_ms", "max"),
            of("simulation", "steps_per_s"),
            run["simulation"]["stalls"],
            of("viewer", "frames_per_s"),
            run["contact"]["ticks_in_contact"],
            run["contact"]["ticks"],
            of("contact", "greatest_force_n"),
            of("core", "others_percent"),
            of("core", "stolen_percent"),
            if run["core_was_free"] == true { "free" } else { "not free" },
        );
    }
    let empty_us = |which: &str| answer["empty_loop_jitter_us"][which].as_f64().unwrap_or(f64::NAN);
    text += &format!(
        "an empty loop's jitter here: p99 {:.1}, p99.9 {:.1} us: the machine {} punctual\n",
        empty_us("p99"),
        empty_us("p999"),
        if answer["machine_is_punctual"] == true { "is" } else { "is not" },
    );
    let rise = answer["missed_percent_rise"].as_f64().unwrap_or(f64::NAN);
    let in_stalls_hz = answer["rate_in_stalls_hz"].as_f64().unwrap_or(f64::NAN);
    text += &format!(
        "stalls raise the missed deadlines by {rise:.4} percentage points; during them the loop ticks at {in_stalls_hz:.1} Hz\n"
    );
    text
}

const SCENE: &str = "glisson_scene = 1\nname = \"haptics\"\n[organ]\nmesh = \"liver.vtu\"\ntissue = \"liver\"\n\
    model = \"explicit\"\nlaw = \"st_venant_kirchhoff\"\ndamping = \"20 1/s\"\n\
    [[organ.fixed]]\nfurthest = { direction = [0, 1, 0], fraction = 0.2 }\n\
    [tool]\ntip_radius = \"6 mm\"\nhome_shaft = [0, -1, 0]\n";
/// From the tip at its home to the place of the surface that it pushes [m]: its radius and a millimetre.
const ABOVE_M: f64 = 7e-3;

/// With the longest step of one millisecond and its halves that is stable; answers it [s]. The probe begins before
/// `front_m` [m], the foremost place of the liver.
fn write_scene(path: &Path, front_m: DVec3) -> anyhow::Result<f64> {
    let home_m = front_m - DVec3::Y * ABOVE_M;
    let home = home_m.to_array().map(|x| format!("\"{:.3} mm\"", 1e3 * x)).join(", ");
    let mut refusal = None;
    for microseconds in [1_000, 500, 250, 125] {
        let text = format!("{SCENE}home_tip = [{home}]\n[simulation]\ntime_step = \"{microseconds} us\"\n");
        std::fs::write(path, text).with_context(|| format!("{}: cannot write", path.display()))?;
        match Simulation::open(OpenScene::read(path)?, None) {
            Ok(_) => return Ok(1e-6 * f64::from(microseconds)),
            Err(error) => refusal = Some(error),
        }
    }
    bail!("no time step down to 0.125 ms is stable: {:#}", refusal.context("nothing was tried")?)
}

/// A part of one of the two runs.
struct Block<'a> {
    scene: &'a Path,
    seconds: f64,
    stalls: Option<&'a Stalls>,
    core: OwnCore,
}

fn measure_block(request: &HapticsRequest, block: &Block<'_>, run: &mut Run) -> anyhow::Result<()> {
    let Block { scene, seconds, stalls, core } = *block;
    let simulation = Simulation::open(OpenScene::read(scene)?, None)?;
    let listener = server::bind("127.0.0.1", 0)?;
    let address = listener.local_addr()?;
    let home = simulation.world().tools()[0].home;
    let name = "simulated".parse().map_err(anyhow::Error::msg)?;
    let mut device = devices::open(&name, &home, request.rate_hz)?;
    device.device = Box::new(Counting {
        device: device.device,
        forces: Arc::clone(&run.forces),
        is_stalled: Arc::clone(&run.is_stalled),
    });
    let held = vec![join(device, 0, home)];
    let haptics = HapticSettings { rate_hz: request.rate_hz, core, ..HapticSettings::default() };
    let service = Service {
        held,
        haptics,
        stalls: stalls.cloned(),
        meters: Arc::clone(&run.meters),
        ..Service::to(Access::for_address(address.ip(), None)?)
    };
    let viewer = Command::new(&request.program)
        .args(["watch", &format!("ws://{address}/ws"), "--json"])
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .with_context(|| format!("{}: cannot start the viewer", request.program.display()))?;
    let end = Duration::from_secs_f64(seconds);
    let (used_in, used) = mpsc::channel();
    let meters = Arc::clone(&run.meters);
    let served = server::serve(simulation, listener, service, async move {
        // The loop is on its core by then, and counts from there on.
        let warm_up = Duration::from_secs_f64(WARM_UP_S);
        tokio::time::sleep(warm_up).await;
        let now = || Moment::now(meters.report().scheduling?.core?, HAPTIC_THREAD);
        let from = now();
        tokio::time::sleep(end - warm_up).await;
        // Who listens waits below.
        let _ = used_in.send(from.zip(now()));
    });
    // It ends with the connection, also when the service failed.
    let watched = viewer.wait_with_output().context("waiting for the viewer")?;
    let Served { ended, .. } = served?;
    let watched: Value = serde_json::from_slice(&watched.stdout)
        .with_context(|| format!("the viewer failed: {}", String::from_utf8_lossy(&watched.stderr).trim()))?;
    if let Ok(Some((from, to))) = used.try_recv() {
        run.core_use = run.core_use.and(CoreUse::between(&from, &to));
    }
    run.n_stalls += ended.n_stalls;
    run.stalled_s += ended.stalled.as_secs_f64();
    run.steps += ended.steps;
    run.times = ended.times;
    run.seconds += seconds;
    run.n_given_up += ended.lateness.n_given_up;
    run.n_frames += watched["frames"].as_u64().context("the viewer counts no frames")?;
    run.n_bytes += watched["bytes"].as_u64().context("the viewer counts no bytes")?;
    Ok(())
}
