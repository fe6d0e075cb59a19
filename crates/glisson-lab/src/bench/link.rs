//! What a link between two machines adds: this process has the hands, another one (the same program) answers each of their
//! moves, as a simulation would that needs no time.

use super::{Answer, Tell, Trial, TrialRequest};
use anyhow::{Context, ensure};
use glisson::haptics::HapticModel;
use glisson::math::DVec3;
use glisson::tool::{Tool, ToolInput};
use glisson_net::bridge::{HapticsScene, HapticsSide, start_haptics, start_simulation};
use glisson_net::conversation::{Conversation, Identity};
use glisson_net::link::Role;
use glisson_net::link_address::LinkAddress;
use glisson_net::messages::SceneHash;
use glisson_net::seal::Seal;
use glisson_runtime::exchange::{Latest, Publisher, exchange};
use glisson_runtime::haptic_loop::{DeviceStatus, Motion, PublishedModel, ToolLink};
use glisson_runtime::histogram::{Histogram, Percentiles};
use glisson_runtime::realtime::{make_prompt, now_ns};
use glisson_runtime::remote_figures::RemoteFigures;
use serde_json::{Value, json};
use std::io::Read;
use std::net::UdpSocket;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// How long the two processes may take to find each other.
const PATIENCE: Duration = Duration::from_secs(30);

pub(super) const TRIAL: Trial =
    Trial { name: "link", about: "what a link between two machines adds", measure: run };

/// How long to measure [s].
const USUAL_SECONDS: f64 = 10.0;

/// Says nothing meanwhile, so that no thread takes the cores that it measures on.
fn run(request: &TrialRequest, _: Tell<'_>) -> anyhow::Result<Answer> {
    let program = std::env::current_exe().context("finding this program, whose second process answers")?;
    let (seconds, link) = (request.seconds.unwrap_or(USUAL_SECONDS), request.link.clone());
    let answer = measure(&LinkRequest { seconds, rate_hz: request.rate_hz, link, program })?;
    Ok(Answer { json: format!("{answer:#}"), text: to_text(&answer) })
}

/// What to measure.
struct LinkRequest {
    /// How long to measure [s].
    seconds: f64,
    /// Moves a second.
    rate_hz: f64,
    /// A free port of this machine for none.
    link: Option<LinkAddress>,
    /// This program, which is started once more.
    program: PathBuf,
}

fn home() -> ToolInput {
    ToolInput::at(DVec3::ZERO, DVec3::Z)
}

fn identity(role: Role) -> Identity {
    Identity { role, scene: SceneHash([0; 32]), n_tools: 1, seal: Seal::Check }
}

/// A move's number travels as a place.
fn move_number(number: u64) -> Motion {
    let tip_in_world_m = DVec3::X * number as f64;
    Motion::of(ToolInput { tip_in_world_m, ..home() }, true)
}

/// The other process: answers each move until the standard input ends.
///
/// # Errors
/// When the link cannot be opened.
pub fn answer(link: &LinkAddress) -> anyhow::Result<()> {
    let link = link.open(Role::Simulation, false)?;
    let (_conversation, mut tools) =
        start_simulation(link, identity(Role::Simulation), &[home()], RemoteFigures::default())?;
    let mut tool = tools.pop().context("one tool was asked for")?;
    tool.motions.wakes(std::thread::current());
    let ends = Arc::new(AtomicBool::new(false));
    let ending = Arc::clone(&ends);
    std::thread::spawn(move || {
        // It ends when the process that started this one does.
        let _ = std::io::stdin().read_to_end(&mut Vec::new());
        ending.store(true, Ordering::Relaxed);
    });
    make_prompt();
    while !ends.load(Ordering::Relaxed) {
        match tool.motions.get_new() {
            Some(motion) => {
                let step = motion.pose.tip_in_world_m.x as u64;
                let model = HapticModel { step, ..HapticModel::default() };
                tool.models.publish(PublishedModel { model, made_ns: now_ns() });
            }
            None => std::thread::park_timeout(Duration::from_millis(20)),
        }
    }
    Ok(())
}

/// Ends with the benchmark, however that ends.
struct Other(Child);

impl Other {
    fn start(program: &Path, address: &str) -> anyhow::Result<Self> {
        let child = Command::new(program)
            .args(["bench", "link", "--answer", "--link", address])
            .stdin(Stdio::piped())
            .spawn()
            .with_context(|| format!("{}: cannot start", program.display()))?;
        Ok(Self(child))
    }
}

