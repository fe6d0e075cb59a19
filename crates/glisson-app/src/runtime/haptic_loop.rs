//! The haptic loop: reads the devices, evaluates the latest models and pushes, a thousand times a second. It waits for
//! nobody; in a tick nothing is allocated, locked or logged.

use super::elsewhere::Nearby;
use super::exchange::{Latest, Publisher, exchange};
use super::force_choices::ForceChoices;
use super::histogram::{Histogram, Percentiles};
use super::realtime::{Scheduling, make_punctual, now_ns, wait_until};
use crate::devices::OpenDevice;
use crate::devices::viewer::PageHand;
use anyhow::{Context, ensure};
use glisson::haptics::{
    DeviceFault, DeviceState, ForceCommand, HapticLaw, HapticModel, InsertedInstrument, LawSettings, LawTick,
};
use glisson::tool::ToolInput;
use glisson::tool::found::Detected;
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
const WARM_UP_S: f64 = 0.2;
/// 2^10 ns: the octave that is nearest to a microsecond ends there.
const MICROSECOND_NS: u64 = 1 << 10;
/// Longest interval between two ticks that the law is told [s]: what lies beyond is a standstill, not a tick.
const LONGEST_TICK_S: f64 = 0.1;

/// How the loop runs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct HapticSettings {
    /// Ticks a second.
    pub(crate) rate_hz: f64,
    /// Core to stay on; the last one that is allowed for none.
    pub(crate) core: Option<usize>,
    /// How forces are made.
    pub(crate) forces: ForceChoices,
}

impl Default for HapticSettings {
    fn default() -> Self {
        Self { rate_hz: 1_000.0, core: None, forces: ForceChoices::default() }
    }
}

/// A model and when the simulation made it, on the clock of [`now_ns`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct PublishedModel {
    pub(crate) model: HapticModel,
    /// 0: none was made yet.
    pub(crate) made_ns: u64,
}

/// Where a device has its instrument.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Motion {
    pub(crate) pose: ToolInput,
    /// Whether the device holds it now; otherwise it stays where it was.
    pub(crate) is_held: bool,
    /// What was found on the way there, if somebody else than the simulation looked.
    pub(crate) detected: Option<Detected>,
}

impl Motion {
    /// Of an instrument for which the simulation looks where it touches.
    pub(crate) fn of(pose: ToolInput, is_held: bool) -> Self {
        Self { pose, is_held, detected: None }
    }
}

