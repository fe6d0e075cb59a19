//! The haptic loop: reads the devices, evaluates the latest models and pushes, a thousand times a second. It waits for
//! nobody; in a tick nothing is allocated, locked or logged.

use crate::elsewhere::Nearby;
use crate::exchange::{Latest, Publisher, exchange};
use crate::force_choices::ForceChoices;
use crate::histogram::{GreatestValue, Histogram, Percentiles};
use crate::open_device::OpenDevice;
use crate::page_hand::PageHand;
use crate::realtime::{OwnCore, Scheduling, make_punctual, now_ns, wait_until};
use anyhow::{Context, ensure};
use glisson::haptics::{
    DeviceFault, DeviceState, ForceCommand, HapticLaw, HapticModel, InsertedInstrument, LawSettings, LawTick,
    TickReport,
};
use glisson::tool::ToolInput;
use glisson::tool::external_detection::ExternalDetection;
use std::borrow::Cow;
use std::ops::RangeInclusive;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};
use std::thread::JoinHandle;

/// Ticks a second that may be asked for.
pub(crate) const RATES_HZ: RangeInclusive<f64> = 100.0..=4_000.0;
/// A deadline counts as missed when its tick begins later than so many periods after it.
const MISSED_PERIODS: u64 = 2;
/// What happens in the first moments (page faults, cold caches) is not counted [s].
pub const WARM_UP_S: f64 = 0.2;
/// 2^10 ns: the octave that is nearest to a microsecond ends there.
const MICROSECOND_NS: u64 = 1 << 10;
/// Longest interval between two ticks that the law is told [s]: what lies beyond is a standstill, not a tick.
const LONGEST_TICK_S: f64 = 0.1;

/// How the loop runs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HapticSettings {
    /// Ticks a second.
    pub rate_hz: f64,
    /// Core to stay on.
    pub core: OwnCore,
    /// How forces are made.
    pub forces: ForceChoices,
}

impl Default for HapticSettings {
    fn default() -> Self {
        Self { rate_hz: 1_000.0, core: OwnCore::Last, forces: ForceChoices::default() }
    }
}

/// A model and when the simulation made it, on the clock of [`now_ns`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PublishedModel {
    /// What the loop evaluates.
    pub model: HapticModel,
    /// 0: none was made yet.
    pub made_ns: u64,
}

/// Where a device has its instrument.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Where the instrument is.
    pub pose: ToolInput,
    /// Whether the device holds it now; otherwise it stays where it was.
    pub is_held: bool,
    /// What was found on the way there, if somebody else than the simulation looked.
    pub detected: Option<ExternalDetection>,
}

impl Motion {
    /// Of an instrument for which the simulation looks where it touches.
    pub fn of(pose: ToolInput, is_held: bool) -> Self {
        Self { pose, is_held, detected: None }
    }
}

