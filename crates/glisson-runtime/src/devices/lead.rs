//! Force-feedback teleoperation: a device leads, an active trocar follows, forces come back (seed `000`, s. 5.5).
//!
//! A trocar that leads is coupled motion by motion ([`Teleoperation`]). Another device leads the follower's tip: its handle's
//! way, turned into the trocar's axes, is the tip's from where it was when they were coupled; down at the desk is into the
//! body. The motions that reach that tip lead, and what their springs exert comes back as the force at the tip that does the
//! same work. Springs are weaker then where the device renders less.

use super::trocar_board::{BoardLine, TrocarDevice};
use super::trocar_choice::TrocarChoice;
use super::{DeviceName, OpenDevice, open};
use crate::haptic_loop::check_rate;
use crate::histogram::{Histogram, Percentiles};
use crate::realtime::{OwnCore, Scheduling, make_punctual, now_ns, wait_until};
use anyhow::{bail, ensure};
use glisson::haptics::limits::{Gate, within_limits, within_period_s};
use glisson::haptics::trocar::statics::felt;
use glisson::haptics::trocar::teleoperation::{End, Exchange, Spring, Teleoperation};
use glisson::haptics::trocar::{AxisEfforts, N_AXES, Placement, TrocarJoints, TrocarProfile};
use glisson::haptics::{DeviceFault, DeviceLimits, DeviceState, ForceCommand, GainShares, HapticDevice};
use glisson::math::{DMat3, DVec3};
use glisson::tool::ToolInput;
use serde_json::{Value, json};
use std::sync::atomic::{AtomicBool, Ordering};

/// What is asked for.
#[derive(Clone, Copy, Debug)]
pub struct LeadRequest<'a> {
    /// The device whose hand leads.
    pub leader: &'a DeviceName,
    /// The device that follows.
    pub follower: &'a DeviceName,
    /// How long [s]; until it is stopped for none.
    pub seconds: Option<f64>,
    /// Motion of the follower for one of the leader.
    pub scale: f64,
    /// Ticks a second.
    pub rate_hz: f64,
}

/// Who leads.
enum Leader {
    Trocar(Box<TrocarDevice<BoardLine>>),
    Other(Handle),
}

/// A device that is no trocar.
struct Handle {
    device: Box<dyn HapticDevice>,
    /// From its axes to the follower's.
    follower_from_device: DMat3,
    /// Where the handle was when it was coupled, and the follower's motions there.
    origin: Option<(DVec3, TrocarJoints)>,
}

/// Over this time a velocity becomes a difference of motions [s]: a tenth of the shortest tick would do.
const DIFFERENCE_S: f64 = 1e-5;
const OUT_OF_REACH: DeviceFault = DeviceFault::Lost(std::borrow::Cow::Borrowed(
    "its handle is where no instrument in the follower can be: bring it back",
));

impl Handle {
    fn new(opened: OpenDevice) -> Self {
        // The follower's instrument goes down into a patient who lies on the back.
        let trocar = Placement::facing(DVec3::ZERO, DVec3::Y).world_from_device;
        let follower_from_device = trocar.transpose() * DMat3::from_quat(opened.world_from_device);
        Self { device: opened.device, follower_from_device, origin: None }
    }

    /// The motions that it leads; where they began when it is coupled to `follower` anew.
    fn read(&mut self, follower: Option<&TrocarJoints>) -> Result<End, DeviceFault> {
        let state = self.device.read()?;
        if !(state.position_m.is_finite() && state.velocity_m_per_s.is_finite()) {
            return Err(DeviceFault::Lost("it sends numbers that are not finite".into()));
        }
        if self.origin.is_none() {
            self.origin = follower.map(|joints| (state.position_m, *joints));
        }
        let Some((origin_m, start)) = &self.origin else {
            return Ok(End::default());
        };
        self.motions(&state, *origin_m, start).ok_or(OUT_OF_REACH)
    }

