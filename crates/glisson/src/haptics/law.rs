//! One tick of the haptic loop: from what a device said to the force that it exerts.
//!
//! handle -> world ([`super::mapping`]) -> force of the latest model at the tool ([`super::handover`]) -> coupling
//! ([`super::coupling`]) -> handle -> gate ([`super::limits`]) -> energy tank, limits and rates ([`super::passivity`]) -> command.
//! The simulation steps with the tool, not with the handle.
//!
//! No clock, no allocation, nothing that waits: the period of a tick and the age of the model come in as numbers.

use super::axes::{AxesHandover, AxesPlace};
use super::coupling::{Coupling, CouplingGains, GainShares, TissueTangent};
use super::device::{DeviceLimits, DeviceState, ForceCommand};
use super::extrapolation::ForceEstimate;
use super::handover::Handover;
use super::limits::{Gate, saturated, within_period_s};
use super::mapping::{DeviceMapping, Handle, MappedDevice, turn_rad};
use super::passivity::{EnergyControl, EnergyTank, TankSettings};
use super::tissue::{HapticModel, Touch};
use crate::math::{DMat3, DVec3, outer};
use crate::tool::ToolInput;
use glam::DQuat;

/// A handle that seems quicker [m/s] was put elsewhere: a choice, ten times what hands do with an instrument.
const MOST_SPEED_M_PER_S: f64 = 10.0;

/// Weight of a tick in the smoothed period: a choice.
const PERIOD_SMOOTHING: f64 = 0.02;

/// Force of the tissue in forces of the device above which it counts no more: no hand could hold it. A choice.
const MOST_FORCES: f64 = 10.0;

/// Share of a pushing force along the surface's normal below which it pushes along itself: a friction of 1.7, above any of tissue
/// on steel. A choice.
const LEAST_PUSH_SHARE: f64 = 0.5;

/// Least stiffness [N/m] by which the energy in touched tissue is estimated: about that of an organ of 4 kPa under a flat tip
/// of 5 mm, 2 E a/(1 - nu^2).
const LEAST_STIFFNESS_N_PER_M: f64 = 50.0;

/// What a law is made of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LawSettings {
    /// How the device's motion becomes the instrument's.
    pub mapping: DeviceMapping,
    /// How the device's room for stiffness and damping is divided.
    pub shares: GainShares,
    /// How it gets from models to forces.
    pub estimate: ForceEstimate,
    /// What the energy tank reckons with.
    pub tank: TankSettings,
    /// Whether it controls.
    pub control: EnergyControl,
    /// Age [s] from which on a model is too old: the simulation stands still. A choice: five steps at 20 Hz.
    pub stale_after_s: f64,
    /// Time from tick to tick that the loop means to keep [s]; 0 takes that of the first tick.
    pub period_s: f64,
}

impl Default for LawSettings {
    fn default() -> Self {
        Self {
            mapping: DeviceMapping::default(),
            shares: GainShares::default(),
            estimate: ForceEstimate::default(),
            tank: TankSettings::default(),
            control: EnergyControl::default(),
            stale_after_s: 0.25,
            period_s: 0.0,
        }
    }
}

/// What a tick comes to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LawTick {
    /// For the device.
    pub command: ForceCommand,
    /// For the simulation.
    pub tool: ToolInput,
    /// For the panel.
    pub report: TickReport,
}

/// What was done at a tick and why.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TickReport {
    /// Energy that the hand put in since the start, less what it got [J].
    pub observed_energy_j: f64,
    /// What the energy tank holds [J].
    pub tank_j: f64,
    /// Share of the wanted change of command that the tank paid for.
    pub admitted_share: f64,
    /// How far the gate is open.
    pub gate_share: f64,
    /// Damping that control added [N s/m].
    pub injected_damping_n_s_per_m: f64,
    /// Force of the tissue on the tool [N], in the world, before anything limits it.
    pub tissue_force_n: DVec3,
    /// Whether more than the device's largest force was wanted.
    pub is_saturated: bool,
    /// Whether the model was too old.
    pub is_stale: bool,
    /// Whether the handle is moved aside.
    pub is_clutched: bool,
    /// Whether the device did not answer.
    pub is_lost: bool,
    /// Whether it began anew: at the start, after the device was away, or because the handle was put elsewhere.
    pub is_restart: bool,
}