/// Whether a device answers.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum DeviceStatus {
    /// Nothing was heard yet.
    Waiting,
    /// It answers.
    Works,
    /// With an instrument that was put into it.
    WorksWith(InsertedInstrument),
    /// It may come back.
    Lost(Cow<'static, str>),
    /// It will not.
    Failed(Cow<'static, str>),
}

/// The haptic loop's end of an instrument.
pub struct HeldTool {
    device: OpenDevice,
    home: ToolInput,
    settings: HapticSettings,
    /// None until the device has said where it is.
    law: Option<HapticLaw>,
    /// Whether the loop is about to end.
    lets_go: bool,
    models: Latest<PublishedModel>,
    motions: Publisher<Motion>,
    statuses: Publisher<DeviceStatus>,
    status: DeviceStatus,
    /// Whether the hand is a viewer's page.
    is_page: bool,
}

/// The simulation's end of an instrument.
pub struct ToolLink {
    /// Number of the instrument.
    pub tool: usize,
    /// What the user calls the device.
    pub device_name: String,
    /// To the loop: the newest models.
    pub models: Publisher<PublishedModel>,
    /// From the loop: where the hand has the instrument.
    pub motions: Latest<Motion>,
    /// From the loop: whether the device answers.
    pub statuses: Latest<DeviceStatus>,
    /// For a machine that looks where it touches: what it has to be told of the surface.
    pub nearby: Option<Publisher<Nearby>>,
}

/// Puts instrument `tool`, whose home is `home`, into the hand at `device`.
pub fn join(device: OpenDevice, tool: usize, home: ToolInput) -> (HeldTool, ToolLink) {
    let (models_in, models) = exchange(PublishedModel::default());
    let (motions, motions_out) = exchange(Motion::of(home, false));
    let (statuses, statuses_out) = exchange(DeviceStatus::Waiting);
    let device_name = device.name.clone();
    let status = DeviceStatus::Waiting;
    let settings = HapticSettings::default();
    let is_page = device.page.is_some();
    let held = HeldTool {
        device,
        home,
        settings,
        law: None,
        lets_go: false,
        models,
        motions,
        statuses,
        status,
        is_page,
    };
    let link = ToolLink {
        tool,
        device_name,
        models: models_in,
        motions: motions_out,
        statuses: statuses_out,
        nearby: None,
    };
    (held, link)
}

impl HeldTool {
    /// The server's end of a page that holds the instrument; once.
    pub fn take_page(&mut self) -> Option<PageHand> {
        self.device.page.take()
    }

    fn tick(&mut self, dt_s: f64, meters: Option<&Meters>) {
        // A device that answers for the first time now is not begun with.
        let is_too_late = self.lets_go && self.law.is_none();
        if is_too_late || matches!(self.status, DeviceStatus::Failed(_)) {
            return;
        }
        let read_ns = now_ns();
        let state = self.device.device.read().and_then(|state| {
            let fault = || DeviceFault::Lost("it sends numbers that are not finite".into());
            is_finite(&state).then_some(state).ok_or_else(fault)
        });
        let published = self.models.get();
        let answer = match state {
            Ok(state) => {
                // Until there is a model the instrument is in free space.
                let age_ns =
                    if published.made_ns == 0 { 0 } else { read_ns.saturating_sub(published.made_ns) };
                let law = self.law.get_or_insert_with(|| {
                    let mapping = self.device.mapping(state.position_m, &self.home);
                    let HapticSettings { rate_hz, forces, .. } = self.settings;
                    let period_s = 1.0 / rate_hz;
                    let settings =
                        forces.into_settings(LawSettings { mapping, period_s, ..LawSettings::default() });
                    HapticLaw::new(&settings, &self.device.device.limits())
                });
                let LawTick { command, tool, report } =
                    law.tick(&state, &published.model, age_ns as f64 * 1e-9, dt_s);
                self.motions.publish(Motion::of(tool, true));
                let written = self.device.device.write(&command);
                if written.is_err() {
                    law.not_taken();
                }
                if let Some(meters) = meters {
                    if published.made_ns > 0 {
                        meters.model_age.record(age_ns);
                    }
                    meters.motion_to_force.record(now_ns().saturating_sub(read_ns));
                    Meters::add(&meters.n_saturated, u64::from(report.is_saturated));
                    Meters::add(&meters.n_stale, u64::from(report.is_stale));
                    meters.felt.look(&report, command.force_n.length());
                    meters.most_given_j.raise_to(-report.observed_energy_j);
                }
                written
            }
            Err(fault) => {
                if let Some(law) = &mut self.law {
                    let LawTick { command, tool, .. } = law.lost(dt_s);
                    self.motions.publish(Motion::of(tool, false));
                    // It may still listen; if not, it goes to zero by itself.
                    if self.device.device.write(&command).is_err() {
                        law.not_taken();
                    }
                }
                Err(fault)
            }
        };
        self.tell(answer);
    }

    /// Begins to take its force back.
    fn let_go(&mut self) {
        self.lets_go = true;
        if let Some(law) = &mut self.law {
            law.let_go();
        }
    }

    /// Whether there is no force left to take back.
    fn has_let_go(&self) -> bool {
        matches!(self.status, DeviceStatus::Failed(_)) || self.law.as_ref().is_none_or(HapticLaw::has_let_go)
    }

    /// Says how the device is when that changed.
    fn tell(&mut self, answer: Result<(), DeviceFault>) {
        let status = match answer {
            Ok(()) => self.device.device.inserted().map_or(DeviceStatus::Works, DeviceStatus::WorksWith),
            Err(DeviceFault::Lost(reason)) => DeviceStatus::Lost(reason),
            Err(DeviceFault::Failed(reason)) => DeviceStatus::Failed(reason),
        };
        if status != self.status {
            self.status = status.clone();
            // A page knows whether it has control, and when it comes back nothing was broken.
            if !self.is_page {
                self.statuses.publish(status);
            }
        }
    }
}

fn is_finite(state: &DeviceState) -> bool {
    state.position_m.is_finite()
        && state.velocity_m_per_s.is_finite()
        && state.orientation.is_none_or(glam::DQuat::is_finite)
        && state.jaw_opening.is_finite()
}

/// What the loop measures about itself; any thread may look.
#[derive(Debug, Default)]
pub struct Meters {
    n_deadlines: AtomicU64,
    n_missed: AtomicU64,
    n_ticks: AtomicU64,
    n_saturated: AtomicU64,
    n_stale: AtomicU64,
    counted_ns: AtomicU64,
    jitter: Histogram,
    motion_to_force: Histogram,
    model_age: Histogram,
    work: Histogram,
    /// What hands got beyond what they put in.
    most_given_j: GreatestValue,
    felt: FeltMeters,
    scheduling: OnceLock<Scheduling>,
    settings: OnceLock<HapticSettings>,
}

/// What hands felt, and that nothing is felt while the simulation does not answer.
#[derive(Debug, Default)]
struct FeltMeters {
    /// Of all ticks, of those at which the force was withdrawn because the model was old, and of those after such a time at
    /// which all of it was given again.
    all_n: GreatestValue,
    taken_back_n: GreatestValue,
    given_again_n: GreatestValue,
    n_taken_back: AtomicU64,
    /// Ticks at which a part of the force was given: of the ramps.
    n_on_ramps: AtomicU64,
}

impl FeltMeters {
    fn look(&self, report: &TickReport, force_n: f64) {
        self.all_n.raise_to(force_n);
        if report.gate_share > 0.0 && report.gate_share < 1.0 {
            Meters::add(&self.n_on_ramps, 1);
        } else if report.gate_share <= 0.0 && report.is_stale {
            Meters::add(&self.n_taken_back, 1);
            self.taken_back_n.raise_to(force_n);
        } else if report.gate_share >= 1.0 && self.n_taken_back.load(Ordering::Relaxed) > 0 {
            self.given_again_n.raise_to(force_n);
        }
    }

    fn report(&self) -> FeltForces {
        FeltForces {
            greatest_n: self.all_n.get(),
            greatest_taken_back_n: self.taken_back_n.get(),
            greatest_given_again_n: self.given_again_n.get(),
            n_taken_back: self.n_taken_back.load(Ordering::Relaxed),
            n_on_ramps: self.n_on_ramps.load(Ordering::Relaxed),
        }
    }
}

/// What hands felt.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FeltForces {
    /// The greatest force [N].
    pub(crate) greatest_n: f64,
    /// The same of the ticks at which all of it was withdrawn because the model was old, and how many these were.
    pub(crate) greatest_taken_back_n: f64,
    pub(crate) n_taken_back: u64,
    /// The same of the ticks at which all of it was given, after such a time.
    pub(crate) greatest_given_again_n: f64,
    /// Ticks at which a part of it was given.
    pub(crate) n_on_ramps: u64,
}