    fn motions(&self, state: &DeviceState, origin_m: DVec3, start: &TrocarJoints) -> Option<End> {
        let tip_m = start.pose().tip_m + self.follower_from_device * (state.position_m - origin_m);
        let velocity_m_per_s = self.follower_from_device * state.velocity_m_per_s;
        // It has no jaws to speak of where it does not tell any: the follower's stay.
        let reach = |tip_m: DVec3| start.reaching(tip_m).map(TrocarJoints::to_array);
        let joints = reach(tip_m)?;
        let later = reach(tip_m + velocity_m_per_s * DIFFERENCE_S)?;
        let rates = std::array::from_fn(|i| (later[i] - joints[i]) / DIFFERENCE_S);
        Some(End { joints: TrocarJoints::from_array(joints), rates })
    }

    /// Pushes as `efforts` on the motions `joints` do.
    fn write(&mut self, joints: &TrocarJoints, efforts: &AxisEfforts) -> Result<f64, DeviceFault> {
        let force_n = self.follower_from_device.transpose() * felt(joints, efforts).force_n;
        let command =
            within_limits(&ForceCommand { force_n, ..ForceCommand::default() }, &self.device.limits());
        self.device.write(&command).map(|()| command.force_n.length())
    }
}

/// Springs of the coupling that a device can render: at the follower's tip no more than its share of what it can.
fn springs_within(of: &[Spring; N_AXES], limits: &DeviceLimits, insertion_m: f64) -> [Spring; N_AXES] {
    let shares = GainShares::default();
    let most = Spring {
        stiffness: shares.stiffness * limits.stiffness_n_per_m,
        damping: (shares.damping + shares.injected) * limits.damping_n_s_per_m,
    };
    let arm2 = insertion_m * insertion_m;
    std::array::from_fn(|i| {
        // Pitch, roll and insertion act on its handle; nothing else does.
        let unit = [arm2, arm2, 1.0, f64::INFINITY, f64::INFINITY][i];
        let within = |own: f64, most: f64| own.min(most * unit);
        Spring {
            stiffness: within(of[i].stiffness, most.stiffness),
            damping: within(of[i].damping, most.damping),
        }
    })
}

/// What a tick comes to.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct LeadTick {
    /// From where the follower's tip should be to where it is [m]; none while they are apart.
    pub(super) error_m: Option<f64>,
    /// Force on the leader's hand, and of the follower's motors on its instrument [N].
    pub(super) force_n: [f64; 2],
}

/// A leader and its follower.
pub(super) struct Lead {
    leader: Leader,
    follower: TrocarDevice<BoardLine>,
    profile: TrocarProfile,
    scale: f64,
    period_s: f64,
    link: Option<Teleoperation>,
    gate: Gate,
    lets_go: bool,
    /// Efforts of the last tick, at full gate.
    last: Exchange,
    at: [TrocarJoints; 2],
    faults: Vec<(String, u64)>,
}

/// Most different reasons that are told.
const MOST_REASONS: usize = 8;

impl Lead {
    /// Opens both.
    ///
    /// # Errors
    /// When one is not there, or the follower is no trocar.
    pub(super) fn open(request: &LeadRequest) -> anyhow::Result<Self> {
        let LeadRequest { leader, follower, scale, rate_hz, .. } = *request;
        check_rate(rate_hz)?;
        ensure!((0.1..=3.0).contains(&scale), "--scale {scale}: must be 0.1 to 3");
        let Some(choice) = follower.as_choice::<TrocarChoice>() else {
            bail!("only an active trocar can follow: name it trocar[:HOST:PORT][,KEY=VALUE ...]");
        };
        let leading = leader.as_choice::<TrocarChoice>();
        if leading.is_some_and(|other| other.is_same_as(choice)) {
            bail!("{} cannot lead itself", choice.description());
        }
        ensure!(
            !leader.is("viewer"),
            "the viewer cannot lead: its page is there in `glisson serve` alone; name another device"
        );
        let follower = choice.open_follower(rate_hz)?;
        let leader = match leading {
            Some(choice) => {
                let device = choice.open_device(rate_hz, super::trocar_board::START_INSERTION_M, None)?;
                Leader::Trocar(Box::new(device))
            }
            None => {
                // A simulated hand pushes along the instrument: down.
                let home = ToolInput::at(DVec3::ZERO, DVec3::NEG_Y);
                Leader::Other(Handle::new(open(leader, &home, rate_hz)?))
            }
        };
        Ok(Self::new(leader, follower, choice.profile(), scale, 1.0 / rate_hz))
    }