impl Drop for Other {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// The link with its name: that asked for, or a free port of this machine.
fn address_of(link: Option<&LinkAddress>) -> anyhow::Result<(String, LinkAddress)> {
    if let Some(link) = link {
        return Ok((link.to_string(), link.clone()));
    }
    let free = UdpSocket::bind("127.0.0.1:0")?.local_addr()?;
    Ok((format!("udp://{free}"), LinkAddress::Udp(free.to_string())))
}

fn wait_until_up(conversation: &Conversation, address: &str) -> anyhow::Result<()> {
    let found = Instant::now();
    while !conversation.report().is_up {
        ensure!(found.elapsed() < PATIENCE, "{address}: the other process did not answer for 30 s");
        std::thread::sleep(Duration::from_millis(5));
    }
    Ok(())
}

/// Sends moves and times their answers.
///
/// # Errors
/// When the other process cannot be started or does not answer.
fn measure(request: &LinkRequest) -> anyhow::Result<Value> {
    ensure!(
        request.seconds > 0.0 && request.seconds <= 600.0,
        "--seconds {}: must be above 0 and at most 600",
        request.seconds
    );
    ensure!(
        (100.0..=4_000.0).contains(&request.rate_hz),
        "--rate {}: must be from 100 to 4000 Hz",
        request.rate_hz
    );
    let (address, link) = address_of(request.link.as_ref())?;
    let _other = Other::start(&request.program, &address)?;
    let opened = link.open(Role::Haptics, false)?;
    let (models_in, models) = exchange(PublishedModel::default());
    let (motions, motions_out) = exchange(Motion::of(home(), false));
    let (_, statuses) = exchange(DeviceStatus::Waiting);
    let held = ToolLink {
        tool: 0,
        device_name: "bench".into(),
        models: models_in,
        motions: motions_out,
        statuses,
        nearby: None,
    };
    let scene = HapticsScene::without_organ(vec![Tool::probe("bench", 5e-3, home())]);
    let HapticsSide { conversation, detection: _detection, .. } =
        start_haptics(opened, identity(Role::Haptics), scene, vec![held])?;
    wait_until_up(&conversation, &address)?;
    // As the haptic loop's thread would be.
    let is_real_time = make_prompt();
    // Caches and, with zenoh, sessions settle.
    let (_, ends) = time_answers(0.5, request.rate_hz, &conversation, (motions, models))?;
    let before = conversation.report();
    let (round_trip, _) = time_answers(request.seconds, request.rate_hz, &conversation, ends)?;
    let after = conversation.report();
    Ok(json!({
        "bench": "link",
        "link": address,
        "seconds": request.seconds,
        "rate_hz": request.rate_hz,
        "n_moves": (request.seconds * request.rate_hz) as u64,
        "n_answers": round_trip.n,
        "n_lost": after.counts.n_lost - before.counts.n_lost,
        // From handing a move over to having the model that answers it: both ways, through all threads.
        "round_trip_us": in_us(round_trip, 1.0),
        // One way: what the link adds to a move, and again to a model.
        "added_latency_us": in_us(round_trip, 0.5),
        // On the wire only, as the messages' own times tell it.
        "wire_round_trip_us": in_us(after.round_trip, 1.0),
        "real_time_scheduling": is_real_time,
        "load_average": load_average(),
    }))
}

/// To a tenth of a microsecond.
fn in_us(p: Percentiles, share: f64) -> Value {
    let us = |ns: u64| (ns as f64 * share / 100.0).round() / 10.0;
    json!({ "p50": us(p.p50_ns), "p99": us(p.p99_ns), "p999": us(p.p999_ns), "greatest": us(p.greatest_ns) })
}

/// How many programs want a core: a busy machine wakes threads late.
fn load_average() -> Option<f64> {
    std::fs::read_to_string("/proc/loadavg").ok()?.split(' ').next()?.parse().ok()
}

type Ends = (Publisher<Motion>, Latest<PublishedModel>);

/// Times from a move to its answer; one that a later move overtook is not counted.
fn time_answers(
    seconds: f64,
    rate_hz: f64,
    conversation: &Conversation,
    (mut motions, mut models): Ends,
) -> anyhow::Result<(Percentiles, Ends)> {
    let times = Histogram::default();
    models.wakes(std::thread::current());
    let period = Duration::from_secs_f64(1.0 / rate_hz);
    let n_moves = (seconds * rate_hz) as usize;
    let mut sent_ns = vec![0; n_moves + 1];
    // Numbers go on from those of the last round.
    let first = models.get().model.step;
    let (mut number, mut deadline) = (0, Instant::now());
    let end = Instant::now() + Duration::from_secs_f64(seconds) + Duration::from_millis(200);
    while Instant::now() < end {
        if let Some(answer) = models.get_new()
            && let Some(index) = answer.model.step.checked_sub(first)
            && let Some(&sent) = sent_ns.get(index as usize)
            && sent > 0
        {
            times.record(now_ns() - sent);
            // The same answer comes again when nothing new does.
            sent_ns[index as usize] = 0;
        }
        let now = Instant::now();
        if now >= deadline && number < n_moves {
            number += 1;
            deadline = (deadline + period).max(now);
            sent_ns[number] = now_ns();
            motions.publish(move_number(first + number as u64));
        }
        let next = if number < n_moves { deadline } else { end };
        std::thread::park_timeout(next.saturating_duration_since(Instant::now()));
    }
    let answered = times.percentiles();
    ensure!(answered.n > 0, "no move was answered: {}", conversation.report().to_text());
    Ok((answered, (motions, models)))
}

/// For people.
fn to_text(answer: &Value) -> String {
    let of = |name: &str| {
        let p = &answer[name];
        format!(
            "p50 {} us, p99 {} us, p99.9 {} us, greatest {} us",
            p["p50"], p["p99"], p["p999"], p["greatest"]
        )
    };
    format!(
        "{}: {} of {} moves answered\nround trip     {}\nadded, one way {}\non the wire    {}\n",
        answer["link"].as_str().unwrap_or_default(),
        answer["n_answers"],
        answer["n_moves"],
        of("round_trip_us"),
        of("added_latency_us"),
        of("wire_round_trip_us"),
    )
}