/// How the loop did so far.
#[derive(Clone, Debug, PartialEq)]
pub struct HapticReport {
    /// Ticks a second, measured.
    pub rate_hz: f64,
    /// Deadlines since the loop was warm.
    pub n_deadlines: u64,
    /// Deadlines whose tick began more than two periods late.
    pub n_missed: u64,
    /// Ticks at which more than the device's largest force was wanted.
    pub n_saturated: u64,
    /// Ticks at which the model was so old that the force was withdrawn.
    pub n_stale: u64,
    /// Interval between two ticks less the period, without its sign.
    pub jitter: Percentiles,
    /// Ends of octaves [ns] and how many intervals lie in each.
    pub jitter_octaves: Vec<(u64, u64)>,
    /// From reading a handle to the end of writing its force.
    pub motion_to_force: Percentiles,
    /// Age of the model when it is evaluated.
    pub model_age: Percentiles,
    /// Time that a tick of all devices takes.
    pub work: Percentiles,
    /// The most that hands ever got from a device beyond what they put in, as a negative number [J].
    pub least_energy_j: f64,
    /// How the loop's thread is scheduled; none before it started.
    pub scheduling: Option<Scheduling>,
    /// How the loop was to run; the default before it started.
    pub settings: HapticSettings,
}

impl FeltForces {
    /// For programs.
    pub fn to_json(self) -> serde_json::Value {
        serde_json::json!({
            "greatest_force_n": self.greatest_n,
            "taken_back_ticks": self.n_taken_back,
            "greatest_force_taken_back_n": self.greatest_taken_back_n,
            "greatest_force_given_again_n": self.greatest_given_again_n,
            "ramp_ticks": self.n_on_ramps,
        })
    }
}

