//! What viewers cost: the bytes of a frame, the server's processor time, and whether the simulation keeps its rate.
//! `docs/bench.md` says how to read the result.

use super::{Answer, Tell, Trial, TrialRequest, thread_cpu_ns};
use crate::scratch::ScratchFolder;
use crate::scripted::{LongestStep, open_with_longest_step};
use anyhow::{Context, ensure};
use glisson::math::DVec3;
use glisson::mesh::box_mesh::box_of_five;
use glisson::mesh::files::write_mesh;
use glisson_protocol::positions::STEP_M;
use glisson_runtime::Simulation;
use glisson_runtime::live::Command as LiveCommand;
use glisson_runtime::published::Published;
use glisson_runtime::steering::{Show, Steering};
use glisson_view::server::access::Access;
use glisson_view::server::{self, Service};
use serde_json::{Value, json};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use tokio::sync::watch;

pub(super) const TRIAL: Trial = Trial {
    name: "viewers",
    about: "bytes and server time of a frame, and the simulation's rate, with many viewers",
    measure: run,
};

/// Cells of the sheet along its sides: 13,920 triangles.
const CELLS: usize = 58;
/// Its side and its thickness [m].
const SIDE_M: f64 = 0.29;
const THICKNESS_M: f64 = 5e-3;
/// Numbers of viewers.
const USUAL_VIEWERS: [usize; 3] = [0, 1, 50];
/// Time of each run [s].
const USUAL_SECONDS: f64 = 5.0;
/// Until all viewers are connected and the simulation has settled to its rate.
const WARM_UP: Duration = Duration::from_secs(3);
/// The table is tilted to and fro this often, so that everything moves all the time.
const TILT_EVERY: Duration = Duration::from_millis(250);
const LOOK_EVERY: Duration = Duration::from_millis(2);

fn run(request: &TrialRequest, tell: Tell<'_>) -> anyhow::Result<Answer> {
    let seconds = request.seconds.unwrap_or(USUAL_SECONDS);
    ensure!(
        (1.0..=600.0).contains(&seconds),
        "--seconds {seconds}: must be 1 to 600 for the benchmark viewers"
    );
    let numbers = request.sizes.clone().unwrap_or(USUAL_VIEWERS.to_vec());
    let program = std::env::current_exe().context("finding this program, whose verb `watch` is a viewer")?;
    let folder = ScratchFolder::new()?;
    let mesh = box_of_five([CELLS, CELLS, 1], DVec3::new(SIDE_M, SIDE_M, THICKNESS_M));
    write_mesh(&folder.path().join("sheet.vtu"), &mesh)?;
    let mut runs = vec![(1, Motion::Still)];
    runs.extend(numbers.into_iter().map(|n| (n, Motion::All)));
    let mut answers = Vec::new();
    let mut about = Value::Null;
    let n_runs = runs.len();
    for (done, (n_viewers, motion)) in runs.into_iter().enumerate() {
        tell(&format!("{n_viewers} viewers, {}", motion.name()), done, n_runs);
        let LongestStep { simulation, step_s, .. } = open_with_longest_step(folder.path(), 1, 1e-3, &scene)?;
        let shown = simulation.world().display_topology();
        about = json!({
            "bench": "viewers", "seconds": seconds, "tetrahedra": mesh.tetrahedra.len(), "vertices": shown.nodes.len(),
            "triangles": shown.triangles.len(), "time_step_s": step_s, "largest_error_m": 0.5 * STEP_M,
        });
        answers.push(measure(simulation, (n_viewers, motion), seconds, &program)?);
    }
    about["runs"] = answers.into();
    Ok(Answer { json: format!("{about:#}"), text: to_text(&about) })
}