/// The force law of one device with one instrument.
#[derive(Clone, Debug, PartialEq)]
pub struct HapticLaw {
    settings: LawSettings,
    limits: DeviceLimits,
    gains: CouplingGains,
    mapped: MappedDevice,
    handover: Handover,
    axes: AxesHandover,
    coupling: Coupling,
    gate: Gate,
    tank: EnergyTank,
    /// Where the handle was last, in its own frame, and how far open its jaws were; none before the first tick and after the
    /// device was away.
    seen: Option<(DVec3, Option<DQuat>, f64)>,
    /// Ticks without an answer since then.
    n_lost: u32,
    /// Time from tick to tick, smoothed [s]: what is expected of the next one. 0 where no tick and no setting has told.
    period_s: f64,
    /// Whether the loop is about to end: the gate closes and stays closed.
    lets_go: bool,
    /// What coupling and tissue hold, at the handle [J].
    stored_j: f64,
    tool: ToolInput,
}

impl HapticLaw {
    /// A law for a device with these limits. The gate is closed, the tank full.
    pub fn new(settings: &LawSettings, limits: &DeviceLimits) -> Self {
        let gains = CouplingGains::within(limits, &settings.shares);
        let mapped = MappedDevice::new(&settings.mapping);
        // A device that renders no stiffness feels nothing; the smallest spring keeps the tool with it.
        let stiffness = mapped.gain_in_world(gains.stiffness_n_per_m.max(1.0));
        let damping = mapped.gain_in_world(gains.damping_n_s_per_m);
        Self {
            settings: *settings,
            limits: *limits,
            gains,
            mapped,
            handover: Handover::new(settings.estimate),
            axes: AxesHandover::default(),
            coupling: Coupling::new(stiffness, damping, DVec3::ZERO),
            gate: Gate::for_force(limits.force_n),
            tank: EnergyTank::new(&settings.tank, &in_ticks_of(limits, settings.period_s), settings.control),
            seen: None,
            n_lost: 0,
            period_s: settings.period_s.max(0.0),
            lets_go: false,
            stored_j: 0.0,
            tool: ToolInput::at(settings.mapping.world_origin_m, DVec3::NEG_Y),
        }
    }

    /// Gains of coupling and injected damping.
    pub fn gains(&self) -> &CouplingGains {
        &self.gains
    }

    /// Energy that the hand put in since the start, less what it got [J].
    pub fn observed_energy_j(&self) -> f64 {
        self.tank.observed_j()
    }

    /// What that does not go below [J]: see [`super::passivity`].
    pub fn energy_bound_j(&self) -> f64 {
        self.tank.bound_j()
    }

    /// Ticks of the loop from a command to the first position that it acted on, beyond the usual one, that are counted.
    pub fn loop_delay_ticks(&self) -> usize {
        self.tank.loop_delay_ticks()
    }

    /// The tip of an instrument without length is at `world_m` [m] when the handle is at `device_m` [m] in its own frame: begins
    /// anew from there.
    pub fn place(&mut self, device_m: DVec3, world_m: DVec3) {
        let mapping =
            DeviceMapping { device_origin_m: device_m, world_origin_m: world_m, ..*self.mapped.mapping() };
        self.mapped = MappedDevice::new(&mapping);
        self.seen = None;
    }

    /// Another way from models to forces; the difference is spread.
    pub fn set_estimate(&mut self, estimate: ForceEstimate) {
        self.settings.estimate = estimate;
        self.handover.set_estimate(estimate);
    }