    fn new(
        leader: Leader,
        follower: TrocarDevice<BoardLine>,
        profile: TrocarProfile,
        scale: f64,
        period_s: f64,
    ) -> Self {
        Self {
            leader,
            follower,
            profile,
            scale,
            period_s,
            link: None,
            gate: Gate::for_force(profile.limits.translation_n),
            lets_go: false,
            last: Exchange::default(),
            at: [TrocarJoints::default(); 2],
            faults: Vec::new(),
        }
    }

    /// A tick `dt_s` [s] after the last one.
    pub(super) fn tick(&mut self, dt_s: f64) -> LeadTick {
        let ramp_dt_s = within_period_s(dt_s, self.period_s);
        let follower = read_trocar(&mut self.follower);
        let leader = match &mut self.leader {
            Leader::Trocar(device) => read_trocar(device),
            Leader::Other(handle) => handle.read(follower.as_ref().ok().map(|end| &end.joints)),
        };
        let (leader, follower) = match (leader, follower) {
            (Ok(leader), Ok(follower)) => (leader, follower),
            (leader, follower) => {
                self.note("leader", leader.err());
                self.note("follower", follower.err());
                // Both give way together; who does not answer is told all the same.
                self.gate.advance(false, ramp_dt_s);
                if self.gate.share() <= 0.0 {
                    self.apart();
                }
                return LeadTick { error_m: None, force_n: self.write() };
            }
        };
        self.gate.advance(!self.lets_go, ramp_dt_s);
        self.at = [leader.joints, follower.joints];
        if self.link.is_none() {
            self.link = Some(self.couple(&leader, &follower));
        }
        let Some(link) = &self.link else { return LeadTick::default() };
        self.last = link.tick(&leader, &follower);
        let error_m = self.last.target.pose().tip_m.distance(follower.joints.pose().tip_m);
        LeadTick { error_m: Some(error_m), force_n: self.write() }
    }

    fn couple(&self, leader: &End, follower: &End) -> Teleoperation {
        let link = Teleoperation::couple(self.profile, [&leader.joints, &follower.joints], self.scale);
        match &self.leader {
            Leader::Trocar(_) => link,
            Leader::Other(handle) => {
                let insertion_m = follower.joints.insertion_m;
                let springs = springs_within(link.springs(), &handle.device.limits(), insertion_m);
                link.with_springs(springs)
            }
        }
    }

    /// They begin anew from where they are when both answer again.
    fn apart(&mut self) {
        self.link = None;
        self.last = Exchange::default();
        if let Leader::Other(handle) = &mut self.leader {
            handle.origin = None;
        }
    }

    /// Forces on the leader's hand and of the follower's motors along its instrument [N].
    fn write(&mut self) -> [f64; 2] {
        let share = self.gate.share();
        let [to_leader, to_follower] = [self.last.leader, self.last.follower]
            .map(|efforts| AxisEfforts::from_array(efforts.to_array().map(|effort| effort * share)));
        let on_hand = match &mut self.leader {
            Leader::Trocar(device) => {
                device.write_efforts(&to_leader).map(|()| felt(&self.at[0], &to_leader).force_n.length())
            }
            Leader::Other(handle) => handle.write(&self.at[0], &to_leader),
        };
        let moved = self.follower.write_efforts(&to_follower);
        let leader_n = on_hand.as_ref().copied().unwrap_or(0.0);
        self.note("leader", on_hand.err());
        self.note("follower", moved.err());
        [leader_n, felt(&self.at[1], &to_follower).force_n.length()]
    }