fn scene(step_s: f64) -> String {
    format!(
        "glisson_scene = 1\nname = \"viewers\"\n[organ]\nmesh = \"sheet.vtu\"\nmodel = \"explicit\"\n\
         young_modulus = \"3 kPa\"\npoisson_ratio = 0.4\ndensity = \"1000 kg/m3\"\ndamping = \"5 1/s\"\n\
         [[organ.fixed]]\nfurthest = {{ direction = [-1, 0, 0], fraction = 0.02 }}\n\
         [[organ.fixed]]\nfurthest = {{ direction = [1, 0, 0], fraction = 0.02 }}\n\
         [tool]\ntip_radius = \"5 mm\"\nhome_tip = [\"145 mm\", \"145 mm\", \"200 mm\"]\nhome_shaft = [0, 0, 1]\n\
         [simulation]\ntime_step = \"{} us\"\n",
        1e6 * step_s
    )
}

/// What the sheet does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Motion {
    Still,
    All,
}

impl Motion {
    fn name(self) -> &'static str {
        match self {
            Self::Still => "nothing moves",
            Self::All => "everything moves",
        }
    }
}

/// How far the simulation is.
#[derive(Default)]
struct Seen {
    n_frames: AtomicU64,
    step: AtomicU64,
}

/// Counts what is published, and moves the sheet.
fn follow(
    seen: Arc<Seen>,
    motion: Motion,
    mut published: watch::Receiver<Arc<Published>>,
    steering: &Steering,
) -> anyhow::Result<JoinHandle<()>> {
    let seat = steering.sit_down().context("no seat at the controls")?;
    let follow = move || {
        let (begin, mut n_tilts) = (Instant::now(), 0);
        while let Ok(has_changed) = published.has_changed() {
            if has_changed {
                seen.step.store(published.borrow_and_update().snapshot.step, Ordering::Relaxed);
                seen.n_frames.fetch_add(1, Ordering::Relaxed);
            }
            if motion == Motion::All && begin.elapsed() > TILT_EVERY * n_tilts {
                n_tilts += 1;
                let up = if n_tilts % 2 == 0 { 2.0 } else { -2.0 };
                seat.send(LiveCommand::Gravity(DVec3::new(0.3, 0.2, 1.0) * up));
            }
            std::thread::sleep(LOOK_EVERY);
        }
    };
    Ok(std::thread::Builder::new().name("follow".into()).spawn(follow)?)
}

/// A viewer in a process of its own, which ends with its connection.
fn viewer(program: &Path, address: &str) -> anyhow::Result<Child> {
    Command::new(program)
        .args(["watch", address, "--json"])
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .with_context(|| format!("{}: cannot start a viewer", program.display()))
}