    /// From now on the gate closes, whatever comes, with damping too: for the last ticks before a device is closed.
    pub fn let_go(&mut self) {
        self.lets_go = true;
    }

    /// Whether the gate has let everything go.
    pub fn has_let_go(&self) -> bool {
        self.lets_go && self.gate.share() <= 0.0
    }

    /// Time [s] from an open gate to none.
    pub fn ramp_s(&self) -> f64 {
        self.gate.ramp_s()
    }

    /// The device did not answer at this tick of `dt_s` [s]. The force closes by the gate; once it has, the next answer is a
    /// new start.
    pub fn lost(&mut self, dt_s: f64) -> LawTick {
        self.n_lost = self.n_lost.saturating_add(1);
        let before = self.gate.share();
        self.gate.advance(false, within_period_s(dt_s, self.period_s));
        let share = if before > 0.0 { self.gate.share() / before } else { 0.0 };
        let last = *self.tank.previous();
        let command = ForceCommand {
            force_n: last.force_n * share,
            torque_n_m: last.torque_n_m * share,
            jaw_force_n: last.jaw_force_n * share,
        };
        self.tank.hold_unseen(&command);
        if self.gate.share() <= 0.0 {
            self.seen = None;
        }
        LawTick { command, tool: self.tool, report: TickReport { is_lost: true, ..self.report(0.0) } }
    }

    /// The device did not take the last command: by the contract of [`super::HapticDevice::write`] it goes to zero by itself, and
    /// what it takes next must begin there. The next answer is a new start.
    pub fn not_taken(&mut self) {
        self.gate.shut();
        self.seen = None;
    }

    /// A tick of `dt_s` [s] with the device as it is, and the newest model, `model_age_s` [s] after it was made.
    /// [`HapticModel::default`] before there is one. A device that says what is no number counts as lost.
    pub fn tick(
        &mut self,
        device: &DeviceState,
        model: &HapticModel,
        model_age_s: f64,
        dt_s: f64,
    ) -> LawTick {
        let is_usable = device.position_m.is_finite()
            && device.orientation.is_none_or(DQuat::is_finite)
            && device.jaw_opening.is_finite()
            && dt_s > 0.0;
        if !is_usable {
            return self.lost(dt_s.max(0.0));
        }
        self.expect_next(dt_s);
        let ramp_dt_s = within_period_s(dt_s, self.period_s);
        let handle = self.mapped.to_world(device);
        let is_restart = self.look(device, &handle, dt_s);
        let is_stale = model_age_s.is_nan() || model_age_s > self.settings.stale_after_s;
        self.gate.advance(!(is_stale || handle.is_clutched || self.lets_go), ramp_dt_s);

        let tool_m = self.coupling.tool_m();
        let felt_n = self.handover.force_in(model, tool_m, model_age_s, dt_s, ramp_dt_s);
        let most_n = MOST_FORCES * self.limits.force_n / self.mapped.mapping().force_scale;
        let tissue_force_n = saturated(felt_n, most_n);
        let tangent = self.tangent(model, tissue_force_n);
        let force_n = self.coupling.step(handle.tip_m, &tangent, dt_s);
        self.stored_j = self.mapped.energy_at_handle_j(
            self.coupling.stored_j() + tissue_energy_j(force_n, &tangent.stiffness_n_per_m),
        );

        self.tool = self.mapped.tool(self.coupling.tool_m(), &handle, device);
        let axes = self.axes_at_handle(model, ramp_dt_s);
        let turn = device.orientation.unwrap_or_else(|| self.mapped.to_device_axes(handle.orientation));
        let along = turn.normalize() * DVec3::Z;

        let open = self.mapped.to_device(force_n, handle.arm_m);
        let injected = self.injected_damping_n_s_per_m();
        let velocity =
            if device.velocity_m_per_s.is_finite() { device.velocity_m_per_s } else { DVec3::ZERO };
        let share = self.gate.share();
        let resisting_n = velocity * -injected * if self.lets_go { share } else { 1.0 };
        let wanted = ForceCommand {
            force_n: open.force_n * share + resisting_n,
            torque_n_m: (open.torque_n_m + along * axes.twist_n_m) * share,
            jaw_force_n: axes.jaw_force_n * share,
        };
        let (command, admitted_share) = self.tank.admit(&wanted, resisting_n, self.period_s);
        let report = TickReport {
            admitted_share,
            injected_damping_n_s_per_m: injected,
            tissue_force_n,
            is_saturated: wanted.force_n.length() > self.limits.force_n,
            is_stale,
            is_clutched: handle.is_clutched,
            is_restart,
            ..self.report(1.0)
        };
        LawTick { command, tool: self.tool, report }
    }

