//! Virtual coupling: a spring and a damper between the device's handle and the tool in the simulation.
//!
//! The hand does not hold the tool but a spring to it (J. E. Colgate, M. C. Stanley and J. M. Brown, Issues in the haptic
//! display of tool use, IROS 1995; R. J. Adams and B. Hannaford, Stable haptic interaction with virtual environments, IEEE
//! Transactions on Robotics and Automation 15(3), 1999). Whatever the tissue does, the device then never has to render more
//! than the coupling's stiffness K_c and damping B_c, which are chosen within what it can.
//!
//! The tool has no mass. At every tick it goes where coupling and tissue balance, by one step of backward Euler on the tissue's
//! tangent K at the tool:
//!
//! `(K_c + B_c/dt + K) y = K_c (h - x) + (B_c/dt) (h - h_before) + F`, tool `x + y`, force on the hand `F - K y`
//!
//! with the handle at h, the tool at x and the tissue's force F there. In free space the tool is at the handle and there is no
//! force.

use super::device::DeviceLimits;
use crate::math::{DMat3, DVec3};

/// Largest stiffness [N/m] that a sampled device renders passively, K = 2 (b - |B|)/T: `device_damping_n_s_per_m` is its own
/// friction b, `virtual_damping_n_s_per_m` the damping B that is commanded, `period_s` the time T between two ticks; 0 where
/// B alone is too much (J. E. Colgate and G. G. Schenkel, Passivity of a class of sampled-data systems: application to haptic
/// interfaces, Journal of Robotic Systems 14(1), 1997: b > K T/2 + |B|).
pub fn renderable_stiffness_n_per_m(
    device_damping_n_s_per_m: f64,
    virtual_damping_n_s_per_m: f64,
    period_s: f64,
) -> f64 {
    (2.0 * (device_damping_n_s_per_m - virtual_damping_n_s_per_m.abs()) / period_s).max(0.0)
}

/// How a device's room for stiffness and damping is divided; the sum is at most one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GainShares {
    /// Of its largest stiffness, for the coupling's spring.
    pub stiffness: f64,
    /// Of its largest damping, for the coupling's damper.
    pub damping: f64,
    /// Of its largest damping, for what passivity control injects.
    pub injected: f64,
}

/// A choice: most for the spring, which decides how stiff tissue can feel.
impl Default for GainShares {
    fn default() -> Self {
        Self { stiffness: 0.6, damping: 0.1, injected: 0.3 }
    }
}

/// Gains at the device's handle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CouplingGains {
    /// Of the coupling's spring [N/m].
    pub stiffness_n_per_m: f64,
    /// Of the coupling's damper [N s/m].
    pub damping_n_s_per_m: f64,
    /// Most damping that passivity control adds [N s/m].
    pub injected_damping_n_s_per_m: f64,
}

impl CouplingGains {
    /// Gains within what a device renders: on the straight line between its largest stiffness without damping and its largest
    /// damping without stiffness, which is where Colgate and Schenkel's condition has it. Shares that are negative count as
    /// none, and a sum above one is scaled down.
    pub fn within(limits: &DeviceLimits, shares: &GainShares) -> Self {
        let [stiffness, damping, injected] =
            [shares.stiffness, shares.damping, shares.injected].map(|share| share.max(0.0));
        let scale = 1.0 / (stiffness + damping + injected).max(1.0);
        Self {
            stiffness_n_per_m: stiffness * scale * limits.stiffness_n_per_m,
            damping_n_s_per_m: damping * scale * limits.damping_n_s_per_m,
            injected_damping_n_s_per_m: injected * scale * limits.damping_n_s_per_m,
        }
    }

    /// The share of a device's room that they take: at most 1 for gains that it renders.
    pub fn used_share(&self, limits: &DeviceLimits) -> f64 {
        let share = |of: f64, most: f64| if of > 0.0 { of / most } else { 0.0 };
        share(self.stiffness_n_per_m, limits.stiffness_n_per_m)
            + share(self.damping_n_s_per_m + self.injected_damping_n_s_per_m, limits.damping_n_s_per_m)
    }
}

