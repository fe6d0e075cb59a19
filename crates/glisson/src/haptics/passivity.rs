//! Passivity in the time domain: what the device gives to the hand it took from the hand before, but for a small reserve.
//!
//! A command F_k is held while the handle goes from x_k to x_(k+1); what the hand puts in is exactly -F_k.(x_(k+1) - x_k),
//! whatever happens in between (S. Stramigioli, C. Secchi, A. J. van der Schaft and C. Fantuzzi, Sampled data systems passivity
//! and discrete port-Hamiltonian systems, IEEE Transactions on Robotics 21(4), 2005, doi 10.1109/TRO.2004.842330). The sum since
//! the start is the observed energy E (the passivity observer of B. Hannaford and J.-H. Ryu, Time-domain passivity control of
//! haptic interfaces, IEEE Transactions on Robotics and Automation 18(1), 2002, doi 10.1109/70.988969); the torque's work on
//! the turning handle and that of the jaws' force on their way count in the same way. It does not matter where energy comes from: sampling, a model that is old, a new
//! model that says something else, or a simulation that goes wrong.
//!
//! A tank (M. Franken, S. Stramigioli, S. Misra, C. Secchi and A. Macchelli, Bilateral telemanipulation with time delays: a
//! two-layer approach combining passivity and transparency, IEEE Transactions on Robotics 27(4), 2011, doi
//! 10.1109/TRO.2011.2142430) starts with a reserve E_0, takes E in and pays for every command. Unlike there, a command is
//! admitted only if the tank could also pay for letting it go: at the device's rate of force, with the handle's last step d
//! towards the command's direction, and a hand that accelerates by at most a:
//!
//! `sum_j (|F| - j r)_+ (d.F/|F| + 2 q + (m + j + 1) a T^2) <= tank`
//!
//! (r: change of force in a tick of T, q: error of a position, m: delay of the device's loop in ticks; commands on their way
//! count likewise). Of a command that is too much the part is admitted that is not, on the straight line from what the device
//! can let go to in this tick. As letting go is always paid for,
//!
//! **E >= -E_0 at every tick, whatever the simulation says and the hand does, as long as the hand accelerates by at most a.**
//! A hand that is quicker, or a tick that is longer than those before, draws at most |F| times the way beyond, until the force
//! has gone at the device's rate. The tank is overdrawn then, and admits nothing but damping against the handle's motion until
//! that has brought it back.
//!
//! So that this is hardly ever needed, and force does not come and go with the rounding of a step, the largest force falls with
//! the tank's last half reserve, `|F| <= F_max tank/(E_0/2)`: it fades out and in with the way, by 1/e in E_0/(2 F_max).
//!
//! What friction and viscosity left in the tank must not feed an oscillation later: above E_0 and twice what tissue and coupling
//! can hold, the tank drains. So what leaves in any time is at most what the tank held at its beginning, little more than what
//! can be stored.

use super::device::{DeviceLimits, ForceCommand};
use super::limits::{rates_of, within_limits};
use crate::math::DVec3;

/// Longest delay of a device's loop that is accounted for, in ticks.
pub const MOST_DELAY_TICKS: usize = 32;

/// Halvings in the search for what the tank can pay: to 2e-4 of a tick's change.
const SEARCH_STEPS: usize = 12;

/// Share of what is above the tank's limit that drains in a second: a choice; gone long before the next push.
const DRAIN_PER_S: f64 = 5.0;

/// How many times the energy that tissue and coupling hold, as the tangent has it, may stand in the tank. A choice: the
/// tangent of tissue that stiffens underestimates it (by 1.5 for a force that grows with the cube of depth).
const STORED_MARGIN: f64 = 2.0;