impl Meters {
    /// What hands felt since the loop was warm.
    pub fn felt(&self) -> FeltForces {
        self.felt.report()
    }

    fn add(counter: &AtomicU64, n: u64) {
        // One thread writes.
        counter.store(counter.load(Ordering::Relaxed) + n, Ordering::Relaxed);
    }

    /// How the loop did so far.
    pub fn report(&self) -> HapticReport {
        let of = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        let counted_s = of(&self.counted_ns) as f64 * 1e-9;
        HapticReport {
            rate_hz: if counted_s > 0.0 { of(&self.n_ticks) as f64 / counted_s } else { 0.0 },
            n_deadlines: of(&self.n_deadlines),
            n_missed: of(&self.n_missed),
            n_saturated: of(&self.n_saturated),
            n_stale: of(&self.n_stale),
            jitter: self.jitter.percentiles(),
            jitter_octaves: self.jitter.octaves(),
            motion_to_force: self.motion_to_force.percentiles(),
            model_age: self.model_age.percentiles(),
            work: self.work.percentiles(),
            least_energy_j: -self.most_given_j.get(),
            scheduling: self.scheduling.get().cloned(),
            settings: self.settings.get().copied().unwrap_or_default(),
        }
    }
}

impl HapticReport {
    /// Missed deadlines of all, in percent.
    pub fn missed_percent(&self) -> f64 {
        100.0 * self.n_missed as f64 / self.n_deadlines.max(1) as f64
    }

    /// Time from one deadline to the next [ns].
    fn period_ns(&self) -> f64 {
        1e9 / self.settings.rate_hz
    }

    /// A few lines for people.
    pub fn to_text(&self) -> String {
        let us = |p: &Percentiles| {
            let us = |ns: u64| format!("{:.1}", ns as f64 * 1e-3);
            format!("{} us (99 %: {}, 99.9 %: {})", us(p.p50_ns), us(p.p99_ns), us(p.p999_ns))
        };
        let line = |what: &str, text: String| format!("\n  {what:16}{text}");
        let mut text = format!(
            "haptics          {:.1} Hz; {} of {} deadlines missed ({:.3} %); {}",
            self.rate_hz,
            self.n_missed,
            self.n_deadlines,
            self.missed_percent(),
            self.scheduling.as_ref().map_or("not started", |s| s.text.as_str()),
        );
        let used = 100.0 * self.work.p999_ns as f64 / self.period_ns();
        let period_us = self.period_ns() * 1e-3;
        text +=
            &line("a tick", format!("{}; 99.9 % within {used:.1} % of {period_us:.0} us", us(&self.work)));
        text += &line("jitter", us(&self.jitter));
        text += &line("", self.jitter_text());
        text += &line("motion to force", us(&self.motion_to_force));
        text += &line(
            "model",
            format!(
                "{:.1} ms old (99.9 %: {:.1})",
                self.model_age.p50_ns as f64 * 1e-6,
                self.model_age.p999_ns as f64 * 1e-6
            ),
        );
        text += &line(
            "forces",
            format!(
                "{}; limited in {} ticks, undone in {} because the model was old; a hand never got more than {:.2} mJ",
                self.settings.forces.text(),
                self.n_saturated,
                self.n_stale,
                // Not -0.
                0.0 - self.least_energy_j * 1e3
            ),
        );
        text
    }