fn measure(
    simulation: Simulation,
    (n_viewers, motion): (usize, Motion),
    seconds: f64,
    program: &Path,
) -> anyhow::Result<Value> {
    let step_s = simulation.world().spec().time_step_s;
    let listener = server::bind("127.0.0.1", 0)?;
    let address = listener.local_addr()?;
    let seen = Arc::<Seen>::default();
    let of_show = Arc::clone(&seen);
    let show: Show = Box::new(move |published, steering| follow(of_show, motion, published, steering));
    let service = Service { shows: vec![show], ..Service::to(Access::for_address(address.ip(), None)?) };
    let viewers: Vec<Child> =
        (0..n_viewers).map(|_| viewer(program, &format!("ws://{address}/ws"))).collect::<Result<_, _>>()?;
    let now = || {
        let of = |counter: &AtomicU64| counter.load(Ordering::Relaxed) as f64;
        // The server's thread is the one that this is asked on.
        (Instant::now(), thread_cpu_ns(), of(&seen.n_frames), of(&seen.step))
    };
    let mut taken = None;
    server::serve(simulation, listener, service, async {
        tokio::time::sleep(WARM_UP).await;
        let from = now();
        tokio::time::sleep(Duration::from_secs_f64(seconds)).await;
        taken = Some((from, now()));
    })?;
    let ((from, cpu_from_ns, frames_from, step_from), (to, cpu_to_ns, frames_to, step_to)) =
        taken.context("the simulation ended before it was measured")?;
    let (passed_s, n_frames) = ((to - from).as_secs_f64(), frames_to - frames_from);
    let (mut rates_hz, mut bytes_per_frame) = (Vec::new(), Vec::new());
    for viewer in viewers {
        let watched = viewer.wait_with_output().context("waiting for a viewer")?;
        let watched: Value = serde_json::from_slice(&watched.stdout).context("a viewer failed")?;
        let of = |what: &str| watched[what].as_f64().with_context(|| format!("a viewer says no {what}"));
        rates_hz.push(of("frames")? / of("elapsed_s")?);
        bytes_per_frame.push(of("bytes_of_frames")? / of("frames")?.max(1.0));
    }
    rates_hz.sort_by(f64::total_cmp);
    let mean = |all: &[f64]| (!all.is_empty()).then(|| all.iter().sum::<f64>() / all.len() as f64);
    Ok(json!({
        "viewers": n_viewers,
        "motion": motion.name(),
        "real_time_factor": (step_to - step_from) * step_s / passed_s,
        "published_per_s": n_frames / passed_s,
        "server_ms_per_frame": 1e-6 * (cpu_to_ns - cpu_from_ns) as f64 / n_frames.max(1.0),
        "bytes_per_frame": mean(&bytes_per_frame),
        "frames_per_s_least": rates_hz.first(),
        "frames_per_s_mean": mean(&rates_hz),
        "kilobytes_per_s": mean(&bytes_per_frame).zip(mean(&rates_hz)).map(|(bytes, hz)| 1e-3 * bytes * hz),
    }))
}

fn to_text(answer: &Value) -> String {
    let mut text = format!(
        "{} triangles, {} vertices, a step of {} ms; a coordinate is off by {} um at most\n\
         viewers  motion            real time  server ms/frame  bytes/frame  frames/s (least)  kB/s each\n",
        answer["triangles"],
        answer["vertices"],
        1e3 * answer["time_step_s"].as_f64().unwrap_or(f64::NAN),
        1e6 * answer["largest_error_m"].as_f64().unwrap_or(f64::NAN),
    );
    for run in answer["runs"].as_array().into_iter().flatten() {
        let of = |what: &str, digits: usize| {
            run[what].as_f64().map_or("-".to_owned(), |x| format!("{x:.digits$}"))
        };
        text += &format!(
            "{:>7}  {:16}  {:>9}  {:>15}  {:>11}  {:>8} {:>7}  {:>9}\n",
            run["viewers"].to_string(),
            run["motion"].as_str().unwrap_or_default(),
            of("real_time_factor", 3),
            of("server_ms_per_frame", 3),
            of("bytes_per_frame", 0),
            of("frames_per_s_mean", 1),
            format!("({})", of("frames_per_s_least", 1)),
            of("kilobytes_per_s", 0),
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_scene_has_the_triangles_that_are_promised_and_takes_a_step() {
        let folder = ScratchFolder::new().unwrap();
        let mesh = box_of_five([CELLS, CELLS, 1], DVec3::new(SIDE_M, SIDE_M, THICKNESS_M));
        write_mesh(&folder.path().join("sheet.vtu"), &mesh).unwrap();
        let opened = open_with_longest_step(folder.path(), 1, 1e-3, &scene).unwrap();
        assert_eq!(opened.simulation.world().display_topology().triangles.len(), 13_920);
    }

    #[test]
    fn a_number_that_is_missing_is_a_dash() {
        let run = json!({ "viewers": 0, "motion": "everything moves", "real_time_factor": 1.0, "bytes_per_frame": null });
        let text = to_text(&json!({ "triangles": 1, "vertices": 3, "runs": [run] }));
        assert!(
            text.ends_with(
                "everything moves      1.000                -            -         -     (-)          -\n"
            ),
            "{text}"
        );
    }
}