/// Whether a device answers.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum DeviceStatus {
    /// Nothing was heard yet.
    Waiting,
    Works,
    /// With an instrument that was put into it.
    WorksWith(InsertedInstrument),
    /// It may come back.
    Lost(Cow<'static, str>),
    /// It will not.
    Failed(Cow<'static, str>),
}

/// The haptic loop's end of an instrument.
pub(crate) struct HeldTool {
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
pub(crate) struct ToolLink {
    /// Number of the instrument.
    pub(crate) tool: usize,
    /// What the user calls the device.
    pub(crate) device_name: String,
    pub(crate) models: Publisher<PublishedModel>,
    pub(crate) motions: Latest<Motion>,
    pub(crate) statuses: Latest<DeviceStatus>,
    /// For a machine that looks where it touches: what it has to be told of the surface.
    pub(crate) nearby: Option<Publisher<Nearby>>,
}

/// Puts instrument `tool`, whose home is `home`, into the hand at `device`.
pub(crate) fn join(device: OpenDevice, tool: usize, home: ToolInput) -> (HeldTool, ToolLink) {
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
    pub(crate) fn take_page(&mut self) -> Option<PageHand> {
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
                let pose = if self.device.tells_orientation {
                    tool
                } else {
                    let ToolInput { shaft_in_world, roll_rad, .. } = self.home;
                    ToolInput { shaft_in_world, roll_rad, ..tool }
                };
                self.motions.publish(Motion::of(pose, true));
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
                    meters.least_energy_j.lower_to(report.observed_energy_j);
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
        && state.orientation.is_finite()
        && state.jaw_opening.is_finite()
}

/// What the loop measures about itself; any thread may look.
#[derive(Debug, Default)]
pub(crate) struct Meters {
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
    least_energy_j: LeastValue,
    scheduling: OnceLock<Scheduling>,
    settings: OnceLock<HapticSettings>,
}

/// The least of values that are at most 0; one thread lowers it.
#[derive(Debug, Default)]
struct LeastValue(AtomicU64);

impl LeastValue {
    fn get(&self) -> f64 {
        f64::from_bits(self.0.load(Ordering::Relaxed))
    }

    fn lower_to(&self, value: f64) {
        if value < self.get() {
            self.0.store(value.to_bits(), Ordering::Relaxed);
        }
    }
}

/// How the loop did so far.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct HapticReport {
    /// Ticks a second, measured.
    pub(crate) rate_hz: f64,
    pub(crate) n_deadlines: u64,
    /// Deadlines whose tick began more than two periods late.
    pub(crate) n_missed: u64,
    /// Ticks at which more than the device's largest force was wanted.
    pub(crate) n_saturated: u64,
    /// Ticks at which the model was so old that the force was taken back.
    pub(crate) n_stale: u64,
    /// Interval between two ticks less the period, without its sign.
    pub(crate) jitter: Percentiles,
    /// Ends of octaves [ns] and how many intervals lie in each.
    pub(crate) jitter_octaves: Vec<(u64, u64)>,
    /// From reading a handle to the end of writing its force.
    pub(crate) motion_to_force: Percentiles,
    /// Age of the model when it is evaluated.
    pub(crate) model_age: Percentiles,
    /// Time that a tick of all devices takes.
    pub(crate) work: Percentiles,
    /// The most that hands ever got from a device beyond what they put in, as a negative number [J].
    pub(crate) least_energy_j: f64,
    pub(crate) scheduling: Option<Scheduling>,
    /// How the loop was to run; the default before it started.
    pub(crate) settings: HapticSettings,
}

impl Meters {
    fn add(counter: &AtomicU64, n: u64) {
        // One thread writes.
        counter.store(counter.load(Ordering::Relaxed) + n, Ordering::Relaxed);
    }

    pub(crate) fn report(&self) -> HapticReport {
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
            least_energy_j: self.least_energy_j.get(),
            scheduling: self.scheduling.get().cloned(),
            settings: self.settings.get().copied().unwrap_or_default(),
        }
    }
}

impl HapticReport {
    /// Missed deadlines of all, in percent.
    pub(crate) fn missed_percent(&self) -> f64 {
        100.0 * self.n_missed as f64 / self.n_deadlines.max(1) as f64
    }

    /// Time from one deadline to the next [ns].
    fn period_ns(&self) -> f64 {
        1e9 / self.settings.rate_hz
    }

    /// A few lines for people.
    pub(crate) fn to_text(&self) -> String {
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
                "{}; limited in {} ticks, taken back in {} because the model was old; a hand never got more than {:.2} mJ",
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
    pub(crate) fn to_json(&self) -> serde_json::Value {
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
pub(crate) fn check_rate(rate_hz: f64) -> anyhow::Result<()> {
    let (least, most) = (RATES_HZ.start(), RATES_HZ.end());
    ensure!(RATES_HZ.contains(&rate_hz), "a haptic rate of {rate_hz} Hz; allowed: {least} to {most} Hz");
    Ok(())
}

/// A running loop; ends when dropped.
pub(crate) struct HapticLoop {
    stop: Arc<AtomicBool>,
    meters: Arc<Meters>,
    thread: Option<JoinHandle<()>>,
}

impl HapticLoop {
    /// Starts it; it adds what it measures to `meters`, which no other loop may fill at the same time.
    ///
    /// # Errors
    /// For a rate outside [`RATES_HZ`], or when no thread can be started.
    pub(crate) fn start(
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

    pub(crate) fn meters(&self) -> &Arc<Meters> {
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
mod tests {
    use super::*;
    use glisson::haptics::{DeviceLimits, HapticDevice, Touch};
    use glisson::math::{DMat3, DVec3};
    use std::sync::Mutex;

    /// Moves 10 um a tick along x; notes what it is told; faults at some ticks.
    struct Scripted {
        n_reads: u64,
        faults: fn(u64) -> Option<DeviceFault>,
        forces: Arc<Mutex<Vec<DVec3>>>,
    }

    impl HapticDevice for Scripted {
        fn limits(&self) -> DeviceLimits {
            DeviceLimits {
                force_n: 10.0,
                torque_n_m: 0.0,
                force_rate_n_per_s: 1e9,
                stiffness_n_per_m: 1e4,
                damping_n_s_per_m: 10.0,
                resolution_m: 1e-6,
                rate_hz: 1_000.0,
                ..DeviceLimits::NONE
            }
        }

        fn read(&mut self) -> Result<DeviceState, DeviceFault> {
            self.n_reads += 1;
            if let Some(fault) = (self.faults)(self.n_reads) {
                return Err(fault);
            }
            let not_finite = if self.n_reads == 7 { f64::NAN } else { 0.0 };
            Ok(DeviceState {
                position_m: DVec3::new(1e-5 * self.n_reads as f64, not_finite, 0.0),
                velocity_m_per_s: DVec3::X * 1e-2,
                orientation: glam::DQuat::IDENTITY,
                jaw_opening: 0.0,
                buttons: 0,
            })
        }

        fn write(&mut self, command: &ForceCommand) -> Result<(), DeviceFault> {
            // A test's lock, with room made before.
            let mut forces = self.forces.lock().unwrap();
            if forces.len() < forces.capacity() {
                forces.push(command.force_n);
            }
            Ok(())
        }
    }

    fn scripted(faults: fn(u64) -> Option<DeviceFault>) -> (HeldTool, ToolLink, Arc<Mutex<Vec<DVec3>>>) {
        let forces = Arc::new(Mutex::new(Vec::with_capacity(100_000)));
        let device = Scripted { n_reads: 0, faults, forces: Arc::clone(&forces) };
        let home = ToolInput::at(DVec3::Y, DVec3::Z);
        let device = OpenDevice {
            device: Box::new(device),
            name: "scripted".into(),
            world_from_device: glam::DQuat::IDENTITY,
            tells_orientation: false,
            has_clutch: false,
            stands: None,
            page: None,
        };
        let (held, link) = join(device, 0, home);
        (held, link, forces)
    }

    #[test]
    fn late_ticks_serve_and_miss_as_many_deadlines_as_passed() {
        let of = |late: u64| served_and_missed(late, 100);
        assert_eq!([0, 99, 100, 200].map(of), [(1, 0), (1, 0), (2, 0), (3, 0)]);
        // 250 late: the deadlines before it are 250, 150 and 50 late.
        assert_eq!([201, 250, 300, 301, 3_000].map(of), [(3, 1), (3, 1), (4, 1), (4, 2), (31, 28)]);
    }

    #[test]
    fn motion_goes_to_the_simulation_and_the_force_of_its_model_to_the_device() {
        let (mut held, mut link, forces) = scripted(|n| (n == 7).then(|| DeviceFault::Lost("away".into())));
        held.tick(1e-3, None);
        let motion = link.motions.get();
        assert_eq!((motion.is_held, motion.pose), (true, ToolInput::at(DVec3::Y, DVec3::Z)));
        let model = HapticModel {
            touch: Touch::Grasp,
            tip_m: DVec3::Y,
            stiffness_n_per_m: DMat3::from_diagonal(DVec3::splat(300.0)),
            hold_n: f64::INFINITY,
            ..HapticModel::default()
        };
        for _ in 0..300 {
            link.models.publish(PublishedModel { model, made_ns: now_ns() });
            held.tick(1e-3, None);
        }
        let motion = link.motions.get();
        assert!(motion.is_held && motion.pose.tip_in_world_m.x > 1e-3, "{motion:?}");
        assert_eq!(motion.pose.shaft_in_world, DVec3::Z);
        let forces = forces.lock().unwrap();
        // Held at its first place, it pulls back.
        assert!(forces[0] == DVec3::ZERO && forces[forces.len() - 1].x < -0.1, "{:?}", forces.last());
        assert_eq!(link.statuses.get_new(), Some(DeviceStatus::Works));
    }

    #[test]
    fn a_lost_device_leaves_its_tool_and_one_that_failed_is_left_alone() {
        let (mut held, mut link, forces) = scripted(|n| match n {
            3..5 => Some(DeviceFault::Lost("unplugged".into())),
            10 => Some(DeviceFault::Failed("broken".into())),
            _ => None,
        });
        let mut seen = Vec::new();
        for _ in 0..14 {
            held.tick(1e-3, None);
            seen.extend(link.statuses.get_new());
            assert!(link.motions.get().pose.is_finite());
        }
        let lost = |text: &'static str| DeviceStatus::Lost(text.into());
        let expected = [
            DeviceStatus::Works,
            lost("unplugged"),
            DeviceStatus::Works,
            lost("it sends numbers that are not finite"),
            DeviceStatus::Works,
            DeviceStatus::Failed("broken".into()),
        ];
        assert_eq!(seen, expected);
        assert!(!link.motions.get().is_held);
        // Also while it was lost it was told what to do; after the end it was left alone.
        assert_eq!(forces.lock().unwrap().len(), 10);
    }

    #[test]
    fn ticks_allocate_nothing_also_while_a_device_is_lost() {
        let (mut held, mut link, _forces) =
            scripted(|n| (n >= 50).then(|| DeviceFault::Lost("unplugged".into())));
        let meters = Meters::default();
        let counted = allocation_counter::measure(|| {
            for _ in 0..100 {
                link.models.publish(PublishedModel::default());
                held.tick(1e-3, Some(&meters));
            }
        });
        assert_eq!(counted.count_total, 0);
        // Of 49 answers the seventh is no number.
        assert_eq!(meters.report().motion_to_force.n, 48);
    }

    /// As fast as a loop may be, and half as fast.
    #[test]
    fn the_loop_keeps_its_rate_measures_itself_and_lets_the_hand_go_slowly() {
        for rate_hz in [2_000.0, *RATES_HZ.end()] {
            let (held, mut link, forces) = scripted(|_| None);
            let settings = HapticSettings { rate_hz, ..HapticSettings::default() };
            let haptics = HapticLoop::start(vec![held], settings, Arc::default()).unwrap();
            let push = HapticModel {
                touch: Touch::Grasp,
                tip_m: DVec3::Y,
                force_n: DVec3::Y,
                hold_n: f64::INFINITY,
                ..HapticModel::default()
            };
            // A busy machine leaves ticks out, and ramps take their number of ticks.
            for round in 0..1_000 {
                link.models.publish(PublishedModel { model: push, made_ns: now_ns() });
                std::thread::sleep(std::time::Duration::from_millis(10));
                if round >= 40 && forces.lock().unwrap().last().is_some_and(|force| force.y > 0.5) {
                    break;
                }
            }
            let report = haptics.meters().report();
            let n_before = forces.lock().unwrap().len();
            drop(haptics);
            assert!(report.rate_hz > 200.0 && report.rate_hz < 1.05 * rate_hz, "{report:?}");
            assert!(
                report.n_deadlines > 100 && report.jitter.n > 100 && report.scheduling.is_some(),
                "{report:?}"
            );
            let json = report.to_json();
            assert!((json["period_us"].as_f64().unwrap() - 1e6 / rate_hz).abs() < 1e-9, "{json}");
            for field in ["jitter_us", "motion_to_force_us", "local_model_age_ms", "tick_us"] {
                assert!(
                    json[field]["p999"].as_f64().unwrap() >= json[field]["p50"].as_f64().unwrap(),
                    "{json}"
                );
            }
            let text = report.to_text();
            let budget = format!("% of {:.0} us", 1e6 / rate_hz);
            for part in [budget.as_str(), "deadlines missed", "below ", "from the local model", "never got"] {
                assert!(text.contains(part), "{part}: {text}");
            }
            let forces = forces.lock().unwrap();
            assert!(forces.len() < forces.capacity(), "the test's list is too short");
            assert!(n_before < forces.len() && forces[n_before - 1].y > 0.5, "{:?}", forces[n_before - 1]);
            assert_eq!(*forces.last().unwrap(), DVec3::ZERO);
            let changes = forces.windows(2).map(|pair| pair[0].distance(pair[1]));
            let greatest_n = changes.fold(0.0, f64::max);
            // Far below the 0.5 N and more that were there; tests without a clock are stricter.
            assert!(greatest_n < 0.25, "{greatest_n}");
        }
    }

    #[test]
    fn the_histogram_in_the_report_adds_up() {
        let meters = Meters::default();
        for (ns, n) in [(20, 50), (700, 30), (1_500, 15), (90_000, 5)] {
            (0..n).for_each(|_| meters.jitter.record(ns));
        }
        let text = meters.report().jitter_text();
        assert_eq!(text, "below 1.0 us 80.000 %, 2.0 us 15.000 %, 131 us 5.000 %");
        assert_eq!(Meters::default().report().jitter_text(), "nothing counted yet");
    }

    #[test]
    fn choices_reach_the_law() {
        let forces = ForceChoices {
            estimate: glisson::haptics::ForceEstimate::Hold,
            control: glisson::haptics::EnergyControl::ObserveOnly,
            ..ForceChoices::default()
        };
        let (mut held, mut link, told) = scripted(|_| None);
        held.settings = HapticSettings { forces, ..HapticSettings::default() };
        // A force that is not where its stiffness would have it: held, it stays; from the local model it grows.
        let model = HapticModel {
            touch: Touch::Grasp,
            tip_m: DVec3::Y,
            force_n: DVec3::X * 0.5,
            stiffness_n_per_m: DMat3::from_diagonal(DVec3::splat(300.0)),
            hold_n: f64::INFINITY,
            ..HapticModel::default()
        };
        for _ in 0..800 {
            link.models.publish(PublishedModel { model, made_ns: now_ns() });
            held.tick(1e-3, None);
        }
        let last_n = *told.lock().unwrap().last().unwrap();
        assert!(last_n.distance(DVec3::X * 0.5) < 1e-9, "{last_n}");
        let limits = held.device.device.limits();
        let law = held.law.as_ref().unwrap();
        assert!((law.gains().stiffness_n_per_m - 0.6 * limits.stiffness_n_per_m).abs() < 1e-9);
    }

    #[test]
    fn a_rate_that_no_loop_keeps_is_refused() {
        for rate_hz in [0.0, 50.0, 5_000.0, f64::NAN] {
            let settings = HapticSettings { rate_hz, ..HapticSettings::default() };
            let error = HapticLoop::start(Vec::new(), settings, Arc::default()).err().unwrap();
            assert!(error.to_string().contains("allowed: 100 to 4000 Hz"), "{error}");
        }
    }
}