    /// How many intervals are off by how much: `below 1 us 95.12 %, 2 us 4.1 % ...`.
    fn jitter_text(&self) -> String {
        let n: u64 = self.jitter_octaves.iter().map(|(_, n)| n).sum();
        if n == 0 {
            return "nothing counted yet".into();
        }
        let share = |(end_ns, count): (u64, u64)| {
            let end_us = end_ns as f64 * 1e-3;
            let digits = usize::from(end_us < 10.0);
            format!("{end_us:.digits$} us {:.3} %", 100.0 * count as f64 / n as f64)
        };
        // What is below a microsecond is one.
        let (small, large): (Vec<_>, Vec<_>) =
            self.jitter_octaves.iter().partition(|(end_ns, _)| *end_ns <= MICROSECOND_NS);
        let small = (MICROSECOND_NS, small.iter().map(|(_, n)| n).sum());
        let octaves = std::iter::once(small).chain(large);
        let shares: Vec<String> = octaves.filter(|(_, n)| *n > 0).map(share).collect();
        format!("below {}", shares.join(", "))
    }

    /// The fields of `glisson bench haptics` and of the viewer's `timing` message.
    pub fn to_json(&self) -> serde_json::Value {
        let scheduling = self.scheduling.as_ref();
        let octaves: Vec<(f64, u64)> =
            self.jitter_octaves.iter().map(|&(end_ns, n)| (end_ns as f64 * 1e-3, n)).collect();
        serde_json::json!({
            "rate_hz": (self.rate_hz * 100.0).round() / 100.0,
            "deadlines": self.n_deadlines,
            "missed_deadlines": self.n_missed,
            "missed_percent": self.missed_percent(),
            "saturated_ticks": self.n_saturated,
            "stale_ticks": self.n_stale,
            "jitter_us": self.jitter.to_json(1e3),
            "jitter_histogram_us": octaves,
            "motion_to_force_us": self.motion_to_force.to_json(1e3),
            "local_model_age_ms": self.model_age.to_json(1e6),
            "tick_us": self.work.to_json(1e3),
            "period_us": self.period_ns() * 1e-3,
            "force_estimate": self.settings.forces.estimate.name(),
            "energy_control": self.settings.forces.is_controlled(),
            "least_energy_mj": self.least_energy_j * 1e3,
            "real_time_scheduling": scheduling.is_some_and(|s| s.is_real_time),
            "scheduling": scheduling.map_or("not started", |s| s.text.as_str()),
        })
    }
}

/// Deadlines that a tick `late_ns` after one of them serves at once, and how many of these are missed.
fn served_and_missed(late_ns: u64, period_ns: u64) -> (u64, u64) {
    let served = late_ns / period_ns + 1;
    // The j-th next one is late_ns - j period_ns late.
    let missed = late_ns.div_ceil(period_ns).saturating_sub(MISSED_PERIODS);
    (served, missed.min(served))
}

/// Refuses a rate that no loop keeps.
///
/// # Errors
/// Outside [`RATES_HZ`].
pub fn check_rate(rate_hz: f64) -> anyhow::Result<()> {
    let (least, most) = (RATES_HZ.start(), RATES_HZ.end());
    ensure!(RATES_HZ.contains(&rate_hz), "a haptic rate of {rate_hz} Hz; allowed: {least} to {most} Hz");
    Ok(())
}

