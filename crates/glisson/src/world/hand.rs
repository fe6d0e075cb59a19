//! How a user's hand holds an instrument: by springs and dampers of six axes, up to a greatest force and torque.
//!
//! Three act between where the hand wants the tip and where it is, and three between how the hand wants the instrument turned and
//! how it is, about the tip. A step of length s moves a tip that nothing touches from x behind the hand to x T/(s + T), with the
//! damping over the stiffness T; the turn behind the hand, a rotation vector, likewise. Through a trocar an instrument turns with
//! its tip: there the three turning axes have no effect.

use crate::math::DVec3;
use crate::tool::Tool;

/// How a user's hand holds an instrument: by a spring and a damper between where the hand wants it and where it is. The hand gives
/// way at the greatest force, and at the greatest torque.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hand {
    /// Stiffness of the spring [N/m].
    pub stiffness_n_per_m: f64,
    /// Damping over stiffness: the time in which a tip that nothing holds comes back to the hand [s].
    pub return_time_s: f64,
    /// Greatest force [N].
    pub greatest_force_n: f64,
    /// Stiffness of the spring that holds how the instrument is turned about its tip [N m/rad].
    pub rotational_stiffness_n_m_per_rad: f64,
    /// Damping over stiffness of that: the time in which an instrument that nothing holds turns back [s].
    pub rotational_return_time_s: f64,
    /// Greatest torque about the tip [N m].
    pub greatest_torque_n_m: f64,
}

impl Default for Hand {
    /// 30 N; a spring that gives way by 0.1 mm for 1 N, and a damper that brings the tip back to the hand in some milliseconds.
    /// 1 N m; a spring that gives way by 0.1 rad for that, as if the two springs of 10 N/mm stood 32 mm from the axis, which is where
    /// 30 N make 1 N m. Choices.
    fn default() -> Self {
        Self {
            stiffness_n_per_m: 1e4,
            return_time_s: 2e-3,
            greatest_force_n: 30.0,
            rotational_stiffness_n_m_per_rad: 10.0,
            rotational_return_time_s: 2e-3,
            greatest_torque_n_m: 1.0,
        }
    }
}

impl Hand {
    /// Force that moves the tip by a metre against the hand in a step of `dt_s` [N/m].
    pub(super) fn step_stiffness_n_per_m(&self, dt_s: f64) -> f64 {
        self.stiffness_n_per_m * (1.0 + self.return_time_s / dt_s)
    }

    /// What of a tip's way behind the hand the damper leaves after a step of `dt_s` in which nothing touches it [m]. A hand that
    /// gave way has its grip further along: what was beyond the greatest force does not count.
    pub(super) fn left_behind_m(&self, behind_m: DVec3, dt_s: f64) -> DVec3 {
        let felt_m = behind_m.clamp_length_max(self.greatest_force_n / self.stiffness_n_per_m);
        felt_m * (self.return_time_s / (dt_s + self.return_time_s))
    }

    /// How far the tip may stay behind the hand before the hand gives way [m].
    pub(super) fn most_behind_m(&self, dt_s: f64) -> f64 {
        self.greatest_force_n / self.step_stiffness_n_per_m(dt_s)
    }

    /// How far any place of an instrument can be pushed in a step against its hand [m].
    pub(super) fn most_pushed_m(&self, tool: &Tool, dt_s: f64) -> f64 {
        let turns_rad = if tool.trocar_m.is_none() { self.most_turned_rad(dt_s) } else { 0.0 };
        self.most_behind_m(dt_s) + turns_rad * tool.shaft_length_m
    }

    /// Torque that turns the instrument by a radian against the hand in a step of `dt_s` [N m/rad].
    pub(super) fn step_stiffness_n_m_per_rad(&self, dt_s: f64) -> f64 {
        self.rotational_stiffness_n_m_per_rad * (1.0 + self.rotational_return_time_s / dt_s)
    }

    /// The same as [`Hand::left_behind_m`] of a turn behind the hand, as rotation vectors [rad].
    pub(super) fn left_turned_rad(&self, turned_rad: DVec3, dt_s: f64) -> DVec3 {
        let most_rad = self.greatest_torque_n_m / self.rotational_stiffness_n_m_per_rad;
        let felt_rad = turned_rad.clamp_length_max(most_rad);
        felt_rad * (self.rotational_return_time_s / (dt_s + self.rotational_return_time_s))
    }

    /// How far the instrument may stay turned behind the hand before the hand gives way [rad].
    pub(super) fn most_turned_rad(&self, dt_s: f64) -> f64 {
        self.greatest_torque_n_m / self.step_stiffness_n_m_per_rad(dt_s)
    }
}