/// The tissue at the tool, to first order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TissueTangent {
    /// Its force on the tool [N].
    pub force_n: DVec3,
    /// How that falls when the tool moves on [N/m]: symmetric, not negative.
    pub stiffness_n_per_m: DMat3,
    /// Outward normal of tissue that can push only; zero where it pulls too.
    pub pushes_along: DVec3,
}

impl TissueTangent {
    /// No tissue.
    pub const NONE: Self =
        Self { force_n: DVec3::ZERO, stiffness_n_per_m: DMat3::ZERO, pushes_along: DVec3::ZERO };
}

/// A tool that hangs on the handle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Coupling {
    stiffness_n_per_m: f64,
    damping_n_s_per_m: f64,
    tool_m: DVec3,
    handle_m: DVec3,
}

impl Coupling {
    /// A coupling of these gains [N/m, N s/m], which have to be positive and not negative; the tool is at `handle_m`.
    pub fn new(stiffness_n_per_m: f64, damping_n_s_per_m: f64, handle_m: DVec3) -> Self {
        Self { stiffness_n_per_m, damping_n_s_per_m, tool_m: handle_m, handle_m }
    }

    /// Puts tool and handle there [m], the spring slack.
    pub fn restart(&mut self, handle_m: DVec3) {
        (self.tool_m, self.handle_m) = (handle_m, handle_m);
    }

    /// Where the tool is [m].
    pub fn tool_m(&self) -> DVec3 {
        self.tool_m
    }

    /// What the spring holds [J].
    pub fn stored_j(&self) -> f64 {
        0.5 * self.stiffness_n_per_m * (self.handle_m - self.tool_m).length_squared()
    }