    /// What is added to the device's own damping while the tank is short of energy.
    #[inline]
    fn injected_damping_n_s_per_m(&self) -> f64 {
        let shortage = match self.settings.control {
            EnergyControl::Tank => self.tank.shortage(),
            EnergyControl::ObserveOnly => 0.0,
        };
        self.gains.injected_damping_n_s_per_m * shortage
    }

    /// A late tick says little about the next one.
    fn expect_next(&mut self, dt_s: f64) {
        if self.period_s <= 0.0 {
            self.period_s = dt_s;
        }
        self.period_s += (dt_s.min(2.0 * self.period_s) - self.period_s) * PERIOD_SMOOTHING;
    }

    /// Counts the energy of the handle's step; true if there was none to count.
    fn look(&mut self, device: &DeviceState, handle: &Handle, dt_s: f64) -> bool {
        let ticks = f64::from(self.n_lost) + 1.0;
        self.n_lost = 0;
        let opening = device.jaw_opening.clamp(0.0, 1.0);
        let now = (device.position_m, device.orientation.map(DQuat::normalize), opening);
        let before = self.seen.replace(now);
        let most_m = MOST_SPEED_M_PER_S * dt_s * ticks;
        match before {
            // An orientation that is told for the first time, or not any more, turns the instrument at once.
            Some((was_m, was, was_open))
                if (now.0 - was_m).length() <= most_m && was.is_some() == now.1.is_some() =>
            {
                let opened_m = (opening - was_open) * self.limits.jaw_travel_m;
                let turned_rad = was.zip(now.1).map_or(DVec3::ZERO, |(was, now)| turn_rad(was, now));
                self.tank.observe_with_jaws(now.0 - was_m, turned_rad, opened_m, self.stored_j, dt_s * ticks);
                false
            }
            _ => {
                self.gate.shut();
                self.handover.restart();
                self.axes.restart();
                self.coupling.restart(handle.tip_m);
                self.tank.restart();
                self.stored_j = 0.0;
                true
            }
        }
    }

    /// Torque about the shaft and force at the jaws for the hand, of the model at the tool as it is now; what they hold is added
    /// to what is stored.
    fn axes_at_handle(&mut self, model: &HapticModel, ramp_dt_s: f64) -> AxesEffort {
        let DeviceLimits { force_n, torque_n_m, jaw_travel_m, .. } = self.limits;
        if torque_n_m <= 0.0 && jaw_travel_m <= 0.0 {
            return AxesEffort::default();
        }
        let scale = self.mapped.energy_at_handle_j(1.0);
        // No stiffer than the coupling is: at the arm at which the largest force has the largest torque, and on the jaws' way.
        let arm_m = if force_n > 0.0 { torque_n_m / force_n } else { 0.0 };
        let most = self.gains.stiffness_n_per_m / scale;
        let axes = match self.settings.estimate {
            ForceEstimate::LocalModel | ForceEstimate::ExtrapolateInPosition => {
                model.axes.no_stiffer_than(most * arm_m * arm_m, most * jaw_travel_m * jaw_travel_m)
            }
            ForceEstimate::Hold | ForceEstimate::ExtrapolateInTime => model.axes.no_stiffer_than(0.0, 0.0),
        };
        let place = AxesPlace { roll_rad: self.tool.roll_rad, jaw_opening: self.tool.jaw_opening };
        let [twist_n_m, jaw_j] = self.axes.efforts(&axes, place, jaw_travel_m, ramp_dt_s);
        let held_j = |effort: f64, slope: f64| if slope > 0.0 { 0.5 * effort * effort / slope } else { 0.0 };
        self.stored_j += scale
            * (held_j(twist_n_m, axes.twist_stiffness_n_m_per_rad) + held_j(jaw_j, axes.jaw_stiffness_j));
        let jaw_force_n = if jaw_travel_m > 0.0 { scale * jaw_j / jaw_travel_m } else { 0.0 };
        AxesEffort { twist_n_m: scale * twist_n_m, jaw_force_n }
    }

