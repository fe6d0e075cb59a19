//! What each mapping of forces to motors makes the hand feel.

use super::{DEPTH_M, EXACT, dashed, figure, line, places, tilted, tip_wrench};
use crate::validate::{Experiment, Figure, Outcome};
use glam::DVec3;
use glisson::haptics::trocar::statics::{efforts, felt};
use glisson::haptics::trocar::{Mapping, TrocarJoints, TrocarProfile};
use glisson::math::SeededRandom;

/// The largest tilt that is drawn [degrees].
const MOST_TILT_DEG: i32 = 45;

/// Largest relative difference between a force at the tip and what an ideal mechanism makes of it.
fn largest_difference(mapping: Mapping, joints: &TrocarJoints) -> f64 {
    let mut random = SeededRandom::new(52);
    let mut worst = 0.0_f64;
    for _ in 0..500 {
        let force_n = DVec3::new(random.normal(), random.normal(), random.normal()).normalize();
        let told = efforts(mapping, joints, &tip_wrench(joints, force_n), 0.0);
        worst = worst.max(felt(joints, &told).force_n.distance(force_n));
    }
    worst
}

/// The tip half-way in.
fn half_way(pitch_deg: f64, roll_deg: f64) -> TrocarJoints {
    TrocarJoints { insertion_m: DEPTH_M, ..tilted([pitch_deg.to_radians(), roll_deg.to_radians()]) }
}

fn claims() -> [Experiment; 2] {
    let exact = places(&TrocarProfile::built())
        .map(|joints| largest_difference(Mapping::VirtualWork, &joints))
        .fold(0.0, f64::max);
    let aside = half_way(0.0, 45.0);
    let across = tip_wrench(&aside, DVec3::Y);
    let [published, by_work] = [Mapping::Thesis, Mapping::VirtualWork]
        .map(|mapping| efforts(mapping, &aside, &across, 0.0).pitch_n_m);
    [
        Experiment::at_most(
            "built: virtual work: force felt through bail, ring and rollers less the force at the tip, relative",
            EXACT,
            exact,
            1e-12,
        ),
        Experiment::near(
            "pitch torque of eq. 5.10 over that of virtual work, roll 45 degrees, force along e_Y",
            "1 / cos^2 of the roll: what C_r e_r would add, if bail and ring could pass it",
            published / by_work,
            2.0,
            1e-12,
        ),
    ]
}

/// A value over whole degrees of tilt.
fn over_tilts(value: impl Fn(f64) -> f64) -> Vec<[f64; 2]> {
    (0..=MOST_TILT_DEG).map(f64::from).map(|d| [d, value(d)]).collect()
}

fn felt_figure() -> Figure {
    let percent = |[pitch_deg, roll_deg]: [f64; 2]| {
        100.0 * largest_difference(Mapping::Thesis, &half_way(pitch_deg, roll_deg))
    };
    figure(
        "active_trocar_felt.svg",
        "What the hand feels of a force at the tip when the equations of the thesis drive an ideal bail and ring: the \
         largest difference over all directions of the force. By virtual work it is zero.",
        [
            "Force felt by the equations of the thesis",
            "tilt [degrees]",
            "largest difference [% of the force]",
        ],
        vec![
            line("pitch or roll alone", over_tilts(|d| percent([0.0, d]))),
            line("pitch and roll alike", over_tilts(|d| percent([d, d]))),
            dashed("virtual work", vec![[0.0, 0.0], [45.0, 0.0]]),
        ],
    )
}

/// The largest force across the instrument in the worst direction before a motor is at its limit [N].
fn bearable_n(mapping: Mapping, joints: &TrocarJoints) -> f64 {
    let limits = TrocarProfile::built().limits;
    let axes = [DVec3::X, DVec3::Y].map(|a| joints.direction().cross(a).normalize());
    let mut least_n = f64::INFINITY;
    for k in 0..180 {
        let (sine, cosine) = f64::from(k).to_radians().sin_cos();
        let across_n = (axes[0] * cosine + axes[1] * sine).reject_from(joints.direction()).normalize();
        let one = efforts(mapping, joints, &tip_wrench(joints, across_n), 0.0);
        for (effort, limit) in one.to_array().into_iter().zip(limits.to_array()).take(4) {
            // Rounding makes no motor work.
            if effort.abs() > 1e-9 {
                least_n = least_n.min(limit / effort.abs());
            }
        }
    }
    least_n
}

fn bearable_figure() -> Figure {
    let curve = |mapping: Mapping, insertion_m: f64| {
        over_tilts(|d| bearable_n(mapping, &TrocarJoints { insertion_m, ..half_way(d, d) }).min(60.0))
    };
    figure(
        "active_trocar_bearable.svg",
        "The largest force across the instrument, in the worst direction, before a motor is at its limit: profile built, \
         pitch and roll alike. By the thesis' equations the self-rotation motor (0.2 N m) saturates first.",
        ["Largest force across the instrument", "pitch = roll [degrees]", "force [N]"],
        vec![
            line("eq. 5.6, tip 0.15 m in", curve(Mapping::Thesis, 0.15)),
            line("eq. 5.6, tip 0.3 m in", curve(Mapping::Thesis, 0.3)),
            line("virtual work, 0.15 m", curve(Mapping::VirtualWork, 0.15)),
            line("virtual work, 0.3 m", curve(Mapping::VirtualWork, 0.3)),
        ],
    )
}

pub(super) fn experiments(outcome: &mut Outcome) {
    outcome.experiments.extend(claims());
    outcome.figures.extend([felt_figure(), bearable_figure()]);
    outcome.notes += "Bail and ring leave the instrument's own axis free, so only the self-rotation motor exerts a \
        moment about it. Equation 5.6 commands C_r = M_Z / cos theta there, although a force on the axis has no such \
        moment, and corrects pitch and roll for it. On an ideal mechanism the hand then feels this:\n\n\
        | pitch, roll [degrees] | largest difference of the force [%] | twist C_r for 1 N across, 0.15 m in [N m] |\n\
        |---|---|---|\n";
    for [pitch, roll] in [[0.0, 0.0], [0.0, 10.0], [0.0, 20.0], [0.0, 45.0], [20.0, 20.0], [45.0, 45.0]] {
        let joints = half_way(pitch, roll);
        let difference = 100.0 * largest_difference(Mapping::Thesis, &joints);
        let [tilt, _] = joints.spherical_rad();
        outcome.notes += &format!("| {pitch}, {roll} | {difference:.1} | {:.3} |\n", DEPTH_M * tilt.tan());
    }
}