/// A running loop; ends when dropped.
pub struct HapticLoop {
    stop: Arc<AtomicBool>,
    meters: Arc<Meters>,
    thread: Option<JoinHandle<()>>,
}

impl HapticLoop {
    /// Starts it; it adds what it measures to `meters`, which no other loop may fill at the same time.
    ///
    /// # Errors
    /// For a rate outside [`RATES_HZ`], or when no thread can be started.
    pub fn start(
        tools: Vec<HeldTool>,
        settings: HapticSettings,
        meters: Arc<Meters>,
    ) -> anyhow::Result<Self> {
        check_rate(settings.rate_hz)?;
        let tools: Vec<HeldTool> = tools.into_iter().map(|tool| HeldTool { settings, ..tool }).collect();
        let stop = Arc::new(AtomicBool::new(false));
        let (stop_seen, own_meters) = (Arc::clone(&stop), Arc::clone(&meters));
        let thread = std::thread::Builder::new()
            .name("haptics".into())
            .spawn(move || {
                // An earlier loop may have set it to the same.
                let _ = own_meters.scheduling.set(make_punctual(settings.core));
                let _ = own_meters.settings.set(settings);
                run(tools, settings.rate_hz, &own_meters, &stop_seen);
            })
            .context("starting the haptic loop")?;
        Ok(Self { stop, meters, thread: Some(thread) })
    }

    /// What the loop measures about itself.
    pub fn meters(&self) -> &Arc<Meters> {
        &self.meters
    }
}

impl Drop for HapticLoop {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // A panic of the loop was printed when it happened.
            let _ = thread.join();
        }
    }
}

fn run(mut tools: Vec<HeldTool>, rate_hz: f64, meters: &Meters, stop: &AtomicBool) {
    let period_ns = (1e9 / rate_hz).round() as u64;
    let n_warm_up = (WARM_UP_S * rate_hz) as u64;
    let mut last_ns = now_ns();
    let mut deadline_ns = last_ns + period_ns;
    let mut n_ticks = 0_u64;
    // Ticks left to take forces back in, once the loop is to stop.
    let mut n_left = None;
    loop {
        if n_left.is_none() && stop.load(Ordering::Relaxed) {
            tools.iter_mut().for_each(HeldTool::let_go);
            let ramps_s = tools.iter().filter_map(|tool| tool.law.as_ref()).map(HapticLaw::ramp_s);
            // One for the last write, one for rounding.
            n_left = Some((ramps_s.fold(0.0, f64::max) * rate_hz).ceil() as u64 + 2);
        }
        if let Some(n) = &mut n_left {
            if *n == 0 || tools.iter().all(HeldTool::has_let_go) {
                break;
            }
            *n -= 1;
        }
        wait_until(deadline_ns);
        let begun_ns = now_ns();
        let (n_served, n_missed) = served_and_missed(begun_ns - deadline_ns, period_ns);
        let interval_ns = begun_ns - last_ns;
        let counts = n_ticks >= n_warm_up && n_left.is_none();
        let dt_s = (interval_ns as f64 * 1e-9).min(LONGEST_TICK_S);
        for tool in &mut tools {
            tool.tick(dt_s, counts.then_some(meters));
        }
        if counts {
            meters.work.record(now_ns() - begun_ns);
            meters.jitter.record(interval_ns.abs_diff(period_ns));
            Meters::add(&meters.n_deadlines, n_served);
            Meters::add(&meters.n_missed, n_missed);
            Meters::add(&meters.n_ticks, 1);
            Meters::add(&meters.counted_ns, interval_ns);
        }
        n_ticks += 1;
        last_ns = begun_ns;
        deadline_ns += n_served * period_ns;
    }
    for tool in &mut tools {
        // A device that does not answer any more goes to zero by itself.
        let _ = tool.device.device.write(&ForceCommand::default());
    }
}

#[cfg(test)]
#[path = "haptic_loop_tests.rs"]
mod tests;