    fn note(&mut self, who: &str, fault: Option<DeviceFault>) {
        let Some(DeviceFault::Lost(why) | DeviceFault::Failed(why)) = fault else { return };
        let is_same = |text: &str| {
            let rest = text.strip_prefix(who).and_then(|rest| rest.strip_prefix(": "));
            rest == Some(why.as_ref())
        };
        match self.faults.iter().position(|(text, _)| is_same(text)) {
            Some(known) => self.faults[known].1 += 1,
            None if self.faults.len() < MOST_REASONS => self.faults.push((format!("{who}: {why}"), 1)),
            None => {}
        }
    }

    /// From now on forces go to zero.
    pub(super) fn let_go(&mut self) {
        self.lets_go = true;
    }

    pub(super) fn has_let_go(&self) -> bool {
        self.lets_go && self.gate.share() <= 0.0
    }

    /// All motors off.
    fn stop(&mut self) {
        // Who does not listen any more goes to zero by itself.
        let _ = self.follower.stop();
        let _ = match &mut self.leader {
            Leader::Trocar(device) => device.stop(),
            Leader::Other(handle) => handle.device.write(&ForceCommand::default()),
        };
    }
}

fn read_trocar(device: &mut TrocarDevice<BoardLine>) -> Result<End, DeviceFault> {
    device.read()?;
    match device.reading() {
        Ok(reading) => Ok(End { joints: reading.joints, rates: reading.rates }),
        Err(_) => Err(DeviceFault::Lost("the board has said nothing yet".into())),
    }
}

/// How it went.
pub struct LeadReport {
    names: [String; 2],
    scale: f64,
    rate_hz: f64,
    seconds: f64,
    n_coupled: u64,
    n_apart: u64,
    faults: Vec<(String, u64)>,
    /// In nanometres.
    error: Percentiles,
    last_error_m: f64,
    /// Of the leader's hand and of the follower's motors [N].
    mean_n: [f64; 2],
    greatest_n: [f64; 2],
    work: Percentiles,
    scheduling: Scheduling,
}

/// Leads until the time is over or `stop` is set, then lets both go.
///
/// # Errors
/// When a device is not there or cannot take part.
pub fn run(request: &LeadRequest, stop: &AtomicBool) -> anyhow::Result<LeadReport> {
    if let Some(seconds) = request.seconds {
        ensure!(
            seconds > 0.0 && seconds <= 36_000.0,
            "--seconds {seconds}: must be above 0 and at most 36000"
        );
    }
    let mut lead = Lead::open(request)?;
    let scheduling = make_punctual(OwnCore::Last);
    let (errors, work) = (Histogram::default(), Histogram::default());
    let period_ns = (1e9 / request.rate_hz).round() as u64;
    let start_ns = now_ns();
    let (mut last_ns, mut deadline_ns) = (start_ns, start_ns + period_ns);
    let (mut n_coupled, mut n_apart, mut last_error_m) = (0, 0, 0.0);
    let (mut sum_n, mut greatest_n) = ([0.0; 2], [0.0_f64; 2]);
    while !lead.has_let_go() {
        wait_until(deadline_ns);
        let begun_ns = now_ns();
        let is_over = request.seconds.is_some_and(|seconds| (begun_ns - start_ns) as f64 * 1e-9 >= seconds);
        if is_over || stop.load(Ordering::Relaxed) {
            lead.let_go();
        }
        let tick = lead.tick((begun_ns - last_ns) as f64 * 1e-9);
        if let (Some(error_m), false) = (tick.error_m, lead.lets_go) {
            n_coupled += 1;
            last_error_m = error_m;
            errors.record((error_m * 1e9) as u64);
            for i in 0..2 {
                sum_n[i] += tick.force_n[i];
                greatest_n[i] = greatest_n[i].max(tick.force_n[i]);
            }
        } else if tick.error_m.is_none() {
            n_apart += 1;
        }
        work.record(now_ns() - begun_ns);
        last_ns = begun_ns;
        // Deadlines that have passed are left out.
        deadline_ns += ((begun_ns - deadline_ns) / period_ns + 1) * period_ns;
    }
    lead.stop();
    Ok(LeadReport {
        names: [request.leader, request.follower].map(DeviceName::text),
        scale: request.scale,
        rate_hz: request.rate_hz,
        seconds: (last_ns - start_ns) as f64 * 1e-9,
        n_coupled,
        n_apart,
        faults: lead.faults,
        error: errors.percentiles(),
        last_error_m,
        mean_n: sum_n.map(|sum| sum / (n_coupled as f64).max(1.0)),
        greatest_n,
        work: work.percentiles(),
        scheduling,
    })
}

