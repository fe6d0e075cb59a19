//! Motions to counts of the encoders and back, and velocities from counts.

use super::{OWN, PROTOTYPE, dashed, figure, line, places};
use crate::validate::{Experiment, Outcome};
use glisson::haptics::trocar::encoders::{VelocityEstimate, counts_at};
use glisson::haptics::trocar::{EncoderSample, JointReader, N_AXES, TrocarJoints, TrocarProfile};
use glisson::math::SeededRandom;

fn sample(profile: &TrocarProfile, joints: &TrocarJoints, zero_steps: &[f64; N_AXES]) -> EncoderSample {
    let at = |values: [f64; N_AXES]| {
        std::array::from_fn(|i| counts_at(values[i], profile.resolution[i], zero_steps[i]))
    };
    EncoderSample { counts: at(joints.to_array()), mark_counts: at([0.0; N_AXES]), is_marked: [true; N_AXES] }
}

/// Somewhere within a step of `joints`: the limits of a range are whole numbers of steps, most places are not.
fn between_steps(profile: &TrocarProfile, joints: &TrocarJoints, random: &mut SeededRandom) -> TrocarJoints {
    let values = TrocarJoints {
        self_rotation_rad: random.uniform_in(-7.0, 7.0),
        jaw_opening: random.uniform(),
        ..*joints
    }
    .to_array();
    let moved = std::array::from_fn(|i| values[i] + random.uniform_in(-1.0, 1.0) * profile.resolution[i]);
    profile.within(&TrocarJoints::from_array(moved))
}

/// Counts and back, and velocities from counts.
pub(super) fn experiments(outcome: &mut Outcome) {
    let mut random = SeededRandom::new(53);
    let mut resolutions = Vec::new();
    for profile in [TrocarProfile::built(), TrocarProfile::specified()] {
        let (mut off_steps, mut off_tip) = (0.0_f64, 0.0_f64);
        for joints in places(&profile) {
            let joints = between_steps(&profile, &joints, &mut random);
            let zero_steps: [f64; N_AXES] = std::array::from_fn(|_| random.uniform_in(-1e4, 1e4));
            let mut reader = JointReader::new(profile);
            let Ok(found) = reader.read(&sample(&profile, &joints, &zero_steps), 1e-3) else {
                off_steps = f64::INFINITY;
                continue;
            };
            let values = found.joints.to_array().into_iter().zip(joints.to_array());
            for ((found, wanted), step) in values.zip(profile.resolution) {
                off_steps = off_steps.max((found - wanted).abs() / step);
            }
            let tip_m = found.joints.pose().tip_m.distance(joints.pose().tip_m);
            off_tip = off_tip.max(tip_m / profile.tip_resolution_m(joints.insertion_m));
        }
        let name = profile.name;
        outcome.experiments.extend([
            Experiment::at_most(
                &format!("{name}: motions to counts and back over the workspace: largest difference [steps]"),
                PROTOTYPE,
                off_steps,
                1.0 + 1e-9,
            ),
            Experiment::at_most(
                &format!(
                    "{name}: the tip from counts: largest difference over one step of all encoders upright"
                ),
                OWN,
                off_tip,
                // A step of pitch or roll moves a tilted direction at most as much as an upright one, times sqrt 2
                // where the two add up.
                2.0_f64.sqrt(),
            ),
        ]);
        let depths = (0..=60).map(|k| f64::from(k) / 60.0 * profile.insertion_limit_m);
        let points = depths.map(|r| [1e3 * r, 1e3 * profile.tip_resolution_m(r)]).collect();
        resolutions.push(line(name, points));
    }
    outcome.figures.push(figure(
        "active_trocar_resolution.svg",
        "How far the tip moves before the encoders see it: pitch, roll and insertion one step each.",
        ["Resolution at the tip", "insertion [mm]", "smallest step seen [mm]"],
        resolutions,
    ));
    velocities(outcome);
}

/// A sinusoid of 20 mm/s along the instrument, as palpation has.
fn velocities(outcome: &mut Outcome) {
    const PEAK_M_PER_S: f64 = 0.02;
    const PERIOD_S: f64 = 2.0;
    let profile = TrocarProfile::built();
    let tick_s = 1.0 / profile.rate_hz;
    let step_m = profile.resolution[2];
    let mut estimate = VelocityEstimate::default();
    let (mut of_estimate, mut of_difference, mut n) = (0.0, 0.0, 0);
    let (mut series, mut before) = ([Vec::new(), Vec::new()], 0.0);
    for k in 0..2000 {
        let angle = std::f64::consts::TAU * f64::from(k) * tick_s / PERIOD_S;
        let (at_m, true_m_per_s) =
            (-PEAK_M_PER_S * PERIOD_S / std::f64::consts::TAU * angle.cos(), PEAK_M_PER_S * angle.sin());
        let steps = (at_m / step_m).floor();
        let found = estimate.push(steps, tick_s) * step_m;
        let difference = if k == 0 { 0.0 } else { (steps - before) * step_m / tick_s };
        before = steps;
        if k >= 100 {
            of_estimate += (found - true_m_per_s).powi(2);
            of_difference += (difference - true_m_per_s).powi(2);
            n += 1;
        }
        let t = f64::from(k) * tick_s;
        series[0].push([t, 1e3 * found]);
        series[1].push([t, 1e3 * true_m_per_s]);
    }
    let rms = |sum: f64| (sum / f64::from(n)).sqrt() / PEAK_M_PER_S;
    outcome.experiments.push(Experiment::at_most(
        "built: velocity from counts of 0.1 mm at 1 kHz, 20 mm/s sinusoid: RMS error over the peak",
        "Janabi-Sharifi, Hayward and Chen 2000",
        rms(of_estimate),
        0.1,
    ));
    outcome.notes +=
        &format!("\nThe same by differences from tick to tick: {:.2} times the peak.\n", rms(of_difference));
    let [found, wanted] = series;
    outcome.figures.push(figure(
        "active_trocar_velocity.svg",
        "Velocity of the insertion from counts of 0.1 mm, a thousand a second, while it moves as in palpation.",
        ["Velocity from counts", "time [s]", "velocity [mm/s]"],
        vec![line("from counts", found), dashed("true", wanted)],
    ));
}
