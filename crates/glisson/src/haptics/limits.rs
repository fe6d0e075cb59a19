//! What a device may be asked for, and how force comes and goes.
//!
//! A gate between 0 and 1 stands before every force. It opens along a straight line at the start, after the device was away and
//! after the simulation stood still, and closes in the same way when the simulation's model is too old, the device does not
//! answer or the handle is moved aside. Its way takes long enough that the device's largest force changes by no more than
//! [`GATE_RATE_N_PER_S`], and never less than [`LEAST_RAMP_S`].
//!
//! A tick that comes late writes once all the same: what ramps goes no further in it than in one period ([`within_period_s`]).

use super::device::{DeviceLimits, ForceCommand};
use crate::math::DVec3;

/// Fastest change of force [N/s] by a gate: 0.04 N in a millisecond, where 0.05 N is the requirement.
pub const GATE_RATE_N_PER_S: f64 = 40.0;
/// Shortest way of a gate [s]: a choice; the requirement is 0.02.
pub const LEAST_RAMP_S: f64 = 0.1;

/// Opens and closes the way of forces to the hand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gate {
    share: f64,
    ramp_s: f64,
}

impl Gate {
    /// A closed gate for forces up to `force_n` [N].
    pub fn for_force(force_n: f64) -> Self {
        Self { share: 0.0, ramp_s: (force_n / GATE_RATE_N_PER_S).max(LEAST_RAMP_S) }
    }

    /// The share of force that passes.
    pub fn share(&self) -> f64 {
        self.share
    }

    /// Time [s] from closed to open.
    pub fn ramp_s(&self) -> f64 {
        self.ramp_s
    }

    /// Opens, or closes, for a tick of `dt_s` [s].
    pub fn advance(&mut self, opens: bool, dt_s: f64) {
        let way = dt_s / self.ramp_s;
        self.share = if opens { (self.share + way).min(1.0) } else { (self.share - way).max(0.0) };
    }

    /// Closes at once.
    pub fn shut(&mut self) {
        self.share = 0.0;
    }
}

/// Time [s] by which ramps go on in a tick that came `dt_s` [s] after the last one, where `period_s` [s] was expected (0 when
/// nothing was): a hand feels a write at once, however long nothing was written before it.
pub fn within_period_s(dt_s: f64, period_s: f64) -> f64 {
    if period_s > 0.0 { dt_s.min(period_s) } else { dt_s }
}

/// A vector of at most this length, in the same direction; zero for one that is not finite.
pub fn saturated(vector: DVec3, most: f64) -> DVec3 {
    if vector.is_finite() { vector.clamp_length_max(most.max(0.0)) } else { DVec3::ZERO }
}

/// A command within a device's force and torque and that of its jaws.
pub fn within_limits(command: &ForceCommand, limits: &DeviceLimits) -> ForceCommand {
    let jaw_force_n = if command.jaw_force_n.is_finite() { command.jaw_force_n } else { 0.0 };
    ForceCommand {
        force_n: saturated(command.force_n, limits.force_n),
        torque_n_m: saturated(command.torque_n_m, limits.torque_n_m),
        jaw_force_n: jaw_force_n.clamp(-limits.jaw_force_n, limits.jaw_force_n),
    }
}

/// Largest change in a tick of `dt_s` [s] of force [N], torque [N m] and the jaws' force [N]. The others may change in the time
/// in which force may.
pub fn rates_of(limits: &DeviceLimits, dt_s: f64) -> [f64; 3] {
    let force_n = (limits.force_rate_n_per_s * dt_s).min(limits.force_n);
    let share = if limits.force_n > 0.0 { force_n / limits.force_n } else { 0.0 };
    [force_n, limits.torque_n_m * share, limits.jaw_force_n * share]
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: DeviceLimits = DeviceLimits {
        force_n: 8.0,
        torque_n_m: 0.2,
        jaw_force_n: 4.0,
        force_rate_n_per_s: 1000.0,
        stiffness_n_per_m: 1000.0,
        damping_n_s_per_m: 2.0,
        resolution_m: 5e-5,
        rate_hz: 1000.0,
        ..DeviceLimits::NONE
    };

    #[test]
    fn a_gate_is_slow_enough_for_the_largest_force() {
        for force_n in [0.1, 3.3, 8.0, 40.0] {
            let mut gate = Gate::for_force(force_n);
            let mut before = gate.share();
            let mut ticks = 0;
            while gate.share() < 1.0 {
                gate.advance(true, 1e-3);
                assert!((gate.share() - before) * force_n <= 0.04 + 1e-12);
                before = gate.share();
                ticks += 1;
            }
            assert!(ticks >= 99, "{ticks}");
            gate.advance(false, 1e-3);
            assert!(gate.share() < 1.0);
            gate.advance(false, 10.0);
            assert_eq!(gate.share(), 0.0);
        }
    }

    #[test]
    fn a_late_tick_ramps_no_further_than_one_period() {
        assert_eq!(within_period_s(0.1, 1e-3), 1e-3);
        assert_eq!(within_period_s(0.9e-3, 1e-3), 0.9e-3);
        assert_eq!(within_period_s(2e-3, 0.0), 2e-3);
    }

    #[test]
    fn commands_keep_their_direction_and_never_exceed_a_limit() {
        let wanted = ForceCommand {
            force_n: DVec3::new(30.0, 0.0, 40.0),
            torque_n_m: DVec3::new(f64::NAN, 0.0, 0.0),
            jaw_force_n: -20.0,
        };
        let given = within_limits(&wanted, &LIMITS);
        assert!((given.force_n - DVec3::new(4.8, 0.0, 6.4)).length() < 1e-12);
        assert_eq!(given.torque_n_m, DVec3::ZERO);
        assert_eq!(given.jaw_force_n, -4.0);
        assert_eq!(rates_of(&LIMITS, 1e-3), [1.0, 0.025, 0.5]);
        let at_once = DeviceLimits { force_rate_n_per_s: f64::INFINITY, ..LIMITS };
        assert_eq!(rates_of(&at_once, 1e-3), [8.0, 0.2, 4.0]);
    }
}