    /// Moves the tool for a tick of `dt_s` [s] in which the handle came to `handle_m` [m]; the force on the hand [N].
    ///
    /// Tissue that pushes only and that the tool leaves in this tick does not hold it back.
    pub fn step(&mut self, handle_m: DVec3, tissue: &TissueTangent, dt_s: f64) -> DVec3 {
        let damper_n_per_m = self.damping_n_s_per_m / dt_s;
        let pull_n =
            (handle_m - self.tool_m) * self.stiffness_n_per_m + (handle_m - self.handle_m) * damper_n_per_m;
        let own_n_per_m = self.stiffness_n_per_m + damper_n_per_m;
        let sum = DMat3::from_diagonal(DVec3::splat(own_n_per_m)) + tissue.stiffness_n_per_m;
        let mut moved_m = sum.inverse() * (pull_n + tissue.force_n);
        let mut force_n = tissue.force_n - tissue.stiffness_n_per_m * moved_m;
        let leaves = force_n.dot(tissue.pushes_along) < 0.0 && tissue.force_n.dot(tissue.pushes_along) >= 0.0;
        if leaves {
            moved_m = pull_n / own_n_per_m;
            force_n = DVec3::ZERO;
        }
        self.tool_m += moved_m;
        self.handle_m = handle_m;
        force_n
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: DeviceLimits = DeviceLimits {
        force_n: 3.3,
        torque_n_m: 0.0,
        force_rate_n_per_s: 1000.0,
        stiffness_n_per_m: 1000.0,
        damping_n_s_per_m: 2.0,
        resolution_m: 5e-5,
        rate_hz: 1000.0,
        ..DeviceLimits::NONE
    };

    #[test]
    fn gains_stay_within_what_a_device_renders() {
        let gains = CouplingGains::within(&LIMITS, &GainShares::default());
        assert!((gains.stiffness_n_per_m - 600.0).abs() < 1e-9);
        assert!((gains.used_share(&LIMITS) - 1.0).abs() < 1e-12);
        let greedy = GainShares { stiffness: 2.0, damping: 1.0, injected: -5.0 };
        let gains = CouplingGains::within(&LIMITS, &greedy);
        assert!((gains.used_share(&LIMITS) - 1.0).abs() < 1e-12 && gains.injected_damping_n_s_per_m == 0.0);
        let stiff_only = DeviceLimits { damping_n_s_per_m: 0.0, ..LIMITS };
        let gains = CouplingGains::within(&stiff_only, &GainShares::default());
        assert!(gains.damping_n_s_per_m == 0.0 && gains.used_share(&stiff_only) <= 1.0);
    }

    /// A sampled and held spring against the zigzag at half the sampling rate, the motion that draws most from it: it gives
    /// 2 K A^2 a tick, and the device's damper takes b (2 A/T)^2 T.
    #[test]
    fn the_passive_limit_is_where_a_zigzag_draws_nothing() {
        let (damping, period_s, amplitude_m) = (0.7, 1e-3, 1e-4);
        let net_j = |stiffness: f64| {
            let mut x_m = amplitude_m;
            (0..100)
                .map(|_| {
                    let to_m = -x_m;
                    let work_j = -stiffness * x_m * (to_m - x_m);
                    let lost_j = damping * (to_m - x_m) * (to_m - x_m) / period_s;
                    x_m = to_m;
                    lost_j - work_j
                })
                .sum::<f64>()
        };
        let limit = renderable_stiffness_n_per_m(damping, 0.0, period_s);
        assert!((limit - 1400.0).abs() < 1e-9);
        assert!(net_j(0.999 * limit) > 0.0 && net_j(1.001 * limit) < 0.0);
        assert!((renderable_stiffness_n_per_m(damping, -0.2, period_s) - 1000.0).abs() < 1e-9);
        assert_eq!(renderable_stiffness_n_per_m(damping, 0.8, period_s), 0.0);
    }

    #[test]
    fn coupling_and_tissue_are_springs_in_series() {
        let tissue_n_per_m = DVec3::new(200.0, 500.0, 2000.0);
        let mut coupling = Coupling::new(600.0, 0.2, DVec3::ZERO);
        let handle_m = DVec3::new(1e-3, -2e-3, 3e-3);
        let mut force_n = DVec3::ZERO;
        for _ in 0..50 {
            let tissue = TissueTangent {
                force_n: -tissue_n_per_m * coupling.tool_m(),
                stiffness_n_per_m: DMat3::from_diagonal(tissue_n_per_m),
                pushes_along: DVec3::ZERO,
            };
            force_n = coupling.step(handle_m, &tissue, 1e-3);
        }
        let series = 600.0 * tissue_n_per_m / (tissue_n_per_m + DVec3::splat(600.0));
        assert!((force_n + series * handle_m).length() < 1e-9, "{force_n}");
        let stretch_m = force_n / 600.0;
        assert!((coupling.stored_j() - 300.0 * stretch_m.length_squared()).abs() < 1e-12);
    }

    #[test]
    fn free_the_tool_is_at_the_handle_and_pulls_nothing() {
        let mut coupling = Coupling::new(600.0, 0.2, DVec3::ZERO);
        for i in 0..20 {
            let handle_m = DVec3::new(1e-3, 2e-3, -1e-3) * f64::from(i);
            assert_eq!(coupling.step(handle_m, &TissueTangent::NONE, 1e-3), DVec3::ZERO);
            assert!((coupling.tool_m() - handle_m).length() < 1e-15);
        }
    }

    #[test]
    fn tissue_that_pushes_only_lets_the_tool_go() {
        let mut coupling = Coupling::new(600.0, 0.2, DVec3::Z * -1e-5);
        let tissue = TissueTangent {
            force_n: DVec3::Z * 0.02,
            stiffness_n_per_m: DMat3::IDENTITY * 2000.0,
            pushes_along: DVec3::Z,
        };
        let force_n = coupling.step(DVec3::Z * 1e-3, &tissue, 1e-3);
        assert_eq!(force_n, DVec3::ZERO);
        assert!(coupling.tool_m().z > 9e-4);
    }
}
