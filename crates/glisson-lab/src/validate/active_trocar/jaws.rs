//! Jaws that close on something: the handle is held open by the jaw motor, and gives no energy.

use super::closed_loop::{Station, TICK_S, fault};
use super::law_loop::{Loop, PRESS_S};
use crate::validate::{Experiment, Outcome};
use glam::DVec3;
use glisson::haptics::trocar::mechanism::Mechanism;
use glisson::haptics::trocar::{Mapping, Placement, TrocarJoints, TrocarProfile};
use glisson::haptics::{AxesModel, ForceCommand, HapticDevice, HapticModel, Touch};
use glisson::tool::ToolInput;

/// What jaws are squeezed by: nothing above this opening, a straight line below it [J for the whole way].
const SLACK: f64 = 0.35;
const SQUEEZE_J: f64 = 0.3;
/// Openings between which the hand closes them.
const OPEN: f64 = 0.5;
const CLOSED_TO: f64 = 0.05;
const INSERTION_M: f64 = 0.1;

/// What is squeezed, as a simulation publishes it.
fn squeezed(step: u64, tool: &ToolInput) -> HapticModel {
    let is_squeezed = tool.jaw_opening < SLACK;
    let axes = AxesModel {
        jaw_j: SQUEEZE_J * (SLACK - tool.jaw_opening).max(0.0),
        jaw_opening: tool.jaw_opening,
        jaw_stiffness_j: if is_squeezed { SQUEEZE_J } else { 0.0 },
        roll_rad: tool.roll_rad,
        ..AxesModel::default()
    };
    let touch = if is_squeezed { Touch::Grasp } else { Touch::Free };
    HapticModel { step, touch, tip_m: tool.tip_in_world_m, gap_m: 1.0, axes, ..HapticModel::default() }
}

/// Force of the jaw motor [N].
#[derive(Default)]
struct JawForce {
    last_n: f64,
    /// Its largest change in a tick.
    jump_n: f64,
}

/// The hand closes the jaws and holds them.
fn close(run: &mut Loop, start: &TrocarJoints) -> anyhow::Result<JawForce> {
    let mut force = JawForce::default();
    for k in 0..2000_u32 {
        let share = (f64::from(k) * TICK_S / PRESS_S).min(1.0);
        let target = TrocarJoints { jaw_opening: OPEN + (CLOSED_TO - OPEN) * share, ..*start };
        run.tick(k, target, &mut |tool| squeezed(u64::from(k), tool))?;
        let jaw_n = run.station.device.commanded().jaw_n;
        force.jump_n = force.jump_n.max((jaw_n - force.last_n).abs());
        force.last_n = jaw_n;
    }
    Ok(force)
}

/// Opening, and force of the motor [N], where the hand's spring balances what is squeezed, both over the handle's way.
fn balance(mechanism: &Mechanism) -> (f64, f64) {
    let travel_m = mechanism.profile.jaw_travel_m;
    let hand_n_per_m = mechanism.motions[4].hand_stiffness;
    let (hand_j, squeeze_j) = (hand_n_per_m * travel_m * travel_m, SQUEEZE_J);
    let opening = (hand_j * CLOSED_TO + squeeze_j * SLACK) / (hand_j + squeeze_j);
    (opening, squeeze_j * (SLACK - opening) / travel_m)
}

pub(super) fn experiments(outcome: &mut Outcome) -> anyhow::Result<()> {
    let start = TrocarJoints { insertion_m: INSERTION_M, jaw_opening: OPEN, ..TrocarJoints::default() };
    let placement = Placement::facing(DVec3::ZERO, DVec3::Y);
    let mut run = Loop::new(Station::new(placement, &start, Mapping::VirtualWork)?);
    let force = close(&mut run, &start)?;
    let mechanism = run.station.mechanism();
    let hand_n = -mechanism.hand_efforts()[4];
    let found = mechanism.joints.jaw_opening;
    let (opening, exact_n) = balance(mechanism);
    outcome.experiments.extend([
        Experiment::near(
            "jaws that close on something soft: force of the jaw motor [N]",
            "the balance of two springs",
            force.last_n,
            exact_n,
            0.02 * exact_n,
        ),
        Experiment::near(
            "the same: what the hand holds against [N]",
            "the same",
            hand_n,
            exact_n,
            0.02 * exact_n,
        ),
        Experiment::near("the same: opening of the jaws", "the same", found, opening, 0.005),
        Experiment::at_most(
            "the same: largest change of the force in a tick [N]",
            "0.04 N, and what the jaws' motion explains",
            force.jump_n,
            0.06,
        ),
        run.bound_row("the same"),
    ]);
    let command = ForceCommand { jaw_force_n: 100.0, ..ForceCommand::default() };
    run.station.device.write(&command).map_err(fault)?;
    outcome.experiments.push(Experiment::near(
        "100 N asked of the jaw motor: given [N]",
        "the profile's limit",
        run.station.device.commanded().jaw_n,
        TrocarProfile::built().limits.jaw_n,
        1e-12,
    ));
    Ok(())
}