impl LeadReport {
    /// For people.
    pub fn to_text(&self) -> String {
        let mm = |nm: u64| nm as f64 * 1e-6;
        let us = |ns: u64| ns as f64 * 1e-3;
        let mut text = format!(
            "{} leads {}, scale {}, {:.1} s at {} Hz; {}\n",
            self.names[0], self.names[1], self.scale, self.seconds, self.rate_hz, self.scheduling.text
        );
        text += &format!("coupled      {} ticks, apart {} ticks\n", self.n_coupled, self.n_apart);
        for (why, n) in &self.faults {
            text += &format!("lost         {n} ticks: {why}\n");
        }
        text += &format!(
            "follows      {:.2} mm behind at the tip (99 %: {:.2}, at most {:.2}; at the end {:.2})\n",
            mm(self.error.p50_ns),
            mm(self.error.p99_ns),
            mm(self.error.greatest_ns),
            self.last_error_m * 1e3
        );
        text += &format!(
            "forces       on the leader's hand {:.2} N (at most {:.2}), of the follower's motors {:.2} N (at most {:.2})\n",
            self.mean_n[0], self.greatest_n[0], self.mean_n[1], self.greatest_n[1]
        );
        text += &format!(
            "a tick       {:.1} us (99.9 %: {:.1}) of {:.0}",
            us(self.work.p50_ns),
            us(self.work.p999_ns),
            1e6 / self.rate_hz
        );
        text
    }

    /// The same for programs.
    pub fn to_json(&self) -> Value {
        let faults: Vec<Value> =
            self.faults.iter().map(|(why, n)| json!({ "reason": why, "ticks": n })).collect();
        let force = |i: usize| json!({ "mean": self.mean_n[i], "greatest": self.greatest_n[i] });
        json!({
            "leader": self.names[0], "follower": self.names[1], "scale": self.scale, "seconds": self.seconds,
            "rate_hz": self.rate_hz, "coupled_ticks": self.n_coupled, "apart_ticks": self.n_apart, "faults": faults,
            "tracking_error_mm": self.error.to_json(1e6), "last_tracking_error_mm": self.last_error_m * 1e3,
            "leader_force_n": force(0), "follower_force_n": force(1), "tick_us": self.work.to_json(1e3),
            "scheduling": self.scheduling.text,
        })
    }

    /// Whether anything was led at all.
    ///
    /// # Errors
    /// When not, with the reasons.
    pub fn check(&self) -> anyhow::Result<()> {
        let reasons: Vec<&str> = self.faults.iter().map(|(why, _)| why.as_str()).collect();
        ensure!(self.n_coupled > 0, "nothing was led: {}", reasons.join("; "));
        Ok(())
    }
}

#[cfg(test)]
#[path = "lead_tests.rs"]
mod tests;