/// What the tank reckons with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TankSettings {
    /// E_0 [J]: the bound. The work of 1 N over 1 cm by default, a choice: unnoticed in a hand, and enough for a free start.
    pub reserve_j: f64,
    /// Largest acceleration of the handle [m/s2]. By default five times gravity, a choice: a device's force of 3.3 N
    /// accelerates a free mass of 66 g by so much, and hands that operate keep far below.
    pub acceleration_m_per_s2: f64,
    /// Largest angular acceleration of the handle [rad/s2]; counts for devices with torque. A choice: that acceleration at 0.1 m.
    pub angular_acceleration_rad_per_s2: f64,
    /// Error of a position [m] beside the device's resolution.
    pub position_error_m: f64,
    /// Error of an orientation [rad].
    pub orientation_error_rad: f64,
    /// Error of the jaws' place on their way [m]. A choice: a thousandth of 25 mm.
    pub jaw_error_m: f64,
    /// Ticks from a command to the first position that it acted on, beyond the usual one and those of
    /// [`DeviceLimits::loop_delay_ticks`]; both together count up to [`MOST_DELAY_TICKS`].
    pub loop_delay_ticks: usize,
}

impl Default for TankSettings {
    fn default() -> Self {
        Self {
            reserve_j: 0.01,
            acceleration_m_per_s2: 50.0,
            angular_acceleration_rad_per_s2: 500.0,
            position_error_m: 0.0,
            orientation_error_rad: 1e-3,
            jaw_error_m: 2.5e-5,
            loop_delay_ticks: 0,
        }
    }
}

/// Handle, its turn, its jaws.
const N_PORTS: usize = 3;

/// What a command exerts at the ports.
fn at_ports(command: &ForceCommand) -> [DVec3; N_PORTS] {
    [command.force_n, command.torque_n_m, DVec3::X * command.jaw_force_n]
}

/// Whether energy is only watched.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum EnergyControl {
    /// Commands are admitted as far as the tank pays for them.
    #[default]
    Tank,
    /// Commands pass as they are: to show what control is for.
    ObserveOnly,
}

/// Force with way, torque with turn, or the jaws' force with theirs (along x).
#[derive(Clone, Copy, Debug, PartialEq)]
struct Port {
    /// The last step over its time [m/s or rad/s].
    velocity: DVec3,
    /// Commands that no step was seen for, the oldest first.
    pending: [DVec3; MOST_DELAY_TICKS + 1],
    /// Twice the error of a position, and an acceleration's change of step in a tick.
    error: f64,
    acceleration: f64,
}

impl Port {
    fn new(error: f64, acceleration: f64) -> Self {
        let pending = [DVec3::ZERO; MOST_DELAY_TICKS + 1];
        Self { velocity: DVec3::ZERO, pending, error: 2.0 * error, acceleration }
    }

    /// Work that the oldest command did on the hand.
    fn settle(&mut self, step: DVec3, n_pending: usize, dt_s: f64) -> f64 {
        let work_j = self.pending[0].dot(step);
        self.pending.copy_within(1..n_pending, 0);
        self.velocity = step / dt_s;
        work_j
    }

    /// The most that commands on their way can take.
    fn pending_cost_j(&self, n_delay: usize, dt_s: f64) -> f64 {
        let (step, change) = self.next_step(dt_s);
        let cost_j = |(i, command): (usize, &DVec3)| {
            let more = self.error + (i + 1) as f64 * change;
            (command.dot(step) + command.length() * more).max(0.0)
        };
        self.pending[..n_delay].iter().enumerate().map(cost_j).sum()
    }

    /// The last step as it would be in a tick of `dt_s` [s], and by how much it can change.
    fn next_step(&self, dt_s: f64) -> (DVec3, f64) {
        (self.velocity * dt_s, self.acceleration * dt_s * dt_s)
    }

    /// The most that `command` can take until it has gone by `rate` a tick.
    fn cost_j(&self, command: DVec3, n_delay: usize, rate: f64, dt_s: f64) -> f64 {
        let (step, change) = self.next_step(dt_s);
        let size = command.length();
        if size <= 0.0 {
            return 0.0;
        }
        let outward = command.dot(step) / size + self.error + (n_delay + 1) as f64 * change;
        let n = if rate > 0.0 { (size / rate).floor().min(1e6) } else { 1e6 };
        let sum_j = 0.5 * n * (n + 1.0);
        let sum_j2 = n * (n + 1.0) * (2.0 * n + 1.0) / 6.0;
        let total =
            (n + 1.0) * size * outward + (size * change - rate * outward) * sum_j - rate * change * sum_j2;
        // The handle may come in first and go out later: never less than what the tank already holds.
        total.max(0.0)
    }
}