    fn tangent(&self, model: &HapticModel, force_n: DVec3) -> TissueTangent {
        let is_local = matches!(
            self.settings.estimate,
            ForceEstimate::LocalModel | ForceEstimate::ExtrapolateInPosition
        );
        let is_felt = is_local && force_n != DVec3::ZERO && model.is_finite();
        let n = model.normal;
        let stiffness_n_per_m = match model.touch {
            _ if !is_felt => DMat3::ZERO,
            Touch::Free => outer(n, n) * n.dot(model.stiffness_n_per_m * n).max(0.0),
            Touch::Contact | Touch::Grasp => model.stiffness_n_per_m,
        };
        let pushes_along = match (model.touch, model.n_parts) {
            (Touch::Grasp, _) => DVec3::ZERO,
            _ if !is_felt => DVec3::ZERO,
            (_, 0) => n,
            (_, 1) => model.parts[0].at_tip_n(model.parts[0].normal).normalize_or_zero(),
            _ => DVec3::ZERO,
        };
        // A force along the surface of a fold, or of a model that is just taken over, would be gone at once when what is left of it
        // along the normal is.
        let is_along = force_n.dot(pushes_along) >= LEAST_PUSH_SHARE * force_n.length();
        let pushes_along =
            if pushes_along == DVec3::ZERO || is_along { pushes_along } else { force_n.normalize_or_zero() };
        TissueTangent { force_n, stiffness_n_per_m, pushes_along }
    }

    fn report(&self, admitted_share: f64) -> TickReport {
        TickReport {
            observed_energy_j: self.tank.observed_j(),
            tank_j: self.tank.level_j(),
            admitted_share,
            gate_share: self.gate.share(),
            ..TickReport::default()
        }
    }
}

/// The limits with the device's delay in ticks of a loop of `period_s` [s]: its own are of its own rate.
fn in_ticks_of(limits: &DeviceLimits, period_s: f64) -> DeviceLimits {
    let ticks_of_loop = limits.loop_delay_ticks as f64 / (limits.rate_hz * period_s);
    // Rounding adds no tick.
    let is_known = period_s > 0.0 && limits.rate_hz > 0.0 && ticks_of_loop.is_finite();
    let loop_delay_ticks =
        if is_known { (ticks_of_loop - 1e-6).ceil() as usize } else { limits.loop_delay_ticks };
    DeviceLimits { loop_delay_ticks, ..*limits }
}

/// For the hand, beside the force at the tip.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct AxesEffort {
    /// About the handle's +z [N m].
    twist_n_m: f64,
    /// Force that opens the jaws [N].
    jaw_force_n: f64,
}

/// What tissue of that stiffness [N/m] holds under that force [J].
fn tissue_energy_j(force_n: DVec3, stiffness_n_per_m: &DMat3) -> f64 {
    let size2 = force_n.length_squared();
    if size2 <= 0.0 {
        return 0.0;
    }
    let along = force_n.dot(*stiffness_n_per_m * force_n) / size2;
    0.5 * size2 / along.max(LEAST_STIFFNESS_N_PER_M)
}
