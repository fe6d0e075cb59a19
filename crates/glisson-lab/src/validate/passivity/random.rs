//! Loops with settings drawn at random, with energy control and without.

use super::run::{Case, Run};
use super::{PASSIVE, ROUNDING_J, Summary, UNSTABLE_M, case, on_spring};
use crate::validate::{Claim, Outcome, check_all};
use glisson::haptics::{EnergyControl, ForceEstimate, HandSettings, SimulatedDeviceSettings};
use glisson::math::SeededRandom;

const N_RANDOM: usize = 150;

/// A loop with settings drawn at random.
struct RandomLoop {
    device: SimulatedDeviceSettings,
    hand: HandSettings,
    estimate: ForceEstimate,
    delay_s: f64,
    rate_hz: f64,
    stiffness_n_per_m: f64,
}

impl RandomLoop {
    fn draw(random: &mut SeededRandom, estimate: ForceEstimate) -> Self {
        let device = SimulatedDeviceSettings {
            mass_kg: random.uniform_in(0.04, 0.2),
            damping_n_s_per_m: random.uniform_in(0.3, 2.0),
            friction_n: random.uniform_in(0.0, 0.3),
            force_n: random.uniform_in(2.0, 10.0),
            force_rate_n_per_s: random.uniform_in(500.0, 10_000.0),
            resolution_m: random.uniform_in(0.0, 1e-4),
            noise_m: random.uniform_in(0.0, 1e-5),
            position_latency_ticks: (random.next_u64() % 4) as usize,
            force_latency_ticks: (random.next_u64() % 3) as usize,
            ..SimulatedDeviceSettings::default()
        };
        let hand = HandSettings {
            mass_kg: random.uniform_in(0.05, 0.5),
            grip_stiffness_n_per_m: random.uniform_in(200.0, 2000.0),
            grip_damping_n_s_per_m: random.uniform_in(0.5, 8.0),
            arm_stiffness_n_per_m: random.uniform_in(100.0, 800.0),
            arm_damping_n_s_per_m: random.uniform_in(0.5, 20.0),
        };
        let (delay_s, rate_hz) = (random.uniform_in(0.0, 0.05), random.uniform_in(20.0, 60.0));
        let stiffness_n_per_m = random.uniform_in(50.0, 5000.0);
        Self { device, hand, estimate, delay_s, rate_hz, stiffness_n_per_m }
    }

    fn run(&self, control: EnergyControl) -> Run {
        let Self { device, hand, estimate, delay_s, rate_hz, stiffness_n_per_m } = *self;
        on_spring(&Case { device, hand, delay_s, rate_hz, ..case(estimate, control) }, stiffness_n_per_m)
    }

    /// Of the hand's grip and arm.
    fn spring_n_per_m(&self) -> f64 {
        series(self.hand.grip_stiffness_n_per_m, self.hand.arm_stiffness_n_per_m)
    }

    /// A spring that holds the reserve is so far from rest, to both sides.
    fn swing_bound_m(&self, bound_j: f64) -> f64 {
        2.0 * (-2.0 * bound_j / self.spring_n_per_m()).sqrt()
    }

    /// Its line in the table of those that swing.
    fn row(&self, controlled: &Run, bound_j: f64) -> String {
        format!(
            "| {} | {:.0} | {:.0} | {:.0} | {} | {:.2} | {:.2} | {:.2} | {:.2} |\n",
            self.estimate.name(),
            self.stiffness_n_per_m,
            self.spring_n_per_m(),
            1e3 * self.delay_s,
            self.device.limits().loop_delay_ticks,
            1e3 * controlled.swing_m,
            1e3 * controlled.late_swing_m,
            1e3 * controlled.given_at_rest_j,
            1e3 * self.swing_bound_m(bound_j),
        )
    }
}

/// Totals of the random loops.
#[derive(Default)]
struct RandomLoops {
    with: Summary,
    without: Summary,
    /// Lines of those that swing with control.
    moving: String,
    most_given_j: f64,
    widest_of_bound: f64,
}