/// Counts energy and admits commands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EnergyTank {
    settings: TankSettings,
    limits: DeviceLimits,
    control: EnergyControl,
    ports: [Port; N_PORTS],
    previous: ForceCommand,
    /// Whether commands went out since a position was seen.
    has_unseen: bool,
    level_j: f64,
    observed_j: f64,
}

impl EnergyTank {
    /// A tank with its reserve.
    pub fn new(settings: &TankSettings, limits: &DeviceLimits, control: EnergyControl) -> Self {
        let error_m = limits.resolution_m.max(0.0) + settings.position_error_m.max(0.0);
        let delay = settings.loop_delay_ticks.saturating_add(limits.loop_delay_ticks).min(MOST_DELAY_TICKS);
        let reserve_j = settings.reserve_j.max(0.0);
        Self {
            settings: TankSettings { loop_delay_ticks: delay, reserve_j, ..*settings },
            limits: *limits,
            control,
            ports: [
                Port::new(error_m, settings.acceleration_m_per_s2),
                Port::new(settings.orientation_error_rad, settings.angular_acceleration_rad_per_s2),
                Port::new(settings.jaw_error_m, settings.acceleration_m_per_s2),
            ],
            previous: ForceCommand::default(),
            has_unseen: false,
            level_j: reserve_j,
            observed_j: 0.0,
        }
    }

    /// E [J]: what the hand put in since the start, less what it got.
    pub fn observed_j(&self) -> f64 {
        self.observed_j
    }

    /// What E does not go below [J]: -E_0.
    pub fn bound_j(&self) -> f64 {
        -self.settings.reserve_j
    }

    /// Ticks of delay that are counted.
    pub fn loop_delay_ticks(&self) -> usize {
        self.settings.loop_delay_ticks
    }

    /// What is in the tank [J].
    pub fn level_j(&self) -> f64 {
        self.level_j
    }

    /// How empty the tank is: 0 from half its reserve on, 1 with nothing left.
    pub fn shortage(&self) -> f64 {
        let half_j = 0.5 * self.settings.reserve_j;
        if half_j > 0.0 { ((half_j - self.level_j) / half_j).clamp(0.0, 1.0) } else { 1.0 }
    }

    /// The command of the last tick.
    pub fn previous(&self) -> &ForceCommand {
        &self.previous
    }

    /// Forgets commands on their way: the device was away and takes none.
    pub fn restart(&mut self) {
        for port in &mut self.ports {
            (port.velocity, port.pending) = (DVec3::ZERO, [DVec3::ZERO; MOST_DELAY_TICKS + 1]);
        }
        self.previous = ForceCommand::default();
        self.has_unseen = false;
    }

    /// `command` goes out though no position came: the next step is then counted with the command, first or last of those
    /// that nobody saw, for which the hand got more.
    pub fn hold_unseen(&mut self, command: &ForceCommand) {
        self.previous = *command;
        self.has_unseen = true;
    }

    /// The handle went by `moved_m` [m] and turned by `turned_rad` [rad] in the `dt_s` [s] since the last tick, while tissue and
    /// coupling held `stored_j` [J]. Its jaws stayed where they were.
    pub fn observe(&mut self, moved_m: DVec3, turned_rad: DVec3, stored_j: f64, dt_s: f64) {
        self.observe_all([moved_m, turned_rad, DVec3::ZERO], stored_j, dt_s);
    }

    /// The same with jaws that opened by `opened_m` [m] of their way.
    pub fn observe_with_jaws(
        &mut self,
        moved_m: DVec3,
        turned_rad: DVec3,
        opened_m: f64,
        stored_j: f64,
        dt_s: f64,
    ) {
        self.observe_all([moved_m, turned_rad, DVec3::X * opened_m], stored_j, dt_s);
    }

    fn observe_all(&mut self, steps: [DVec3; N_PORTS], stored_j: f64, dt_s: f64) {
        let n_pending = self.settings.loop_delay_ticks + 1;
        let settled = self.ports.iter_mut().zip(steps).map(|(port, step)| port.settle(step, n_pending, dt_s));
        let mut work_j: f64 = settled.sum();
        if self.has_unseen {
            let unseen = at_ports(&self.previous);
            work_j = work_j.max(unseen.iter().zip(steps).map(|(of, step)| of.dot(step)).sum());
            for (port, of) in self.ports.iter_mut().zip(unseen) {
                port.pending[..n_pending].fill(of);
            }
            self.has_unseen = false;
        }
        self.observed_j -= work_j;
        self.level_j -= work_j;
        let most_j = self.settings.reserve_j + STORED_MARGIN * stored_j.max(0.0);
        if self.level_j > most_j {
            self.level_j -= (self.level_j - most_j) * (DRAIN_PER_S * dt_s).min(1.0);
        }
    }

    /// What of `wanted` is admitted for the coming tick of `dt_s` [s], and which share of the way to it: within the device's
    /// limits and rates, and paid for. `resisting_n` [N] is the part of it that damps: all that an overdrawn tank admits, and
    /// only where it stands against a step that is no error of the position. To be called once after each
    /// [`EnergyTank::observe`].
    pub fn admit(&mut self, wanted: &ForceCommand, resisting_n: DVec3, dt_s: f64) -> (ForceCommand, f64) {
        let rates = rates_of(&self.limits, dt_s);
        let is_overdrawn = self.level_j < 0.0 && self.control == EnergyControl::Tank;
        let wanted = if is_overdrawn {
            let (step_m, _) = self.ports[0].next_step(dt_s);
            let resists = resisting_n.dot(step_m) < 0.0 && step_m.length() > self.ports[0].error;
            let force_n = if resists { resisting_n } else { DVec3::ZERO };
            within_limits(&ForceCommand { force_n, ..ForceCommand::default() }, &self.limits)
        } else {
            within_limits(wanted, &self.faded_limits())
        };
        let (before, wanted) = (at_ports(&self.previous), at_ports(&wanted));
        let toward: [DVec3; N_PORTS] =
            std::array::from_fn(|i| before[i] + (wanted[i] - before[i]).clamp_length_max(rates[i]));
        let let_go: [DVec3; N_PORTS] = std::array::from_fn(|i| before[i].move_towards(DVec3::ZERO, rates[i]));
        let share = match self.control {
            EnergyControl::ObserveOnly => 1.0,
            EnergyControl::Tank if is_overdrawn => 1.0,
            EnergyControl::Tank => self.paid_share(&let_go, &toward, &rates, dt_s),
        };
        let given: [DVec3; N_PORTS] = std::array::from_fn(|i| let_go[i] + (toward[i] - let_go[i]) * share);
        let [force_n, torque_n_m, jaw] = given;
        let command = ForceCommand { force_n, torque_n_m, jaw_force_n: jaw.x };
        let newest = self.settings.loop_delay_ticks;
        for (port, of) in self.ports.iter_mut().zip(given) {
            port.pending[newest] = of;
        }
        self.previous = command;
        (command, share)
    }

    fn faded_limits(&self) -> DeviceLimits {
        let left = match self.control {
            EnergyControl::Tank => 1.0 - self.shortage(),
            EnergyControl::ObserveOnly => 1.0,
        };
        DeviceLimits {
            force_n: self.limits.force_n * left,
            torque_n_m: self.limits.torque_n_m * left,
            jaw_force_n: self.limits.jaw_force_n * left,
            ..self.limits
        }
    }

    fn paid_share(
        &self,
        from: &[DVec3; N_PORTS],
        to: &[DVec3; N_PORTS],
        rates: &[f64; N_PORTS],
        dt_s: f64,
    ) -> f64 {
        let delay = self.settings.loop_delay_ticks;
        let pending_j: f64 = self.ports.iter().map(|port| port.pending_cost_j(delay, dt_s)).sum();
        let is_paid = |share: f64| {
            let cost_j: f64 = (0..N_PORTS)
                .map(|i| self.ports[i].cost_j(from[i] + (to[i] - from[i]) * share, delay, rates[i], dt_s))
                .sum();
            pending_j + cost_j <= self.level_j
        };
        if is_paid(1.0) {
            return 1.0;
        }
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..SEARCH_STEPS {
            let middle = 0.5 * (low + high);
            if is_paid(middle) { low = middle } else { high = middle }
        }
        low
    }
}