impl RandomLoops {
    fn add(&mut self, one: &RandomLoop, bound_j: f64) {
        let controlled = one.run(EnergyControl::Tank);
        self.with.add(&controlled);
        self.most_given_j = self.most_given_j.max(controlled.given_at_rest_j);
        if controlled.swing_m > UNSTABLE_M {
            self.widest_of_bound = self.widest_of_bound.max(controlled.swing_m / one.swing_bound_m(bound_j));
            self.moving += &one.row(&controlled, bound_j);
        }
        self.without.add(&one.run(EnergyControl::ObserveOnly));
    }
}

/// The claims about them; `name` is the first one's.
fn random_claims(name: &str, bound_j: f64) -> [Claim<'_, RandomLoops>; 5] {
    [
        Claim::within(name, PASSIVE, |r| r.with.least_j, [bound_j - ROUNDING_J, 0.0]),
        Claim::at_most(
            "the same: loops whose handle swings by more than 1 mm while the hand wants to rest",
            "as measured: passivity bounds energy, not swings",
            |r| r.with.n_unstable as f64,
            3.0,
        ),
        Claim::at_most(
            "the same: widest of these swings over that of the hand's springs with the reserve in them",
            "2 sqrt(2 E_0/k), k of grip and arm in series",
            |r| r.widest_of_bound,
            1.0,
        ),
        Claim::at_most(
            "the same: most energy that a hand got while it wanted to rest [J]",
            "requirement: no more than the reserve and what was stored: 20 mJ",
            |r| r.most_given_j,
            -2.0 * bound_j,
        ),
        Claim::within(
            "the same: least energy that the actuator in truth had taken [J]",
            "the bound, and what steps and noise of positions (0.16 mm at 10 N: 1.6 mJ) hide when force comes and goes",
            |r| r.with.least_true_j,
            [1.25 * bound_j, 0.0],
        ),
    ]
}

/// Loops with settings drawn at random.
pub(super) fn random_loops(outcome: &mut Outcome, bound_j: f64) {
    let mut random = SeededRandom::new(6);
    let mut loops = RandomLoops::default();
    for index in 0..N_RANDOM {
        let estimate = ForceEstimate::ALL[index % ForceEstimate::ALL.len()];
        loops.add(&RandomLoop::draw(&mut random, estimate), bound_j);
    }
    let name = format!(
        "{N_RANDOM} loops of random devices, hands and tissues with control: least observed energy [J]"
    );
    outcome.experiments.extend(check_all(&random_claims(&name, bound_j), &loops));
    let RandomLoops { with, without, moving, .. } = &loops;
    outcome.notes += &format!(
        "### Random loops\n\n{N_RANDOM} devices (up to 10 N, 0.1 mm, 5 ticks late), hands, tissues (50 to 5000 N/m), delays and rates. With \
         control: least energy {:.2} mJ, {} unstable, greatest acceleration {:.0} m/s2. Without: {:.0} mJ, {} unstable.\n\n",
        1e3 * with.least_j,
        with.n_unstable,
        with.acceleration_m_per_s2,
        1e3 * without.least_j,
        without.n_unstable
    );
    outcome.notes += &format!(
        "What is left of swings with control is fed by the reserve: passivity bounds the energy that a hand gets, and a hand that \
         holds loosely swings wide on little. It dies away. Those above 1 mm, none of them with the local model:\n\n| force from | tissue [N/m] | hand [N/m] | delay [ms] | late by \
         [ticks] | swing at rest [mm] | in the last 0.16 s [mm] | most given at rest [mJ] | swing of the hand's springs with 10 mJ in \
         them [mm] |\n|---|---|---|---|---|---|---|---|---|\n{moving}\n"
    );
}

/// Stiffness of two springs in series [N/m].
fn series(a_n_per_m: f64, b_n_per_m: f64) -> f64 {
    a_n_per_m * b_n_per_m / (a_n_per_m + b_n_per_m)
}
